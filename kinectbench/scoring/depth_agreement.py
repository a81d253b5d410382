"""Measure how far a predicted shape is from its view's depth, and find a unit or axis error that explains it.

A complete shape passes through the points that its view measured; a shape in a wrong unit or frame does not.
For each usual error of unit or axes, the distance after its correction is computed.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.geometry import invert_rigid, rigid, transform_points
from kinectbench.core.types import Float64, Int64
from kinectbench.scoring.camera_shape import CAMERA_AXES, METRES, CameraShape
from kinectbench.scoring.suspicious import Held

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

# Numbers of points of the depth, and of a shape, that are compared. The median of 300 differs by some per
# cent from the median of all, and testing all errors of a view takes 0.1 s (chosen here).
DEPTH_POINTS, SHAPE_POINTS = 300, 20_000
SEED = 0
# Thresholds of the distance, as shares of the diagonal of the measured points. Below the first, the distance
# is small: it is what points 1 cm apart on an object of 1 m leave. Above the second, it is reported even if
# no error explains it (chosen here; in the test of ten objects, exact shapes have at most 0.3 %).
SMALL, LARGE = 0.01, 0.1
# A shape is a scene if more than this share of its surface is farther from the middle of the pair's cube than
# the cube's side. An object has no surface there; a room of 5 m around an object of 1 m has most of its
# surface there (chosen here).
SCENE = 0.2
# An error explains a distance if its correction reduces the distance by the first factor, and the excess over
# the gaps between the shape's points by the second (chosen here).
NEARER, NEARER_BEYOND_GAPS = 1.5, 3.0
# Errors whose distances differ by less than this factor explain a distance equally well: for a round shape,
# axes can hardly be distinguished (chosen here).
ABOUT = 1.3
# 10 m in 65535 steps are 6553.5 steps per metre; millimetres are 1000 per metre.
STEPS_OF_10_M = 6.5535

# Message about a prediction -> the factor that corrects it.
UNITS: Mapping[str, float] = {
    "": 1.0,
    "1000 times too far: millimetres for metres?": 0.001,
    "1000 times too near: metres for millimetres?": 1000.0,
    f"{STEPS_OF_10_M:.2f} times too far: depth of 65535 = 10 m read as millimetres?": 1 / STEPS_OF_10_M,
    f"{STEPS_OF_10_M:.2f} times too near: depth in millimetres read as 65535 = 10 m?": STEPS_OF_10_M,
}
# The two conventions come first: for a shape with a mirror plane, one flipped axis would explain as much.
AXES: Mapping[tuple[int, int, int], str] = {
    (1, 1, 1): "",
    (-1, -1, 1): "x left and y up (axes: pytorch3d)?",
    (1, -1, -1): "y up and z backward (axes: opengl)?",
    (1, -1, 1): "y up?",
    (-1, 1, 1): "x left?",
    (1, 1, -1): "z backward?",
    (-1, 1, -1): "x left and z backward?",
    (-1, -1, -1): "x left, y up and z backward?",
}


@dataclass(frozen=True)
class Agreement:
    """How well a predicted shape fits its view's depth image.

    Attributes:
        distance_m: median distance of the measured points of the object from the shape, metres.
        diagonal_m: diagonal of the bounding box of these points.
        slips: (error in words, distance after its correction, metres) for each error of unit or axes that
            explains the distance, the simplest first; () if the distance is small or unexplained. Of a shape
            with a mirror plane, several errors may explain it.
        beyond_share: share of the shape's surface that is more than a cube's side from the middle of the
            pair's cube.
        refused: why the shape cannot be made solid, so that `score` refuses it; "" if it can.
        open_because: why a mesh is not closed, in words; "" if it is closed, or no mesh.
        content: digest of the shape; None if it is not needed.
    """

    distance_m: float
    diagonal_m: float
    slips: tuple[tuple[str, float], ...] = ()
    beyond_share: float = 0.0
    refused: str = ""
    open_because: str = ""
    content: Held | None = None

    @property
    def is_scene(self) -> bool:
        """Whether the shape extends so far beyond the object that it must be the whole visible scene."""
        return self.beyond_share > SCENE

    @property
    def is_large(self) -> bool:
        """Whether the distance is so large for the object that it is reported even if unexplained."""
        return self.distance_m > LARGE * self.diagonal_m

    def line(self, slip: str, method: MethodFile) -> str:
        """Return a line: the distance, the error `slip` (in words) that explains it, and the remedy."""
        words = f"{self.distance_m:.3g} m from its view's depth (median)"
        without = f"Without that it is {dict(self.slips)[slip]:.3g} m"
        return f"{words}; {slip} {without}: declare {remedy(slip, method)} in {MethodFile.FILE}"


def agreement(
    shape: CameraShape,
    depth_points_m: Float64,
    T_camera_prediction: Float64,
    T_world_camera: Float64,
    T_world_grid: Float64,
) -> Agreement:
    """Compare a shape with its view's depth, and search for errors of unit or axes.

    Args:
        shape: the shape in the camera frame, placed as method.json declares.
        depth_points_m: (n, 3), n > 0: the object's measured points, camera frame, metres.
        T_camera_prediction: (4, 4), the similarity that was used to map the file's coordinates to the camera.
        T_world_camera: (4, 4), the camera pose of the view.
        T_world_grid: (4, 4), the pose of the pair's cube.
    """
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(SEED)
    seen = depth_points_m[rng.permutation(len(depth_points_m))[:DEPTH_POINTS]]
    tree = cKDTree(shape_points(shape))
    diagonal = float(np.linalg.norm(np.ptp(depth_points_m, axis=0)))

    def distance(T: Float64) -> float:
        """Return the distance after mapping the shape by T; the points are mapped back instead."""
        back = (seen - T[:3, 3]) @ np.linalg.inv(T[:3, :3]).T
        return float(np.median(tree.query(back)[0])) * _scale(T)

    gap = _gap(tree, rng)

    def beyond(distance_m: float, scale: float) -> float:
        """Return sqrt(distance^2 - (gap scale)^2): the distance beyond what the cloud's gaps cause."""
        return float(np.sqrt(max(distance_m**2 - (gap * scale) ** 2, 0)))

    own = distance(np.eye(4))
    if beyond(own, 1) <= SMALL * diagonal:
        return Agreement(own, diagonal)
    slips = list(typical_errors(T_camera_prediction, T_world_camera, T_world_grid))
    distances = np.array([distance(T) for _, T in slips])
    as_well = max(ABOUT * distances.min(), SMALL / 4 * diagonal)
    explained = [
        (words, without)
        for (words, T), without in zip(slips, distances.tolist(), strict=True)
        if without <= min(as_well, own / NEARER)
        and beyond(own, 1) >= NEARER_BEYOND_GAPS * beyond(without, _scale(T))
    ]
    return Agreement(own, diagonal, tuple(explained))


