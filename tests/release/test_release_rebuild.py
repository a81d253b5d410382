"""`verify --rebuild`: what was made again is compared to the byte, and what differs is said."""

import io
import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raising import raises
from small_benchmark import Run, copied
from synthetic_release import RECORDINGS, synthetic_settings

from kinectbench._version import __version__
from kinectbench.core.artefacts.benchmark import ReleaseInfo
from kinectbench.core.errors import ReleaseError, SettingsError
from kinectbench.core.voxels.npz import load_arrays, packed_npz_bytes
from kinectbench.release.check.rebuild import (
    LocalRecording,
    RebuildPlan,
    differences,
    find_sources,
    rebuild_plan,
    version_notes,
)
from kinectbench.release.check.verify import verify
from kinectbench.release.contents import Entry, most_bytes
from kinectbench.release.opening import open_contents
from kinectbench.release.publish import publish


@pytest.fixture
def sources(tmp_path: Path) -> dict[str, LocalRecording]:
    for name, *_ in RECORDINGS:
        (tmp_path / "recordings" / name).mkdir(parents=True)
    return find_sources(tmp_path / "recordings")


@pytest.fixture
def again(analytic: Path, tmp_path: Path) -> Path:
    """A build that made everything again as it was."""
    return Path(shutil.copytree(analytic / "build", tmp_path / "again"))


def compare(analytic: Path, sources: dict[str, LocalRecording], build: Path) -> list[str]:
    with open_contents(analytic / "benchmark") as contents:
        plan = rebuild_plan(contents, sources)
        assert plan.notes == () and len(plan.targets) == 7
        return list(differences(contents, plan, build))


def change(path: Path, **values: np.ndarray) -> None:
    path.write_bytes(packed_npz_bytes({**load_arrays(path), **values}))


def test_the_same(analytic: Path, sources: dict[str, LocalRecording], again: Path) -> None:
    assert compare(analytic, sources, again) == []


def test_what_differs_and_where(analytic: Path, sources: dict[str, LocalRecording], again: Path) -> None:
    pair = load_arrays(again / "chair_01" / "pairs" / "001.npz")
    full, T = pair["full"].copy(), pair["T_world_grid"].copy()
    full[0, 0, 0] ^= 0b1010_0000
    T[0, 3] += 0.002
    change(again / "chair_01" / "pairs" / "001.npz", full=full, T_world_grid=T)
    change(again / "chair_02" / "pairs" / "000.npz", partial_rule=np.asarray("majority"))
    path = again / "table_01" / "object" / "mesh.ply"
    path.write_bytes(path.read_bytes() + b"\n")
    shutil.copy(again / "table_02" / "pairs" / "000.npz", again / "table_02" / "pairs" / "001.npz")
    (again / "chair_03" / "pairs" / "001.npz").unlink()
    (again / "chair_03" / "views" / "001.mask.png").unlink()
    assert compare(analytic, sources, again) == [
        "pairs/chair_01/001.npz: differs when made again: full in 2 cells, T_world_grid by 0.002",
        "pairs/chair_02/000.npz: differs when made again: partial_rule (any there, majority here)",
        "views/chair_03/001.mask.png: was not made again",
        "pairs/chair_03/001.npz: was not made again: its view was refused, or another was drawn",
        "objects/table_01/mesh.ply: differs when made again",
        "table_02/001: made again, but there is no such pair in the release",
    ]


def test_what_was_made_again_may_have_any_size(
    analytic: Path, sources: dict[str, LocalRecording], again: Path
) -> None:
    large = {
        "objects/table_01/mesh.ply": "object/mesh.ply",
        "views/table_01/000.mask.png": "views/000.mask.png",
    }
    for name, built in large.items():
        os.truncate(again / "table_01" / built, most_bytes(name) + 1)
    os.truncate(again / "table_01" / "pairs" / "000.npz", most_bytes("pairs/a/000.npz") + 1)
    *others, pair = compare(analytic, sources, again)
    assert others == [f"{name}: differs when made again" for name in large]
    assert pair.startswith("pairs/table_01/000.npz: what was made again cannot be read (")
    assert "larger than the 16777216 bytes" in pair


