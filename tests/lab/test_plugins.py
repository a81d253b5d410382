"""Packages add families and formats by entry points; one that cannot be used is named in one line."""

from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import pytest
from raising import raises

from kinectbench.core.errors import SettingsError
from kinectbench.lab import plugins as module
from kinectbench.lab.plugins import plugins
from kinectbench.lab.simulate.objects import PAPER_FURNITURE, families
from kinectbench.lab.simulate.objects.joinery import Family
from kinectbench.lab.simulate.writers import OWN_FORMATS, formats

MINE = {"stool_of_mine": PAPER_FURNITURE["table"]}
TAKEN = {"chair": PAPER_FURNITURE["table"]}
NO_FAMILY = {"thing": 3}
GROUP = "kinectbench.families"


def with_entry_point(monkeypatch: pytest.MonkeyPatch, value: str) -> dict[str, Family]:
    """Families when one package adds those of `value`."""
    point = EntryPoint("mine", value, GROUP)
    monkeypatch.setattr(module, "entry_points", lambda group: [point])
    return plugins(GROUP, Family, PAPER_FURNITURE)


def test_a_package_adds_families(monkeypatch: pytest.MonkeyPatch) -> None:
    found = with_entry_point(monkeypatch, f"{__name__}:MINE")
    assert list(found) == [*PAPER_FURNITURE, "stool_of_mine"]


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ("no_such_package:FAMILIES", "cannot be imported"),
        (f"{__name__}:ABSENT", "cannot be imported"),
        (f"{__name__}:NO_FAMILY", "no mapping from names to Family"),
        (f"{__name__}:GROUP", "no mapping from names to Family"),
        (f"{__name__}:TAKEN", "'chair' is there already"),
    ],
)
def test_a_package_that_cannot_be_used_is_named(
    monkeypatch: pytest.MonkeyPatch, value: str, says: str
) -> None:
    with pytest.raises(SettingsError) as caught:
        with_entry_point(monkeypatch, value)
    assert says in str(caught.value) and f"'mine' of {GROUP}" in str(caught.value)


def test_a_package_that_fails_as_it_is_imported_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "failing_families.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(str(tmp_path))
    with raises(SettingsError, "settings.bad-plugin", match="ZeroDivisionError: division by zero"):
        with_entry_point(monkeypatch, "failing_families:FAMILIES")


def test_the_plug_ins_of_a_checkout_are_there() -> None:
    assert {point.value for point in entry_points(group=GROUP)} == {"kinectbench_plugins.families:FAMILIES"}
    assert len(families()) > len(PAPER_FURNITURE) and len(formats()) > len(OWN_FORMATS)
