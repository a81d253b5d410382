"""What somebody changed in a release and sealed again: `verify` compares whatever stands twice in it."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from small_benchmark import Run
from synthetic_release import resum

from kinectbench.core.artefacts.targets import benchmark_sha256
from kinectbench.core.storage import sha256_file
from kinectbench.release.check.verify import verify
from kinectbench.release.release import Release, open_release

Command = Callable[..., Run]
QUALITY = {"repeatability_iou": 0.999}


@pytest.fixture
def copy(release: Release, tmp_path: Path) -> Path:
    """A release whose lineage.json has a setting of the pairs."""
    folder = Path(shutil.copytree(release.folder, tmp_path / "benchmark"))
    path, croissant = folder / "lineage.json", folder / "croissant.json"
    lineage, before = json.loads(path.read_text()), sha256_file(path)
    for recording in lineage["recordings"].values():
        recording["stages"]["pairs"]["settings"] = {"pairs": {"min_containment": 0.85}}
    path.write_text(json.dumps(lineage))
    croissant.write_text(croissant.read_text().replace(before, sha256_file(path)))
    sealed(folder, lambda stated: None, "lineage.json", "croissant.json")
    assert verify(folder) == []
    return folder


def sealed(folder: Path, change: Callable[[dict[str, Any]], object], *files: str) -> None:
    """Change benchmark.json, and make hashes and identity those of what is there now."""
    resum(folder, *files)
    path = folder / "benchmark.json"
    stated = json.loads(path.read_text())
    change(stated)
    stated["benchmark_sha256"] = benchmark_sha256((folder / "SHA256SUMS").read_text(), json.dumps(stated))
    path.write_text(json.dumps(stated))
    resum(folder, "benchmark.json")


FORGED: dict[str, tuple[Callable[[dict[str, Any]], object], list[str]]] = {
    "quality": (
        lambda stated: stated["recordings"]["chair_01"].update(quality=QUALITY),
        [
            "README.md: does not have the row '| chair_01 | red_chair | 2 | 0 | 0.999 | 30.1% |' of "
            "benchmark.json",
            "datasheet.md: does not have the line '- IoU of solids made of odd and of even frames: "
            "0.93 (0.93 to 0.999), of 5 recordings' of benchmark.json",
            "objects/chair_01/quality.json: another repeatability_iou than in benchmark.json",
        ],
    ),
    "refused": (
        lambda stated: stated["recordings"]["chair_01"].update(refused=7),
        [
            "README.md: does not have the row '| chair_01 | red_chair | 2 | 7 | 0.930 | 30.1% |' of "
            "benchmark.json",
            "views/chair_01/views.json: 0 frames and views refused where benchmark.json has 7",
        ],
    ),
    "settings": (
        lambda stated: stated["settings"]["pairs"].update(min_containment=0.0),
        [
            f"lineage.json: another pairs.min_containment of stage pairs of {name} than the settings in "
            "benchmark.json"
            for name in ("chair_01", "chair_02", "chair_03", "table_01", "table_02")
        ],
    ),
    "framing in the settings": (
        lambda stated: stated["settings"]["pairs"].update(framing="view"),
        ["benchmark.json: settings.pairs.framing 'view' where framing is 'object'"],
    ),
    "licence": (
        lambda stated: stated.update(license="MIT"),
        [
            f"benchmark.json: settings.recordings of {name} has another license than recordings"
            for name in ("chair_01", "chair_02", "chair_03", "table_01", "table_02")
        ],
    ),
    "distribution": (
        lambda stated: stated["distribution"].update(allowed=False),
        ["benchmark.json: distribution is not as licence and source of its recordings have it"],
    ),
}


@pytest.mark.parametrize("name", FORGED)
def test_what_stands_twice_is_compared(copy: Path, name: str) -> None:
    change, expected = FORGED[name]
    sealed(copy, change)
    assert verify(copy) == expected


def test_the_identity_covers_what_stands_once(copy: Path) -> None:
    before = open_release(copy).benchmark_sha256
    sealed(copy, lambda stated: stated["packages"].update(numpy="0.1"))
    assert verify(copy) == [] and open_release(copy).benchmark_sha256 != before


def test_a_release_of_the_first_identity_is_read_and_says_so(copy: Path, command: Command) -> None:
    sealed(copy, lambda stated: stated.pop("benchmark_sha256_version"))
    assert verify(copy) == [] and open_release(copy).targets
    said = command(copy.parent, "verify", str(copy))
    assert said.status == 0 and "all well; its benchmark_sha256 is of version 1" in said.out
    assert "version 1" not in command(copy.parent, "verify", str(copy), "--json").out
