"""A stage in a store is written once: what was finished first stays, and nothing is mixed into it."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from raising import raises
from small_benchmark import hashes
from stored_benchmark import jobs_of, know_sources, put_benchmark
from stores import s3, s3_server

from kinectbench.core.errors import RecordingError, SettingsError, StorageError
from kinectbench.core.store.store import Store
from kinectbench.engine.artefact import Artefact
from kinectbench.engine.checkout import checkout, fetch_named
from kinectbench.engine.orphans import find_orphans, remove_orphans
from kinectbench.engine.pipeline import STAGE_NAMES, artefacts_upto
from kinectbench.engine.stages import Job
from kinectbench.engine.stored_build import build_stored
from kinectbench.engine.stored_stage import (
    ARCHIVE,
    fetch_file,
    fetch_stage,
    pack_files,
    put_stage,
    stored_folder,
)
from kinectbench.settings.models import BenchmarkSettings

__all__ = ["s3", "s3_server"]
pytestmark = pytest.mark.xdist_group("stores")

LAST = "pairs"
BEFORE = STAGE_NAMES[:-1]


def test_the_same_made_by_another_version_is_success(small: Path, tmp_path: Path, s3: str) -> None:
    store = put_benchmark(small, s3, ())
    job = jobs_of(small)[0]
    artefact = artefacts_upto(job, LAST)[LAST]
    put_stage(store, "chair", artefact)
    place = f"{stored_folder('chair', artefact)}/manifest.json"
    theirs = store.read(place).replace(b'"package_version": "', b'"package_version": "9')
    store.put(place, theirs)
    put_stage(store, "chair", artefact)
    assert store.read(place) == theirs


def naming(root: Path, **named: str) -> Job:
    recording = {"id": "a", "path": "a", "category": "chair", **named}
    settings = BenchmarkSettings.model_validate({"name": "b", "recordings": [recording]})
    return Job(settings, settings.recordings[0], root)


@pytest.mark.parametrize("written", ["{}", "./{}", "{}/", "x/{}", "x//{}", "x/./{}", "/elsewhere/{}"])
def test_masks_and_mesh_are_named_as_on_a_disk(written: str, tmp_path: Path) -> None:
    place = tmp_path / "there" / written.format("").strip("/")
    (place / "masks").mkdir(parents=True)
    for file in ("masks/000.png", "cad.ply"):
        (place / file).write_bytes(b"content")
    job = naming(tmp_path / "here", masks=written.format("masks"), reference=written.format("cad.ply"))
    fetch_named(Store(f"file://{tmp_path}/there"), job)
    assert job.masks is not None and job.reference is not None
    shared = written.startswith("/")  # a disk of all machines: nothing to fetch
    assert (job.masks / "000.png").exists() == job.reference.exists() == (not shared)


@pytest.mark.parametrize("key", ["masks", "reference"])
@pytest.mark.parametrize("name", ["../x", "a/../../x", "."])
def test_masks_and_mesh_lie_in_the_store(key: str, name: str, tmp_path: Path) -> None:
    with raises(SettingsError, "settings.outside-folder", match=f"recordings.a.{key}: '{name}' leads out"):
        fetch_named(Store(f"file://{tmp_path}"), naming(tmp_path, **{key: name}))


def other_bytes(artefact: Artefact, folder: Path) -> Artefact:
    """The artefact as another processor might have made it: of one file another byte, all sizes the same."""
    shutil.copytree(artefact.folder, folder)
    file = folder / "000.npz"
    file.write_bytes(file.read_bytes()[:-1] + b"\xff")
    return replace(artefact, folder=folder)


def test_what_is_finished_is_believed_and_stays(small: Path, tmp_path: Path, s3: str) -> None:
    store = put_benchmark(small, s3, ())
    artefact = artefacts_upto(jobs_of(small)[0], LAST)[LAST]
    other = other_bytes(artefact, tmp_path / "other")
    assert put_stage(store, "chair", artefact)
    before = store.objects("build")
    assert not put_stage(store, "chair", other)
    assert put_stage(store, "chair", artefact)
    assert store.objects("build") == before and find_orphans(store, young=True) == []
    fetch_stage(store, "chair", replace(artefact, folder=tmp_path / "got"))
    assert hashes(tmp_path / "got") == hashes(artefact.folder)


@dataclass(frozen=True)
class Slow(Store):
    """A store to which another run puts the same stage before this one's manifest arrives."""

    meanwhile: Callable[[], object] = print

    def put_new(self, *given: Any, **options: Any) -> bool:
        self.meanwhile()
        return super().put_new(*given, **options)


