"""What a release says of undersides: each recording's word, by whom it is, and nothing of a hidden truth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evidence_by_hand import shape_of
from synthetic_release import synthetic_settings, write_json
from typed import model_of

from kinectbench.core.artefacts.benchmark import RecordingInfo, ReleaseInfo, SettingsInfo
from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.types import CLOSED_MEANS, OPEN_MEANS, Underside
from kinectbench.release.check.rebuild import LocalRecording, _settings
from kinectbench.release.publish.card import card_figures, underside_line
from kinectbench.release.publish.datasheet import datasheet
from kinectbench.release.publish.publish import _public_settings
from kinectbench.release.publish.publish_recording import _stage
from kinectbench.settings.models import UNDERSIDE, BenchmarkSettings
from kinectbench.stages.segment.judge.quality import _underside_question

RESTS = "the ground truth rests on it"


def recording(word: Underside | None, share: float | None = None) -> RecordingInfo:
    """As benchmark.json has it; without a word as of an older build, or with its truth held back."""
    quality = QualityFile() if word is None else QualityFile(underside=word, underside_share=share)
    return RecordingInfo(
        object="a",
        category="chair",
        split="test",
        pairs=1,
        refused=0,
        quality=quality,
        license="CC0-1.0",
        source="our lab",
    )


@pytest.mark.parametrize(
    ("words", "begins", "rests"),
    [
        ((), "", False),
        ((None, None), "", False),
        (("unseen",), "Underside, as stated of 1 recording: closed 0, open 0, unseen 1.", False),
        (
            ("open", "unseen", None),
            "Underside, as stated of 2 recordings: closed 0, open 1, unseen 1.",
            False,
        ),
        (
            ("closed", "closed", "open"),
            "Underside, as stated of 3 recordings: closed 2, open 1, unseen 0.",
            True,
        ),
    ],
)
def test_one_line_says_whose_word_it_is(words: tuple[Underside | None], begins: str, rests: bool) -> None:
    line = underside_line({str(number): recording(word) for number, word in enumerate(words)})
    assert line.startswith(begins) and (line == "") == (begins == "") and "\n" not in line
    assert (RESTS in line) == rests == (" by the word of whoever recorded it" in line)
    assert (CLOSED_MEANS in line) == rests


def test_settings_cards_and_messages_explain_the_words_alike() -> None:
    solid = np.ones((3, 3, 3), bool)
    (line,) = _underside_question(replace(shape_of(solid), underside=solid), "unseen")
    assert f"`underside: closed` if {CLOSED_MEANS}, " in line and f"`underside: open` if {OPEN_MEANS}" in line
    assert "space behind it is open to the air" in CLOSED_MEANS and "hand meets one face" in UNDERSIDE
    assert f"closed: {CLOSED_MEANS}; open: {OPEN_MEANS}" in UNDERSIDE


def test_card_and_datasheet_say_it() -> None:
    infos = {"a": recording("closed", 0.125), "b": recording("unseen", 0.0), "c": recording(None)}
    info = model_of(ReleaseInfo, recordings=infos)
    card = card_figures(info)
    table = card.splitlines()
    assert table[0].endswith("| seen from below only, of the solid | underside, as stated |")
    assert table[2].endswith("| 12.5 % | closed |") and table[4].endswith("|  |  |")
    sheet = datasheet(info, synthetic_settings(), (), (), "none")
    assert underside_line(infos) in card and f"- {underside_line(infos)}\n" in sheet
    assert "could be seen from below only: 6.25 (0 to 12.5) %, of 2 recordings" in sheet


def settings_by_category() -> BenchmarkSettings:
    return synthetic_settings(
        categories={"chair": {"underside": "closed"}, "table": {"underside": "open"}},
    )


def test_each_recording_of_a_release_has_its_word_and_a_hidden_one_has_none() -> None:
    settings = settings_by_category()
    public = _public_settings(settings, ("test",), [])
    assert "categories" not in public
    assert [row.get("underside") for row in public["recordings"]] == [None, None, "closed", None, "open"]
    whole = _public_settings(settings, (), [])
    assert [row["underside"] for row in whole["recordings"]] == [*["closed"] * 3, *["open"] * 2]


def test_it_is_made_again_with_these_words_though_a_category_is_missing(tmp_path: Path) -> None:
    stated = SettingsInfo.model_validate(_public_settings(settings_by_category(), (), []))
    info = model_of(ReleaseInfo, name="x", license="CC0-1.0", package_version="1", settings=stated)
    again = _settings(info, {"chair_02": LocalRecording(tmp_path)}, {"chair_02"})
    assert [again.underside_of(each) for each in again.recordings] == ["closed"]


@pytest.mark.parametrize(("hidden", "told"), [(False, {"underside", "box", "floor"}), (True, {"floor"})])
def test_the_lineage_of_a_hidden_recording_has_no_word(tmp_path: Path, hidden: bool, told: set[str]) -> None:
    said = {"underside": "closed", "box": None, "floor": None}
    known = {"format_version": 1, "package_version": "1", "stage": "segment", "fingerprint": "0" * 64}
    write_json(tmp_path / "manifest.json", {**known, "settings": said, "inputs": {}, "files": {}})
    assert set(_stage(tmp_path, hidden).settings) == told
