"""The page of a benchmark of thousands: a list of all recordings, sections of some, and no more than 5 MB."""

import json
import re
from pathlib import Path

from report_fake_build import SETTINGS, parsed_tables, score

from kinectbench.core.listing import PAGE_ROWS, SHOWN
from kinectbench.report import write_report
from kinectbench.report.page import _listed
from kinectbench.report.recording_list import COLUMNS, NOT_BUILT, shortened
from kinectbench.settings.models import BenchmarkSettings

MOST_BYTES = 5_000_000
COUNT = 2000


def many_settings(count: int) -> BenchmarkSettings:
    """The benchmark that is built, and recordings that are not."""
    values = SETTINGS.model_dump()
    values["recordings"] += [
        {"id": f"thing_{n:05d}", "path": "x", "category": ("lamp", "sofa")[n % 2]} for n in range(count - 3)
    ]
    return BenchmarkSettings.model_validate(values)


def data(page: str) -> list[list[str]]:
    (text,) = re.findall(r'<script type="application/json">(.*?)</script>', page)
    rows: list[list[str]] = json.loads(text)["rows"]
    return rows


def test_all_are_listed_and_some_are_shown(build: Path, tmp_path: Path) -> None:
    out = write_report(many_settings(COUNT), build, parsed_tables([score("net", 0.4)]), tmp_path / "x.html")
    page = out.read_text()
    assert len(page.encode()) <= MOST_BYTES
    assert page.count('<section class="recording"') == SHOWN
    rows = [dict(zip(COLUMNS, row, strict=True)) for row in data(page)]
    assert len(rows) == COUNT and page.count('<tr><th class="name" scope="row">') >= PAGE_ROWS
    assert (rows[0]["recording"], rows[0]["object"], rows[0]["pairs"]) == ("chair_01", "red_chair", "3")
    assert rows[-1]["verdict"] == NOT_BUILT and rows[0]["verdict"] != NOT_BUILT
    assert "<dt>pairs</dt><dd>3</dd>" in page
    assert f"And {COUNT - SHOWN} more recordings." in page


def test_few_are_as_before(build: Path, tmp_path: Path) -> None:
    page = write_report(many_settings(SHOWN), build, [], tmp_path / "x.html").read_text()
    assert page.count('<section class="recording"') == SHOWN
    assert 'class="listing"' not in page and "sortable overview" in page and "more recordings" not in page
    assert _listed(SETTINGS, build, []) is not None
    assert shortened({"recordings": [1] * SHOWN}) == ({"recordings": [1] * SHOWN}, 0)
