"""What failed is tried again once something that it depends on has changed, and not before."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from kinectbench.core.errors import (
    PairError,
    RecordingError,
    SegmentationError,
    SettingsError,
    ShapeError,
    StorageError,
    TrackingError,
)
from kinectbench.engine import failures, pipeline, steps
from kinectbench.engine.artefact import VERSIONS
from kinectbench.engine.pipeline import STAGE_NAMES, Outcome, build_recording
from kinectbench.engine.stage_settings import Work
from kinectbench.engine.stages import Job
from kinectbench.settings.models import BenchmarkSettings

REASON = "frame 7: too dark; record again"
OTHERS: dict[str, dict[str, dict[str, Any]]] = {
    "ingest": {"recordings": {"camera": {"fx": 500.0}}},
    "track": {"tracking": {"check_stride_px": 3}},
    "fuse": {"fusion": {"min_depth_m": 0.35}},
    "segment": {"segmentation": {"seed": 1}},
    "sample-views": {"views": {"seed": 1}},
    "pairs": {"pairs": {"framing": "view"}},
}


class Attempts:
    """Stages that write one file each, but for one that fails."""

    def __init__(self, failing: str, error: Callable[[], None]) -> None:
        self.failing, self.error = failing, error
        self.of: list[str] = []

    def step(self, name: str) -> Callable[..., None]:
        def make(work: Work[Any]) -> None:
            self.of.append(name)
            if name == self.failing:
                self.error()
            (work.folder / "made").write_text(name)

        return make


def raising(error: Exception, cause: Exception | None = None) -> Callable[[], None]:
    def fail() -> None:
        raise error from cause

    return fail


def job_of(root: Path, **changes: dict[str, object]) -> Job:
    recording = {"id": "chair", "path": "chair", "category": "chair", "masks": "masks"}
    settings = BenchmarkSettings.model_validate(
        {
            "name": "small",
            "recordings": [{**recording, **changes.get("recordings", {})}],
            **{name: change for name, change in changes.items() if name != "recordings"},
        }
    )
    return Job(settings, settings.recordings[0], root)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    for name in ("chair", "masks"):
        (tmp_path / name).mkdir()
    (tmp_path / "chair" / "depth.txt").write_text("0.0 depth/0.png\n")
    (tmp_path / "masks" / "a.png").write_bytes(b"first")
    return tmp_path


@pytest.fixture
def attempts(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Attempts]]:
    monkeypatch.setattr(pipeline, "_explained", lambda job, failure: str(failure))
    # The steps here write no images that a mask could belong to.
    monkeypatch.setattr(pipeline, "_checked_masks", lambda job: None)

    def install(failing: str, error: Callable[[], None] | None = None) -> Attempts:
        made = Attempts(failing, error or raising(SegmentationError(REASON)))
        monkeypatch.setattr(steps, "STEPS", {name: made.step(name) for name in STAGE_NAMES})
        return made

    yield install


def built(
    root: Path, upto: str = "pairs", force: tuple[str, ...] = (), **changes: dict[str, object]
) -> Outcome:
    return build_recording(job_of(root, **changes), upto, force)


@pytest.mark.parametrize("stage", STAGE_NAMES)
def test_each_stage_that_failed_waits_for_a_change(
    stage: str, root: Path, attempts: Callable[..., Attempts]
) -> None:
    tried = attempts(stage)
    first = built(root)
    assert first.error == REASON and tried.of[-1] == stage
    tried.of.clear()
    for _ in range(3):
        again = built(root)
        assert (again.error, again.repeated) == (REASON, True)
    assert tried.of == []
    kept = json.loads((root / "build" / "chair" / "failed.json").read_text())
    assert (kept["error"], kept["code"]) == (REASON, again.code) and again.code == first.code is not None
    changed = built(root, "pairs", (), **OTHERS[stage])
    assert (changed.error, changed.repeated, tried.of[-1]) == (REASON, False, stage)
    tried.of.clear()
    assert built(root, force=(stage,)).error == REASON and tried.of[-1] == stage


@pytest.mark.parametrize("setting", [{"trajectory": "ignore"}, {"segment_by": "turntable"}])
def test_what_the_message_of_a_broken_trajectory_advises_is_tried(
    setting: dict[str, object], root: Path, attempts: Callable[..., Attempts]
) -> None:
    tried = attempts(
        "ingest", raising(RecordingError("poses.txt: row 3; `trajectory: ignore` does without it"))
    )
    assert built(root).error is not None
    tried.failing = ""
    assert built(root).repeated
    assert built(root, recordings=setting).error is None
    # And what was read without a trajectory is not taken for what was read with it.
    tried.of.clear()
    assert built(root).error is None and tried.of == list(STAGE_NAMES)


@pytest.mark.parametrize("stage", STAGE_NAMES)
def test_it_is_tried_once_the_recording_changes(
    stage: str, root: Path, attempts: Callable[..., Attempts]
) -> None:
    tried = attempts(stage)
    built(root)
    tried.of.clear()
    (root / "chair" / "depth.txt").write_text("0.0 depth/0.png\n1.0 depth/1.png\n")
    assert built(root).error == REASON and tried.of[-1] == stage
    tried.of.clear()
    tried.failing = ""
    assert built(root).error is not None and tried.of == []
    (root / "chair" / "depth.txt").write_text("0.0 depth/2.png\n")
    assert built(root).error is None and not (root / "build" / "chair" / "failed.json").exists()


@pytest.mark.parametrize("stage", ["sample-views", "pairs"])
def test_it_is_tried_once_a_mask_changes(stage: str, root: Path, attempts: Callable[..., Attempts]) -> None:
    tried = attempts(stage)
    built(root)
    tried.of.clear()
    (root / "masks" / "a.png").write_bytes(b"another")
    assert built(root).error == REASON and tried.of[-1] == stage


@pytest.mark.parametrize("stage", STAGE_NAMES)
def test_it_is_tried_by_another_version(
    stage: str, root: Path, attempts: Callable[..., Attempts], monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = attempts(stage)
    built(root)
    tried.of.clear()
    monkeypatch.setitem(VERSIONS, stage, VERSIONS[stage] + 1)
    assert built(root).error == REASON and tried.of[-1] == stage
    tried.of.clear()
    monkeypatch.setattr(failures, "__version__", "99.0")
    assert built(root).error == REASON and tried.of == [stage]


@pytest.mark.parametrize("kind", [RecordingError, TrackingError, SegmentationError, ShapeError])
@pytest.mark.parametrize("cause", [None, ValueError("a row"), OSError(5, "I/O"), MemoryError()])
def test_only_what_the_recording_is_to_blame_for_is_kept(
    kind: type[Exception], cause: Exception | None, root: Path, attempts: Callable[..., Attempts]
) -> None:
    tried = attempts("ingest", raising(kind(REASON), cause))
    of_machine = isinstance(cause, OSError | MemoryError)
    assert [built(root).error, built(root).error] == [REASON, REASON]
    assert len(tried.of) == (2 if of_machine else 1)


@pytest.mark.parametrize(
    "error",
    [
        StorageError("full"),
        OSError(28, "full"),
        MemoryError(),
        SettingsError("no"),
        PairError("no"),
        ZeroDivisionError(),
    ],
)
def test_what_the_machine_or_the_code_is_to_blame_for_is_tried_again(
    error: Exception, root: Path, attempts: Callable[..., Attempts]
) -> None:
    tried = attempts("fuse", raising(error))
    assert built(root).error == built(root).error is not None
    assert tried.of.count("fuse") == 2


def test_files_of_older_versions_and_damaged_ones_are_no_reason_to_wait(
    root: Path, attempts: Callable[..., Attempts]
) -> None:
    tried = attempts("track")
    built(root)
    for text in (
        '{"format_version": 1, "stage": "track", "error": "old"}',
        "{",
        '{"stage": null, "error": "killed"}',
    ):
        (root / "build" / "chair" / "failed.json").write_text(text)
        tried.of.clear()
        assert built(root).error == REASON and tried.of == ["track"]


def test_stages_before_it_are_still_made(root: Path, attempts: Callable[..., Attempts]) -> None:
    tried = attempts("segment")
    built(root)
    tried.of.clear()
    assert built(root, "fuse").error is None and built(root, "fuse", ("track",)).error is None
    assert built(root).repeated and tried.of == ["track"]
