"""What a release says of an object, forged and sealed again: `verify` makes it anew of the object's mesh."""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from file_damage import seal
from scipy import ndimage
from synthetic_release import publish_synthetic

from kinectbench.core.artefacts.object import FloorFile
from kinectbench.core.artefacts.object_grids import Label, ObjectVolume
from kinectbench.core.geometry import Grid
from kinectbench.core.geometry.mesh import parse_ply, read_own_ply, write_ply
from kinectbench.core.voxels.open_mesh import voxelize_open
from kinectbench.core.voxels.pair_file import Pair, pack, pair_bytes, read_pair, unpack
from kinectbench.core.voxels.solid import costs_too_much, packed_shell, voxelize_solid
from kinectbench.release.check.truth_check import ObjectTruth, truth_problems
from kinectbench.release.check.verify import verify
from kinectbench.release.publish.object_glb import glb_bytes

PAIR, FOLDER = "pairs/chair_02/000.npz", "objects/chair_02"


@pytest.fixture
def copy(analytic: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(analytic / "benchmark", tmp_path / "benchmark"))


def with_full(pair: Pair, full: np.ndarray) -> Pair:
    return replace(pair, full=full, shell=packed_shell(full))


def grown(pair: Pair) -> Pair:
    """By five cells on all sides."""
    return with_full(pair, pack(ndimage.binary_dilation(unpack(pair.full), iterations=5)))


def shrunk(pair: Pair) -> Pair:
    return with_full(pair, pack(ndimage.binary_erosion(unpack(pair.full))))


def moved(pair: Pair) -> Pair:
    T = pair.T_world_grid.copy()
    T[:3, 3] += pair.voxel_size_m
    return replace(pair, T_world_grid=T)


def forged_volume(change: Callable[[ObjectVolume], ObjectVolume]) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        change(ObjectVolume.read(folder / FOLDER)).write(folder / FOLDER)

    return make


def forged_pair(change: Callable[[Pair], Pair]) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        (folder / PAIR).write_bytes(pair_bytes(change(read_pair(folder / PAIR))))

    return make


def larger_mesh(folder: Path) -> None:
    mesh = read_own_ply(folder / FOLDER / "mesh.ply")
    middle = mesh.vertices.mean(axis=0)
    write_ply(replace(mesh, vertices=middle + 1.02 * (mesh.vertices - middle)), folder / FOLDER / "mesh.ply")


def larger_glb(folder: Path) -> None:
    mesh = read_own_ply(folder / FOLDER / "mesh.ply")
    floor = FloorFile.read(folder / FOLDER)
    content = glb_bytes(replace(mesh, vertices=mesh.vertices * 1.02), floor.T_floor_world)
    assert content is not None
    (folder / f"{FOLDER}.glb").write_bytes(content)


def glb_of_fewer(folder: Path) -> None:
    path = folder / f"{FOLDER}.glb"
    path.write_bytes(re.sub(rb'("triangles_of_mesh_ply": ?)2', rb"\g<1>1", path.read_bytes()))


def unknown_part(volume: ObjectVolume) -> ObjectVolume:
    labels = volume.labels.copy()
    labels[1] = Label.UNKNOWN
    return replace(volume, labels=labels)


OF_FULL, OF_VOLUME = (
    f"{PAIR}: [0-9]+ of the [0-9]+ cells of 'full' are",
    f"{FOLDER}/volume.npz: [0-9]+ voxels",
)
# What is seen of the shape is of `full`, too.
SHARE = "benchmark.json: its recordings.chair_02.visible_share is "
FORGED: dict[str, tuple[Callable[[Path], None], str]] = {
    "full is grown": (forged_pair(grown), OF_FULL),
    "full is eroded": (forged_pair(shrunk), OF_FULL),
    "the cube is moved by a cell": (forged_pair(moved), OF_FULL),
    "full by another rule": (
        forged_pair(lambda pair: replace(grown(pair), occupancy_rule="seeable")),
        f"{PAIR}: occupancy_rule is 'seeable', which is not that of such an object",
    ),
    "a rule that there is not": (
        forged_pair(lambda pair: replace(grown(pair), occupancy_rule="x\x1b")),
        f"{PAIR}: occupancy_rule is 'x[?]', which",
    ),
    "known is cut": (
        forged_pair(lambda pair: replace(pair, known=pair.known & np.uint8(0xF0))),
        f"{PAIR}: [0-9]+ cells of 'known' are not as its volume.npz has them",
    ),
    "interior is made up": (
        forged_pair(lambda pair: replace(pair, interior=pair.full)),
        f"{PAIR}: [0-9]+ cells of 'interior' are not as its volume.npz has them",
    ),
    "unknown voxels": (forged_volume(unknown_part), f"{PAIR}: [0-9]+ cells of 'known' are not"),
    "solid is emptied": (
        forged_volume(lambda volume: replace(volume, solid=np.zeros_like(volume.solid))),
        f"{OF_VOLUME} of 'solid' are not as mesh.ply has them",
    ),
    "labels are free": (
        forged_volume(lambda volume: replace(volume, labels=np.zeros_like(volume.labels))),
        f"{OF_VOLUME} of 'solid' are not as 'labels' has them",
    ),
    "no mesh to compare with": (
        lambda folder: (folder / FOLDER / "mesh.ply").unlink(),
        f"{FOLDER}/mesh.ply: missing, a release of recordings has it",
    ),
    "another camera": (
        forged_pair(lambda pair: replace(pair, K=pair.K * [[1.1], [1.1], [1]])),
        f"{PAIR}: K is not that of views.json",
    ),
    "the GLB is larger": (larger_glb, f"{FOLDER}.glb: the box around it is [0-9.]+ m from that of mesh.ply"),
    "the GLB is of another mesh": (glb_of_fewer, f"{FOLDER}.glb: is of a mesh of 10480 triangles where"),
    "the mesh is larger": (larger_mesh, OF_FULL),
}


