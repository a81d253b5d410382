"""`kinectbench formats` lists every reader; `init` names what it leaves out."""

import json
import shutil
import time
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from pathlib import Path

import pytest
from small_benchmark import Run, copied

from kinectbench.cli import recordings
from kinectbench.cli.recordings import MOST_COMPARED_PATHS, _without_recording
from kinectbench.settings.file import load_benchmark
from kinectbench.stages.ingest.readers import FORMATS, find_recordings

NAMES = ("chair", "table")


def test_formats(command: Callable[..., Run], tmp_path: Path) -> None:
    rows = json.loads(command(tmp_path, "formats", "--json").out)
    assert [row["format"] for row in rows] == list(FORMATS)
    tried = {row["format"]: row["evidence"] for row in rows}
    assert {name for name, evidence in tried.items() if evidence == "recording"} == {"7scenes"}
    assert {name for name, evidence in tried.items() if evidence == "copy"} == {"tum", "scanner_app"}
    # Whoever claims a real recording names it.
    assert all(row["verified"] for row in rows if row["evidence"] != "writer")
    text = command(tmp_path, "formats").out
    assert "klg: a .klg file of ElasticFusion\n    verified on: nothing real, but files written" in text
    assert "    verified on: a real recording: 150 frames of redkitchen" in text
    assert "    verified on: a real recording whose licence lets it be copied: fr3/cabinet" in text


def test_a_mistyped_recording_is_answered_with_a_similar_one(
    command: Callable[..., Run], small: Path, tmp_path: Path
) -> None:
    root = copied(small, tmp_path / "b")
    for name, near in (("tabel", "table"), ("recordings/chiar", "recordings/chair")):
        said = command(root, "inspect", name)
        assert said.status == 1 and f"{name}: there is no such file or folder" in said.out
        assert f"did you mean '{near}'?" in said.out
    assert "did you mean" not in command(root, "inspect", "qqqq").out
    # The id is right, its path is not: what is near the path is named.
    config = root / "benchmark.yaml"
    for path, answer in (
        ("recordings/chiar", "did you mean 'recordings/chair'?"),
        ("chair", "file or folder"),
    ):
        config.write_text(config.read_text().replace("path: recordings/chair,", f"path: {path},"))
        (line,) = [line for line in command(root, "inspect", "chair").out.splitlines() if "no such" in line]
        assert answer in line and "did you mean 'chair'" not in line
        config.write_text(config.read_text().replace(f"path: {path},", "path: recordings/chair,"))


