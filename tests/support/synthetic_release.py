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
from numpy.typing import NDArray
from references import shell_of

from kinectbench.core.artefacts.object_grids import Label, ObjectVolume
from kinectbench.core.geometry import (
    Grid,
    TriangleMesh,
    rigid,
    rotation_from_quaternion_xyzw,
    transform_points,
)
from kinectbench.core.geometry.mesh import join, read_own_ply, write_ply
from kinectbench.core.storage import sha256_file, sha256_text
from kinectbench.core.voxels.pair_file import Pair, pack, pair_bytes, unpack
from kinectbench.core.voxels.resample import reduce_blocks
from kinectbench.core.voxels.solid import voxelize_solid
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
CAMERA = {
    "format_version": 2,
    **{"width": 8, "height": 6, "fx": 5.0, "fy": 5.0, "cx": 3.5, "cy": 2.5},
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
CELLS = np.arange(256, dtype=np.int16)


def ball(center: tuple[float, float, float], radius: float) -> Bools:
    """(256, 256, 256) bool: cells whose centre lies in a ball; cells."""
    x, y, z = ((CENTRES - c) ** 2 for c in center)
    ball: Bools = x[:, None, None] + y[:, None] + z <= radius**2
    return ball


@lru_cache(maxsize=16)
def synthetic_pair(number: int, category: str) -> Pair:
    """A ball (chair) or a board (table) seen from z = 0, with an unknown slab; differs by number.

    Made once: its arrays are not to be changed, and cannot.
    """
    if category == "chair":
        full = ball((120 + number, 128, 130), 90.0 - 3 * number)
    else:
        full = np.zeros((256, 256, 256), bool)
        full[20:230, 100 + number : 130, 30:220] = True
    first = full.argmax(axis=2).astype(np.int16)
    front = full & (first[..., None] + 1 >= CELLS)
    known = np.ones((256, 256, 256), bool)
    known[200 : 210 + number] = False
    seen = np.where(full.any(axis=2), first + 1, np.int16(255))[..., None] >= CELLS
    T = rigid(rotation_from_quaternion_xyzw([0.1, -0.2, 0.3, 0.9]), [0.5, -0.2, 1.0 + number])
    pair = Pair(
        partial=pack(reduce_blocks(front, "any")),
        partial_256=pack(front),
        full=pack(full),
        shell=shell_of(full),
        known=pack(known),
        seen=pack(seen),
        T_world_grid=T,
        T_world_camera=rigid(T[:3, :3], [0.0, 0.0, 0.0]),
        K=np.array([[5.0, 0, 3.5], [0, 5, 2.5], [0, 0, 1]]),
        voxel_size_m=0.004,
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
        pairs = [pair_of(index + int(view), category) for view in views]
        for view, pair in zip(views, pairs, strict=True):
            (build / name / "pairs" / f"{view}.npz").write_bytes(pair_bytes(pair))
            write_images(build / name / "views", view)
            pose = pair.T_world_camera.tolist()
            rows.append({"view": view, "frame": 7, "stamp_ns": 70, "T_world_camera": pose, "pixels": 12})
        listed = {"pairs": [{"view": view, "frame": 7, "containment": 1.0} for view in views], "refused": []}
        write_json(build / name / "pairs" / "pairs.json", listed)
        write_json(build / name / "views" / "views.json", {"format_version": 1, "views": rows, "refused": []})
        write_json(build / name / "object" / "floor.json", FLOOR)
        numbers = [index + int(view) for view in views]
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


def write_images(views: Path, view: str) -> None:
    """Depth of 8 x 6 pixels at 1.5 m, its middle the object, and a grey colour image."""
    depth_mm = np.full((6, 8), 1500, np.uint16)
    mask = np.zeros((6, 8), np.uint8)
    mask[2:4, 2:6] = 255
    grey = np.full((6, 8, 3), 128, np.uint8)
    for suffix, image in (("depth.png", depth_mm), ("mask.png", mask), ("color.jpg", grey)):
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
