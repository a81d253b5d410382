"""Collect from a recording's build folder everything that the page shows of the recording."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from markupsafe import Markup

from kinectbench.core import StorageError, images, pictures
from kinectbench.core.artefacts.manifest import Failed
from kinectbench.core.artefacts.object import FloorFile, FrontierPart, QualityFile
from kinectbench.core.artefacts.object_grids import ObjectVolume, unmeasured_faces
from kinectbench.core.artefacts.sequence import CameraFile
from kinectbench.core.artefacts.stored import Stored
from kinectbench.core.artefacts.trajectory import TrajectoryHealth
from kinectbench.core.artefacts.views import PairRow, PairsFile, ViewsFile
from kinectbench.core.geometry import TriangleMesh, read_own_ply
from kinectbench.core.medians import known_median
from kinectbench.core.trajectory.trajectory import read_poses
from kinectbench.core.turntable import QUALITY, turntable
from kinectbench.core.types import Bools, Float64, Rgb
from kinectbench.core.voxels.pair_file import read_pair
from kinectbench.engine.stages import STAGES, Job, current_stages
from kinectbench.report import page_pictures
from kinectbench.report.figures import StageFigures, health_figures, per_cent, quality_figures, text_of
from kinectbench.report.plan import draw_plan
from kinectbench.report.recording_list import millimetres
from kinectbench.settings.models import RecordingSettings

OBJECT_PX = 320
# Orange and blue are safe for colour-blind readers; seen parts are grey, so only unseen parts have colour.
SEEN_RGB, UNSEEN_RGB, ARROW_RGB = (184, 184, 180), (240, 150, 20), (0, 92, 160)
# Contrast of shading: openings are in the shade, where orange looks brown (chosen from pictures).
CONTRAST = 0.45
# Three viewpoints around the object, from a person's height: azimuth and elevation, degrees.
LOOKS_DEG = ((-50.0, 24.0), (70.0, 24.0), (190.0, 24.0))
# Limits of a viewpoint's elevation: from straight above or below the object is hard to recognise (chosen from
# pictures).
ELEVATIONS_DEG = (-40.0, 62.0)
LEVEL_COSINE = 0.2
# Largest number of arrows: more would hide the object.
MARKED = 4
# Length of an arrow as a share of the object's longest edge; an arrow that appears shorter than the second
# share of its length is drawn as a ring.
ARROW_SHARE, RING_SHARE = 0.4, 0.3
# An arrow beyond this cosine points to the far side, but would seem to point to the near side.
BEHIND_COSINE = -0.3


@dataclass(frozen=True)
class ObjectPicture:
    """A picture of the object from one side as a `data:` URL, and its caption, which may be ""."""

    picture: str
    caption: str


def object_pictures(
    mesh_floor: TriangleMesh, unseen: Bools, frontiers: Sequence[FrontierPart]
) -> tuple[ObjectPicture, ...]:
    """Draw the object from three sides, and from a viewpoint that looks into its first unobserved opening.

    Args:
        mesh_floor: the object's closed surface, floor frame, metres.
        unseen: mask (m,) of unmeasured faces, drawn in orange; measured faces are grey.
        frontiers: unobserved openings; the first four get a numbered arrow.
    """
    pieces = [(mesh_floor.keep_faces(~unseen), SEEN_RGB), (mesh_floor.keep_faces(unseen), UNSEEN_RGB)]
    length_m = ARROW_SHARE * float(np.ptp(mesh_floor.vertices, axis=0).max())
    arrows = arrows_to(frontiers[:MARKED], length_m)
    points = np.concatenate([mesh_floor.vertices, *arrows])
    looks_deg = [*LOOKS_DEG, *(_look_deg(frontier) for frontier in frontiers[:1])]
    shown: list[ObjectPicture] = []
    for viewpoint in pictures.viewpoints_around(points, looks_deg):
        picture = pictures.render_pieces(pieces, viewpoint, OBJECT_PX, CONTRAST)
        for number, arrow in enumerate(arrows, start=1):
            draw_arrow(picture, viewpoint, arrow, str(number))
        caption = "from where 1 would be seen" if len(shown) == len(LOOKS_DEG) else ""
        shown.append(ObjectPicture(images.data_uri(picture), caption))
    return tuple(shown)


def arrows_to(frontiers: Sequence[FrontierPart], length_m: float) -> list[Float64]:
    """Return an arrow into each frontier (unobserved opening): (2, 3), tail and tip, floor frame, metres."""
    centers = [np.array(frontier.center_m) for frontier in frontiers]
    return [
        np.stack([center + length_m * np.array(frontier.look_from), center])
        for center, frontier in zip(centers, frontiers, strict=True)
    ]


def _look_deg(frontier: FrontierPart) -> tuple[float, float]:
    """Return azimuth and elevation, degrees, of a viewpoint that looks into a frontier."""
    x, y, z = frontier.look_from
    azimuth = LOOKS_DEG[0][0] if np.hypot(x, y) < LEVEL_COSINE else float(np.rad2deg(np.arctan2(y, x)))
    elevation = np.clip(np.rad2deg(np.arctan2(z, np.hypot(x, y))), *ELEVATIONS_DEG)
    return azimuth, float(elevation)


def draw_arrow(picture: Rgb, viewpoint: pictures.Viewpoint, arrow: Float64, number: str) -> None:
    """Draw into `picture` an arrow (2, 3), tail and tip, with its number at the tail.

    An arrow nearly along the line of sight is drawn as a ring; one that points to the viewer is not drawn.
    """
    import cv2

    along = arrow[1] - arrow[0]
    length_m = float(np.linalg.norm(along))
    if viewpoint.R_frame_view[:, 2] @ along < BEHIND_COSINE * length_m:
        return
    offsets = (arrow - viewpoint.center_m) @ viewpoint.R_frame_view[:, :2]
    (u0, v0), (u1, v1) = np.rint((offsets / viewpoint.half_m + 1) / 2 * len(picture)).astype(int).tolist()
    far_px = float(np.hypot(u1 - u0, v1 - v0))
    if far_px < RING_SHARE * length_m / (2 * viewpoint.half_m) * len(picture):
        for color, width in (((255, 255, 255), 5), (ARROW_RGB, 2)):
            cv2.circle(picture, (u1, v1), 17, color, width, cv2.LINE_AA)
        u0, v0 = u1, v1
    else:
        for color, width in (((255, 255, 255), 6), (ARROW_RGB, 3)):
            cv2.arrowedLine(picture, (u0, v0), (u1, v1), color, width, cv2.LINE_AA, tipLength=14 / far_px)
    cv2.circle(picture, (u0, v0), 11, ARROW_RGB, -1, cv2.LINE_AA)
    at = (u0 - 5, v0 + 6)
    cv2.putText(picture, number, at, cv2.FONT_HERSHEY_SIMPLEX, 0.55, (255, 255, 255), 2, cv2.LINE_AA)


File = TypeVar("File", bound=Stored)


@dataclass(frozen=True)
class Tile:
    """A pair on the page, as texts.

    Attributes:
        view: name of the view.
        frame: number of its frame.
        picture: picture of partial and full shape as a `data:` URL.
        containment: share of the partial inside the full shape.
        residual: median difference between measured and rendered depth.
        unknown: share of the true shape that is not known.
    """

    view: str
    frame: str
    picture: str
    containment: str
    residual: str
    unknown: str


@dataclass(frozen=True)
class RecordingPart:
    """The page's contents about one recording; pictures are `data:` URLs.

    Attributes:
        settings: the recording's own settings.
        health: statistics of the trajectory; None if there are none.
        quality: statistics of the object; None if there are none.
        turntable: a strip of pictures of the object from all around; None if there is none.
        plan: the camera's path seen from above; None if there is none.
        object_pictures: pictures of the object from a few sides, with unseen parts in colour.
        frames: pictures of some recorded views.
        tiles: every pair.
        refused: (view, frame, reason) of every refused pair and of every frame that was refused as a view.
            Such a frame has "" as its view.
        containment: median containment over the pairs, as text.
        residual: median residual over the pairs, as text.
        missing: results that are not built yet, of "trajectory", "floor", "object", "views" and "pairs".
        outdated: results, of the same five, that are not shown because they were made with another version,
            other settings or other inputs.
        failed: the stage at which the last build failed, and why, one line; or "".
    """

    settings: RecordingSettings
    health: StageFigures | None
    quality: StageFigures | None
    turntable: str | None
    plan: Markup | None
    object_pictures: tuple[ObjectPicture, ...]
    frames: tuple[page_pictures.FramePicture, ...]
    tiles: tuple[Tile, ...]
    refused: tuple[tuple[str, str, str], ...]
    containment: str
    residual: str
    missing: tuple[str, ...]
    outdated: tuple[str, ...] = ()
    failed: str = ""


def collect(job: Job, folder: Path) -> RecordingPart:
    """Collect the current results of one recording in `build/<recording>/`; outdated ones are only named.

    Raises:
        StorageError: a file is damaged.
        PairError: a pair file is missing or damaged.
    """
    current = current_stages(folder, job)

    def read(stage: str, model: type[File]) -> File | None:
        """Read a stage's file; None if the stage is not current or has no such file."""
        return model.read_if_there(current[stage]) if stage in current else None

    health, floor = read("track", TrajectoryHealth), read("segment", FloorFile)
    cameras_world = read_poses(current["track"]).T_world_camera if "track" in current else None
    T_floor_world = None if floor is None else floor.T_floor_world
    quality, mesh, unseen, turning = read("segment", QualityFile), None, np.zeros(0, bool), None
    frontiers = quality.frontiers if quality else ()
    if T_floor_world is not None:
        mesh, unseen = _mesh(current["segment"], T_floor_world)
        turning = _turntable(mesh, T_floor_world, current.get("fuse"))
    plan = None
    if cameras_world is not None and T_floor_world is not None:
        cameras_floor = T_floor_world @ cameras_world
        left_out_floor = _left_out(cameras_floor, health)
        outlines = page_pictures.outlines(mesh) if mesh else []
        plan = draw_plan(cameras_floor, left_out_floor, outlines, frontiers)
    views, pairs = read("sample-views", ViewsFile), read("pairs", PairsFile)
    frames = () if views is None else page_pictures.frame_pictures(folder / "views", views)
    rows = () if pairs is None else pairs.pairs
    refused = (*(views.refused if views else ()), *(pairs.refused if pairs else ()))
    failed = Failed.read_if_there(folder)
    absent = (
        ("trajectory", "track", cameras_world is None),
        ("floor", "segment", T_floor_world is None),
        ("object", "segment", mesh is None),
        ("views", "sample-views", not frames),
        ("pairs", "pairs", pairs is None),
    )
    old = {s.name for s in STAGES if s.name not in current and (folder / s.folder).is_dir()}
    return RecordingPart(
        settings=job.recording,
        health=None if health is None else health_figures(health, read("ingest", CameraFile)),
        quality=None if quality is None else quality_figures(quality),
        turntable=turning,
        plan=plan,
        object_pictures=object_pictures(mesh, unseen, frontiers) if mesh else (),
        frames=frames,
        tiles=tuple(_tile(folder / "pairs", row, T_floor_world) for row in rows),
        refused=tuple((row.view or "", text_of(row.frame), row.reason) for row in refused),
        containment=per_cent(known_median(row.containment for row in rows)),
        residual=millimetres(known_median(row.residual_m for row in rows)),
        missing=tuple(name for name, stage, is_absent in absent if is_absent and stage not in old),
        outdated=tuple(name for name, stage, is_absent in absent if is_absent and stage in old),
        failed=": ".join(filter(None, (failed.stage, failed.error))) if failed else "",
    )


