"""What triage and a release say of a recording's truth beside a mesh of somebody else."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from raising import raises
from synthetic_release import RECORDINGS, synthetic_settings, write_build

from kinectbench.core.artefacts.benchmark import ReleaseInfo
from kinectbench.core.artefacts.manifest import Manifest
from kinectbench.core.artefacts.reference import ReferenceFile
from kinectbench.core.artefacts.targets import parse_targets, targets_text
from kinectbench.core.errors import ReleaseError, StorageError
from kinectbench.release.check.verify import verify
from kinectbench.release.publish.gate import gate
from kinectbench.release.publish.publish import publish
from kinectbench.release.publish.publish_if_stale import already_published, publish_if_stale
from kinectbench.release.release import open_release, recording_problems

NAMES = [row[0] for row in RECORDINGS]
NAME = NAMES[0]
FITS = {"refused": None, "closed": True, "f_score_5mm": 0.91, "f_score_10mm": 0.97, "iou": 0.88}


def compared(folder: Path, fingerprint: str = "", **figures: Any) -> Path:
    """A build whose first recording was compared with scan.ply."""
    write_build(folder)
    if not (folder / NAME / "object/manifest.json").is_file():
        Manifest(
            format_version=1, package_version="0", stage="segment", fingerprint="f", settings={}, inputs={},
            files={},
        ).write(folder / NAME / "object")  # fmt: skip
    made = fingerprint or Manifest.read(folder / NAME / "object").fingerprint
    words = {"reference": "scan.ply", "sha256": "ab", "object_fingerprint": made}
    ReferenceFile(**FITS | words | figures).write(folder / NAME)
    return folder


def look(build: Path) -> str:
    passed = gate(synthetic_settings(), build, NAMES, allow_poor=False)
    return "; ".join(passed.look.get(NAME, ()))


@pytest.mark.parametrize(
    ("figures", "said"),
    [
        ({}, ""),
        ({"f_score_10mm": 0.85}, "its reference scan.ply disagrees: F at 10 mm is 0.85, below 0.9"),
        ({"refused": "its mirror image fits better"}, "its reference scan.ply does not fit: its mirror"),
        ({"refused": "of an object built before", "fingerprint": "older"}, ""),
    ],
)
def test_a_reference_that_disagrees_is_looked_at(figures: dict[str, Any], said: str, tmp_path: Path) -> None:
    found = look(compared(tmp_path, **figures))
    assert said in found and ("reference" in found) == bool(said)


def test_other_figures_of_the_same_mesh_are_published_again(tmp_path: Path) -> None:
    build, settings = compared(tmp_path / "build"), synthetic_settings()
    publish_if_stale(settings, tmp_path, NAMES)
    assert already_published(settings, tmp_path, NAMES, None) is not None
    ReferenceFile.read(build / NAME).model_copy(update={"f_score_5mm": 0.95}).write(build / NAME)
    assert already_published(settings, tmp_path, NAMES, None) is None
    publish_if_stale(settings, tmp_path, NAMES)
    stated = ReleaseInfo.read(tmp_path / "benchmark").recordings[NAME].reference
    assert stated is not None and stated.f_score_5mm == 0.95


def test_the_card_has_the_figures(tmp_path: Path) -> None:
    summary = publish(synthetic_settings(), compared(tmp_path / "build"), tmp_path / "out", NAMES)
    assert verify(summary.folder) == []
    info = ReleaseInfo.read(summary.folder).recordings
    reference = info[NAME].reference
    assert reference is not None and reference.iou == 0.88
    assert info[NAMES[1]].reference is None
    card = (summary.folder / "README.md").read_text()
    assert "F at 5 mm to its reference" in card and "| 0.910 | 0.970 | 0.880 |" in card


def test_a_truth_beside_itself_has_no_figures_in_the_card(tmp_path: Path) -> None:
    build = compared(tmp_path / "build", itself=True, f_score_10mm=1.0)
    folder = publish(synthetic_settings(), build, tmp_path / "out", NAMES).folder
    stated = ReleaseInfo.read(folder).recordings[NAME].reference
    assert (
        stated is not None and stated.itself and "to its reference" not in (folder / "README.md").read_text()
    )


def test_targets_say_which_truth_is_a_mesh(tmp_path: Path) -> None:
    write_build(tmp_path / "build")
    made = publish(synthetic_settings(), tmp_path / "build", tmp_path / "out", NAMES)
    release = open_release(made.folder)
    first, *others = release.targets
    assert "truth" not in (release.folder / "targets.csv").read_text().splitlines()[0]
    labelled = (replace(first, truth="reference mesh"), *others)
    text = targets_text(labelled)
    assert text.splitlines()[0].endswith(",unknown_share,truth") and parse_targets(text, "here") == labelled
    with raises(ReleaseError, "release.damaged", "truth 'guess'"):
        parse_targets(text.replace("reference mesh", "guess"), "here")
    # benchmark.json does not say so.
    (line,) = recording_problems(labelled, release.metadata)
    assert "truth 'reference mesh' where benchmark.json has ''" in line


def test_a_damaged_file_is_one_line(tmp_path: Path) -> None:
    build = compared(tmp_path)
    (build / NAME / ReferenceFile.FILE).write_text("{")
    with raises(StorageError, "storage.damaged", "compare-truth"):
        look(build)