def test_the_bytes_of_two_that_put_at_once_are_not_mixed(small: Path, tmp_path: Path, s3: str) -> None:
    store = put_benchmark(small, s3, ())
    artefact = artefacts_upto(jobs_of(small)[0], LAST)[LAST]
    other = other_bytes(artefact, tmp_path / "other")
    slow = Slow(s3, lambda: put_stage(store, "chair", artefact))
    assert not put_stage(slow, "chair", other)
    fetch_stage(store, "chair", replace(artefact, folder=tmp_path / "got"))
    assert hashes(tmp_path / "got") == hashes(artefact.folder)
    left = find_orphans(store, young=True)
    assert len(left) == 3 and remove_orphans(store, left) == 3
    shutil.rmtree(tmp_path / "got")
    fetch_stage(store, "chair", replace(artefact, folder=tmp_path / "got"))
    assert hashes(tmp_path / "got") == hashes(artefact.folder)


def test_a_build_that_comes_second_takes_what_is_there(small: Path, tmp_path: Path, s3: str) -> None:
    store = put_benchmark(small, s3, BEFORE)
    know_sources(s3)
    job = jobs_of(small)[0]
    artefact = artefacts_upto(job, LAST)[LAST]
    other = other_bytes(artefact, tmp_path / "other")
    there = replace(job, root=Path(s3))

    def meanwhile(stage: str, done: int, total: int) -> None:
        if stage == "put" and not done:
            put_stage(store, "chair", other)

    outcome = build_stored(there, progress=meanwhile)
    assert (outcome.error, outcome.made, outcome.current) == (None, (), STAGE_NAMES)
    found = checkout(there, tmp_path / "there")
    fetch_stage(store, "chair", found.artefacts[LAST])
    assert hashes(found.artefacts[LAST].folder) == hashes(other.folder)
    assert build_stored(there, force=[LAST]).error is None


def test_an_artefact_beside_its_manifest_is_read(small: Path, tmp_path: Path, s3: str) -> None:
    """As earlier versions put it."""
    store = put_benchmark(small, s3, ())
    artefact = artefacts_upto(jobs_of(small)[0], LAST)[LAST]
    where = stored_folder("chair", artefact)
    names = sorted(path.name for path in artefact.folder.glob("*.npz"))
    pack_files(artefact.folder, names, tmp_path / ARCHIVE)
    for path in (tmp_path / ARCHIVE, *artefact.folder.glob("*.json")):
        store.put(f"{where}/{path.name}", path)
    assert find_orphans(store, young=True) == []
    fetch_stage(store, "chair", replace(artefact, folder=tmp_path / "got"))
    fetch_file(store, "chair", replace(artefact, folder=tmp_path / "one"), "pairs.json")
    wanted = hashes(artefact.folder)
    assert hashes(tmp_path / "got") == wanted and (tmp_path / "one" / "pairs.json").is_file()
    store.put(f"{where}/pairs.json", b"{}")
    with raises(StorageError, "storage.damaged", match=r"manifest\.json"):
        fetch_stage(store, "chair", replace(artefact, folder=tmp_path / "cut"))
    assert not replace(artefact, folder=tmp_path / "cut").is_current()


def test_a_changed_recording_outside_the_store_is_noticed(small: Path, tmp_path: Path, s3: str) -> None:
    put_benchmark(small, s3)
    shutil.copytree(small / "recordings/chair", outside := tmp_path / "chair")
    job = replace(jobs_of(small)[0], root=Path(s3))
    job = replace(job, recording=job.recording.model_copy(update={"path": str(outside)}))
    assert checkout(job, tmp_path / "a").current == STAGE_NAMES
    file = next(outside.glob("*.txt"))
    file.write_text(file.read_text() + "# changed\n")
    assert checkout(job, tmp_path / "b").current == ()
    shutil.rmtree(outside)
    with raises(RecordingError, "recording.not-found"):
        checkout(job, tmp_path / "c")


def test_what_was_built_of_a_recording_outside_the_store_stays_when_that_is_deleted(
    small: Path, tmp_path: Path, s3: str
) -> None:
    put_benchmark(small, s3)
    shutil.copytree(small / "recordings/chair", outside := tmp_path / "chair")
    job = replace(jobs_of(small)[0], root=Path(s3))
    job = replace(job, recording=job.recording.model_copy(update={"path": str(outside)}))
    assert checkout(job, tmp_path / "a").current == STAGE_NAMES
    shutil.rmtree(outside)
    assert checkout(job, tmp_path / "b").current == STAGE_NAMES
