"""Texts of releases of many recordings, categories and lines: `verify` looks each thing up once."""

import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from kinectbench.core.artefacts.benchmark import RecordingInfo
from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.targets import Target
from kinectbench.release.check.agreement_check import (
    CITATION_BYTES,
    _card_problems,
    _license_problems,
    _limits,
)
from kinectbench.release.publish.attribution import license_text
from kinectbench.release.publish.card import counts_table

INFO = RecordingInfo(
    object="a", category="c", split="test", pairs=1, refused=0, quality=QualityFile(), license="CC-BY-4.0",
    source="who recorded it",
)  # fmt: skip
INFOS = {f"r{index}": INFO for index in range(5000)}
TARGET = Target("r0", "o", "000", "c0", "test", "pairs/r0/000.npz", "0" * 64)


def metadata(count: int = len(INFOS)) -> Any:
    """benchmark.json of the first recordings."""
    infos = dict(list(INFOS.items())[:count])
    return SimpleNamespace(name="b", license="CC-BY-4.0", recordings=infos)


def stated(targets: tuple[Target, ...] = (TARGET,)) -> Any:
    return SimpleNamespace(metadata=metadata(), targets=targets, says_twice=False)


LICENSES = {
    "nothing like it": "x" * (16 << 20),
    "near matches": "rrrr1\n  licence: CC-BY-4.0\n  sourcr0" * (1 << 18),
    "one that is near, often": "r1\n  licence: CC-BY-4.0\n  source: me\n" * (1 << 18),
}


@pytest.mark.parametrize("kind", LICENSES)
def test_a_licence_of_many_lines_is_read_once(kind: str) -> None:
    started = time.process_time()
    found = list(_license_problems(LICENSES[kind], stated()))
    assert time.process_time() - started < 5  # with a search for each recording: half a minute and more
    assert len(found) == len(INFOS) and found[0].startswith("does not state licence and source of r0 as")


def test_what_is_stated_is_found_wherever_it_stands() -> None:
    text = license_text("b", "CC-BY-4.0", INFOS)
    assert list(_license_problems(text, stated())) == []
    assert list(_license_problems(f"My words.\n\n{text}\nAnd more of them.\n", stated())) == []
    assert len(list(_license_problems(text.replace("r17\n", "r-17\n"), stated()))) == 1
    assert len(list(_license_problems(text.replace("r17\n  lic", "r17\n  Lic"), stated()))) == 1


def test_a_card_of_many_lines_is_read_once() -> None:
    targets = tuple(replace(TARGET, category=f"c{index}", object=f"o{index}") for index in range(20_000))
    text = f"b CC-BY-4.0\n{counts_table(targets)}"
    started = time.process_time()
    assert list(_card_problems(text, stated(targets))) == []
    assert time.process_time() - started < 5
    wrong = list(_card_problems(text.replace("| c7 | 1 |", "| c7 | 2 |"), stated(targets)))
    assert wrong == ["does not have the row '| c7 | 1 | 0 | 0 | 1 |', which targets.csv counts"]


@pytest.mark.parametrize("name", ["LICENSE", "README.md", "CITATION.cff"])
def test_texts_are_bounded_by_what_they_have_to_say(name: str) -> None:
    said = len(license_text("b", "CC-BY-4.0", INFOS))
    assert _limits(metadata(1))[name] < CITATION_BYTES + 4096
    assert _limits(metadata())[name] >= {"LICENSE": said, "README.md": 2 * said}.get(name, CITATION_BYTES)
