"""Presets are frozen: what they say, and what comes of them."""

import json

import pytest
from preset_pins import OBJECTS, PINS, machine, object_pin, preset_pin

from kinectbench.lab.simulate.presets import PRESETS

PINNED = json.loads(PINS.read_text())


def test_every_preset_is_pinned_and_has_a_version() -> None:
    assert set(PINNED["presets"]) == set(PRESETS)
    for name, (text, _) in PRESETS.items():
        stem, _, number = name.rpartition("-v")
        assert stem and number.isdecimal()
        assert 5 < len(text) < 60


@pytest.mark.parametrize(("family", "seed"), OBJECTS)
def test_furniture_is_frozen(family: str, seed: int) -> None:
    assert object_pin(family, seed) == PINNED["objects"][f"{family}:seed={seed}"]


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_frozen(name: str) -> None:
    pinned, found = dict(PINNED["presets"][name]), preset_pin(name)
    bytes_pinned, bytes_found = pinned.pop("pixels"), found.pop("pixels")
    for key, tolerance in {"valid_share": 0.002, "mean_depth_m": 0.002, "mean_color": 0.2}.items():
        assert found.pop(key) == pytest.approx(pinned.pop(key), abs=tolerance)
    assert found == pinned
    if PINNED["machine"] == machine():
        assert bytes_found == bytes_pinned


def test_the_bytes_are_compared_on_the_machine_they_were_pinned_on() -> None:
    if PINNED["machine"] != machine():
        pytest.skip("another machine or other packages than the bytes were pinned with")
    assert all(len(pin["pixels"]) == 16 for pin in PINNED["presets"].values())
