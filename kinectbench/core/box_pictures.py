"""Pictures of boxes in a recording: all boxes from above, and each box in the frame that shows it best."""

from collections.abc import Sequence as Listed
from dataclasses import dataclass

import cv2
import numpy as np

from kinectbench.core.even_choice import evenly
from kinectbench.core.geometry import OrientedBox, invert_rigid, transform_points
from kinectbench.core.images import png
from kinectbench.core.pictures import INK, SOFT, figure_png, new_figure
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Bools, Float64, Int64, Rgb

PLAN_CELL_M = 0.04
# Higher surface is black.
TALLEST_M = 2.0
# The picture has fewer pixels a side. Of a scene that one wrong pose extends, cells are larger.
MOST_PLAN_CELLS = 2000
# Blue, orange, green, vermilion, purple, sky blue of Okabe and Ito, which colour-blind people distinguish.
COLORS_RGB = ((0, 114, 178), (230, 159, 0), (0, 158, 115), (213, 94, 0), (204, 121, 167), (86, 180, 233))
JUDGED_FRAMES = 60
JUDGED_POINTS = 1500
SEEN_M = 0.05
# A frame counts as occluded if it sees less than this share of what the best frame sees of the object.
MIN_SEEN = 0.5
# A box that is entirely in the image counts more than a few more visible points.
WHOLE_WEIGHT = 2.0
# If two frames show equally much, the nearer frame is chosen: the object is larger in it.
NEARER_BONUS_M = 0.1
# Frames whose scores differ by less than this show an object equally well: the sharpest one wins.
SIMILAR = 0.05
# Used for a frame of unknown blur; blur is relative to the median frame (`relative_blur`).
TYPICAL_BLUR = 1.0
NEAR_M = 0.05
# Edges of a box: pairs of corner indices in the order of `OrientedBox.corners_floor`.
EDGES = ((0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7), (0, 4), (1, 5), (2, 6), (3, 7))


@dataclass(frozen=True)
class ShownBox:
    """An upright box with the surface points inside it, to be drawn into a frame.

    Attributes:
        box: the box, in the frame `floor`.
        points_floor: (n, 3) points of the surface, metres.
        T_world_floor: (4, 4), from the floor frame to the world frame.
    """

    box: OrientedBox
    points_floor: Float64
    T_world_floor: Float64


def plan_picture(
    boxes: Listed[OrientedBox],
    points_floor: Float64,
    focus_floor: Float64,
    T_floor_world: Float64,
    trajectory: Trajectory,
    scale: float = 1.0,
) -> bytes:
    """Draw the surface's heights, numbered boxes and the camera's path from above; return a PNG file.

    Args:
        boxes: the boxes to draw, in the floor frame, numbered from 1.
        points_floor: (n, 3) points of the scene's surface, metres.
        focus_floor: (3,) the point that the cameras look at.
        T_floor_world: (4, 4), from the world to the floor frame.
        trajectory: poses of the frames.
        scale: of the scene, by which its points lie nearer to each other.
    """
    figure = new_figure(7.2, 6.2, "white")
    axes = figure.add_subplot(aspect="equal", xlabel="x of the floor frame, m", ylabel="y, m")
    heights_m, extent_m = _heights(points_floor, PLAN_CELL_M * scale)
    # Boards are as dark as cupboards are, if nothing higher is to choose from.
    top_m = min(max(box.corners_floor()[:, 2].max() for box in boxes), TALLEST_M)
    image = axes.imshow(
        heights_m.T, origin="lower", extent=extent_m, cmap="Greys", vmin=-top_m / 10, vmax=top_m
    )
    figure.colorbar(image, label="height, m", shrink=0.8)
    T_world_camera = trajectory.T_world_camera[trajectory.good_frames]
    path = transform_points(T_floor_world, T_world_camera[:, :3, 3])
    axes.plot(*path[:, :2].T, ":", color=SOFT, linewidth=1)
    axes.plot(*path[0, :2], "o", color=SOFT, markersize=4)
    axes.plot(*focus_floor[:2], "+", color=INK, markersize=10)
    for number, box in enumerate(boxes, start=1):
        color = tuple(channel / 255 for channel in _color(number))
        outline = box.corners_floor()[[0, 2, 6, 4, 0], :2]
        axes.plot(*outline.T, color=color, linewidth=2)
        axes.annotate(
            str(number), outline[0], color="white", fontsize=10, fontweight="bold",
            bbox={"boxstyle": "round,pad=0.2", "facecolor": color, "edgecolor": "none"},
        )  # fmt: skip
    axes.set_title("dotted: the camera's path, o its start, + where it looks", fontsize=9)
    return figure_png(figure)


