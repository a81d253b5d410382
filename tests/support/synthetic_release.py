"""A small release of simple shapes, made as the stages would make it: a build folder, then publish."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from analytic_scenes import box, depth_of, sphere
from numpy.typing import NDArray
from references import shell_of

from kinectbench.core.artefacts.object_grids import Label, ObjectVolume
from kinectbench.core.geometry import (
    Camera,
    Grid,
    TriangleMesh,
    rigid,
    rotation_from_quaternion_xyzw,
    transform_points,
)
from kinectbench.core.geometry.depth import depth_in_mm
from kinectbench.core.geometry.mesh import join, read_own_ply, write_ply
from kinectbench.core.sequence import depth_in_metres
from kinectbench.core.storage import sha256_file, sha256_text
from kinectbench.core.voxels.pair_file import Pair, pack, pair_bytes, unpack
from kinectbench.core.voxels.seen_cells import seen_cells
from kinectbench.core.voxels.solid import voxelize_solid
from kinectbench.core.voxels.view_grids import partial_grids
from kinectbench.release.publish.publish import PublishSummary, publish
from kinectbench.settings.models import BenchmarkSettings

Bools = NDArray[np.bool_]
PairOf = Callable[[int, str], Pair]

Recordings = tuple[tuple[str, str, str, str, int], ...]
RECORDINGS: Recordings = (
    # id, category, object, split, number of views
    ("chair_01", "chair", "red_chair", "test", 2),
    ("chair_02", "chair", "blue_chair", "test", 1),
    ("chair_03", "chair", "val_chair", "validation", 2),
    ("table_01", "table", "old_table", "test", 1),
    ("table_02", "table", "val_table", "validation", 1),
)
# At the shapes a pixel is as wide as a cell.
DEPTH_CAMERA = Camera(320, 240, 200.0, 200.0, 159.5, 119.5)
CAMERA = {
    "format_version": 2,
    **{key: getattr(DEPTH_CAMERA, key) for key in ("width", "height", "fx", "fy", "cx", "cy")},
    **{"depth_scale": 1000.0, "color_registered": True, "registered_by": "recording"},
    **{"source_format": "tum", "frames": 8, "warnings": [], "trajectory_error": ""},
}
FLOOR = {
    "format_version": 1,
    "plane_world": [0.0, 0.0, 1.0, 0.5],
    "T_floor_world": [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.5], [0.0, 0.0, 0.0, 1.0]],
    "noise_m": 0.001,
    "inlier_share": 0.9,
    "tilt_rad": 0.1,
    "found": True,
}
CENTRES = np.arange(256) + 0.5
VOXEL_M = 0.004
# In the axes of the grid, 0.9 m before the middle of its front; and how far the wall behind the grid is.
EYE_M, WALL_M = (0.512, 0.512, -0.9), 2.0


def ball(center: tuple[float, float, float], radius: float) -> Bools:
    """(256, 256, 256) bool: cells whose centre lies in a ball; cells."""
    x, y, z = ((CENTRES - c) ** 2 for c in center)
    ball: Bools = x[:, None, None] + y[:, None] + z <= radius**2
    return ball


def synthetic_view(number: int, category: str) -> tuple[NDArray[np.uint16], Bools]:
    """Depth in whole millimetres, and mask, of the shape of `synthetic_pair`; (240, 320)."""
    if category == "chair":
        shape = sphere((120 + number, 128, 130), 90.0 - 3 * number)
    else:
        shape = box((20, 100 + number, 30), (230, 130, 220))
    eye_cells = np.array(EYE_M) / VOXEL_M
    shape_m = depth_of([shape], DEPTH_CAMERA, rigid(np.eye(3), eye_cells)) * VOXEL_M
    mask = shape_m > 0
    return depth_in_mm(np.where(mask, shape_m, np.float32(WALL_M))), mask


@lru_cache(maxsize=16)
def synthetic_pair(number: int, category: str) -> Pair:
    """A ball (chair) or a board (table) before a wall, with an unknown slab; differs by number.

    Made once: its arrays are not to be changed, and cannot.
    """
    if category == "chair":
        full = ball((120 + number, 128, 130), 90.0 - 3 * number)
    else:
        full = np.zeros((256, 256, 256), bool)
        full[20:230, 100 + number : 130, 30:220] = True
    known = np.ones((256, 256, 256), bool)
    known[200 : 210 + number] = False
    T = rigid(rotation_from_quaternion_xyzw([0.1, -0.2, 0.3, 0.9]), [0.5, -0.2, 1.0 + number])
    grid = Grid((256, 256, 256), VOXEL_M, T)
    T_world_camera = T @ rigid(np.eye(3), EYE_M)
    depth_mm, mask = synthetic_view(number, category)
    depth_m = depth_in_metres(depth_mm, 1000)
    object_m = np.where(mask, depth_m, np.float32(0))
    partial_256, partial = partial_grids(object_m, DEPTH_CAMERA, T_world_camera, grid)
    pair = Pair(
        partial=partial,
        partial_256=partial_256,
        full=pack(full),
        shell=shell_of(full),
        known=pack(known),
        seen=seen_cells(depth_m, DEPTH_CAMERA, T_world_camera, grid),
        T_world_grid=T,
        T_world_camera=T_world_camera,
        K=DEPTH_CAMERA.K,
        voxel_size_m=VOXEL_M,
        surface_sigma_m=0.003,
        framing="object",
        partial_rule="any",
    )
    for values in vars(pair).values():
        if isinstance(values, np.ndarray):
            values.flags.writeable = False
    return pair


def told_pair(number: int, category: str) -> Pair:
    """The same, told by what it is known: what lies deep inside is not measured, a part of that was said."""
    pair = synthetic_pair(number, category)
    deep = unpack(pair.full) & ~unpack(pair.shell) & unpack(pair.known) & (np.arange(256) > 60)
    return replace(pair, interior=pack(deep), said=pack(deep & (np.arange(256) > 160)))


def synthetic_settings(wanted: Recordings = RECORDINGS, **more: Any) -> BenchmarkSettings:
    """Settings of the benchmark that the synthetic release is published from."""
    recordings = [
        {"id": name, "path": f"/home/someone/{name}", "category": category, "object": thing, "split": split}
        for name, category, thing, split, _ in wanted
    ]
    content = {"name": "synthetic", "license": "CC0-1.0", "source": "made up", "recordings": recordings}
    return BenchmarkSettings.model_validate(content | more)


def write_build(build: Path, wanted: Recordings = RECORDINGS, pair_of: PairOf = synthetic_pair) -> None:
    """Write what publish reads of every recording; `pair_of` gives a pair by its number and category."""
    for index, (name, category, _, _, count) in enumerate(wanted):
        views = [f"{view:03d}" for view in range(count)]
        for folder in ("sequence", "trajectory", "reconstruction", "object", "views", "pairs"):
            (build / name / folder).mkdir(parents=True)
            manifest = {
                "format_version": 1,
                "package_version": "0.1.0",
                "stage": folder,
                "fingerprint": "0" * 64,
                "settings": {"box": None},
                "inputs": {},
                "files": {},
            }
            write_json(build / name / folder / "manifest.json", manifest)
        rows = []
        numbers = [index + int(view) for view in views]
        pairs = [pair_of(number, category) for number in numbers]
        for view, number, pair in zip(views, numbers, pairs, strict=True):
            (build / name / "pairs" / f"{view}.npz").write_bytes(pair_bytes(pair))
            write_images(build / name / "views", view, number, category)
            pose = pair.T_world_camera.tolist()
            rows.append(
                {"view": view, "frame": int(view), "stamp_ns": 70, "T_world_camera": pose, "pixels": 12}
            )
        listed = {"pairs": [{"view": view, "frame": 7, "containment": 1.0} for view in views], "refused": []}
        write_json(build / name / "pairs" / "pairs.json", listed)
        write_json(build / name / "views" / "views.json", {"format_version": 1, "views": rows, "refused": []})
        write_json(build / name / "object" / "floor.json", FLOOR)
        # On the front of the first pair's shape.
        front = transform_points(pairs[0].T_world_grid, np.array([[0.48, 0.48, 0.14]]))[0]
        write_object(build / name / "object", mesh_of(pairs, numbers, category), front)
        write_json(build / name / "object" / "quality.json", {"repeatability_iou": 0.93})
        write_json(build / name / "sequence" / "camera.json", CAMERA)
        write_json(build / name / "sources.json", {"depth/0.png": [10, 20, sha256_text(name)]})


def mesh_of(pairs: Sequence[Pair], numbers: Sequence[int], category: str) -> TriangleMesh:
    """A ball or a board for each pair, world frame, metres: `full` is what of it lies in the pair's cube.

    The cubes are a metre apart along the world's z: no shape reaches into the cube of another. A ball of so
    many triangles differs from `full` in 0.07 % of its cells, a board in none.
    """
    shapes = []
    for pair, number in zip(pairs, numbers, strict=True):
        if category == "chair":
            shape = trimesh.creation.icosphere(subdivisions=4, radius=90.0 - 3 * number)
            shape.vertices *= (4 / 3 * np.pi * (90.0 - 3 * number) ** 3 / shape.volume) ** (1 / 3)
            shape.apply_translation((120 + number, 128, 130))
        else:
            shape = trimesh.creation.box(bounds=[(20, 100 + number, 30), (230, 130, 220)])
        mesh = TriangleMesh(np.array(shape.vertices) * pair.voxel_size_m, np.array(shape.faces, np.int32))
        shapes.append(mesh.transformed(pair.T_world_grid))
    return join(shapes)


def write_object(folder: Path, mesh: TriangleMesh, corner_world: NDArray[np.float64]) -> None:
    """The mesh, and as its volume what of it lies in a few voxels from a corner on, metres."""
    write_ply(mesh, folder / "mesh.ply")
    mesh = read_own_ply(folder / "mesh.ply")  # of float32
    grid = Grid((4, 5, 8), 0.01, rigid(np.eye(3), corner_world))
    solid = unpack(voxelize_solid(mesh.vertices, mesh.faces, grid))
    labels = np.where(solid, Label.SURFACE, Label.FREE).astype(np.uint8)
    ObjectVolume(grid, solid, labels, solid.astype(np.float16), np.zeros_like(solid)).write(folder)


def write_images(views: Path, view: str, number: int, category: str) -> None:
    """Depth and mask of `synthetic_view`, and a grey colour image."""
    depth_mm, mask = synthetic_view(number, category)
    grey = np.full((*mask.shape, 3), 128, np.uint8)
    for suffix, image in (("depth.png", depth_mm), ("mask.png", mask * np.uint8(255)), ("color.jpg", grey)):
        cv2.imwrite(str(views / f"{view}.{suffix}"), image)


def write_json(path: Path, content: Any) -> None:
    path.write_text(json.dumps(content), encoding="utf-8")


def publish_synthetic(
    root: Path, wanted: Recordings = RECORDINGS, pair_of: PairOf = synthetic_pair
) -> PublishSummary:
    """Build and publish below `root`."""
    write_build(root / "build", wanted, pair_of)
    names = [recording[0] for recording in wanted]
    return publish(synthetic_settings(wanted), root / "build", root / "benchmark", names)


def resum(folder: Path, *names: str) -> None:
    """Put the present hashes of some files into SHA256SUMS: damage that checksums do not show."""
    lines = (folder / "SHA256SUMS").read_text().splitlines(keepends=True)
    for name in names:
        lines = [
            f"{sha256_file(folder / name)}  {name}\n" if line.endswith(f"  {name}\n") else line
            for line in lines
        ]
    (folder / "SHA256SUMS").write_text("".join(lines))
