"""A build folder as the stages would leave it: a box with a sphere on it, seen on a circle."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from known_builds import write_manifests

from kinectbench.core.artefacts.object_grids import Label, ObjectVolume
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.geometry import Grid, TriangleMesh, invert_rigid, quaternion_xyzw_from_rotation, rigid
from kinectbench.core.geometry.mesh import write_ply
from kinectbench.core.pictures import look_along
from kinectbench.core.voxels.pair_file import Pair, pack, pair_bytes
from kinectbench.engine.stages import Job
from kinectbench.settings.models import BenchmarkSettings

SETTINGS = BenchmarkSettings.model_validate(
    {
        "name": "furniture",
        "license": "CC-BY-4.0",
        "recordings": [
            {"id": "chair_01", "path": "recordings/chair_01", "category": "chair", "object": "red_chair"},
            {"id": "table_01", "path": "recordings/table_01", "category": "table"},
            {"id": "bench_01", "path": "recordings/bench_01", "category": "bench"},
        ],
    }
)
N_FRAMES = 40
# Nobody looked under the seat from the front, which is at -y.
FRONTIER = {
    "direction": "side",
    "area_m2": 0.13,
    "size_m": [0.39, 0.33],
    "center_m": [0.0, -0.2, 0.2],
    "look_from": [0.0, -1.0, 0.0],
    "advice": "nobody looked into the opening at the side, 39 x 33 cm: record from the front <b>",
    "volume_m3": 0.05,
    "inside_share": 0.3,
    "solid_share": 0.0,
}
# The world is the first camera's; the floor's z is the world's -y.
T_FLOOR_WORLD = rigid([[1, 0, 0], [0, 0, 1], [0, -1, 0]], [0, -1.2, 1.0])


def cameras_floor() -> np.ndarray:
    """Three quarters of a circle of 1.2 m around the object, 1 m up, looking at it."""
    angles = np.linspace(0, 1.5 * np.pi, N_FRAMES) - np.pi / 2
    eyes = np.stack([1.2 * np.cos(angles), 1.2 * np.sin(angles), np.full(N_FRAMES, 1.0)], axis=-1)
    up = np.array([0.0, 0, 1])
    return np.stack([rigid(look_along(np.array([0, 0, 0.3]) - eye, up), eye) for eye in eyes])


def solid_floor(points: np.ndarray) -> np.ndarray:
    """A seat 0.5 x 0.4 on four legs, with a back along its +y side and a ball on its +x side: (...) bool."""
    x, y, z = np.moveaxis(points, -1, 0)
    seat = (abs(x) < 0.25) & (abs(y) < 0.2) & (z > 0.38) & (z < 0.44)
    legs = (abs(abs(x) - 0.22) < 0.025) & (abs(abs(y) - 0.17) < 0.025) & (z > 0) & (z < 0.4)
    back = (abs(x) < 0.25) & (abs(y - 0.18) < 0.02) & (z > 0.4) & (z < 0.85)
    ball = (x - 0.15) ** 2 + (y + 0.08) ** 2 + (z - 0.5) ** 2 < 0.06**2
    solid: np.ndarray = seat | legs | back | ball
    return solid


def make_pair(T_world_camera: np.ndarray) -> Pair:
    """The pair of one camera; its partial is what the camera's rays, taken as parallel, meet first."""
    n, cell_m = 128, 0.92 / 128
    T_floor_camera = T_FLOOR_WORLD @ T_world_camera
    center = invert_rigid(T_floor_camera)[:3] @ np.array([0, 0, 0.42, 1])
    T_world_grid = T_world_camera @ rigid(np.eye(3), center - n * cell_m / 2)
    axis = ((np.arange(n) + 0.5) * cell_m).astype(np.float32)
    T = (T_FLOOR_WORLD @ T_world_grid).astype(np.float32)
    x, y, z = axis[:, None, None, None], axis[None, :, None, None], axis[None, None, :, None]
    full = solid_floor(x * T[:3, 0] + y * T[:3, 1] + z * T[:3, 2] + T[:3, 3])
    first = full & (np.cumsum(full, axis=2, dtype=np.int16) <= 1)
    blocks = np.asarray(first.reshape(64, 2, 64, 2, 64, 2).any(axis=(1, 3, 5)))
    first, full = (grid.repeat(2, 0).repeat(2, 1).repeat(2, 2) for grid in (first, full))
    everywhere = np.full((256, 256, 32), 255, np.uint8)
    return Pair(
        partial=pack(blocks),
        partial_256=pack(first),
        full=pack(full),
        shell=pack(full),
        known=everywhere,
        seen=everywhere,
        T_world_grid=T_world_grid,
        T_world_camera=T_world_camera,
        K=np.array([[525.0, 0, 319.5], [0, 525, 239.5], [0, 0, 1]]),
        voxel_size_m=cell_m / 2,
        surface_sigma_m=0.002,
        framing="object",
        partial_rule="any",
    )


