"""The tutorial's text and pictures are of one run, which docs/tutorial.json keeps."""

import json
import re

import pytest
from docs_tutorial import KEPT, PAGE, PICTURES, digest, pictures_of, printed, prose, retold

AGAIN = "run `make docs-pictures`, which makes text and pictures of one run"


@pytest.fixture(scope="module")
def kept() -> dict[str, dict[str, object]]:
    found: dict[str, dict[str, object]] = json.loads(KEPT.read_text(encoding="utf-8"))
    return found


def test_what_commands_print_is_of_the_run(kept: dict[str, dict[str, object]]) -> None:
    text = PAGE.read_text(encoding="utf-8")
    found = printed(text)
    assert list(found) == list(kept["outputs"]), AGAIN
    for command, lines in found.items():
        assert lines == kept["outputs"][command], (command, AGAIN)
    assert retold(text, found) == text


def test_pictures_are_of_the_run(kept: dict[str, dict[str, object]]) -> None:
    names = pictures_of(PAGE.read_text(encoding="utf-8"))
    assert {name: digest(PICTURES / name) for name in names} == kept["pictures"], AGAIN


def test_figures_in_sentences_are_of_the_run(kept: dict[str, dict[str, object]]) -> None:
    text, figures = prose(PAGE.read_text(encoding="utf-8")), kept["figures"]
    (frames,) = re.findall(r"Our recording: (\d+) frames of (\d+) × (\d+) pixels", text)
    assert list(map(int, frames)) == [figures[key] for key in ("frames", "width", "height")]
    assert {int(count) for count in re.findall(r"(\d+) pairs", text)} == {figures["pairs"]}
    # Scores and lengths of the run stand in what commands print alone.
    assert re.findall(r"\d\.\d{2,}", text) == []


def test_a_text_that_was_changed_by_hand_is_not_of_the_run() -> None:
    text = "a\n```\n$ kinectbench a\none\n$ kinectbench b\n```\n```yaml\nx: 1\n```\n"
    assert printed(text) == {"kinectbench a": ["one"], "kinectbench b": []}
    told = retold(text, {"kinectbench a": ["two"], "kinectbench b": ["three"]})
    assert told == text.replace("one\n", "two\n").replace("b\n", "b\nthree\n")
