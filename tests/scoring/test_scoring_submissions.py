"""Meshes, packed bits, orders of bytes, hostile folders: each is scored, or refused in one line."""

import csv
import errno
import io
import json
import os
import socket
import tracemalloc
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from bounds import within
from hypothesis import given, settings
from prediction_bytes import FILES, good_files, read_one
from raising import raises
from typed import present

from kinectbench.core.artefacts.counted import JOURNAL
from kinectbench.core.errors import PredictionError, StorageError
from kinectbench.core.storage import canonical_json
from kinectbench.core.voxels.pair_file import pack, read_pair, unpack
from kinectbench.release.release import Release
from kinectbench.scoring.method_json import NAMED
from kinectbench.scoring.pair_result import Counting, Journal, PairJob, count_job
from kinectbench.scoring.prediction_file import load_prediction
from kinectbench.scoring.predictions import (
    check,
    check_method,
    find_predictions,
    split_methods,
)
from kinectbench.scoring.score import score, score_methods
from kinectbench.scoring.strays import stray_lines
from kinectbench.scoring.truth import read_voxel_size

VOXEL_M = 0.004
BOX = trimesh.creation.box(bounds=[[0.1, 0.2, 0.3], [0.5, 0.4, 0.9]])


def exported(mesh: trimesh.Trimesh, kind: str) -> bytes:
    content = mesh.export(file_type=kind)
    return content.encode() if isinstance(content, str) else content


@pytest.mark.parametrize("kind", ["ply", "obj"])
def test_a_mesh_is_voxelised(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"000.{kind}"
    path.write_bytes(exported(BOX, kind))
    expected = np.zeros((256, 256, 256), bool)
    expected[25:125, 50:100, 75:225] = True  # centres between the sides
    np.testing.assert_array_equal(load_prediction(path, "chair/000", VOXEL_M), expected)
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=0.3).apply_translation([0.5, 0.5, 0.5])
    path.write_bytes(exported(sphere, kind))
    volume_m3 = load_prediction(path, None, VOXEL_M).sum() * VOXEL_M**3
    assert volume_m3 == pytest.approx(sphere.volume, rel=2e-3)