def write_volume(folder: Path) -> None:
    """volume.npz: voxels of 2 cm whose upper neighbour is not solid were measured."""
    edge_m, shape = 0.02, (32, 28, 46)
    T_floor_grid = rigid(np.eye(3), [-0.32, -0.28, -0.02])
    cells = (np.moveaxis(np.indices(shape), 0, -1) + 0.5) * edge_m + T_floor_grid[:3, 3]
    solid = solid_floor(cells)
    top = solid & ~np.roll(solid, -1, axis=2)
    labels = np.where(top, Label.SURFACE, np.where(solid, Label.INTERIOR, Label.FREE)).astype(np.uint8)
    grid = Grid(shape, edge_m, invert_rigid(T_FLOOR_WORLD) @ T_floor_grid)
    ObjectVolume(grid, solid, labels, solid.astype(np.float16), np.zeros_like(solid)).write(folder)


def write_object(folder: Path) -> None:
    """floor.json, mesh.ply, volume.npz (what faces up was measured) and quality.json."""
    import open3d as o3d

    boxes = [
        ((0.5, 0.4, 0.06), (-0.25, -0.2, 0.38)),
        ((0.5, 0.04, 0.45), (-0.25, 0.16, 0.4)),
        *(((0.05, 0.05, 0.4), (x - 0.025, y - 0.025, 0)) for x in (-0.22, 0.22) for y in (-0.17, 0.17)),
    ]
    parts = [(o3d.geometry.TriangleMesh.create_box(*size), corner) for size, corner in boxes]
    parts.append((o3d.geometry.TriangleMesh.create_sphere(0.06), (0.15, -0.08, 0.5)))
    whole = o3d.geometry.TriangleMesh()
    for part, place in parts:
        part.translate(place)
        whole += part
    # Off the faces of voxels, where single precision decides what is within.
    whole.translate((0, 0, 1e-4))
    whole.transform(invert_rigid(T_FLOOR_WORLD))
    folder.mkdir(parents=True)
    mesh = TriangleMesh(np.asarray(whole.vertices), np.asarray(whole.triangles, np.int32))
    write_ply(mesh, folder / "mesh.ply")
    write_volume(folder)
    floor = {"plane_world": [0, -1, 0, 1], "T_floor_world": T_FLOOR_WORLD.tolist(), "noise_m": 0.002,
             "inlier_share": 0.5}  # fmt: skip
    (folder / "floor.json").write_text(json.dumps(floor))
    quality = {
        "verdict": "good",
        "warnings": [],
        "repeatability_iou": 0.95321,
        "voxels": {"surface": 12, "unknown": 3},
        "estimated_iou": 0.7412,
        "estimated_iou_low": 0.352,
        "estimated_iou_high": 0.8,
        "estimated_iou_reasons": ["an opening that nobody looked into"],
        "frontiers": [FRONTIER],
    }
    (folder / "quality.json").write_text(json.dumps(quality))


def write_trajectory(folder: Path, left_out: list[int]) -> None:
    """trajectory.txt without the frames left out, and health.json."""
    folder.mkdir(parents=True)
    lines = ["# t tx ty tz qx qy qz qw"]
    for index, T in enumerate(invert_rigid(T_FLOOR_WORLD) @ cameras_floor()):
        if index not in left_out:
            numbers = [index, *T[:3, 3], *quaternion_xyzw_from_rotation(T[:3, :3])]
            lines.append(" ".join(f"{value:.6f}" for value in numbers))
    (folder / "trajectory.txt").write_text("\n".join(lines) + "\n")
    health = {
        "source": "tracked",
        "verdict": "usable: the frames agree",
        "grade": "fair",
        "warnings": ["2 frames disagree with the rest"],
        "frames": N_FRAMES,
        "tracked": N_FRAMES - len(left_out),
        "rejected": [{"frame": f, "reason": "residual 41 mm"} for f in left_out],
        "median_residual_mm": 4.2,
    }
    (folder / "health.json").write_text(json.dumps(health))


