"""A step is given what is in its stage's fingerprint, and nothing else."""

import inspect
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
from pydantic import ValidationError

from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.engine import steps
from kinectbench.engine.stage_settings import Source, Work
from kinectbench.engine.stages import STAGES, SUGGEST, Job, Stage
from kinectbench.engine.steps import STEPS
from kinectbench.settings.base import Settings
from kinectbench.settings.models import BenchmarkSettings, ObjectCuts
from kinectbench.stages.segment.find.given import GivenObject

EVERY = (*STAGES, SUGGEST)
# Values of which each optional setting takes one.
FILLED: tuple[Any, ...] = (
    *("masks", "trust", "plain", "NP3", 0.01, 5.0, 640, [0, 0, 1, 0], {"fx": 500.0}),
    {"center_m": [0, 0, 0.5], "size_m": [1, 1, 1]},
)


def job(**recording: Any) -> Job:
    own = {"id": "chair", "path": "chair", "category": "chair", **recording}
    settings = BenchmarkSettings.model_validate({"name": "small", "recordings": [own]})
    return Job(settings, settings.recordings[0], Path("root"))


def full() -> Job:
    """A recording whose sections are all given, so that their fields can be walked."""
    box = {"center_m": [0, 0, 0.5], "size_m": [1, 1, 1], "anchor_frame": 3}
    pose = {"anchor_pose": [0, 0, 1, 0, 0, 0, 1]}
    camera = {"fx": 500.0, "trajectory_reading": {"axes": "opengl"}}
    return job(camera=camera, box=box | pose, pick={"frame": 3, "pixel": [80, 60]})