OPEN = trimesh.Trimesh(BOX.vertices, BOX.faces[1:], process=False)
TURNED = trimesh.Trimesh(BOX.vertices, [BOX.faces[0][::-1], *BOX.faces[1:]], process=False)
DOUBLED = trimesh.Trimesh(BOX.vertices, [*BOX.faces, BOX.faces[0]], process=False)
FAN = "".join(f"v {x} {y} 0.5\n" for x in (0, 1) for y in np.linspace(0, 1, 400)) + "".join(
    f"f {a} {a % 400 + 1} {401 + (7 * a) % 400}\n" for _ in range(40) for a in range(1, 401)
)
MESHES: dict[str, tuple[str, bytes, str]] = {
    "open": ("ply", exported(OPEN, "ply"), "the mesh is not closed .3 of 18 edges with one face: holes"),
    "doubled": (
        "ply",
        exported(DOUBLED, "ply"),
        "not closed .3 of 18 edges with more than two faces: doubled triangles",
    ),
    "turned": ("obj", exported(TURNED, "obj"), "not consistently oriented"),
    "far": ("ply", exported(BOX.copy().apply_translation([500, 0, 0]), "ply"), "vertices beyond 16.4 m"),
    "not finite": ("obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "vertices beyond|not a readable"),
    "points only": ("ply", exported(trimesh.Trimesh(BOX.vertices), "ply"), "without faces|not a readable"),
    "empty": ("ply", b"", "the file is empty"),
    "ends where it begins": ("ply", b"end_header\n", "not a readable ply mesh: a malformed header"),
    "garbage": ("obj", b"\x00\xff" * 99, "not a readable obj mesh|without faces"),
    "cut off": ("ply", exported(BOX, "ply")[:-30], "not a readable ply mesh"),
    "claims terabytes": (
        "ply",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\nproperty float x\n"
        b"property float y\nproperty float z\nelement face 99999999999\n"
        b"property list uchar int vertex_indices\nend_header\n",
        "not a readable ply mesh",
    ),
    "faces of no vertex": ("obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 900\n", "not a readable obj mesh"),
    "costly": ("obj", FAN.encode(), "faces across each other"),
}


@pytest.mark.parametrize("name", list(MESHES))
def test_hostile_meshes(name: str, tmp_path: Path) -> None:
    kind, content, message = MESHES[name]
    path = tmp_path / f"000.{kind}"
    path.write_bytes(content)
    with pytest.raises(PredictionError, match=message) as caught:
        load_prediction(path, "chair_01/000", VOXEL_M)
    assert str(caught.value).startswith("chair_01/000: ") and "\n" not in str(caught.value)
    assert len(str(caught.value)) < 250


def test_an_obj_opens_no_other_file(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "secret.mtl").write_text("newmtl a\nmap_Kd ../secret.png\n")
    path = tmp_path / "in" / "000.obj"
    path.write_bytes(b"mtllib ../secret.mtl\nusemtl a\n" + exported(BOX, "obj"))
    assert load_prediction(path, None, VOXEL_M).any()
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["000.obj", "in", "secret.mtl"]


def test_packed_bits(tmp_path: Path) -> None:
    grid = np.random.default_rng(0).random((256,) * 3, dtype=np.float32) < 0.3
    np.savez_compressed(tmp_path / "000.npz", pack(grid))
    np.testing.assert_array_equal(load_prediction(tmp_path / "000.npz"), grid)
    np.save(tmp_path / "001.npy", np.asfortranarray(pack(grid[:16, :16, :16])))
    np.testing.assert_array_equal(load_prediction(tmp_path / "001.npy"), grid[:16, :16, :16])
    np.save(tmp_path / "002.npy", np.full((16, 16, 3), 255, np.uint8))
    with raises(PredictionError, "prediction.malformed", match=r"/ 8\)"):
        load_prediction(tmp_path / "002.npy")


@pytest.mark.parametrize("dtype", [">f4", "<f4", ">f2"])
def test_orders_are_put_right_in_place(dtype: str, tmp_path: Path) -> None:
    grid = np.random.default_rng(1).random((96, 96, 96)).astype(dtype)
    np.save(tmp_path / "000.npy", np.asfortranarray(grid))
    tracemalloc.start()
    loaded = load_prediction(tmp_path / "000.npy")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_array_equal(loaded, grid)
    assert loaded.flags.c_contiguous and loaded.dtype.isnative
    assert peak < 1.5 * grid.nbytes + (2 << 20)


def write_empty(release: Release, folder: Path) -> Path:
    for target in release.split("test"):
        (folder / target.recording).mkdir(parents=True, exist_ok=True)
        np.save(folder / target.recording / f"{target.view}.npy", np.zeros((4, 4, 4), bool))
    return folder


def test_a_submitted_mesh_is_scored(release: Release, tmp_path: Path) -> None:
    target = release.split("test")[0]
    size_m = read_voxel_size(release.pair_path(target), target.sha256)
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=90 * size_m)
    sphere.apply_translation(np.array([120, 128, 130]) * size_m)  # the first pair's ball
    folder = write_empty(release, tmp_path / "mine")
    (folder / target.recording / f"{target.view}.npy").unlink()
    (folder / target.recording / f"{target.view}.ply").write_bytes(exported(sphere, "ply"))
    assert check(release, folder) == []
    table = score(release, folder, method="mine", protocols=["known"], surface=False)
    assert table.complete
    row = table.rows[0]
    assert (row.recording, row.view, row.cells) == (target.recording, target.view, 256)
    assert present(row.iou) > 0.99


def test_what_is_wrong_with_a_folder_is_told_at_once(release: Release, tmp_path: Path) -> None:
    folder = write_empty(release, tmp_path / "mine")
    (folder / "chair_01" / "000.npy").rename(folder / "chair_01" / "000.NPY")
    (folder / "table_01" / "000.npy").unlink()
    (folder / "table_01" / "000.npy").mkdir()
    for suffix in ("npz", "ply", "obj"):
        (folder / "chair_01" / f"001.{suffix}").write_bytes(b"x")
    for n in range(10_000):
        (folder / f"stray_{n:05d}").touch()
    problems = check(release, folder)
    assert problems[:4] == [
        "chair_01/000: no prediction; expected chair_01/000.npy, .npz, .ply or .obj",
        "chair_01/001: .npy, .npz, .ply and .obj are there; keep one",
        "table_01/000.npy: cannot be read (not a plain file but a folder)",
        "chair_01/000.NPY: answers no target of the benchmark; rename it to chair_01/000.npy",
    ]
    assert len(problems) == 3 + NAMED + 1
    assert problems[-1] == f"and {10_001 - NAMED} more files that answer no target of the benchmark"


