"""What a person says of undersides, by recording and by category, and the lengths in the definition."""

import re
from pathlib import Path
from typing import Any, get_args

import pytest

from kinectbench.core.errors import SettingsError
from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.types import Underside
from kinectbench.settings.file import load_benchmark, parse_benchmark
from kinectbench.settings.models import BenchmarkSettings, SegmentationSettings
from kinectbench.settings.template import init_benchmark

RECORDINGS = """\
name: furniture
recordings:
  - {id: a, path: a, category: couch}
  - {id: b, path: b, category: couch, underside: open}
  - {id: c, path: c, category: couch, underside: unseen}
  - {id: d, path: d, category: desk}
"""


def words(text: str, *overrides: str) -> list[str]:
    """The word of each recording."""
    settings = parse_benchmark(text, "x.yaml", overrides)
    return [settings.underside_of(recording) for recording in settings.recordings]


def test_a_recordings_own_word_wins_over_its_categorys() -> None:
    assert words(RECORDINGS) == ["unseen", "open", "unseen", "unseen"]
    closed = RECORDINGS + "categories: {couch: {underside: closed}}\n"
    assert words(closed) == ["closed", "open", "unseen", "unseen"]
    assert words(closed, "recordings.a.underside=open") == ["open", "open", "unseen", "unseen"]
    assert words(closed, "categories.couch.underside=unseen") == ["unseen", "open", "unseen", "unseen"]
    assert words(RECORDINGS, "categories.desk.underside=closed")[-1] == "closed"
    assert words(RECORDINGS + "categories:\n") == words(RECORDINGS)


def test_recordings_of_included_files_have_a_word(tmp_path: Path) -> None:
    (tmp_path / "rows.csv").write_text("id,path,category,underside\nx,x,couch,closed\ny,y,couch,\n")
    text = "name: furniture\ninclude: [rows.csv]\ncategories: {couch: {underside: open}}\n"
    (tmp_path / "benchmark.yaml").write_text(text)
    settings = load_benchmark(tmp_path / "benchmark.yaml")
    assert [settings.underside_of(recording) for recording in settings.recordings] == ["closed", "open"]


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("categories: closed", "categories: found the text 'closed'; wanted a mapping from names to"),
        ("categories: [couch]", "categories: found ['couch']; wanted a mapping from names to"),
        ("categories: {couch: closed}", "categories.couch: found the text 'closed'; wanted a mapping with"),
        ("categories: {couch: }", "categories.couch: found nothing; wanted a mapping with underside"),
        ("categories: {a/b: {}}", "categories.a/b: use letters, digits"),
        ("categories: {all: {}}", "categories.all: 'all' is what the mean"),
        ("categories: {couhc: {}}", "categories.couhc: no recording has this category; did you mean 'couch'"),
        ("categories: {Couch: {}}", "categories.Couch: no recording has this category; did you mean 'couch'"),
        ("categories: {car: {}}", "categories.car: no recording has this category; valid here: couch, desk"),
        ("categories: {couch: {under: open}}", "categories.couch.under: unknown key; did you mean"),
        ("categories: {couch: {underside: shut}}", "categories.couch.underside: found the text 'shut'"),
        ("categories: {couch: {underside: true}}", "wanted one of closed, open, unseen"),
    ],
)
def test_what_is_wrong_with_categories_is_told_in_its_line(line: str, told: str) -> None:
    with pytest.raises(SettingsError) as caught:
        parse_benchmark(RECORDINGS + line, "x.yaml")
    assert str(caught.value).startswith("x.yaml:7: ") and told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_init_asks_for_the_word_of_each_recording(tmp_path: Path) -> None:
    text = init_benchmark(tmp_path / "x", [("one", "log"), ("two", "log")], ())
    asked = re.findall(
        r"^    # underside: (\w+) +# say what you know; closed: .*; open: ", text, re.MULTILINE
    )
    assert asked == ["unseen", "unseen"]
    assert len(re.findall(r"^    # trajectory: … +# trust, refine, ignore; ", text, re.MULTILINE)) == 2
    assert re.search(r"^# categories: +# \w.*\n#   chair: \{underside: unseen\}$", text, re.MULTILINE)
    assert set(words(text)) == {"unseen"}
    said = text.replace("    # underside: unseen", "    underside: closed", 1)
    assert words(said) == ["closed", "unseen"]
    of_all = re.sub(r"^# (categories:|  chair:)", r"\1", text.replace(": unknown", ": chair"), flags=re.M)
    assert words(of_all.replace("{underside: unseen}", "{underside: open}")) == ["open", "open"]


def test_the_lengths_are_those_of_the_definition() -> None:
    assert SegmentationSettings().limits() == SensorLimits()
    given = {"line_width_m": 0.02, "near_m": 0.3, "camera_size_m": 0.1, "camera_height_m": 0.2}
    assert SegmentationSettings.model_validate(given).limits() == SensorLimits(**given)


def test_packaged_benchmarks_say_their_furniture_truly() -> None:
    """The samples' and the demo's simulated things have no aprons; of the real one nobody said anything."""
    root = Path(__file__).parents[2]
    for file in (root / "benchmark.yaml", root / "demo" / "benchmark.yaml"):
        settings: BenchmarkSettings = load_benchmark(file)
        said: dict[str, Any] = {each.id: settings.underside_of(each) for each in settings.recordings}
        assert said.pop("cabinet_01") == "unseen"
        assert set(said.values()) == {"closed"} and set(said.values()) <= set(get_args(Underside))