def box_picture(number: int, shown: ShownBox, sequence: Sequence, trajectory: Trajectory) -> bytes:
    """Draw a box's edges, number and surface points into the frame that shows it best; return a PNG file.

    The frame is drawn in colour if its colour image is as large as its depth image, otherwise as depth.
    """
    frame = best_frame(shown, sequence, trajectory)
    image = _background(sequence, frame)
    T_camera_floor = invert_rigid(trajectory.T_world_camera[frame]) @ shown.T_world_floor
    color = _color(number)
    pixels, _ = _seen(_sampled_world(shown), frame, sequence, trajectory)
    for u, v in pixels.tolist():
        cv2.circle(image, (u, v), 1, color, -1, cv2.LINE_AA)
    for a, b in _edges_px(shown.box, T_camera_floor, sequence):
        cv2.line(image, a, b, (255, 255, 255), 4, cv2.LINE_AA)
        cv2.line(image, a, b, color, 2, cv2.LINE_AA)
    cv2.rectangle(image, (0, 0), (46, 46), color, -1)
    cv2.putText(image, str(number), (12, 34), cv2.FONT_HERSHEY_SIMPLEX, 1.0, (255, 255, 255), 2, cv2.LINE_AA)
    return png(image[..., ::-1])


def best_frame(shown: ShownBox, sequence: Sequence, trajectory: Trajectory) -> int:
    """Return the index of the frame, out of up to 60 evenly spread ones, that shows a box best.

    The score counts how much of the box is in the image, how many surface points are visible, and how near
    the box is. Of frames with similar scores, the sharpest one wins.
    """
    good = trajectory.good_frames
    judged = good[evenly(len(good), JUDGED_FRAMES)]
    points_world = _sampled_world(shown)
    corners_world = transform_points(shown.T_world_floor, shown.box.corners_floor())
    whole, seen, nearness = np.zeros((3, len(judged)))
    for k, frame in enumerate(judged.tolist()):
        whole[k] = _inside(corners_world, frame, sequence, trajectory).mean()
        pixels, distance_m = _seen(points_world, frame, sequence, trajectory)
        seen[k] = len(pixels) / len(points_world)
        nearness[k] = NEARER_BONUS_M / distance_m
    scores = np.where(seen >= MIN_SEEN * seen.max(), WHOLE_WEIGHT * whole + seen + nearness, 0.0)
    blur = {row.frame: row.blur for row in trajectory.health.per_frame} if trajectory.health else {}
    similar = np.flatnonzero(scores > scores.max() - SIMILAR).tolist()
    best = min(similar, key=lambda k: (blur.get(int(judged[k])) or TYPICAL_BLUR, -scores[k]))
    return int(judged[best])


