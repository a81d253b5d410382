"""Surfaces from volumes: outward, closed across bricks, and only where all corners were observed."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from object_checks import closed
from raising import raises

from kinectbench.core.errors import StorageError
from kinectbench.core.geometry import (
    Grid,
    TriangleMesh,
    rigid,
    rotation_from_quaternion_xyzw,
    transform_points,
)
from kinectbench.core.geometry.mesh import isosurface, read_own_ply, write_ply
from kinectbench.stages.fuse.blocks import BLOCK_VOXELS, BlockVolume, blocks_of_grid, empty_volume
from kinectbench.stages.fuse.mesh import BRICK_BLOCKS, extract_mesh


def distance_field(
    shape: tuple[int, int, int], center: tuple[float, float, float] | NDArray[np.float64], radius: float
) -> NDArray[np.float32]:
    """Signed distance of a ball, in cells."""
    x, y, z = (np.arange(n) - c for n, c in zip(shape, center, strict=True))
    distance = np.sqrt(x[:, None, None] ** 2 + y[:, None] ** 2 + z**2)
    return np.asarray(distance.astype(np.float32) - np.float32(radius))


def test_isosurface_lies_on_cell_centres_in_array_order() -> None:
    center = (12.25, 9.5, 16.75)
    mesh = isosurface(distance_field((24, 20, 32), center, 6.0))
    distance = np.linalg.norm(mesh.vertices - center, axis=1)
    assert np.abs(distance - 6.0).max() < 0.03
    assert closed(mesh).volume == pytest.approx(
        4 / 3 * np.pi * 6**3, rel=0.02
    )  # positive: faces look outward


def test_isosurface_of_an_empty_field() -> None:
    mesh = isosurface(np.ones((8, 8, 8), np.float32))
    assert mesh.vertices.shape == (0, 3) and mesh.faces.shape == (0, 3)


def test_no_faces_where_a_corner_was_unobserved() -> None:
    """Against a plain walk over all cells: those with a sign change and eight observed corners have faces."""
    field = distance_field((16, 16, 16), (7.3, 7.6, 7.1), 4.4)
    observed = np.random.default_rng(1).random(field.shape) > 0.15
    mesh = isosurface(field, observed)
    cells_with_faces = set(map(tuple, np.floor(mesh.vertices[mesh.faces].mean(axis=1)).astype(int).tolist()))
    expected = set()
    for i, j, k in np.ndindex(15, 15, 15):
        corner = (slice(i, i + 2), slice(j, j + 2), slice(k, k + 2))
        if observed[corner].all() and (field[corner] < 0).any() and (field[corner] > 0).any():
            expected.add((i, j, k))
    assert cells_with_faces == expected
    assert 50 < len(expected) < 400


def ball_volume(
    radius_voxels: float,
    center_voxels: tuple[float, float, float],
    blocks_side: int,
    T_world_grid: NDArray[np.float64],
    voxel_m: float = 0.01,
) -> BlockVolume:
    side = blocks_side * BLOCK_VOXELS
    grid = Grid((side,) * 3, voxel_m, T_world_grid)
    volume = empty_volume(blocks_of_grid(grid), voxel_m, T_world_grid)
    field = distance_field((side,) * 3, np.array(center_voxels) - 0.5, radius_voxels) * np.float32(voxel_m)
    for n, (x, y, z) in enumerate(volume.blocks * BLOCK_VOXELS):
        volume.tsdf[n] = field[x : x + BLOCK_VOXELS, y : y + BLOCK_VOXELS, z : z + BLOCK_VOXELS]
    volume.weight[:] = 1.0
    return volume


@pytest.mark.parametrize("offset", [0.0, 0.25, 0.5])
def test_bricks_join_without_seams(offset: float) -> None:
    """A ball across eight bricks; offsets put its surface on voxel centres and brick borders, too."""
    T = rigid(rotation_from_quaternion_xyzw([0.1, -0.3, 0.2, 0.9]), [1.0, -2.0, 0.5])
    middle = BRICK_BLOCKS * BLOCK_VOXELS + offset
    volume = ball_volume(14.0 + offset, (middle,) * 3, BRICK_BLOCKS + 4, T)
    keep = np.all((volume.blocks >= BRICK_BLOCKS - 4) & (volume.blocks < BRICK_BLOCKS + 4), axis=1)
    part = empty_volume(volume.blocks[keep], volume.voxel_size_m, T)
    part.tsdf[:], part.weight[:] = volume.tsdf[keep], volume.weight[keep]
    mesh = extract_mesh(part, min_weight=0.5)
    shell = closed(mesh)
    assert shell.body_count == 1
    center = transform_points(T, np.full(3, middle * 0.01))
    radius_m = np.linalg.norm(mesh.vertices - center, axis=1)
    assert np.abs(radius_m - (0.14 + offset * 0.01)).max() < 0.0002
    assert shell.volume > 0


def test_voxels_of_less_weight_count_as_unobserved() -> None:
    volume = ball_volume(10.0, (24.2, 24.3, 24.1), 6, np.eye(4))
    volume.weight[volume.blocks[:, 2] < 2] = 0.1
    mesh = extract_mesh(volume, min_weight=0.5)
    assert mesh.vertices[:, 2].min() >= 0.16
    assert mesh.vertices[:, 2].min() < 0.18
    assert len(extract_mesh(volume, min_weight=2.0).faces) == 0


def test_keep_faces_drops_unused_vertices_and_keeps_colours() -> None:
    vertices = np.arange(15.0).reshape(5, 3)
    colors = np.arange(15, dtype=np.uint8).reshape(5, 3)
    mesh = TriangleMesh(vertices, np.array([[0, 1, 2], [2, 3, 4]], np.int32), colors)
    kept = mesh.keep_faces(np.array([False, True]))
    np.testing.assert_array_equal(kept.vertices, vertices[2:])
    np.testing.assert_array_equal(kept.faces, [[0, 1, 2]])
    np.testing.assert_array_equal(kept.colors, colors[2:])


def test_ply_round_trip(tmp_path: Path) -> None:
    mesh = isosurface(distance_field((16, 16, 16), (7.3, 7.6, 7.1), 4.4))
    path = tmp_path / "mesh.ply"
    write_ply(mesh, path)
    first = path.read_bytes()
    again = read_own_ply(path)
    np.testing.assert_array_equal(again.faces, mesh.faces)
    np.testing.assert_array_equal(again.vertices, mesh.vertices.astype(np.float32))
    write_ply(mesh, path)
    assert path.read_bytes() == first


@pytest.mark.parametrize("damage", ["missing", "empty", "text", "cut"])
def test_damaged_ply(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "mesh.ply"
    write_ply(isosurface(distance_field((16, 16, 16), (7.3, 7.6, 7.1), 4.4)), path)
    whole = path.read_bytes()
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes({"empty": b"", "text": b"hello", "cut": whole[: len(whole) // 2]}[damage])
    with raises(StorageError, "storage.damaged", match=r"mesh\.ply.*--force"):
        read_own_ply(path)