def test_a_recording_that_failed_and_other_packing(
    analytic: Path, sources: dict[str, LocalRecording], again: Path
) -> None:
    shutil.rmtree(again / "table_01" / "pairs")
    path = again / "table_02" / "pairs" / "000.npz"
    arrays: dict[str, Any] = load_arrays(path)
    np.savez(path, **arrays)
    assert compare(analytic, sources, again) == [
        "table_01: could not be built again, so none of its 1 pairs was compared",
        "pairs/table_02/000.npz: differs when made again: the same values, but packed otherwise",
    ]


def test_of_very_many_files_one_hash_is_kept(
    analytic: Path,
    sources: dict[str, LocalRecording],
    again: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(publish, "MOST_NAMED_FILES", 2 * len(RECORDINGS))
    root = tmp_path / "many"
    shutil.copytree(analytic / "build", root / "build")
    path = root / "build" / "chair_02" / "sources.json"
    files = json.loads(path.read_text()) | {f"{number}.png": [1, 1, "1" * 64] for number in range(3)}
    path.write_text(json.dumps(files))
    names = [recording[0] for recording in RECORDINGS]
    publish.publish(synthetic_settings(RECORDINGS), root / "build", root / "benchmark", names)
    lineage = json.loads((root / "benchmark" / "lineage.json").read_text())["recordings"]
    assert lineage["chair_02"]["files"] == {} and len(lineage["chair_02"]["files_sha256"]) == 64
    assert lineage["table_01"]["files"] and "files_sha256" not in lineage["table_01"]
    assert verify(root / "benchmark") == []
    said = "chair_02: not the recording that was published: its 1 files are others"
    assert said in compare(root, sources, again)
    shutil.copyfile(path, again / "chair_02" / "sources.json")
    assert compare(root, sources, again) == []


def test_another_recording(analytic: Path, sources: dict[str, LocalRecording], again: Path) -> None:
    path = again / "chair_02" / "sources.json"
    content = json.loads(path.read_text())
    name = next(iter(content))
    content[name][2] = "0" * 64
    path.write_text(json.dumps({**content, "more.png": [1, 1, "1" * 64]}))
    first = compare(analytic, sources, again)[0]
    assert first.startswith(f"chair_02: not the recording that was published: {name}, more.png")


def test_a_sample_of_objects_needs_only_their_recordings(analytic: Path, tmp_path: Path) -> None:
    with open_contents(analytic / "benchmark") as contents:
        every = rebuild_plan(contents, {name: LocalRecording(tmp_path) for name, *_ in RECORDINGS})
        objects = {target.object for target in every.targets}
        drawn = rebuild_plan(contents, {name: LocalRecording(tmp_path) for name, *_ in RECORDINGS}, 1)
        assert {target.object for target in drawn.targets} < objects and len(drawn.notes) == 1
        assert drawn.notes[0].startswith(f"1 of {len(objects)} objects are made again: ")
        wanted = {target.recording for target in drawn.targets}
        again = rebuild_plan(contents, {name: LocalRecording(tmp_path) for name in wanted}, 1)
        assert again.targets == drawn.targets
        assert {row.id for row in again.settings.recordings} == wanted
        assert (
            rebuild_plan(contents, {name: LocalRecording(tmp_path) for name, *_ in RECORDINGS}, 99) == every
        )


def test_missing_recordings_and_other_releases(
    analytic: Path, sources: dict[str, LocalRecording], tmp_path: Path
) -> None:
    del sources["chair_02"]
    shutil.rmtree(sources["table_01"].path)
    with open_contents(analytic / "benchmark") as contents:
        with raises(SettingsError, "settings.no-recording", match="chair_02, table_01"):
            rebuild_plan(contents, sources)
        everything = {name: LocalRecording(tmp_path) for name, *_ in RECORDINGS}
        text = contents.text("benchmark.json")

        def released(**values: object) -> RebuildPlan:
            changed = json.loads(text)
            changed["settings"] |= values
            content = json.dumps(changed).encode()
            entry = Entry(len(content), lambda: io.BytesIO(content))
            reader = replace(contents, entries={**contents.entries, "benchmark.json": entry})
            return rebuild_plan(reader, everything)

        assert released(views={"count": 7}).settings.views.count == 7
        with raises(ReleaseError, "release.other-version"):
            released(views={"colour": True})
        with raises(ReleaseError, "release.not-rebuildable"):
            released(recordings=[])
        lacking = json.loads(text)
        del lacking["recordings"]["chair_02"]
        content = json.dumps(lacking).encode()
        entry = Entry(len(content), lambda: io.BytesIO(content))
        reader = replace(contents, entries={**contents.entries, "benchmark.json": entry})
        with raises(ReleaseError, "release.damaged", match="chair_02"):
            rebuild_plan(reader, everything)


def test_versions(analytic: Path) -> None:
    metadata = ReleaseInfo.read(analytic / "benchmark")
    assert version_notes(metadata) == []
    other = metadata.model_copy(
        update={"package_version": "0.0.9", "packages": {"numpy": "1.0", "abacus": "3"}}
    )
    assert version_notes(other) == [
        f"made with kinectbench 0.0.9, here is {__version__}: results may differ",
        f"made with numpy 1.0, here is {np.__version__}: results may differ",
        "made with abacus 3, here is none: results may differ",
    ]


def test_where_recordings_are_looked_for(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b.bag").write_bytes(b"")
    (tmp_path / "c.v2").mkdir()
    found = find_sources(tmp_path)
    assert {name: found[name].path.name for name in ("a", "b", "c.v2")} == {
        "a": "a",
        "b": "b.bag",
        "c.v2": "c.v2",
    }
    for name in ("b.txt", "b.zip"):
        (tmp_path / name).write_bytes(b"")
    assert find_sources(tmp_path, (".bag", ".klg"))["b"].path.name == "b.bag"
    (tmp_path / "benchmark.yaml").write_text(
        "name: x\nrecordings:\n  - {id: one, path: rec/one, category: chair, masks: m}\n"
    )
    for path in (tmp_path, tmp_path / "benchmark.yaml"):
        said = {"category": "chair"}
        assert find_sources(path) == {
            "one": LocalRecording(tmp_path / "rec/one", tmp_path / "m", stated=said)
        }
    with raises(SettingsError, "settings.no-file"):
        find_sources(tmp_path / "nowhere")


@pytest.mark.xdist_group("commands")
def test_command(small: Path, tmp_path: Path, command: Callable[..., Run]) -> None:
    """The build of the fixture is where the rebuild works: current, so that only the comparison is run."""
    root = copied(small, tmp_path / "small")
    assert command(root, "publish", "--jobs", "1").status == 0
    made = shutil.copytree(root / "build", tmp_path / "work" / "build").parent
    arguments = ("verify", "benchmark", "--rebuild", ".", "--work", str(made), "--jobs", "1")
    assert command(root, *arguments).status == 0
    pairs = made / "build" / "chair" / "pairs"
    change(pairs / "000.npz", surface_sigma_m=np.asarray(0.5))
    # As if the stage had made it so.
    manifest = json.loads((pairs / "manifest.json").read_text())
    manifest["files"]["000.npz"] = (pairs / "000.npz").stat().st_size
    (pairs / "manifest.json").write_text(json.dumps(manifest))
    result = command(root, *arguments)
    assert result.status == 1
    assert "pairs/chair/000.npz: differs when made again: surface_sigma_m by 0.4" in result.err
    gone = command(root, "verify", "benchmark", "--rebuild", "recordings/chair")
    assert gone.status == 2 and "no recording here for chair, table" in gone.err
