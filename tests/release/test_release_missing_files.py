"""A release of recordings without one of its files, with all hashes made again."""

import json
import shutil
from pathlib import Path

import pytest
from file_damage import seal

from kinectbench._version import __version__
from kinectbench.core.artefacts.benchmark import PUBLISH_VERSION
from kinectbench.release.check.reservations import reservations
from kinectbench.release.check.verify import verify

# Whatever hides what is wrong with the truth, or where it is from.
FILES = (
    *("README.md", "datasheet.md", "READING.md", "CHANGELOG.md", "LICENSE", "CITATION.cff", "index.html"),
    *("datacite.json", "lineage.json", "privacy.json", "splits.json"),
    *("schemas/quality.schema.json", "schemas/targets.csv.json", "targets/test.csv"),
    *("objects/chair_01/quality.json", "objects/chair_01/floor.json", "views/chair_01/views.json"),
    *("previews/test/metadata.jsonl", "categories/chair.html"),
)
ABSENT = "missing, a release of recordings has it"


@pytest.fixture
def release(analytic: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(analytic / "benchmark", tmp_path / "benchmark"))


def changed(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def problems_without(release: Path, name: str) -> list[str]:
    """What is wrong with a release that lacks a file, which its croissant.json does not list either."""
    (release / name).unlink()
    content = json.loads((release / "croissant.json").read_text())
    content["distribution"] = [each for each in content["distribution"] if each.get("contentUrl") != name]
    (release / "croissant.json").write_text(json.dumps(content))
    seal(release)
    return verify(release)


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_every_release_has(release: Path, name: str) -> None:
    assert f"{name}: {ABSENT}" in problems_without(release, name)


def test_all_images_of_a_recording(release: Path) -> None:
    """Without them no partial is compared with depth."""
    images = sorted((release / "views/chair_01").glob("*.png"))
    for image in images[1:]:
        image.unlink()
    first = images[0].relative_to(release).as_posix()
    assert any(
        line.startswith(f"{first}: missing, targets.csv ") for line in problems_without(release, first)
    )


def test_earlier_versions_may_have_written_fewer(release: Path) -> None:
    version = f'"package_version": "{__version__}"'
    for name in ("benchmark.json", "lineage.json"):
        changed(release / name, version, '"package_version": "0.0.1"')
    assert not any(ABSENT in line for line in problems_without(release, "categories/chair.html"))


def test_an_earlier_publish_of_this_package_version(release: Path) -> None:
    """Between two releases of the package, what `publish` writes changes."""
    changed(release / "benchmark.json", f'"publish_version": {PUBLISH_VERSION}', '"publish_version": 1')
    changed(release / "schemas/pair.npz.json", "cells where the truth is trusted", "known cells")
    seal(release)
    assert verify(release) == []
    assert any("publish version 1," in line for line in reservations(release))


def test_a_schema_that_says_something_else(release: Path) -> None:
    changed(release / "schemas/pair.npz.json", "cells where the truth is trusted", "all cells")
    seal(release)
    (line,) = verify(release)
    assert line.startswith("schemas/pair.npz.json: line ")