def _sampled_world(shown: ShownBox) -> Float64:
    step = max(1, len(shown.points_floor) // JUDGED_POINTS)
    return transform_points(shown.T_world_floor, shown.points_floor[::step])


def _seen(
    points_world: Float64, frame: int, sequence: Sequence, trajectory: Trajectory
) -> tuple[Int64, float]:
    """Return the pixels (k, 2) of the points that a frame's depth shows, and the mean depth of these points.

    The mean is in metres; it is inf if k is 0.
    """
    points_camera = transform_points(invert_rigid(trajectory.T_world_camera[frame]), points_world)
    points_camera = points_camera[_inside(points_world, frame, sequence, trajectory)]
    pixels = np.rint(sequence.camera.project(points_camera)).astype(np.int64)
    z_m = points_camera[:, 2]
    depth_m = sequence.depth_m(frame)[pixels[:, 1], pixels[:, 0]]
    seen = (depth_m > 0) & (np.abs(depth_m - z_m) < SEEN_M)
    return pixels[seen], float(z_m[seen].mean()) if seen.any() else np.inf


def _inside(points_world: Float64, frame: int, sequence: Sequence, trajectory: Trajectory) -> Bools:
    """Whether each point (n, 3) lies in front of the camera and projects into the image: (n,) bool."""
    points_camera = transform_points(invert_rigid(trajectory.T_world_camera[frame]), points_world)
    ahead = points_camera[:, 2] > NEAR_M
    pixels = np.rint(sequence.camera.project(np.where(ahead[:, None], points_camera, 1.0)))
    size_px = np.array([sequence.camera.width, sequence.camera.height])
    return np.asarray(ahead & np.all((pixels >= 0) & (pixels < size_px), axis=1))


def _background(sequence: Sequence, frame: int) -> Rgb:
    """Return a frame in colour, or its depth in grey, darker farther away: (height, width, 3) uint8 RGB."""
    shape = (sequence.camera.height, sequence.camera.width)
    color_rgb = sequence.color_rgb(frame)
    if color_rgb is not None and color_rgb.shape[:2] == shape:
        return np.ascontiguousarray(color_rgb)
    depth_m = sequence.depth_m(frame)
    grey = np.where(depth_m > 0, np.clip(255 - 60 * depth_m, 20, 255), 0).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def _edges_px(
    box: OrientedBox, T_camera_floor: Float64, sequence: Sequence
) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Project the parts of a box's edges in front of the camera; return their end pixels ((u, v), (u, v))."""
    corners = transform_points(T_camera_floor, box.corners_floor())
    lines = []
    for a, b in ((corners[i], corners[j]) for i, j in EDGES):
        if max(a[2], b[2]) <= NEAR_M:
            continue
        near, far = (a, b) if a[2] < b[2] else (b, a)
        if near[2] < NEAR_M:
            near = far + (near - far) * (far[2] - NEAR_M) / (far[2] - near[2])
        pixels = np.clip(np.rint(sequence.camera.project(np.stack([near, far]))), -20_000, 20_000).astype(int)
        (u0, v0), (u1, v1) = pixels.tolist()
        lines.append(((u0, v0), (u1, v1)))
    return lines


def _heights(points_floor: Float64, least_m: float) -> tuple[Float64, tuple[float, float, float, float]]:
    """Return the largest z per ground cell, (nx, ny), NaN if the cell is empty, and the extent of the cells.

    The cells have edges of `least_m` or more. All are in metres; the extent is (x0, x1, y0, y1).
    """
    cell_m = max(least_m, float(np.ptp(points_floor[:, :2], axis=0).max()) / MOST_PLAN_CELLS)
    cells = np.floor(points_floor[:, :2] / cell_m).astype(int)
    first = cells.min(axis=0)
    shape = cells.max(axis=0) - first + 1
    heights_m = np.full(shape, -np.inf)
    np.maximum.at(heights_m, tuple((cells - first).T), points_floor[:, 2])
    heights_m[np.isinf(heights_m)] = np.nan
    low, high = first * cell_m, (first + shape) * cell_m
    return heights_m, (float(low[0]), float(high[0]), float(low[1]), float(high[1]))


def _color(number: int) -> tuple[int, int, int]:
    return COLORS_RGB[(number - 1) % len(COLORS_RGB)]
