"""Scores of random predictions of every kind against plain numpy, as in benchmarks/score_reference.py."""

from pathlib import Path

import numpy as np
import pytest
from score_reference import KINDS, Case, differences, reference, searched_threshold, write_predictions

from kinectbench.release.release import Release


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
    largest, wrong = differences(release, tmp_path)
    assert wrong == []
    assert max(largest.values()) <= 1e-6
