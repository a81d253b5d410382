"""Scores of random predictions of every kind against plain numpy, as in the benchmark score_reference."""

from math import inf
from pathlib import Path

import numpy as np
import pytest
import score_reference
from score_reference import (
    KINDS,
    NOTHING_KNOWN,
    ONLY_SEEN_KNOWN,
    RECORDINGS,
    Case,
    compared,
    difference,
    publish_shapes,
    reference,
    searched_threshold,
    write_predictions,
)

from kinectbench.release.release import Release, open_release


def case(y: list[float], full: list[int], known: list[int]) -> Case:
    return Case(np.array(y), np.array(full, bool), np.array(known, bool), np.zeros(len(full), bool))


def test_the_reference_by_hand() -> None:
    values = case([0.9, 0.6, 0.2, 0.8], [1, 0, 1, 1], [1, 1, 1, 0])
    assert reference(values, 0.5, "paper") == pytest.approx(
        {
            "iou": 2 / 4,
            "ce": -(np.log(0.9) + np.log(0.4) + np.log(0.2) + np.log(0.8)) / 4,
            "precision": 2 / 3,
            "recall": 2 / 3,
            "f1": 2 / 3,
        }
    )
    assert reference(values, 0.5, "known") == pytest.approx(
        {
            "iou": 1 / 3,
            "ce": -(np.log(0.9) + np.log(0.4) + np.log(0.2)) / 3,
            "precision": 1 / 2,
            "recall": 1 / 2,
            "f1": 1 / 2,
        }
    )
    assert searched_threshold([case([0.7, 0.31, 0.3], [1, 1, 0], [1, 1, 1])]) == 0.3


def test_every_kind_of_prediction(release: Release, tmp_path: Path) -> None:
    assert len(release.targets) >= len(KINDS)  # so that one turn has every kind
    write_predictions(release, tmp_path, turn=0)
    found = compared(release, tmp_path)
    assert found.wrong == [] and found.left_out == []
    assert max(found.largest.values()) <= 1e-6


def test_pairs_that_are_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of one nothing is known, of another only what its view saw: figures are null in both computations."""
    wanted = NOTHING_KNOWN[0], ONLY_SEEN_KNOWN[1]
    held = {name.split("/")[0] for name in wanted}
    few = [(*row[:4], 1) for row in RECORDINGS if row[0] in held or row[3] == "validation"]
    monkeypatch.setattr(score_reference, "RECORDINGS", tuple(few))
    monkeypatch.setattr(score_reference, "NOTHING_KNOWN", wanted[:1])
    monkeypatch.setattr(score_reference, "ONLY_SEEN_KNOWN", wanted[1:])
    monkeypatch.setattr(score_reference, "KINDS", {"bool": KINDS["bool"]})  # the kind decides nothing here
    release = open_release(publish_shapes(tmp_path))
    assert [t.name for t in release.split("test")] == [*wanted]
    write_predictions(release, tmp_path / "predictions", turn=0)
    found = compared(release, tmp_path / "predictions")
    assert found.wrong == [] and max(found.largest.values()) <= 1e-6
    expected = [*(f"{NOTHING_KNOWN[0]} {p}" for p in ("known", "occluded")), f"{ONLY_SEEN_KNOWN[1]} occluded"]
    assert found.left_out == expected
    assert [difference(*both) for both in ((None, 0.5), (0.5, None), (None, None), (0.5, 0.25))] == [
        inf,
        inf,
        0,
        0.25,
    ]