def remedy(slip: str, method: MethodFile) -> str:
    """Return the declaration for method.json that corrects an error: unit and axes, or T_camera_prediction.

    Args:
        slip: the error, in the words that `typical_errors` yields.
        method: the current method.json.
    """
    for (words, factor), (signs, axes) in product(UNITS.items(), AXES.items()):
        if slip != _both(words, axes):
            continue
        scale = METRES[method.unit] * factor
        unit = next((name for name in ("m", "mm") if math.isclose(METRES[name], scale)), None)
        turned = tuple(np.array(CAMERA_AXES[method.axes]) * signs)
        frame = next((name for name, of in CAMERA_AXES.items() if of == turned), None)
        if unit and frame and method.unit != "free":
            keys = [f"'unit': '{unit}'"] * bool(words) + [f"'axes': '{frame}'"] * bool(axes)
            return " and ".join(keys)
    return "'T_camera_prediction'"


def beyond_share(shape: CameraShape, T_grid_camera: Float64, side_m: float) -> float:
    """Return the share of a shape's surface that is more than `side_m` from the cube's middle along an axis.

    Args:
        shape: the shape, camera frame.
        T_grid_camera: (4, 4), from the camera to the cube, whose corner is the origin.
        side_m: side of the cube, metres.
    """
    away = transform_points(T_grid_camera, shape_points(shape)) - side_m / 2
    return float((np.abs(away).max(axis=1) > side_m).mean())