def _turntable(mesh_floor: TriangleMesh, T_floor_world: Float64, reconstruction: Path | None) -> str:
    """Return pictures of the object from all sides, in one strip: a `data:` URL.

    The object is coloured if the scene's mesh is. `reconstruction` is the folder with that mesh, or None.
    """
    scene_floor = None
    if reconstruction and (reconstruction / "mesh.ply").is_file():
        scene_floor = read_own_ply(reconstruction / "mesh.ply", colors=True).transformed(T_floor_world)
    return images.data_uri(turntable(mesh_floor, scene_floor), QUALITY)


def _mesh(folder: Path, T_floor_world: Float64) -> tuple[TriangleMesh, Bools]:
    """Read the object's closed mesh, floor frame, and a mask (m,) of its faces that were not measured."""
    mesh_world = read_own_ply(folder / "mesh.ply")
    if not len(mesh_world.faces):
        raise StorageError(f"{folder / 'mesh.ply'}: has no faces; delete the folder and build it again")
    volume = ObjectVolume.read(folder)
    unseen = unmeasured_faces(mesh_world, volume.grid, volume.labels)
    return mesh_world.transformed(T_floor_world), unseen


def _left_out(cameras_floor: Float64, health: TrajectoryHealth | None) -> Float64:
    """Return the camera positions of rejected frames: (k, 3), floor frame, metres.

    They are interpolated between other frames. The result is empty unless the trajectory has a row for each
    frame, or for each frame that was kept.
    """
    if health is None or not health.rejected:
        return np.zeros((0, 3))
    rejected = sorted({row.frame for row in health.rejected})
    kept = np.arange(health.frames)
    if len(cameras_floor) != health.frames:
        kept = np.setdiff1d(kept, [*rejected, *health.lost])
    if len(kept) != len(cameras_floor):
        return np.zeros((0, 3))
    return np.stack([np.interp(rejected, kept, cameras_floor[:, axis, 3]) for axis in range(3)], axis=-1)


def _tile(folder: Path, row: PairRow, T_floor_world: Float64 | None) -> Tile:
    pair = read_pair(folder / f"{row.view}.npz")
    # Without a known floor, up is up in the view.
    R_world_grid = pair.T_world_grid[:3, :3]
    up_grid = np.array([0.0, -1, 0]) if T_floor_world is None else T_floor_world[2, :3] @ R_world_grid
    picture = page_pictures.pair_picture(pair.partial, pair.full, pair.voxel_size_m, up_grid)
    return Tile(
        view=row.view,
        frame=text_of(row.frame),
        picture=images.data_uri(picture),
        containment=per_cent(row.containment),
        residual=millimetres(row.residual_m),
        unknown=per_cent(pair.unknown_share),
    )
