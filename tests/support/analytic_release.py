"""A release of balls and boxes whose views are rendered exactly, to be held against formulas.

Other than in `synthetic_release`, pairs, views, meshes and cameras belong together.
"""

import json
from pathlib import Path

import cv2
import numpy as np
import trimesh
from analytic_scenes import box, depth_of, sphere
from numpy.typing import NDArray
from synthetic_release import RECORDINGS, Recordings, synthetic_settings, write_build, write_object

from kinectbench.core.geometry import (
    Camera,
    TriangleMesh,
    invert_rigid,
    rigid,
    rotation_from_quaternion_xyzw,
    transform_points,
)
from kinectbench.core.geometry.mesh import read_own_ply
from kinectbench.core.voxels.pair_file import Pair, pair_bytes
from kinectbench.core.voxels.seen_cells import seen_cells
from kinectbench.core.voxels.solid import packed_shell, voxelize_solid
from kinectbench.core.voxels.view_grids import object_cube, partial_grids, view_cube
from kinectbench.lab.simulate.path import look_at
from kinectbench.release.publish.publish import PublishSummary, publish
from kinectbench.scoring.camera_shape import CameraShape

Float64 = NDArray[np.float64]

CAMERA = Camera(320, 240, 262.5, 260.0, 157.5, 121.0)
RADIUS_M = 0.3
# In the floor's frame.
CENTER_M = (0.1, -0.05, RADIUS_M)
BOX_LOW, BOX_HIGH = (-0.45, -0.3, 0.0), (0.4, 0.25, 0.5)


def T_world_floor(index: int) -> Float64:
    """Where the floor of the index-th recording lies in its world."""
    turn = rotation_from_quaternion_xyzw([0.7, 0.1 * index, -0.1, 0.6])
    return np.asarray(rigid(turn, [0.3, -0.1 * index, 1.2]))


def T_floor_camera(view: int) -> Float64:
    """A camera 1.3 m from the object, each view from another side; the third is too near to see all of it."""
    angle, away = 0.7 + 1.9 * view, 1.3 if view < 2 else 0.8
    eye = np.array([away * np.cos(angle), away * np.sin(angle), 0.9])
    return np.asarray(look_at(eye, np.array(CENTER_M)))


def is_ball(category: str) -> bool:
    return category == "chair"


def true_in_camera(recording: str, category: str, view: str) -> CameraShape:
    """The true mesh of a recording in the camera of a view, metres."""
    index = [row[0] for row in RECORDINGS].index(recording)
    mesh = true_mesh(category, index)
    T_camera_world = invert_rigid(T_world_floor(index) @ T_floor_camera(int(view)))
    return CameraShape("mesh", transform_points(T_camera_world, mesh.vertices), mesh.faces.astype(np.int64))


def true_mesh(category: str, index: int) -> TriangleMesh:
    """In the index-th recording's world."""
    if is_ball(category):
        mesh = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS_M)
        mesh.apply_translation(CENTER_M)
    else:
        mesh = trimesh.creation.box(bounds=[BOX_LOW, BOX_HIGH])
    return TriangleMesh(np.array(mesh.vertices), np.array(mesh.faces, np.int32)).transformed(
        T_world_floor(index)
    )


def true_depth_m(category: str, view: int) -> NDArray[np.float32]:
    """Of the object alone, by formula; (240, 320)."""
    surface = sphere(CENTER_M, RADIUS_M) if is_ball(category) else box(BOX_LOW, BOX_HIGH)
    return depth_of([surface], CAMERA, T_floor_camera(view))


def surface_distance_m(category: str, points_floor: Float64) -> Float64:
    """How far points (n, 3) are from the true surface, metres, by formula."""
    if is_ball(category):
        return np.asarray(np.abs(np.linalg.norm(points_floor - np.array(CENTER_M), axis=1) - RADIUS_M))
    low, high = points_floor - np.array(BOX_LOW), np.array(BOX_HIGH) - points_floor
    outside = np.linalg.norm(np.maximum(np.maximum(-low, -high), 0), axis=1)
    inside = np.minimum(low, high).min(axis=1)
    return np.asarray(np.where(outside > 0, outside, np.maximum(inside, 0)))


def true_pair(category: str, index: int, view: int, mesh: TriangleMesh, framing: str = "object") -> Pair:
    """Depth of whole millimetres, as a view's file holds it."""
    depth_m = np.rint(true_depth_m(category, view) * 1000).astype(np.float32) / np.float32(1000)
    T_world_camera = T_world_floor(index) @ T_floor_camera(view)
    if framing == "object":
        grid = object_cube(mesh.vertices, T_world_camera)
    else:
        grid = view_cube(CAMERA.backproject(depth_m)[depth_m > 0], T_world_camera)
    full = voxelize_solid(mesh.vertices, mesh.faces, grid)
    partial_256, partial = partial_grids(depth_m, CAMERA, T_world_camera, grid)
    return Pair(
        partial=partial,
        partial_256=partial_256,
        full=full,
        shell=packed_shell(full),
        known=np.full_like(full, 255),
        seen=seen_cells(depth_m, CAMERA, T_world_camera, grid),
        T_world_grid=grid.T_world_grid,
        T_world_camera=T_world_camera,
        K=CAMERA.K,
        voxel_size_m=grid.voxel_size_m,
        surface_sigma_m=0.001,
        framing=framing,
        partial_rule="any",
    )


def write_analytic_build(build: Path, wanted: Recordings = RECORDINGS, framing: str = "object") -> None:
    """What publish reads, true to each other."""
    write_build(build, wanted)
    for index, (name, category, _, _, count) in enumerate(wanted):
        folder = build / name
        true = true_mesh(category, index)
        write_object(folder / "object", true, true.vertices[0] - 0.02)
        mesh = read_own_ply(folder / "object" / "mesh.ply")  # of float32, as the stages have it
        T_floor_world = invert_rigid(T_world_floor(index))
        _update(
            folder / "object" / "floor.json",
            {"plane_world": T_floor_world[2].tolist(), "T_floor_world": T_floor_world.tolist()},
        )
        rows = []
        for number in range(count):
            view = f"{number:03d}"
            pair = true_pair(category, index, number, mesh, framing)
            depth_mm = np.rint(true_depth_m(category, number) * 1000).astype(np.uint16)
            (folder / "pairs" / f"{view}.npz").write_bytes(pair_bytes(pair))
            for suffix, image in (("depth", depth_mm), ("mask", (depth_mm > 0).astype(np.uint8) * 255)):
                cv2.imwrite(str(folder / "views" / f"{view}.{suffix}.png"), image)
            rows.append({"view": view, "frame": number, "stamp_ns": number * 10**9, "containment": 1.0})
            rows[-1]["T_world_camera"] = pair.T_world_camera.tolist()
        _update(folder / "views" / "views.json", {"format_version": 1, "views": rows, "refused": []})
        (folder / "sequence").mkdir(exist_ok=True)
        K = {key: getattr(CAMERA, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}
        _update(folder / "sequence" / "camera.json", K)


def publish_analytic(root: Path) -> PublishSummary:
    """Build and publish below `root`."""
    write_analytic_build(root / "build")
    names = [recording[0] for recording in RECORDINGS]
    return publish(synthetic_settings(), root / "build", root / "benchmark", names)


def _update(path: Path, values: dict[str, object]) -> None:
    content = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    path.write_text(json.dumps(content | values), encoding="utf-8")