def write_views(folder: Path, registered: bool, n_views: int) -> None:
    """views.json with depth, colour and mask of each view: a bright disc on a slope."""
    import cv2

    folder.mkdir(parents=True)
    y, x = np.mgrid[:240, :320]
    rows = []
    for k in range(n_views):
        disc = (x - 120 - 12 * k) ** 2 + (y - 120) ** 2 < 70**2
        depth = np.where(disc, 900, 1500 + 2 * y).astype(np.uint16)
        depth[:, :12] = 0
        color = np.where(disc[..., None], [60, 140, 200], [120, 110, 100]).astype(np.uint8)
        view = f"{k:03d}"
        cv2.imwrite(str(folder / f"{view}.depth.png"), depth)
        cv2.imwrite(str(folder / f"{view}.color.jpg"), color)
        cv2.imwrite(str(folder / f"{view}.mask.png"), disc.astype(np.uint8) * 255)
        rows.append({"view": view, "frame": 3 * k, "stamp_ns": 10**8 * k, "reason": "random"})
    (folder / "views.json").write_text(
        json.dumps({"color_registered": registered, "views": rows, "refused": []})
    )


def write_pairs(folder: Path, n_pairs: int) -> None:
    """Pair files and pairs.json, with one view refused."""
    folder.mkdir(parents=True)
    cameras_world = invert_rigid(T_FLOOR_WORLD) @ cameras_floor()
    rows = []
    for k, frame in enumerate(np.linspace(0, N_FRAMES - 1, n_pairs).astype(int).tolist()):
        (folder / f"{k:03d}.npz").write_bytes(pair_bytes(make_pair(cameras_world[frame])))
        rows.append(
            {"view": f"{k:03d}", "frame": frame, "containment": 0.93 + k / 1000, "residual_m": 0.0031}
        )
    refused = [{"view": "099", "frame": 7, "reason": "residual of 22 mm is above 15 mm <b>"}]
    (folder / "pairs.json").write_text(json.dumps({"pairs": rows, "refused": refused}))


def parsed_tables(contents: list[dict[str, Any]]) -> list[ScoreTable]:
    """Score tables as they are read from files of these contents."""
    return [ScoreTable.parse(json.dumps(content), "scores.json") for content in contents]


def score(method: str, iou: float | None, complete: bool = True) -> dict[str, Any]:
    """A score table of two categories."""

    def row(offset: float) -> dict[str, Any]:
        value = None if iou is None else iou + offset
        return {"iou": value, "ce": 0.2 - offset, "precision": 0.8, "recall": 0.7, "f1": 0.75, "pairs": 3,
                "objects": 1, "coverage_voxels": 0.91, "coverage_shape": 0.97, "base_rate_ce": 0.26,
                "base_rate_source": "test (oracle)"}  # fmt: skip

    tables = {p: {"chair": row(0.0), "table": row(0.05)} for p in ("known", "paper", "occluded")}
    return {
        "method": method,
        "benchmark_sha256": "ab" * 32,
        "package_version": "0.1.0",
        "settings": {},
        "thresholds": {"chair": 0.35, "table": 0.5},
        "threshold_source": "validation",
        "rows": [],
        "by_category": tables if complete else None,
        "overall": {p: row(0.02) for p in tables} if complete else None,
        "failures": [] if complete else [{"view": "chair_01/003", "error": "missing"}],
        "warnings": [],
    }


def write_build(build: Path, n_pairs: int) -> None:
    """chair_01 is whole, table_01 has an unregistered camera and no pairs, bench_01 is not built."""
    write_trajectory(build / "chair_01" / "trajectory", left_out=[11, 12, 30])
    write_object(build / "chair_01" / "object")
    write_views(build / "chair_01" / "views", registered=True, n_views=8)
    write_pairs(build / "chair_01" / "pairs", n_pairs)
    write_trajectory(build / "table_01" / "trajectory", left_out=[])
    write_views(build / "table_01" / "views", registered=False, n_views=3)
    for recording in SETTINGS.recordings[:2]:
        write_manifests(build / recording.id, Job(SETTINGS, recording, build.parent))
