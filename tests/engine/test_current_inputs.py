"""The status compares a recording, its masks and its mesh with those of the build, and reads none."""

import os
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from kinectbench.core.artefacts.manifest import Manifest, SourceFile, Sources
from kinectbench.core.storage import pretty_json, sha256_file
from kinectbench.engine import artefact as artefacts
from kinectbench.engine.artefact import Artefact, has_sizes, whole_hash
from kinectbench.engine.stages import STAGES, Job, current_stages
from kinectbench.engine.status import statuses
from kinectbench.settings.models import BenchmarkSettings

CAMERA = {"fx": 50, "fy": 50, "cx": 32, "cy": 24, "width": 64, "height": 48, "depth_scale": 1000}
FRAMES = 3


def job_of(root: Path, **named: str) -> Job:
    recording = {"id": "a", "path": "rec", "category": "chair", **named}
    settings = BenchmarkSettings.model_validate({"name": "t", "recordings": [recording]})
    return Job(settings, settings.recordings[0], root)


def recorded(root: Path) -> None:
    """A recording of images at `rec`, with masks of its frames and a mesh."""
    for folder, dtype in (("depth", np.uint16), ("rgb", np.uint8), ("masks", np.uint8)):
        place = root / ("drawn" if folder == "masks" else f"rec/{folder}")
        place.mkdir(parents=True)
        for index in range(FRAMES):
            cv2.imwrite(str(place / f"{index:06d}.png"), np.full((48, 64), 7, dtype))
    (root / "rec" / "camera.json").write_text(pretty_json(CAMERA))
    (root / "cad.ply").write_bytes(b"a mesh")


def built(job: Job) -> Job:
    """The job, whose stages are there with the inputs and settings of a build, and without content."""
    made: dict[str, str] = {}
    for stage in STAGES:
        inputs = {name: made[name] for name in stage.inputs}
        inputs |= {name: source.sha256 for name, source in stage.sources(job).items()}
        artefact = Artefact(job.build / stage.folder, stage.name, stage.version, stage.settings(job), inputs)
        with artefact.write():
            made[stage.name] = artefact.fingerprint
    return job


def last_current(job: Job) -> str | None:
    return max(current_stages(job.build, job), key=[stage.name for stage in STAGES].index, default=None)


@pytest.mark.parametrize(
    ("named", "changed", "last"),
    [
        ({"masks": "drawn", "segment_by": "masks"}, "drawn/000001.png", "ingest"),
        ({"masks": "drawn", "segment_by": "masks"}, "drawn/000003.png", "ingest"),  # it is added
        ({"masks": "drawn"}, "drawn/000001.png", "segment"),
        ({"reference": "cad.ply"}, "cad.ply", "fuse"),
        ({}, "rec/depth/000001.png", None),
    ],
)
def test_inputs_are_compared_by_names_sizes_and_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, named: dict[str, str], changed: str, last: str | None
) -> None:
    recorded(tmp_path)
    job = built(job_of(tmp_path, **named))
    listed: list[object] = []
    has_sizes = artefacts.has_sizes

    def once(*of: object, **named: bool) -> bool:
        listed.append(of)
        return has_sizes(*of, **named)  # type: ignore[arg-type]

    monkeypatch.setattr("kinectbench.engine.stages.has_sizes", once)
    read = list[Path]()

    def hashed(path: Path) -> str:
        read.append(path)
        return sha256_file(path)

    monkeypatch.setattr(artefacts, "sha256_file", hashed)
    assert last_current(job) == "pairs" and read == []
    listed.clear()
    touched = tmp_path / "drawn/000002.png", tmp_path / "cad.ply", tmp_path / "rec/depth/000001.png"
    for path in touched:
        path.touch()
    assert last_current(job) == "pairs"  # the same bytes at another time, as after a copy
    assert set(read) <= set(touched[:2]) and len(read) == len({"masks", "reference"} & named.keys())
    assert len(listed) == 1 + len({"masks", "reference"} & named.keys())  # each once
    if named and (tmp_path / changed).exists():
        before = (tmp_path / changed).read_bytes()
        (tmp_path / changed).write_bytes(bytes(byte ^ 1 for byte in before))  # of equal size
        assert last_current(job) == last
    (tmp_path / changed).write_bytes(b"of another size")
    assert last_current(job) == last


