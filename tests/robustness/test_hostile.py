"""Of the hostile inputs: each is one of a kind, and what a command does wrong with one is seen."""

import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from fuzz.releases import make_release, seal
from hostile import cases, tried
from hostile_cases.case import Case

from kinectbench.release.check.verify import verify

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="memory and time are asked of /proc")

GROUPS = {*(f"H{n}" for n in range(7)), *(f"M{n}" for n in range(1, 7)), "L"}
CUT_OFF = Case(
    "M3", "cut off", "verify release.zip", lambda folder: cut_off(folder), says="cut off or damaged"
)


def cut_off(folder: Path) -> None:
    (folder / "release.zip").write_bytes(b"PK\3\4" + bytes(99))


def test_each_case_is_one_of_a_kind_and_every_group_has_some() -> None:
    every = list(cases())
    twice = [
        key
        for key, count in Counter((c.name, c.command, str(c.variables)) for c in every).items()
        if count > 1
    ]
    assert twice == []
    assert {case.group for case in every} == GROUPS
    assert all(set(case.statuses) <= {0, 1, 2, 3} for case in every)


def test_what_a_command_does_wrong_is_seen(tmp_path: Path) -> None:
    assert tried(CUT_OFF, tmp_path, tmp_path).faults == ()
    wrong = replace(CUT_OFF, statuses=(0,), says="all well", errors=0)
    faults = tried(wrong, tmp_path, tmp_path).faults
    assert faults == ("status 1, not 0", "1 lines of errors", "does not say 'all well'")


def test_a_release_is_sealed_by_its_own_rule(tmp_path: Path) -> None:
    """Otherwise everything would be refused for its checksums, and nothing else be tried."""
    make_release(tmp_path)
    path = tmp_path / "release/objects/chair_01/quality.json"
    path.write_text("[]", encoding="utf-8")
    seal(tmp_path / "release")
    lines = verify(tmp_path / "release")
    assert lines and all("quality.json" in line or "README" in line for line in lines), lines