def leaves(value: Any, above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Where each value of nested mappings stands."""
    if not isinstance(value, dict):
        yield above
        return
    for key, inner in value.items():
        yield from leaves(inner, (*above, key))


def others(value: Any) -> tuple[Any, ...]:
    """What another value than this one may be."""
    if isinstance(value, bool):
        return (not value,)
    if isinstance(value, int | float):
        return (value + 1, value - 1, value + 0.01, value - 0.01)
    if isinstance(value, list):
        return tuple([number + step for number in value] for step in (0.1, 1))
    words = ("majority", "view", "coverage", "refine", "closed", "robot", "x")
    return words if isinstance(value, str) else FILLED


@pytest.mark.parametrize("stage", EVERY, ids=lambda stage: stage.name)
def test_every_setting_that_a_step_can_reach_is_in_the_fingerprint(stage: Stage) -> None:
    needs = stage.needs(full())
    whole = needs.model_dump(mode="json")
    for place in leaves(whole):
        changed = json.loads(json.dumps(whole))
        section = changed
        for key in place[:-1]:
            section = section[key]
        tried = 0
        for other in others(section[place[-1]]):
            section[place[-1]] = other
            try:
                another = type(needs).model_validate_json(json.dumps(changed))
            except ValidationError:
                continue
            tried += 1
            assert another.fingerprinted() != needs.fingerprinted(), place
        assert tried, f"no other value of {place} is tried"


@pytest.mark.parametrize("stage", EVERY, ids=lambda stage: stage.name)
def test_no_setting_lies_beside_those_that_are_written_out(stage: Stage) -> None:
    """What is left out of the JSON can only be None."""

    def hidden(model: Any) -> Iterator[str]:
        for name, field in model.model_fields.items():
            if field.exclude and field.annotation is not type(None):
                yield f"{model.__name__}.{name}"
            for part in (field.annotation, *get_args(field.annotation)):
                if hasattr(part, "model_fields"):
                    yield from hidden(part)

    assert not list(hidden(type(stage.needs(full()))))
    # And a section is of the very model that says what it has, not of one with more fields.
    for name, field in type(stage.needs(full())).model_fields.items():
        value = getattr(stage.needs(full()), name)
        if isinstance(value, Settings):
            assert type(value) in (field.annotation, *get_args(field.annotation))


@pytest.mark.parametrize("stage", EVERY, ids=lambda stage: stage.name)
def test_a_step_takes_the_work_of_its_own_stage(stage: Stage) -> None:
    (parameter,) = inspect.signature(STEPS[stage.name]).parameters
    hint = get_type_hints(STEPS[stage.name])[parameter]
    assert hint.__origin__ is Work and get_args(hint) == (type(stage.needs(full())),)


def test_segment_hands_on_the_word_and_the_lengths(monkeypatch: pytest.MonkeyPatch) -> None:
    handed: list[Any] = []
    for name in ("_read_masked", "_scene", "plane_given", "write_object"):
        monkeypatch.setattr(steps, name, lambda *_: (None, None))
    monkeypatch.setattr(steps, "segment", lambda *values: handed.extend(values))
    own = {"id": "chair", "path": "chair", "category": "chair"}
    said = {"categories": {"chair": {"underside": "closed"}}, "segmentation": {"line_width_m": 0.02}}
    settings = BenchmarkSettings.model_validate({"name": "small", "recordings": [own], **said})
    needs = STAGES[3].needs(Job(settings, settings.recordings[0], Path("root")))
    STEPS["segment"](Work(needs, {}, {}, Path("object"), lambda *_: None))
    (cuts,) = [each for each in handed if isinstance(each, ObjectCuts)]
    (given,) = [each for each in handed if isinstance(each, GivenObject)]
    assert cuts.limits() == SensorLimits(line_width_m=0.02)
    assert (given.underside, given.picked, given.box) == ("closed", None, None)


def test_open3d_is_loaded_by_what_needs_it() -> None:
    """Two threads that load it at once do not find its submodules; and it takes half a second."""
    code = "import kinectbench.engine.steps, sys; sys.exit('open3d' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_no_way_leads_from_the_work_to_the_job() -> None:
    assert set(get_type_hints(Work)) == {"settings", "stages", "sources", "folder", "progress"}
    assert get_type_hints(Source) == {"path": Path, "sha256": str}


@pytest.mark.parametrize(
    "said",
    [
        {"segmentation": {"line_width_m": 0.02}},
        {"segmentation": {"near_m": 0.5}},
        {"segmentation": {"camera_size_m": 0.1}},
        {"segmentation": {"camera_height_m": 0.1}},
        {"categories": {"chair": {"underside": "closed"}}},
    ],
)
def test_what_decides_between_solid_and_air_is_of_segment_alone(said: dict[str, Any]) -> None:
    own = {"id": "chair", "path": "chair", "category": "chair"}
    settings = BenchmarkSettings.model_validate({"name": "small", "recordings": [own], **said})
    changed = Job(settings, settings.recordings[0], Path("root"))
    assert [s.name for s in EVERY if s.settings(changed) != s.settings(job())] == ["segment"]
    assert STAGES[3].settings(job(underside="unseen")) == STAGES[3].settings(job())


def test_what_was_made_before_a_setting_came_stays_current() -> None:
    """The keys of the fingerprints at the defaults, as they were: a new one is in `ADDED`."""
    keys = {stage.name: {".".join(place) for place in leaves(stage.settings(job()))} for stage in EVERY}
    fusion = {"truncation_voxels", "min_depth_m", "max_depth_m"}
    cuts = {f"segmentation.{name}" for name in ("seed", "floor_cut_m", "low_cut_m")}
    tracking = ("check_stride_px", "check_neighbours", "max_disagreement_m", "max_stamp_gap_s")
    views = ("count", "seed", "strategy", "min_pixels", "recorded_masks")
    limits = ("min_containment", "max_residual_m", "min_visible_share")
    assert keys == {
        "ingest": {"camera"},
        "track": {"trajectory", *(f"tracking.{name}" for name in tracking)},
        "fuse": {f"fusion.{name}" for name in (*fusion, "scene_voxel_size_m")},
        "segment": {"box", *cuts, *(f"fusion.{name}" for name in (*fusion, "voxel_size_m"))},
        "sample-views": {
            *(f"views.{name}" for name in views),
            *(f"pairs.{name}" for name in limits),
            "segmentation.mask_tolerance_m",
        },
        "pairs": {"pairs.framing", "pairs.partial_rule", "pairs.min_containment"},
        "suggest": cuts,
    }
