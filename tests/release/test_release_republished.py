"""A release that is forged, with all hashes made again: what it tells by itself, and what a rebuild tells."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from file_damage import seal
from synthetic_release import RECORDINGS, synthetic_settings

from kinectbench._version import __version__
from kinectbench.core.artefacts.benchmark import PUBLISH_VERSION, ReleaseInfo
from kinectbench.core.artefacts.targets import parse_targets
from kinectbench.core.voxels.npz import load_arrays, packed_npz_bytes
from kinectbench.release.check.rebuild import LocalRecording, differences, find_sources, rebuild_plan
from kinectbench.release.check.reservations import reservations
from kinectbench.release.check.text_check import text_problems
from kinectbench.release.check.verify import verify
from kinectbench.release.opening import open_contents
from kinectbench.release.publish.publish import publish
from kinectbench.settings.models import BenchmarkSettings

NAMES = tuple(name for name, *_ in RECORDINGS)


def edited(path: Path, change: Callable[[str], str]) -> None:
    text = path.read_text(encoding="utf-8")
    assert change(text) != text
    path.write_text(change(text), encoding="utf-8")


def interior_of_one(folder: Path) -> None:
    path = folder / "pairs/chair_01/001.npz"
    arrays = load_arrays(path)
    path.write_bytes(packed_npz_bytes({**arrays, "interior": np.zeros_like(arrays["full"])}))


def one_view_twice(folder: Path) -> None:
    for name in ("pairs/chair_01/{}.npz", "views/chair_01/{}.depth.png", "views/chair_01/{}.mask.png"):
        shutil.copyfile(folder / name.format("000"), folder / name.format("001"))


FORGED: dict[str, tuple[Callable[[Path], object], str]] = {
    "a figure of the page": (
        lambda folder: edited(
            folder / "index.html", lambda text: text.replace("<td>0.930</td>", "<td>0.99</td>")
        ),
        "index.html: line",
    ),
    "an object of a category's page": (
        lambda folder: edited(
            folder / "categories/chair.html", lambda text: text.replace("red_chair", "sofa")
        ),
        "categories/chair.html: line",
    ),
    "the licence at the head of the card": (
        lambda folder: edited(
            folder / "README.md", lambda text: text.replace("license: cc0-1.0", "license: mit")
        ),
        "README.md: line 2 is 'license: mit', which should be 'license: cc0-1.0'",
    ),
    "the licence of croissant.json": (
        lambda folder: edited(
            folder / "croissant.json", lambda text: text.replace('"license": "', '"license": "x')
        ),
        'croissant.json: license is "x',
    ),
    "a sentence of the datasheet": (
        lambda folder: edited(folder / "datasheet.md", lambda text: text.replace("made up", "by me")),
        "datasheet.md: line",
    ),
    "a key that one pair lacks": (
        interior_of_one,
        "pairs/chair_01/000.npz: without 'interior', which is in 1 of the 2 pairs of chair_01",
    ),
    "one view twice": (
        one_view_twice,
        "pairs/chair_01/001.npz: a copy of pairs/chair_01/000.npz; no camera gives one view twice",
    ),
}


@pytest.mark.parametrize("what", FORGED)
def test_a_release_by_itself(analytic: Path, tmp_path: Path, what: str) -> None:
    folder = Path(shutil.copytree(analytic / "benchmark", tmp_path / "benchmark"))
    forge, line = FORGED[what]
    forge(folder)
    seal(folder)
    found = verify(folder)
    assert sum(each.startswith(line) for each in found) == 1, found


def test_of_other_versions_no_text_is_compared(
    analytic: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = Path(shutil.copytree(analytic / "benchmark", tmp_path / "benchmark"))
    edited(folder / "index.html", lambda text: text.replace("<td>0.930</td>", "<td>0.99</td>"))
    seal(folder)
    monkeypatch.setattr("kinectbench.core.artefacts.benchmark.__version__", "99")
    assert verify(folder) == []
    (said,) = reservations(folder)
    version = f"kinectbench {__version__}, publish version {PUBLISH_VERSION},"
    assert said == f"no text was written again: {version} wrote them"


def test_a_recording_without_a_pair_has_no_texts(analytic: Path) -> None:
    info = ReleaseInfo.read(analytic / "benchmark")
    more = info.model_copy(update={"recordings": {**info.recordings, "nobody": info.recordings["chair_01"]}})
    with open_contents(analytic / "benchmark") as contents:
        targets = parse_targets(contents.text("targets.csv"), "targets.csv")
        assert text_problems(contents, info, targets) == []
        assert text_problems(contents, more, targets) == ["benchmark.json: its recording nobody has no pair"]


def rebuilt(release: Path, build: Path, sources: dict[str, LocalRecording]) -> list[str]:
    """What a rebuild finds in a release that `verify` finds to be well."""
    assert verify(release) == []
    with open_contents(release) as contents:
        return list(differences(contents, rebuild_plan(contents, sources), build))


@pytest.fixture
def sources(tmp_path: Path) -> dict[str, LocalRecording]:
    for name in NAMES:
        (tmp_path / "recordings" / name).mkdir(parents=True)
    return find_sources(tmp_path / "recordings")


def test_figures_are_made_again(analytic: Path, tmp_path: Path, sources: dict[str, LocalRecording]) -> None:
    """Whoever publishes a build with other figures has a release that agrees with itself."""
    forged = Path(shutil.copytree(analytic / "build", tmp_path / "forged"))
    quality = json.loads((forged / "chair_01/object/quality.json").read_text())
    old = quality["repeatability_iou"]
    quality |= {"repeatability_iou": 0.999, "warnings": []}
    (forged / "chair_01/object/quality.json").write_text(json.dumps(quality))
    edited(forged / "chair_01/views/views.json", lambda text: text.replace('"frame": 0', '"frame": 7', 1))
    publish(synthetic_settings(RECORDINGS), forged, tmp_path / "benchmark", NAMES)
    found = rebuilt(tmp_path / "benchmark", analytic / "build", sources)
    said = f"repeatability_iou is 0.999, which should be {old}"
    assert f"objects/chair_01/quality.json: {said}" in found
    assert f"benchmark.json: recordings.chair_01.quality.{said}" in found
    assert any(line.startswith("views/chair_01/views.json: views.0.frame is 7, which") for line in found)
    assert any(
        line.startswith("lineage.json: recordings.chair_01.views.0.frame is 7, which") for line in found
    )
    assert not any("chair_02" in line.split(" is ")[0] for line in found)


def test_pictures_are_made_again(analytic: Path, tmp_path: Path, sources: dict[str, LocalRecording]) -> None:
    folder = Path(shutil.copytree(analytic / "benchmark", tmp_path / "benchmark"))
    assert rebuilt(folder, analytic / "build", sources) == []
    shutil.copyfile(folder / "previews/test/table_01/000.jpg", folder / "previews/test/chair_01/000.jpg")
    page = folder / "categories/chair.html"
    first, second = (part.split('"')[0] for part in page.read_text().split("base64,")[1:3])
    page.write_text(page.read_text().replace(first, second))
    seal(folder)
    picture, line = rebuilt(folder, analytic / "build", sources)
    assert picture == "previews/test/chair_01/000.jpg: differs when made again"
    assert line.startswith("categories/chair.html: line")


def test_licence_and_source_are_those_of_the_recordings(
    analytic: Path, tmp_path: Path, sources: dict[str, LocalRecording]
) -> None:
    stated = synthetic_settings(RECORDINGS)
    forged = BenchmarkSettings.model_validate(stated.model_dump() | {"license": "MIT", "source": "by me"})
    publish(forged, analytic / "build", tmp_path / "benchmark", NAMES)
    rows = "".join(f"  - {{id: {name}, path: {name}, category: {kind}}}\n" for name, kind, *_ in RECORDINGS)
    config = tmp_path / "recordings" / "benchmark.yaml"
    config.write_text(f"name: x\nlicense: CC0-1.0\nsource: made up\nrecordings:\n{rows}")
    found = rebuilt(tmp_path / "benchmark", analytic / "build", find_sources(config))
    assert found[:2] == [
        "benchmark.json: license of chair_01 is 'MIT', which benchmark.yaml states as 'CC0-1.0'",
        "benchmark.json: source of chair_01 is 'by me', which benchmark.yaml states as 'made up'",
    ]
    assert len(found) == 2 * len(NAMES)
    assert rebuilt(tmp_path / "benchmark", analytic / "build", sources) == []


def test_object_category_and_split_are_those_that_benchmark_yaml_states(
    analytic: Path, tmp_path: Path, sources: dict[str, LocalRecording]
) -> None:
    rows = "".join(
        f"  - {{id: {name}, path: {name}, category: {kind}, object: {thing}, split: {split}}}\n"
        for name, kind, thing, split, _ in RECORDINGS
    )
    config = tmp_path / "recordings" / "benchmark.yaml"
    config.write_text(f"name: x\nrecordings:\n{rows}")
    assert rebuilt(analytic / "benchmark", analytic / "build", find_sources(config)) == []
    exchanged = rows.replace("red_chair, split: test", "sofa, split: train")
    config.write_text(f"name: x\nrecordings:\n{exchanged}")
    assert rebuilt(analytic / "benchmark", analytic / "build", find_sources(config)) == [
        "benchmark.json: object of chair_01 is 'red_chair', which benchmark.yaml states as 'sofa'",
        "benchmark.json: split of chair_01 is 'test', which benchmark.yaml states as 'train'",
    ]


def test_pages_say_which_splits_are_not_published(
    analytic: Path, tmp_path: Path, sources: dict[str, LocalRecording]
) -> None:
    """Recordings that are left out are not made again, but pages speak of them."""
    asked = ("chair_01", "chair_02", "table_01")
    publish(synthetic_settings(RECORDINGS), analytic / "build", tmp_path / "benchmark", asked)
    assert rebuilt(tmp_path / "benchmark", analytic / "build", sources) == []
