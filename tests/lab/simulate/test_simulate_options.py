"""Presets and `--set` to a spec, and one line for every wrong word."""

import pytest
from raising import raises

from kinectbench.core.errors import SettingsError
from kinectbench.lab.simulate.presets import PRESETS, preset_spec
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.settings.overrides import merged


def test_overrides_win_and_the_last_one_most() -> None:
    spec = preset_spec(
        "arc-v1",
        {"object": "table:seed=2", "path": {"frames": 9}},
        ["path.frames=20", "path.frames=30", "seed=4"],
    )
    assert (spec.object, spec.path.frames, spec.seed) == ("table:seed=2", 30, 4)
    assert spec.path.arc_rad == preset_spec("arc-v1", {}).path.arc_rad


def test_a_spec_survives_json() -> None:
    for name in PRESETS:
        spec = preset_spec(name, {})
        assert SimulationSpec.model_validate_json(spec.model_dump_json()) == spec


def test_merged_leaves_its_arguments_alone() -> None:
    values, changes = {"a": {"b": 1, "c": 2}}, {"a": {"c": 3}}
    assert merged(values, changes) == {"a": {"b": 1, "c": 3}}
    assert values == {"a": {"b": 1, "c": 2}}


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("path.frams=3", "in --set path.frams=3: unknown; did you mean 'frames'"),
        ("sensr.model=ideal", "did you mean 'sensor'"),
        ("frames=3", "in --set frames=3: unknown; did you mean path.frames?"),
        ("scene.frames=3", "in --set scene.frames=3: unknown; did you mean path.frames?"),
        ("path.frames=x", "found 'x'; wanted a whole number from 1 to 100000"),
        ("path.frames=0", "in --set path.frames=0: found 0; wanted a whole number"),
        ("path.arc_rad=1e9", "from 0 to 100"),
        ("path=3", "wanted values of frames, rate_hz"),
        ("scene.place=indor", "one of indoor, outdoor"),
        ("format=mcap", "one of tum, folder"),
        ("path.distance_m=.nan", "wanted a number above 0.2"),
        ("a", "write --set key=value"),
        ("path.frames=[", "not valid YAML"),
    ],
)
def test_wrong_overrides_get_one_line(override: str, says: str) -> None:
    with pytest.raises(SettingsError) as caught:
        preset_spec("orbit-v1", {}, [override])
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unknown_preset_gets_the_nearest() -> None:
    with raises(SettingsError, "settings.wrong-value", match="'orbit-v1'"):
        preset_spec("orbit", {}, [])