@pytest.mark.parametrize("name", FORGED)
def test_what_is_said_of_an_object_is_made_anew(copy: Path, name: str) -> None:
    make, expected = FORGED[name]
    make(copy)
    seal(copy)
    lines = verify(copy)
    assert any(re.match(expected, line) for line in lines), lines
    assert [line for line in lines if not line.startswith((PAIR, FOLDER, SHARE))] == []


def test_sound_ones_are_well(analytic: Path, tmp_path: Path) -> None:
    assert verify(analytic / "benchmark") == []
    publish_synthetic(tmp_path)
    assert verify(tmp_path / "benchmark") == []


def problems_of(pair: Pair, mesh: Any) -> list[str]:
    return list(truth_problems(pair, ObjectTruth(mesh)))


def test_objects_that_no_volume_comes_with(copy: Path) -> None:
    """Synthesised ones: by the rule that the pair names; beyond the mesh's box nothing is solid."""
    pair = read_pair(copy / PAIR)
    mesh = parse_ply((copy / FOLDER / "mesh.ply").read_bytes())
    rays = replace(pair, occupancy_rule="six-rays", full=voxelize_open(mesh.vertices, mesh.faces, pair.grid))
    assert problems_of(rays, mesh) == []
    assert "cells of 'full'" in problems_of(replace(rays, full=grown(pair).full), mesh)[0]
    seeable = replace(pair, occupancy_rule="seeable")
    assert problems_of(seeable, mesh) == []
    assert "lie beyond the box" in problems_of(replace(seeable, full=grown(pair).full), mesh)[0]
    assert "are not as its mesh.ply" in problems_of(replace(seeable, full=shrunk(pair).full), mesh)[0]


def test_meshes_that_would_cost_too_much_are_told(copy: Path) -> None:
    pair = read_pair(copy / PAIR)
    mesh = parse_ply((copy / FOLDER / "mesh.ply").read_bytes())
    far = replace(mesh, vertices=mesh.vertices * 1e30)
    assert problems_of(pair, far) == ["'full' cannot be compared: mesh.ply has vertices far from it"]
    across = replace(mesh, faces=np.tile(mesh.faces, (400, 1)))
    assert "faces across each other" in problems_of(pair, across)[0]


def test_cells_of_grids_that_are_no_cubes() -> None:
    corners = np.array([[0.0, 0.0, 0.0], [40, 0, 0], [0, 9, 0], [0, 0, 8]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    assert not costs_too_much(corners[:, :2], faces, (40, 9))
    assert costs_too_much(corners[:, :2], np.tile(faces, (5000, 1)), (40, 9))
    assert voxelize_solid(corners, faces, Grid((40, 9, 8), 1.0, np.eye(4))).any()


def test_a_volume_that_is_too_large_is_named(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Padding the volume does not switch the comparison off without a word."""
    monkeypatch.setattr("kinectbench.release.check.truth_check.MOST_VOXELS", 10)
    lines = verify(copy)
    assert any(re.match(rf"{FOLDER}/volume\.npz: [\d x]+ voxels are too many", line) for line in lines)


def test_objects_are_asked_for_whatever_the_settings_say(copy: Path) -> None:
    for path in (copy / FOLDER).iterdir():
        path.unlink()
    stated = json.loads((copy / "benchmark.json").read_text())
    stated["settings"] |= {"recordings": None, "views": None}
    (copy / "benchmark.json").write_text(json.dumps(stated))
    seal(copy)
    assert f"{FOLDER}/mesh.ply: missing, a release of recordings has it" in verify(copy)
