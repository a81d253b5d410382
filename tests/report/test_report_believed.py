"""What the page says of scores: units, groups, a test set that is too small; headings that stay in sight."""

import itertools
from pathlib import Path

import pytest
from headless import Browser, find_chromium
from report_fake_build import SETTINGS

from kinectbench.core.artefacts.score_figures import ScoreRow
from kinectbench.core.artefacts.scores import ScoreSettings, ScoreTable
from kinectbench.report.page import ScoreExtras, write_report
from kinectbench.report.run import grouped
from kinectbench.scoring.read_table import recomputed


def row(category: str, thing: int, view: int, iou: float) -> ScoreRow:
    name = f"{category}_{thing}"
    return ScoreRow(
        name, name, f"{view:03d}", category, "known", 0.5, iou, 1 - iou, 1.0, iou, 2 * iou / (1 + iou)
    )


def method(name: str, rows: list[ScoreRow]) -> ScoreTable:
    return ScoreTable(
        method=name,
        benchmark_sha256="a" * 64,
        settings=ScoreSettings(protocols=("known",)),
        complete=True,
        rows=tuple(rows),
    )


def scored_page(folder: Path, objects: int = 8) -> Path:
    """A page of three methods and 21 categories, wider than any window."""
    made = []
    for place, name in enumerate(("high", "middle", "low")):
        rows = [
            row(f"category_{c:02d}", n, 0, 0.6 - 0.1 * place + (0.12 if place == 1 and (n + c) % 2 else 0.0))
            for c in range(21)
            for n in range(objects)
        ]
        made.append(recomputed(method(name, rows), name))
    groups = grouped(made, ("known",))
    return write_report(SETTINGS, None, made, folder / "scores.html", extras=ScoreExtras(groups))


@pytest.mark.skipif(find_chromium() is None, reason="no chromium here to open the page in")
def test_scores_in_a_narrow_window(tmp_path: Path) -> None:
    page = scored_page(tmp_path)
    with Browser(tmp_path / "profile") as browser:
        for width, dark in ((1400, False), (400, True)):
            browser.window(width, 800, dark)
            browser.open(page)
            assert browser.evaluate("document.documentElement.scrollWidth") <= width
            # The table tells that it scrolls; its headings and its methods stay in sight when it does.
            browser.wait_for("document.querySelector('.scores .scroll').classList.contains('more-right')")
            browser.evaluate(
                "const b = document.querySelector('.scores .scroll'); b.scrollLeft = b.scrollWidth / 1.5"
            )
            browser.wait_for("document.querySelector('.scores .scroll').classList.contains('more-left')")
            seen = browser.evaluate(
                "[...document.querySelectorAll('.scores .group span')].slice(0, 2).map(span => {"
                " const at = span.getBoundingClientRect();"
                " const of = span.closest('.scroll').getBoundingClientRect();"
                " return at.left >= of.left - 1 && at.right <= of.right + 1; })"
            )
            assert seen == [False, True]  # that of CE
            first = "document.querySelector('.scores tbody th').getBoundingClientRect().left"
            assert browser.evaluate(first) >= 0
        # Rows of the table of figures can be chosen.
        browser.evaluate("document.querySelectorAll('details').forEach(each => each.open = true)")
        chosen = (
            "const select = document.querySelector('.filters select'); select.value = '=low';"
            "select.dispatchEvent(new Event('change'));"
            "[...document.querySelectorAll('.filterable tbody tr')].filter(r => !r.hidden)"
            ".map(r => r.cells[0].textContent)"
        )
        assert set(browser.evaluate(chosen)) == {"low"}
        levels = browser.evaluate("[...document.querySelectorAll('h1,h2,h3,h4,h5')].map(h => +h.tagName[1])")
        assert levels[0] == 1 and all(b - a <= 1 for a, b in itertools.pairwise(levels))
        assert browser.complaints() == []


def test_what_the_page_says_of_scores(tmp_path: Path) -> None:
    text = " ".join(scored_page(tmp_path).read_text(encoding="utf-8").split())
    assert "IoU, higher is better ↑; protocol known" in text
    assert "CE, nats a voxel, lower is better ↓; protocol known" in text and "group by IoU, known" in text
    assert "too small to tell methods apart" not in text and text.count("<small>reported</small>") == 3
    small = " ".join(scored_page(tmp_path, objects=1).read_text(encoding="utf-8").split())
    assert "too small to tell methods apart" not in small  # 21 objects in all
    few = [recomputed(method(name, [row("chair", n, 0, 0.5) for n in range(4)]), name) for name in "ab"]
    page = write_report(
        SETTINGS, None, few, tmp_path / "few.html", extras=ScoreExtras(grouped(few, ("known",)))
    )
    text = page.read_text(encoding="utf-8")
    assert text.index("too small to tell methods apart") < text.index("Protocol “known”")