def test_strays_and_missing_targets_cost_their_sum(release: Release, tmp_path: Path) -> None:
    one = release.split("test")[0]
    targets = [replace(one, recording=f"r{n}") for n in range(20_000)]
    stray = [f"R{n}/{one.view}.NPZ" for n in range(20_000)]
    with within(2):
        lines = stray_lines(stray, [target.name for target in targets])
    assert lines[0].startswith("R0/: ") and lines[0].endswith(" r0/") and len(lines) == NAMED + 1
    (tmp_path / one.recording).mkdir()
    for n in range(2000):
        (tmp_path / one.recording / f"{n}.npy").touch()
    with within(2):
        found = find_predictions(tmp_path, targets[:2000])
        assert len(found.stray) == len(found.missing) == 2000
        assert len(stray_lines(found.stray, [target.name for target in found.missing])) == NAMED + 1


def test_score_names_strays_too(release: Release, tmp_path: Path) -> None:
    folder = write_empty(release, tmp_path / "mine")
    (folder / "notes\x1b[2J\nerror: all well.txt").touch()
    line = "notes?[2J?error: all well.txt: answers no target of the benchmark; move it away"
    assert check(release, folder) == [line]
    table = score(release, folder, method="mine", protocols=["known"], surface=False)
    assert table.complete and line in table.warnings


METHOD_FILES = {
    "notes": ({"name": "a", "training": {"notes": ["learnt\x1b from 1 of the test objects", 7]}}, 1),
    "many notes": ({"name": "a", "training": {"notes": ["learnt"] * 999}}, NAMED),
    "no list": ({"name": "a", "training": {"notes": "learnt"}}, 0),
    "nothing": ({"name": "a"}, 0),
}


@pytest.mark.parametrize("kind", METHOD_FILES)
def test_what_a_method_says_of_itself_stands_with_its_scores(
    kind: str, release: Release, tmp_path: Path
) -> None:
    content, count = METHOD_FILES[kind]
    folder = write_empty(release, tmp_path / "mine")
    (folder / "method.json").write_text(json.dumps(content))
    warnings = score(release, folder, method="mine", protocols=["known"], surface=False).warnings
    said = [line for line in warnings if "method.json: " in line]
    assert len(said) == count and all(line.isprintable() for line in said)
    assert all("learnt" in line for line in said)


def test_a_folder_that_cannot_be_looked_into(
    release: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_empty(release, tmp_path / "mine")
    scandir = os.scandir

    def refuse(path: str | Path) -> object:
        if Path(path).name != "mine":
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refuse)
    for look in (split_methods, find_predictions):
        with raises(PredictionError, "prediction.unreadable", match="_0[0-9]"):
            look(folder, release.targets)


@pytest.mark.parametrize("kind", ["npy", "npz", "ply", "obj"])
@pytest.mark.parametrize("what", ["pipe", "zero", "socket"])
def test_what_is_no_plain_file_is_not_waited_for(kind: str, what: str, tmp_path: Path) -> None:
    path = tmp_path / f"000.{kind}"
    if what == "pipe":
        os.mkfifo(path)
    elif what == "zero":
        path.symlink_to("/dev/zero")
    else:
        with socket.socket(socket.AF_UNIX) as bound:
            bound.bind(os.path.relpath(path))
    with raises(PredictionError, "prediction.unreadable", match="plain file"):
        load_prediction(path, "a/000", VOXEL_M)


@pytest.mark.parametrize(
    "name",
    ["index.html", "Scores.JSON", "scores.csv", "gallery.npz", "baselines", "=cmd|calc", "a\x1b[2J", ".a"],
)
def test_names_that_are_not_for_methods(name: str, release: Release, tmp_path: Path) -> None:
    for method in (name, "other"):
        write_empty(release, tmp_path / "p" / method)
    if not name.startswith("."):
        with raises(PredictionError, "prediction.bad-name", match=r"method: .*; rename") as refused:
            split_methods(tmp_path / "p", release.targets)
        assert "\x1b" not in str(refused.value)
    with raises(PredictionError, "prediction.bad-name", match="no name for a method"):
        score_methods(release, tmp_path / "p" / "other", tmp_path / "s", method=name, surface=False)
    assert not (tmp_path / "s").exists()
    check_method("3D-RecGAN++")


def test_no_cell_is_a_formula(release: Release, tmp_path: Path) -> None:
    folder = write_empty(release, tmp_path / "mine")
    table = score(release, folder, method="=cmd|calc", protocols=["known"], surface=False)
    rows = list(csv.reader(io.StringIO(table.csv())))
    assert {row[0] for row in rows[1:]} == {"'=cmd|calc"}
    assert not any(text[:1] in tuple("=+@\t\r") for row in rows for text in row)