def likeliest(agreements: Sequence[Agreement]) -> list[str]:
    """Return the most likely error of each prediction of a method, in words; "" if a prediction has none.

    Several errors may explain one prediction, for example if the object is symmetric. Of these, the one that
    explains most of the method's predictions is taken, because they usually share one error.

    Args:
        agreements: one for each prediction of the method.
    """
    counts = Counter(words for one in agreements for words, _ in one.slips)
    return [max(one.slips, key=lambda slip: counts[slip[0]])[0] if one.slips else "" for one in agreements]


def _scale(T: Float64) -> float:
    """Return the scale of a similarity (4, 4), which may mirror."""
    return float(np.cbrt(abs(np.linalg.det(T[:3, :3]))))


def _gap(tree: "cKDTree", rng: np.random.Generator) -> float:
    """Return the median distance between nearest neighbours in a point cloud; 0 for a single point.

    If the points are random samples of a surface, their median distance from points of the surface is the
    same.
    """
    if tree.n < 2:
        return 0.0
    chosen = tree.data[rng.permutation(tree.n)[:DEPTH_POINTS]]
    return float(np.median(tree.query(chosen, k=2)[0][:, 1]))


def typical_errors(
    T_camera_prediction: Float64, T_world_camera: Float64, T_world_grid: Float64
) -> Iterator[tuple[str, Float64]]:
    """Yield (error in words, correction: (4, 4), applied in the camera frame), simplest errors first."""
    both = sorted(product(UNITS.items(), AXES.items()), key=lambda one: (one[0][0] != "") + (one[1][1] != ""))
    for (unit, factor), (signs, axes) in both:
        if words := _both(unit, axes):
            yield words, np.diag([*(factor * np.array(signs, float)), 1.0])
    T_camera_world = invert_rigid(T_world_camera)
    yield "in the world's frame?", T_camera_world
    yield "in the frame of the pair's cube?", T_camera_world @ T_world_grid
    transposed = T_camera_prediction.copy()
    transposed[:3, :3] = transposed[:3, :3].T
    rows = "rows for columns in the rotation of 'T_camera_prediction'?"
    yield rows, transposed @ np.linalg.inv(T_camera_prediction)
    by_rows = rigid(T_world_camera[:3, :3].T, T_world_camera[:3, 3])
    yield "in the world's frame, with rows for columns in the rotation?", invert_rigid(by_rows)


def _both(unit: str, axes: str) -> str:
    return " and ".join(part for part in (unit, axes) if part)


def shape_points(shape: CameraShape) -> Float64:
    """Return at most `SHAPE_POINTS` points (m, 3) of a shape's surface.

    A mesh is sampled at random, uniformly by area. If a mesh has no area, all its vertices are returned.
    """
    rng = np.random.default_rng(SEED)
    if len(shape.faces):
        return _on_triangles(shape.points_m, shape.faces, rng)
    if len(shape.points_m) <= SHAPE_POINTS:
        return shape.points_m
    return shape.points_m[rng.choice(len(shape.points_m), SHAPE_POINTS, replace=False)]


def _on_triangles(vertices: Float64, faces: Int64, rng: np.random.Generator) -> Float64:
    """Draw uniform points on triangles (Osada et al., "Shape distributions", 2002, section 4.2)."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if not areas.sum() > 0:
        return vertices
    chosen = np.searchsorted(np.cumsum(areas), rng.random(SHAPE_POINTS) * areas.sum())
    chosen = np.minimum(chosen, len(faces) - 1)
    root, along = np.sqrt(rng.random((SHAPE_POINTS, 1))), rng.random((SHAPE_POINTS, 1))
    points: Float64 = (1 - root) * a[chosen] + root * (1 - along) * b[chosen] + root * along * c[chosen]
    return points
