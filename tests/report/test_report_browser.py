"""The page in a real browser, without a screen: it turns, it sorts, and it asks the network for nothing."""

import base64
import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from headless import Browser, find_chromium
from read_pictures import decoded_picture
from synthetic_release import ball

from kinectbench.core.voxels.pair_file import read_pair, unpack
from kinectbench.release.release import Release
from kinectbench.report.run import page_of_release, write_galleries
from kinectbench.scoring.score import score_methods

pytestmark = pytest.mark.skipif(find_chromium() is None, reason="no chromium here to open the page in")

CARD = "document.querySelector('.card')"
ROWS = "[...document.querySelectorAll('table.sortable')[0].tBodies[0].rows]"


@pytest.fixture(scope="module")
def page(release: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three methods: the truth moved, a ball, and nothing."""
    root = tmp_path_factory.mktemp("page")
    for target in release.split("test"):
        full = unpack(read_pair(release.pair_path(target)).full)
        grids = {
            "moved": np.roll(full, 12, axis=0),
            "ball": ball((128, 128, 128), 70),
            "nothing": full & False,
        }
        for name, grid in grids.items():
            path = root / "predictions" / name / target.recording / f"{target.view}.npy"
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, grid)
    tables = score_methods(release, root / "predictions", root / "scores", surface=False)
    write_galleries(release, root / "predictions", tables, root / "scores", "half-pixel")
    return page_of_release(release, root / "scores")[0]


@pytest.fixture(scope="module")
def browser(page: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        opened.window(1280, 900)
        opened.open(page)
        yield opened


@pytest.fixture(autouse=True)
def no_errors(browser: Browser) -> Iterator[None]:
    yield
    # What the software renderer says of its own speed is no error of the page.
    assert [line for line in browser.complaints() if "GL Driver Message" not in line] == []
    assert [url for url in browser.requested() if not url.startswith(("file:", "data:"))] == []


def picture(browser: Browser, pane: int) -> np.ndarray:
    """One picture of the first card: (h, w, 4) as drawn."""
    uri = browser.evaluate(f"{CARD}.querySelectorAll('canvas')[{pane}].toDataURL('image/png')")
    return decoded_picture(base64.b64decode(uri.partition(",")[2]), cv2.IMREAD_UNCHANGED)


def show(browser: Browser, **choices: str) -> None:
    """Choose in the gallery's menus, by their texts, and wait for the first card."""
    for name, text in choices.items():
        browser.evaluate(
            f"(() => {{ const menu = document.querySelector('select[name={name}]');"
            f"menu.value = [...menu.options].find(o => o.text === {json.dumps(text)}).value;"
            "menu.dispatchEvent(new Event('change')); })()"
        )
    browser.evaluate("document.getElementById('gallery-title').scrollIntoView({behavior: 'instant'})")
    browser.wait_for(f"{CARD}.dataset.drawn === 'yes'")


def azimuth(browser: Browser) -> float:
    return float(browser.evaluate(f"{CARD}.dataset.azimuth"))


def test_a_pair_turns(browser: Browser) -> None:
    show(browser, method="moved", beside="none", order="by name")
    assert browser.evaluate(f"{CARD}.dataset.pair") == "chair_01/000"
    before = [picture(browser, pane) for pane in range(4)]
    assert all(np.ptp(image[..., :3]) > 20 and (image[..., 3] > 0).mean() > 0.02 for image in before)
    start = azimuth(browser)
    box = browser.evaluate(
        f"(() => {{ const b = {CARD}.querySelector('canvas').getBoundingClientRect();"
        "return [b.x + b.width / 2, b.y + b.height / 2]; })()"
    )
    x, y = box
    browser.drag(x, y, 80, 30)
    browser.wait_for(f"{CARD}.dataset.azimuth !== '{start:g}'")
    assert azimuth(browser) == pytest.approx(start + 40)
    assert float(browser.evaluate(f"{CARD}.dataset.elevation")) == pytest.approx(33)
    after = [picture(browser, pane) for pane in range(4)]
    assert all((one != two).mean() > 0.01 for one, two in zip(before, after, strict=True))


def test_the_truth_that_nobody_saw_is_orange(browser: Browser) -> None:
    show(browser, method="moved", beside="none", order="by name")
    partial, truth = (picture(browser, pane) for pane in (0, 2))

    def orange(image: np.ndarray) -> np.ndarray:
        blue, _, red = (image[..., channel].astype(int) for channel in range(3))
        return np.asarray((image[..., 3] == 255) & (red - blue > 90))

    # A slab of the ball of three cells, of some forty.
    assert 0.02 < orange(truth).sum() / (truth[..., 3] == 255).sum() < 0.2
    assert not orange(partial).any()


def test_keys_turn_it_too(browser: Browser) -> None:
    show(browser, method="moved", order="best first")
    browser.evaluate(f"{CARD}.querySelector('.panes').focus()")
    start = azimuth(browser)
    for _ in range(2):
        for kind in ("keyDown", "keyUp"):
            browser.call("Input.dispatchKeyEvent", type=kind, key="ArrowLeft", code="ArrowLeft")
    browser.wait_for(f"{CARD}.dataset.azimuth === '{start - 20:g}'")


def test_the_order_is_that_of_the_scores(browser: Browser) -> None:
    for order, sign in (("worst first", 1), ("best first", -1)):
        show(browser, method="ball", order=order, category="chair")
        shown = browser.evaluate("[...document.querySelectorAll('.card .iou')].map(e => e.textContent)")
        values = [float(text.removeprefix("IoU ").split(" and ")[0]) for text in shown]
        assert len(values) == 3 and values == sorted(values, key=lambda value: sign * value)
    show(browser, category="all")
    assert browser.evaluate("document.querySelectorAll('.card').length") == 4


def test_the_error_shows_what_is_missing(browser: Browser) -> None:
    show(browser, method="nothing", beside="none", order="by name")
    error, truth = picture(browser, 3), picture(browser, 2)
    # Of an empty prediction all is missing: blue in the same places as the truth; the prediction is blank.
    assert not picture(browser, 1)[..., 3].any()
    inside = (error[..., 3] == 255) & (truth[..., 3] == 255)
    assert inside.mean() > 0.05 and np.abs((error[..., 3] > 0) ^ (truth[..., 3] > 0)).mean() < 0.01
    blue, _, red = (error[inside][:, channel].astype(int) for channel in range(3))
    assert ((blue > red + 20).mean()) > 0.8


def test_two_methods_stand_side_by_side_below_their_view(browser: Browser) -> None:
    show(browser, method="moved", beside="ball", order="by name")
    captions = browser.evaluate(f"[...{CARD}.querySelectorAll('figcaption')].map(e => e.textContent)")
    assert captions == ["partial", "moved", "ball", "truth", "error of moved", "error of ball"]
    assert (picture(browser, 1) != picture(browser, 2)).any()
    assert browser.evaluate(f"{CARD}.querySelector('img.view').naturalWidth") > 0


def test_a_table_sorts(browser: Browser) -> None:
    column = "document.querySelectorAll('table.sortable')[0].tHead.rows[1].cells[1]"
    assert browser.evaluate(f"{column}.textContent") == "group by IoU, known"
    click = f"{column}.nextElementSibling.querySelector('button').click()"
    order = f"{ROWS}.map(row => row.cells[0].dataset.value)"
    browser.evaluate(click)
    falling = browser.evaluate(order)
    assert browser.evaluate(f"{column}.nextElementSibling.getAttribute('aria-sort')") == "descending"
    values = browser.evaluate(f"{ROWS}.map(row => +row.cells[2].dataset.value)")
    assert values == sorted(values, reverse=True) and len(set(values)) == 3
    browser.evaluate(click)
    assert browser.evaluate(order) == falling[::-1] and falling[-1] == "nothing"
    assert browser.evaluate(f"{column}.nextElementSibling.getAttribute('aria-sort')") == "ascending"
    # Of cross-entropy the least is the best, and words begin with a.
    lowest = "document.querySelectorAll('table.sortable')[0].tHead.rows[1]"
    for cell in ("cells[0]", "lastElementChild"):
        browser.evaluate(f"{lowest}.{cell}.querySelector('button').click()")
        assert browser.evaluate(f"{lowest}.{cell}.getAttribute('aria-sort')") == "ascending"


def test_a_best_pair_leads_to_the_gallery(browser: Browser) -> None:
    link = "[...document.querySelectorAll('a[data-pair]')].find(a => a.dataset.method === 'ball')"
    name = browser.evaluate(f"{link}.dataset.pair")
    browser.evaluate(f"{link}.click()")
    browser.wait_for(f"document.activeElement.closest('.card')?.dataset.pair === {json.dumps(name)}")
    assert browser.evaluate("document.querySelector('select[name=method]').selectedOptions[0].text") == "ball"


def test_the_legend_brings_a_method_out(browser: Browser) -> None:
    browser.evaluate("document.querySelectorAll('.legend button')[1].click()")
    dim = browser.evaluate(
        "[...document.querySelectorAll('.series')].map(s => [s.dataset.series, s.matches('.dim')])"
    )
    assert {series for series, faded in dim if not faded} == {"1"}
    browser.evaluate("document.querySelectorAll('.legend button')[1].click()")
    assert browser.evaluate("document.querySelectorAll('.series.dim').length") == 0


@pytest.mark.parametrize(("width", "dark"), [(390, False), (390, True), (1280, True)])
def test_it_fits_the_window(browser: Browser, page: Path, width: int, dark: bool) -> None:
    browser.window(width, 844, dark)
    browser.open(page)
    assert browser.evaluate("document.documentElement.scrollWidth") == width
    colors = browser.evaluate(
        "[getComputedStyle(document.body).color, getComputedStyle(document.body).backgroundColor]"
    )
    ink, paper = (sum(int(part) for part in color[4:-1].split(",")) for color in colors)
    assert (ink > paper) == dark
    browser.window(1280, 900)
