"""An object in BOP's form: its model in millimetres, and its silhouette in a view."""

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import cdist

from kinectbench.core import ReleaseError, StorageError
from kinectbench.core.artefacts.object import FloorFile
from kinectbench.core.geometry import (
    Camera,
    DepthRenderer,
    TriangleMesh,
    invert_rigid,
    parse_ply,
    rigid,
    transform_points,
)
from kinectbench.core.store.address import shown
from kinectbench.core.types import MM_PER_M, Bools, Float64
from kinectbench.release.release import Release

# Rows of the distance matrix that are held at once.
CHUNK = 512
# Fewest points, less one, of a hull that Qhull computes of flat meshes: a simplex and a point.
MIN_HULL = 4
# A model's pixel is visible if it lies at most this far behind the measured depth (BOP: delta).
DELTA_MM = 15.0
NO_BOX = (-1, -1, -1, -1)
Box = tuple[int, int, int, int]


@dataclass(frozen=True)
class BopModel:
    """An object's mesh in the world frame, and the pose of its BOP model frame.

    Attributes:
        mesh: closed mesh, world frame, metres.
        T_world_model: (4, 4), model to world, metres. The model frame has the floor's axes, z up; its origin
            is the middle of the mesh's bounding box along these axes.
    """

    mesh: TriangleMesh
    T_world_model: Float64

    @property
    def mesh_mm(self) -> TriangleMesh:
        """The mesh in the model frame, millimetres."""
        mesh = self.mesh.transformed(invert_rigid(self.T_world_model))
        return TriangleMesh(mesh.vertices * MM_PER_M, mesh.faces)


def read_bop_model(release: Release, recording: str) -> BopModel:
    """Read the object of a recording.

    Raises:
        ReleaseError: a file of the object is missing or damaged.
    """
    folder = f"objects/{recording}"
    try:
        mesh = parse_ply(release.content(f"{folder}/mesh.ply"))
        floor = FloorFile.parse(release.text(f"{folder}/{FloorFile.FILE}"), FloorFile.FILE)
        if not len(mesh.faces):
            raise ValueError("it has no faces")
    except (StorageError, ValueError) as error:
        raise ReleaseError(
            f"{shown(release.folder / folder)}: the object cannot be read ({error})"
        ) from error
    vertices_floor = mesh.transformed(floor.T_floor_world).vertices
    middle = (vertices_floor.min(axis=0) + vertices_floor.max(axis=0)) / 2
    return BopModel(mesh, invert_rigid(floor.T_floor_world) @ rigid(np.eye(3), middle))


def model_ply(mesh: TriangleMesh) -> bytes:
    """Return a binary PLY file with vertex normals, in types that the BOP toolkit reads (float, int)."""
    shell = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return bytes(trimesh.exchange.ply.export_ply(shell, vertex_normal=True))


def model_info(mesh: TriangleMesh) -> dict[str, float]:
    """Return a mesh's row of models_info.json, in the mesh's unit: its `_diameter` and its bounding box."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    info = {"diameter": _diameter(mesh.vertices)}
    info |= {f"min_{axis}": float(value) for axis, value in zip("xyz", low, strict=True)}
    return info | {f"size_{axis}": float(value) for axis, value in zip("xyz", high - low, strict=True)}


def _diameter(vertices: Float64) -> float:
    """Return the largest distance between any two vertices (n, 3), by comparing the convex hull's corners."""
    corners = vertices
    try:
        corners = vertices[ConvexHull(vertices).vertices]
    except QhullError:  # flat: corners of the hull of vertices that are moved by rounding errors
        if len(vertices) > MIN_HULL:
            corners = vertices[ConvexHull(vertices, qhull_options="QJ").vertices]
    return max(float(cdist(corners[i : i + CHUNK], corners).max()) for i in range(0, len(corners), CHUNK))