def test_a_linked_recording_with_intrinsics_beside_it_is_done(tmp_path: Path) -> None:
    seen, root = tmp_path / "disk" / "seen", tmp_path / "b"
    for folder in (seen, root):
        folder.mkdir(parents=True)
    for index in range(FRAMES):
        cv2.imwrite(str(seen / f"frame-{index:06d}.depth.png"), np.full((48, 64), 1000, np.uint16))
        cv2.imwrite(str(seen / f"frame-{index:06d}.color.png"), np.zeros((48, 64, 3), np.uint8))
        np.savetxt(seen / f"frame-{index:06d}.pose.txt", np.eye(4))
    (root / "rec").symlink_to(seen)
    beside = root / "camera-intrinsics.txt"
    np.savetxt(beside, [[50, 0, 32], [0, 50, 24], [0, 0, 1]])
    job = built(job_of(root))
    assert "../camera-intrinsics.txt" in (job.build / "sources.json").read_text()
    assert statuses([job])[0].state == "done"
    beside.write_text("another")
    assert last_current(job) is None


def close(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """Let the system refuse to list a folder and to look at what lies in it, as if its mode were 0."""

    def refuse(asked: Any, path: Any, *of: Any, **named: Any) -> Any:
        if str(path).startswith(f"{folder}{os.sep}") or (asked is scandir and str(path) == str(folder)):
            raise PermissionError(13, "Permission denied", str(path))
        return asked(path, *of, **named)

    stat, scandir = os.stat, os.scandir
    monkeypatch.setattr(os, "stat", partial(refuse, stat))
    monkeypatch.setattr(os, "scandir", partial(refuse, scandir))


@pytest.mark.parametrize("damage", ["masks", "build", "sources", "manifest"])
def test_one_damaged_recording_does_not_end_the_status_of_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: str
) -> None:
    good, bad = tmp_path / "good", tmp_path / "bad"
    for root in (good, bad):
        recorded(root)
    jobs = [built(job_of(root, masks="drawn")) for root in (good, bad)]
    ingest = jobs[1].build / "sequence"
    closed = {"masks": bad / "drawn", "build": jobs[1].build}.get(damage)
    if damage == "sources":
        sources = Sources.model_validate({"a\0b": SourceFile(1, 1, "a" * 64)})
        (jobs[1].build / "sources.json").write_text(sources.text())
        hashed = Manifest.read(ingest).model_copy(update={"inputs": {"recording": whole_hash(sources)}})
        hashed.write(ingest)
    if damage == "manifest":
        Manifest.read(ingest).model_copy(update={"files": {"a\0b": 1}}).write(ingest)
    if closed is not None:
        close(monkeypatch, closed)
    assert [row.state for row in statuses(jobs)] == ["done", "missing"]


@pytest.mark.parametrize("root", [".", "../b", "whole"])
@pytest.mark.parametrize("path", ["rec", "rec/../rec"])
@pytest.mark.parametrize("key", ["masks", "reference"])
@pytest.mark.parametrize("written", ["rec/{}", "rec/../rec/{}", "{whole}/rec/{}"])
def test_inputs_inside_a_recording_are_apart_however_their_paths_are_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, root: str, path: str, key: str, written: str
) -> None:
    folder, name = tmp_path / "b", {"masks": "drawn", "reference": "cad.ply"}[key]
    recorded(folder)
    (folder / name).rename(folder / "rec" / name)
    monkeypatch.chdir(folder)
    named = {key: written.format(name, whole=folder), "path": path}
    job = job_of(folder if root == "whole" else Path(root), **named)
    before = STAGES[0].sources(job)["recording"].sha256
    changed = folder / "rec" / ("drawn/000001.png" if key == "masks" else name)
    changed.write_bytes(b"another")
    assert STAGES[0].sources(job)["recording"].sha256 == before
    (folder / "rec/depth/000001.png").write_bytes(b"another")
    assert STAGES[0].sources(job)["recording"].sha256 != before


@pytest.mark.parametrize("root", ["rec/bench", "rec/../rec/bench"])
def test_results_inside_a_recording_are_apart(tmp_path: Path, root: str) -> None:
    recorded(tmp_path)
    (tmp_path / "rec" / "bench").mkdir()
    job = job_of(tmp_path / root, path="..")
    before = STAGES[0].sources(job)["recording"].sha256
    (job.build / "more.json").write_bytes(b"of a build")
    assert STAGES[0].sources(job)["recording"].sha256 == before


@pytest.mark.parametrize(
    ("text", "same"),
    [(None, True), ("{", True), ("[" * 10**5, True), ("[]", False), ("7", False)]
    + [(text, False) for text in ('{"a": 1}', '{"a": [1]}', '{"a": {"size": 1}}', '{"a": [1, 2, [NAN]]}')],
)
def test_damaged_names_and_sizes_are_no_crash(tmp_path: Path, text: str | None, same: bool) -> None:
    if text is not None:
        (tmp_path / "sources.json").write_text(text.replace("NAN", "1e999"))
    assert has_sizes(tmp_path, tmp_path / "sources.json", "a" * 64) is same
