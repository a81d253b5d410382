"""What was built with other settings is told before another command makes it anew."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import pytest

from kinectbench.cli.build import _tell_changed_settings
from kinectbench.engine.artefact import Artefact
from kinectbench.engine.pipeline import changed_settings
from kinectbench.engine.stages import STAGES, Job
from kinectbench.settings.models import BenchmarkSettings, RecordingSettings


def job(
    root: Path,
    name: str = "a",
    count: int = 50,
    voxel_size_m: float | None = None,
    of_recording: Mapping[str, object] = MappingProxyType({}),
) -> Job:
    own = {"id": name, "path": name, "category": "chair", "split": "test", **of_recording}
    recording = RecordingSettings.model_validate(own)
    content = {
        "name": "b", "recordings": [recording],
        "views": {"count": count}, "fusion": {"voxel_size_m": voxel_size_m},
    }  # fmt: skip
    settings = BenchmarkSettings.model_validate(content)
    return Job(settings, recording, root)


def built(of: Job, versions_back: int = 0) -> Job:
    """As if every stage had been built by these settings."""
    for stage in STAGES:
        version = stage.version - versions_back
        folder = of.build / stage.folder
        with Artefact(folder, stage.name, version, stage.settings(of), {}).write() as temporary:
            (temporary / "x").write_text("x")
    return of


def test_settings_that_were_others(tmp_path: Path) -> None:
    built(job(tmp_path, count=5))
    assert changed_settings(job(tmp_path, count=5), "pairs") == {}
    assert changed_settings(job(tmp_path), "pairs") == {"views.count": (5, 50)}
    found = changed_settings(job(tmp_path, voxel_size_m=0.007), "pairs")
    assert found == {"views.count": (5, 50), "fusion.voxel_size_m": (None, 0.007)}
    assert changed_settings(job(tmp_path), "segment") == {}  # views come later


BOX = {"center_m": [0.0, 0.0, 0.4], "size_m": [1.0, 1.0, 1.0]}


@pytest.mark.parametrize(
    ("of_recording", "key", "default"),
    [
        ({"segment_by": "turntable"}, "segment_by", "default"),
        ({"underside": "closed"}, "underside", "default"),
        ({"floor": {"plane_world": [0.0, 0.0, 1.0, 0.0]}}, "floor", "default"),
        ({"pick": {"frame": 3, "pixel": [1, 2]}}, "pick", "default"),
        ({"box": BOX}, "box", None),
        ({"camera": {"fx": 500.0}}, "camera", None),
    ],
)
def test_settings_that_were_or_are_left_out(
    of_recording: dict[str, object], key: str, default: str | None, tmp_path: Path
) -> None:
    plain, other = job(tmp_path), job(tmp_path, of_recording=of_recording)
    built(plain)
    then, now = changed_settings(other, "pairs")[key]
    assert then == default != now
    built(other)
    assert changed_settings(plain, "pairs")[key] == (now, default)


@pytest.mark.parametrize(
    ("key", "value"),
    [("line_width_m", 0.02), ("near_m", 0.3), ("camera_size_m", 0.1), ("camera_height_m", 0.2), ("seed", 1)],
)
def test_numbers_that_are_left_out_at_their_default(key: str, value: float, tmp_path: Path) -> None:
    plain = built(job(tmp_path))
    section = plain.settings.segmentation.model_copy(update={key: value})
    other = replace(plain, settings=plain.settings.model_copy(update={"segmentation": section}))
    assert changed_settings(other, "pairs")[f"segmentation.{key}"][1] == value


def test_nothing_is_said_of_what_is_not_there_or_of_another_version(tmp_path: Path) -> None:
    assert changed_settings(job(tmp_path), "pairs") == {}
    built(job(tmp_path, count=5), versions_back=1)
    assert changed_settings(job(tmp_path), "pairs") == {}


def test_one_line_for_all_recordings_that_differ_alike(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    jobs = [job(tmp_path, name) for name in "ab"]
    for name in "ab":
        built(job(tmp_path, name, count=5))
    _tell_changed_settings(jobs, "pairs")
    told = capsys.readouterr().err
    changed = "built with other settings (views.count was 5, now 50)"
    assert told == f"note: a, b: {changed}; made again by benchmark.yaml and --set\n"
    _tell_changed_settings([job(tmp_path, "a", count=5)], "pairs")
    assert capsys.readouterr().err == ""