@dataclass(frozen=True)
class ObjectInView:
    """The object in one view: its two masks, and the values of its row in scene_gt_info.json.

    Attributes:
        mask: (height, width) bool, the silhouette within the image.
        mask_visib: (height, width) bool, the visible part of `mask`.
        px_count_all: number of pixels of the silhouette, including those beyond the image.
        px_count_valid: number of pixels of `mask` with a measured depth.
        px_count_visib: number of pixels of `mask_visib`.
        bbox_obj: x, y, width, height of the whole silhouette, pixels. Width and height are differences of the
            last and first pixel, so one pixel has width 0. All are -1 if nothing is visible.
        bbox_visib: x, y, width, height of `mask_visib`, defined in the same way.
    """

    mask: Bools
    mask_visib: Bools
    px_count_all: int
    px_count_valid: int
    px_count_visib: int
    bbox_obj: Box
    bbox_visib: Box

    @property
    def visib_fract(self) -> float:
        """The visible share of the silhouette."""
        return self.px_count_visib / self.px_count_all if self.px_count_all else 0.0


def object_in_view(
    depth_mm: NDArray[np.uint16],
    camera: Camera,
    T_world_camera: Float64,
    mesh: TriangleMesh,
    renderer: DepthRenderer,
) -> ObjectInView:
    """Return the object's silhouette in a view, the visible part of it, and pixel counts and boxes of both.

    Args:
        depth_mm: (height, width) uint16, measured depth, 0 = none.
        camera: the image's camera.
        T_world_camera: (4, 4), metres.
        mesh: the object's mesh, world frame, metres.
        renderer: a renderer of the same mesh.

    Source: the BOP format page and its definition of visibility, mode `bop19`: a pixel of the silhouette is
    visible if the model lies at most 15 mm behind the measurement along the ray, or if nothing is measured.
    The silhouette is rendered in an image enlarged to hold the whole object, to at most three times its size.
    """
    wide, left, top = _wide_camera(camera, T_world_camera, mesh)
    wide_m = renderer.depth_m(wide, T_world_camera)
    model_m = wide_m[top : top + camera.height, left : left + camera.width]
    mask = model_m > 0
    ray_lengths = np.linalg.norm(camera.rays(), axis=-1)
    behind_mm = (model_m * 1000.0 - depth_mm) * ray_lengths
    mask_visib = mask & ((behind_mm <= DELTA_MM) | (depth_mm == 0))
    visible = bool(mask_visib.any())
    return ObjectInView(
        mask=mask,
        mask_visib=mask_visib,
        px_count_all=int((wide_m > 0).sum()),
        px_count_valid=int((depth_mm[mask] > 0).sum()),
        px_count_visib=int(mask_visib.sum()),
        bbox_obj=_box(wide_m > 0, left, top) if visible else NO_BOX,
        bbox_visib=_box(mask_visib, 0, 0) if visible else NO_BOX,
    )


def _wide_camera(camera: Camera, T_world_camera: Float64, mesh: TriangleMesh) -> tuple[Camera, int, int]:
    """Enlarge a camera's image to hold the object; return camera, and pixels added on the left and on top."""
    points_camera = transform_points(invert_rigid(T_world_camera), mesh.vertices)
    left, right, top, bottom = camera.width, camera.width, camera.height, camera.height
    if points_camera[:, 2].min() > 0:
        u, v = np.moveaxis(camera.project(points_camera), -1, 0)
        left, right = _margins(u, camera.width)
        top, bottom = _margins(v, camera.height)
    wide = replace(
        camera,
        width=camera.width + left + right,
        height=camera.height + top + bottom,
        cx=camera.cx + left,
        cy=camera.cy + top,
    )
    return wide, left, top


def _margins(pixels: Float64, size: int) -> tuple[int, int]:
    """Return how many pixels to add before and after an axis of `size` to hold `pixels`; at most `size`."""
    before, after = np.ceil([-pixels.min(), pixels.max() - (size - 1)])
    return int(np.clip(before, 0, size)), int(np.clip(after, 0, size))


def _box(mask: Bools, left: int, top: int) -> Box:
    """Return BOP's box (x, y, width, height) of a mask; x and y count from the mask's pixel (left, top)."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return (
        int(columns[0]) - left,
        int(rows[0]) - top,
        int(columns[-1] - columns[0]),
        int(rows[-1] - rows[0]),
    )
