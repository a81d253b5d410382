"""What a release says of each category: the card's table, and a page with a picture of every object."""

import re
from pathlib import Path
from statistics import median

import numpy as np
import pytest
from synthetic_release import RECORDINGS, synthetic_settings, write_build, write_json

from kinectbench.core.artefacts.benchmark import PublishOptions, ReleaseInfo
from kinectbench.core.types import Split
from kinectbench.core.voxels.pair_file import read_pair, unpack
from kinectbench.release.check.verify import verify
from kinectbench.release.publish.publish import publish

NAMES = [name for name, *_ in RECORDINGS]
# Recording -> estimate, its low end and high end, unknown share, sides of its box.
FIGURES = {
    "chair_01": (0.93, 0.8, 0.97, 0.2, (0.4, 0.5, 0.9)),
    "chair_02": (0.9, 0.75, 0.95, 0.1, (0.6, 0.45, 0.8)),
    "chair_03": (0.8, 0.7, 0.9, 0.04, (0.5, 0.5, 1.1)),
    "table_01": (0.95, 0.9, 0.99, 0.01, (1.2, 0.7, 0.75)),
    "table_02": (0.95, 0.9, 0.99, 0.01, (1.2, 0.7, 0.75)),
}


def released(folder: Path, *hold_back: Split) -> Path:
    write_build(folder / "build")
    for name, (estimate, low, high, unknown, size) in FIGURES.items():
        quality = {
            **{"format_version": 1, "estimated_iou": estimate, "estimated_iou_low": low},
            **{"estimated_iou_high": high, "unknown_share": unknown},
            "box": {"center_m": [0, 0, 0], "size_m": size, "yaw_rad": 0.0},
        }
        write_json(folder / "build" / name / "object/quality.json", quality)
    options = PublishOptions(hold_back=hold_back, thresholds=None)
    return publish(synthetic_settings(), folder / "build", folder / "b", NAMES, options).folder


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return released(tmp_path_factory.mktemp("categories"))


def table(card: str) -> dict[str, list[str]]:
    """Category -> the other cells of its row in the second table."""
    lines = card.split("| category | longer side")[1].split("\n\n")[0].splitlines()[2:]
    return {row[0]: row[1:] for row in (line.strip("| ").split(" | ") for line in lines)}


def test_the_card_has_the_figures_of_each_category(release: Path) -> None:
    info = ReleaseInfo.read(release)
    rows = table((release / "README.md").read_text())
    shares = {name: of.visible_share for name, of in info.recordings.items()}
    assert all(share is not None and 0 < share < 1 for share in shares.values())
    chairs = f"{median(shares[name] or 0 for name in NAMES[:3]):.1%}"
    assert rows["chair"] == [
        "0.50 to 0.60 x 0.40 to 0.50 x 0.80 to 1.10", chairs, "10.0%", "0.90 (0.75 to 0.95)",
    ]  # fmt: skip
    assert rows["table"][0] == "1.20 x 0.70 x 0.75" and rows["table"][2:] == ["1.0%", "0.95 (0.90 to 0.99)"]
    assert verify(release) == []


def test_the_visible_share_is_of_the_true_surface(release: Path) -> None:
    pairs = [read_pair(release / "pairs/chair_01" / f"{view}.npz") for view in ("000", "001")]
    cells = [(unpack(pair.shell), unpack(pair.seen)) for pair in pairs]
    stated = ReleaseInfo.read(release).recordings["chair_01"].visible_share
    assert stated == pytest.approx(
        np.mean([(shell & seen).sum() / shell.sum() for shell, seen in cells]), abs=1e-4
    )


def test_each_category_has_a_page_with_a_picture_of_every_object(release: Path) -> None:
    pages = {path.stem: path.read_text() for path in (release / "categories").iterdir()}
    assert set(pages) == {"chair", "table"}
    index = (release / "index.html").read_text()
    assert re.findall('href="(categories/[^"]+)"', index) == [
        "categories/chair.html",
        "categories/table.html",
    ]
    assert re.findall(r'<img src="data:image/jpeg;[^"]+" alt="(\w+)"', pages["chair"]) == NAMES[:3]
    assert "3 objects in 3 recordings" in pages["chair"] and "object red_chair" in pages["chair"]
    assert "0.50 x 0.40 x 0.90" in pages["chair"] and "0.93 (0.80 to 0.97)" in pages["chair"]


def test_the_pages_keep_back_what_is_held_back(release: Path, tmp_path: Path) -> None:
    public = released(tmp_path, "test")
    held = ReleaseInfo.read(public).recordings["chair_01"]
    assert held.visible_share is None
    page, whole = ((folder / "categories/chair.html").read_text() for folder in (public, release))
    assert "0.93" not in page and "0.80 (0.70 to 0.90)" in page
    pictures = [
        dict(zip(*[iter(re.findall(r'(?:src|alt)="([^"]+)"', text))] * 2, strict=True))
        for text in (page, whole)
    ]
    shown, truth = ({name: picture for picture, name in each.items()} for each in pictures)
    assert shown["chair_01"] != truth["chair_01"] and shown["chair_03"] == truth["chair_03"]
    assert verify(public) == []