def test_a_mistyped_path_is_compared_with_few(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(MOST_COMPARED_PATHS + 10):
        (tmp_path / f"recording_{number}").touch()
    compared = list[int]()

    def close(name: str, names: Sequence[str], count: int) -> list[str]:
        compared.append(len(names))
        return get_close_matches(name, names, count)

    monkeypatch.setattr(recordings, "get_close_matches", close)
    assert "did you mean" in recordings._near(str(tmp_path / "recordinh_7"), ids=True)
    assert compared == [MOST_COMPARED_PATHS]


def test_init_names_the_folders_in_which_there_is_no_recording(
    command: Callable[..., Run], tmp_path: Path
) -> None:
    sample = Path(__file__).parents[2] / "recordings" / "cabinet_01"
    for name in ("depth", "rgb"):
        shutil.copytree(sample / name, tmp_path / "cabinet" / name)
    for file in ("depth.txt", "rgb.txt", "camera.json"):
        shutil.copy(sample / file, tmp_path / "cabinet")
    (tmp_path / "colour_only").mkdir()
    shutil.copy(next((sample / "rgb").iterdir()), tmp_path / "colour_only")
    for ours in ("build", "scores", ".hidden", "chair.truth"):
        (tmp_path / ours).mkdir()
    (tmp_path / "chair.truth" / "truth.json").write_text("{}", encoding="utf-8")
    run = command(tmp_path, "init", ".")
    assert "1 recording:" in run.out
    said = "note: left out, as no recording of a known format: colour_only; `kinectbench inspect"
    assert run.err.split("\n")[0].startswith(said)
    assert "scores" not in run.err
    assert "chair.truth" not in run.err


def test_init_names_what_no_reader_takes_beside_recordings_farther_down(
    command: Callable[..., Run], tmp_path: Path
) -> None:
    """In one line, of very many the first; a recording that lies one level deeper is found."""
    sample = Path(__file__).parents[2] / "recordings" / "cabinet_01"
    shutil.copytree(sample, tmp_path / "recordings/deeper/data")
    for number in range(30):
        (tmp_path / f"recordings/lost_{number:02d}").mkdir()
        (tmp_path / f"recordings/lost_{number:02d}/notes.txt").write_text("no frames")
    (tmp_path / "recordings/cut.bag").write_bytes(b"#ROS")
    run = command(tmp_path, "init", ".")
    assert run.status == 0 and "recordings/deeper/data" in (tmp_path / "benchmark.yaml").read_text()
    (line,) = [line for line in run.err.splitlines() if "left out" in line]
    assert "recordings/cut.bag, recordings/lost_00, recordings/lost_01" in line and " and 19 more; " in line
    assert "lost_11" not in line and "deeper" not in line


def test_init_does_not_name_the_folders_of_a_program(command: Callable[..., Run], tmp_path: Path) -> None:
    """As in a clone of this repository: docs/ and tests/ are no recordings that somebody forgot."""
    sample = Path(__file__).parents[2] / "recordings" / "cabinet_01"
    shutil.copytree(sample, tmp_path / "recordings/cabinet")
    (tmp_path / "recordings/lost").mkdir()
    (tmp_path / "pyproject.toml").write_text("[project]\n")
    for name in ("docs", "tests"):
        (tmp_path / name).mkdir()
    run = command(tmp_path, "init", ".")
    assert run.status == 0 and "left out, as no recording of a known format: recordings/lost;" in run.err


def test_what_was_built_is_no_recording(command: Callable[..., Run], small: Path, tmp_path: Path) -> None:
    """Nor in a benchmark farther down, nor where a build was renamed; nor is it called left out."""
    root = copied(small, tmp_path / "top")
    for below in ("nested", "elsewhere/results"):
        copied(small, root / below)
    (root / "elsewhere/results/build").rename(root / "elsewhere/old")
    for ours in ("triage", "evaluation"):
        (root / ours).mkdir()
    (root / "mine").mkdir()
    (root / "mine/export.json").write_text("{}")
    assert find_recordings(root / "build") == []
    run = command(root, "init", ".", "--force")
    assert run.status == 0
    paths = [recording.path for recording in load_benchmark(root / "benchmark.yaml").recordings]
    each = [
        ("", "nested/", "elsewhere/results/")[n] + f"recordings/{name}" for n in range(3) for name in NAMES
    ]
    assert sorted(paths) == sorted(each)
    assert not any(name in run.err for name in ("triage", "evaluation", "mine", "nested"))
    # A manifest of another program says nothing.
    (root / "recordings/chair/manifest.json").write_text('{"name": "app", "version": 3}')
    assert root / "recordings/chair" in [path for path, _ in find_recordings(root / "recordings")]


def test_init_without_any_recording_says_where_to_look(command: Callable[..., Run], tmp_path: Path) -> None:
    (tmp_path / "lost").mkdir()
    run = command(tmp_path, "init", ".")
    assert run.status != 0 and "left out, as no recording of a known format: lost" in run.err
    (line,) = [line for line in run.err.splitlines() if line.startswith("error")]
    assert "`kinectbench inspect FOLDER` says" in line and "`kinectbench formats`" in line


def test_masks_in_any_case_are_no_recording(tmp_path: Path) -> None:
    (tmp_path / "Masks").mkdir()
    assert _without_recording(tmp_path, [tmp_path / "recording"], []) == []


def test_folders_are_looked_up_among_the_recordings_once(tmp_path: Path) -> None:
    for n in range(4000):
        (tmp_path / f"{n:04d}").mkdir()
    recordings = [tmp_path / f"{n:04d}" / "below" for n in range(3999)]
    started = time.process_time()
    assert _without_recording(tmp_path, recordings, [".bag"]) == [tmp_path / "3999"]
    assert time.process_time() - started < 5  # with a scan for each: over a minute