def test_the_journal_key_follows_what_matters(release: Release, tmp_path: Path) -> None:
    target = release.split("test")[0]
    path = tmp_path / "000.npy"
    np.save(path, np.ones((4, 4, 4), bool))
    job = PairJob(target, release.pair_path(target), path, 0.5, Counting(("known",)))
    result = count_job(job)
    assert not isinstance(result, str)
    keys = {
        job.key(result.digest),
        job.key("0" * 64),
        PairJob(target, job.truth, path, 0.4, job.counting).key(result.digest),
        PairJob(target, job.truth, path, 0.5, Counting(("known",), surface=False)).key(result.digest),
    }
    assert len(keys) == 4


def test_the_journal_keeps_every_bit_and_no_damaged_line(release: Release, tmp_path: Path) -> None:
    target = release.split("test")[0]
    np.save(tmp_path / "000.npy", np.random.default_rng(0).random((8, 8, 8), np.float32))
    job = PairJob(target, release.pair_path(target), tmp_path / "000.npy", 0.5, Counting(("known", "paper")))
    result = count_job(job)
    assert not isinstance(result, str)
    Journal(tmp_path).add(job, result)
    written = (tmp_path / JOURNAL).read_text()
    tally = {name: values.tolist() for name, values in vars(result.tally).items()}
    surface = {protocol: asdict(values) for protocol, values in result.surface.items()}
    plain: dict[str, Any] = {
        "pair": target.name,
        "key": job.key(result.digest),
        "result": {**vars(result), "tally": tally, "surface": surface},
    }
    assert written == canonical_json(plain) + "\n"
    read = Journal(tmp_path).earlier(target.name)
    assert read is not None and read.line() == written and read.result.surface == result.surface
    for name, values in vars(result.tally).items():
        again = getattr(read.result.tally, name)
        assert again.dtype == values.dtype and np.array_equal(again, values)
    results = [
        plain["result"] | {"tally": tally | {"voxels": voxels}}
        for voxels in ([1, 2, 3], None, ["1"] * 8, [0.5] * 8, [10**30] * 8)
    ]
    results.append(plain["result"] | {"cells": "8"})
    lines: list[object] = [{}, [], *(plain | {"result": result} for result in results)]
    for damaged in lines:
        (tmp_path / JOURNAL).write_text(json.dumps(damaged) + "\n")
        assert Journal(tmp_path).earlier(target.name) is None


@pytest.mark.parametrize("kind", ["a pipe", "a link", "a folder"])
def test_a_journal_that_is_no_plain_file_is_not_written(release: Release, tmp_path: Path, kind: str) -> None:
    """A pipe would be waited for; a link leads out of the folder."""
    target, path, outside = release.split("test")[0], tmp_path / JOURNAL, tmp_path / "outside"
    outside.write_text("mine")
    {"a pipe": os.mkfifo, "a link": lambda to: to.symlink_to(outside), "a folder": Path.mkdir}[kind](path)
    result = count_job(job := PairJob(target, release.pair_path(target), None, None, Counting(("known",))))
    assert not isinstance(result, str)
    with raises(StorageError, "storage.no-plain-file"):
        Journal(tmp_path).add(job, result)
    assert outside.read_text() == "mine"


@settings(max_examples=150, deadline=None)
@given(file=FILES)
def test_no_bytes_crash_the_reader(file: tuple[str, bytes], tmp_path_factory: pytest.TempPathFactory) -> None:
    kind, content = file
    read_one(tmp_path_factory.getbasetemp() / f"fuzz.{kind}", content)


def test_the_fuzzed_files_are_good_ones_too(tmp_path: Path) -> None:
    assert all(read_one(tmp_path / f"000.{kind}", content) for kind, content in good_files())


def test_truth_as_packed_bits_is_perfect(release: Release, tmp_path: Path) -> None:
    for target in release.split("test"):
        (tmp_path / target.recording).mkdir(parents=True, exist_ok=True)
        full = read_pair(release.pair_path(target)).full
        assert unpack(full).any()
        np.savez_compressed(tmp_path / target.recording / f"{target.view}.npz", full)
    table = score(release, tmp_path, method="truth", protocols=["paper"])
    for row in table.rows:
        assert (row.iou, row.chamfer_mm, row.surface_dice) == (1.0, 0.0, 1.0)
        assert row.normal_consistency == pytest.approx(1.0)
