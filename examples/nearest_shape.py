"""A method that knows no network: the nearest training shape by partial view, registered to the view's depth.

    python examples/nearest_shape.py benchmark/ predictions/nearest-shape
    kinectbench check predictions/nearest-shape --benchmark benchmark/
    kinectbench score predictions/nearest-shape --benchmark benchmark/

The training pairs whose partial lies nearest, once both are centred, are registered by ICP with a scale; the
one that then lies nearest is the answer, as cells in the camera frame. To run another training set than the
benchmark's own, name it with --train.
"""

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import kinectbench
from kinectbench.core.types import Float64

# Points of a cloud; registered candidates; steps of ICP; by how much a training shape may be scaled.
POINTS, CANDIDATES, STEPS, MOST_SCALE = 1000, 8, 30, 1.3


@dataclass(frozen=True)
class Shape:
    """A training pair: its partial as points (n, 3) in the camera frame, metres, and its cells."""

    partial_m: Float64
    full: NDArray[np.uint8]
    T_camera_grid: Float64
    voxel_size_m: float


def camera_of(item: dict) -> Float64:
    """(4, 4) from grid to camera, metres."""
    return np.linalg.inv(item["T_world_camera"]) @ item["T_world_grid"]


def partial_of(item: dict) -> Float64:
    """(n, 3) points of the partial in the camera frame, metres; n is POINTS at most."""
    cells = np.argwhere(np.unpackbits(item["partial_256"], axis=-1))
    cells = cells[np.random.default_rng(0).permutation(len(cells))[:POINTS]]
    T = camera_of(item)
    return (cells + 0.5) * item["voxel_size_m"] @ T[:3, :3].T + T[:3, 3]


def similarity(source: Float64, target: Float64) -> Float64:
    """(4, 4): the similarity of bounded scale that brings points (n, 3) nearest to others (Umeyama, 1991)."""
    middles = source.mean(axis=0), target.mean(axis=0)
    u, s, vt = np.linalg.svd((target - middles[1]).T @ (source - middles[0]))
    sign = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = np.clip((s * sign).sum() / ((source - middles[0]) ** 2).sum(), 1 / MOST_SCALE, MOST_SCALE)
    T = np.eye(4)
    T[:3, :3] = scale * (u * sign) @ vt
    T[:3, 3] = middles[1] - T[:3, :3] @ middles[0]
    return T


def moved(T: Float64, points: Float64) -> Float64:
    """Points (n, 3) mapped by (4, 4)."""
    return points @ T[:3, :3].T + T[:3, 3]


def registered(source: Float64, target: Float64) -> tuple[float, Float64]:
    """ICP of points to others, from their means on: mean distance of both ways, metres, and (4, 4)."""
    tree, T = cKDTree(target), np.eye(4)
    T[:3, 3] = target.mean(axis=0) - source.mean(axis=0)
    for _ in range(STEPS):
        there, back = tree.query(moved(T, source))[1], cKDTree(moved(T, source)).query(target)[1]
        T = similarity(np.concatenate([source, source[back]]), np.concatenate([target[there], target]))
    return distance(moved(T, source), target), T


def distance(one: Float64, other: Float64) -> float:
    """Mean distance of two clouds, both ways, metres."""
    return (cKDTree(one).query(other)[0].mean() + cKDTree(other).query(one)[0].mean()) / 2


def centred(points: Float64) -> Float64:
    """Points with their mean at the origin."""
    return points - points.mean(axis=0)


def nearest(partial_m: Float64, shapes: list[Shape]) -> tuple[Shape, Float64]:
    """The training shape for a partial (n, 3), and (4, 4) from its camera to the view's."""
    first = [distance(centred(shape.partial_m), centred(partial_m)) for shape in shapes]
    chosen = [shapes[index] for index in np.argsort(first)[:CANDIDATES]]
    fits = [registered(shape.partial_m, partial_m) for shape in chosen]
    best = int(np.argmin([found for found, _ in fits]))
    return chosen[best], fits[best][1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("benchmark")
    parser.add_argument("out", type=Path)
    parser.add_argument("--train", help="a release with training pairs; default: the benchmark")
    options = parser.parse_args()
    keys = ("partial_256", "full", "T_world_grid", "T_world_camera", "voxel_size_m", "meta")
    shapes = dict[str, list[Shape]]()
    for item in kinectbench.load(options.train or options.benchmark, keys=keys, packed=True).split("train"):
        shape = Shape(partial_of(item), item["full"], camera_of(item), float(item["voxel_size_m"]))
        shapes.setdefault(item["meta"]["category"], []).append(shape)
    for item in kinectbench.load(options.benchmark, keys=keys, packed=True).split("test"):
        meta = item["meta"]
        shape, T = nearest(partial_of(item), shapes[meta["category"]])
        path = options.out / meta["recording"] / f"{meta['view']}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(
            path,
            occupancy=np.unpackbits(shape.full, axis=-1).astype(bool),
            T_camera_grid=T @ shape.T_camera_grid,
            voxel_size_m=shape.voxel_size_m,
        )
    method = {"name": "nearest-shape", "frame": "camera", "form": "voxels", "inputs": ["depth", "mask"]}
    (options.out / "method.json").write_text(json.dumps(method, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
