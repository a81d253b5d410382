"""Counts and metrics against plain numpy in float64, for every dtype and protocol."""

from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from references import upsample
from slow import slow

from kinectbench.core.voxels.pair_file import pack
from kinectbench.scoring.counts import (
    THRESHOLDS,
    constant_cross_entropy,
    ious,
    metrics,
    protocol_counts,
    reduced,
    tallies,
    tally,
)
from kinectbench.scoring.protocols import USUAL
from kinectbench.scoring.truth import PackedTruth

Bools = NDArray[np.bool_]
SIDE = 256
RNG = np.random.default_rng(1)


@pytest.fixture(scope="module")
def grids() -> tuple[Bools, Bools, Bools]:
    """Random full, known and seen: every code occurs, in no order."""
    full, known, seen = (RNG.random((SIDE,) * 3, dtype=np.float32) < share for share in (0.3, 0.8, 0.5))
    return full, known, seen


def truth_of(full: Bools, known: Bools, seen: Bools, **others: Bools) -> PackedTruth:
    return PackedTruth(
        pack(full), pack(known), pack(seen), 0.004, 0.005, {n: pack(of) for n, of in others.items()}
    )


def plain_metrics(y: NDArray[np.float64], full: Bools, mask: Bools, p: float) -> dict[str, float]:
    """The definitions, as they are written down."""
    y, truth = y[mask], full[mask]
    above, count = y > p, np.count_nonzero
    hit = count(above & truth)
    clipped = np.clip(y, 1e-7, 1 - 1e-7)
    precision, recall = hit / count(above), hit / count(truth)
    return {
        "iou": hit / count(above | truth),
        "ce": -np.log(np.where(truth, clipped, 1 - clipped)).mean(),
        "precision": precision,
        "recall": recall,
        "f1": 2 * precision * recall / (precision + recall),
    }


CUBE = (SIDE,) * 3
ULPS = np.array(
    [np.nextafter(np.float32(p), np.float32(side)) for p in THRESHOLDS for side in (0, 1)]
    + [np.float32(p) for p in THRESHOLDS]
    + [0, 1, 1e-8, 0.05, 0.95, 1.4e-45],
    np.float32,
)
HALVES = np.concatenate([ULPS.astype(np.float16), -np.zeros(3, np.float16)])
PREDICTIONS: dict[str, Callable[[], NDArray[Any]]] = {
    "bool": lambda: RNG.random(CUBE, dtype=np.float32) < 0.4,
    "float16": lambda: RNG.random(CUBE, dtype=np.float32).astype(np.float16),
    "float16 at thresholds": lambda: HALVES[RNG.integers(len(HALVES), size=CUBE, dtype=np.uint8)],
    "float32 at thresholds": lambda: ULPS[RNG.integers(len(ULPS), size=CUBE, dtype=np.uint8)],
    "bool 32": lambda: RNG.random((32,) * 3) < 0.4,
    "float16 40": lambda: RNG.random((40,) * 3).astype(np.float16),
    "float32 300": lambda: RNG.random((300,) * 3, dtype=np.float32),
}


# What these two are is also said by another type of their size and another size of their type.
FURTHER = {"float16", "bool 32"}


@pytest.mark.parametrize("name", [slow(name) if name in FURTHER else name for name in PREDICTIONS])
def test_same_as_plain_numpy(name: str, grids: tuple[Bools, Bools, Bools]) -> None:
    full, known, seen = grids
    prediction = PREDICTIONS[name]()
    interior, said = (np.broadcast_to(np.arange(SIDE) % step == 0, known.shape) for step in (3, 7))
    counted, less = tallies(prediction, truth_of(*grids, interior=interior, said=said), USUAL)
    y = prediction.astype(np.float64) if len(prediction) == SIDE else upsample(prediction)
    masks = {"paper": np.ones_like(known), "known": known, "occluded": known & ~seen}
    masks |= {"measured": known & ~interior, "known-unsaid": known & ~said}
    assert set(masks) == set(USUAL) and set(less) == {"measured", "known-unsaid"}
    for protocol, mask in masks.items():
        counts = protocol_counts(less.get(protocol, counted), protocol)
        assert counts.voxels == np.count_nonzero(mask)
        assert counts.occupied == np.count_nonzero(full & mask)
        for step in {"paper": (0, 16), "occluded": (4, 9)}.get(protocol, (5,)):
            above = (y > THRESHOLDS[step]) & mask
            assert counts.predicted[step] == np.count_nonzero(above)
            assert counts.hit[step] == np.count_nonzero(above & full)
        if protocol not in ("known", "occluded"):
            continue
        expected = plain_metrics(y, full, mask, THRESHOLDS[8])
        found = asdict(metrics(counts, 8))
        assert found == pytest.approx(expected, abs=1e-6, rel=0)
        assert found["ce"] == pytest.approx(expected["ce"], abs=1e-10)


def test_float64_thresholds_are_those_of_the_definition() -> None:
    assert tuple(k / 20 for k in range(2, 19)) == THRESHOLDS
    # 0.3 as float16 is 0.30005: above in float64, equal if compared in float16
    half = np.full((SIDE,) * 3, 0.3, np.float16)
    everything = np.ones((SIDE,) * 3, bool)
    counts = protocol_counts(tally(half, truth_of(everything, everything, everything)), "paper")
    assert counts.predicted[THRESHOLDS.index(6 / 20)] == SIDE**3


def test_hand_computed() -> None:
    full, known, seen = (np.zeros((SIDE,) * 3, bool) for _ in range(3))
    known[:2, :2, :2] = True
    full[0, :2, :2] = True  # four of the eight known
    full[9, 9, 9] = True  # unknown
    seen[:2, 0, :2] = True
    y = np.zeros((SIDE,) * 3, np.float32)
    y[0, 0, 0], y[0, 1, 0], y[1, 1, 1] = 0.75, 0.25, 0.75
    counted = tally(y, truth_of(full, known, seen))
    known_only = metrics(protocol_counts(counted, "known"), THRESHOLDS.index(0.5))
    assert known_only.iou == 1 / 5  # one hit; four occupied and one wrong
    assert (known_only.precision, known_only.recall) == (1 / 2, 1 / 4)
    assert known_only.f1 == pytest.approx(1 / 3)
    log = np.log
    losses = -(log(0.75) + log(0.25) + 2 * log(1e-7) + log(0.25) + 3 * log(1 - 1e-7)) / 8
    assert known_only.ce == pytest.approx(losses, rel=1e-12)
    occluded = metrics(protocol_counts(counted, "occluded"), THRESHOLDS.index(0.2))
    assert (occluded.iou, occluded.precision, occluded.recall) == (1 / 3, 1 / 2, 1 / 2)
    everything = metrics(protocol_counts(counted, "paper"), THRESHOLDS.index(0.5))
    assert everything.iou == 1 / 6


@pytest.mark.parametrize("dtype", [np.bool_, np.float16, np.float32])
@pytest.mark.parametrize(
    ("predicted", "occupied", "iou", "precision", "recall"),
    [(0, 0, 1, 1, 1), (1, 0, 0, 0, 0), (0, 1, 0, 0, 0), (1, 1, 1, 1, 1)],
)
def test_empty_and_full(
    dtype: type[np.generic], predicted: int, occupied: int, iou: float, precision: float, recall: float
) -> None:
    full = np.full((SIDE,) * 3, occupied, bool)
    truth = truth_of(full, ~np.zeros_like(full), np.zeros_like(full))
    counts = protocol_counts(tally(np.full((SIDE,) * 3, predicted, dtype), truth), "known")
    values = metrics(counts, 8)
    assert (values.iou, values.precision, values.recall) == (iou, precision, recall)
    assert values.f1 == (1 if predicted == occupied else 0)
    assert values.ce == pytest.approx(-np.log(1 - 1e-7) if predicted == occupied else -np.log(1e-7), rel=1e-6)
    assert len(set(ious(counts))) == 1


def test_no_voxel_counted() -> None:
    nothing = np.zeros((SIDE,) * 3, bool)
    counts = protocol_counts(tally(np.ones((SIDE,) * 3, bool), truth_of(nothing, nothing, nothing)), "known")
    values = metrics(counts, 0)
    assert (counts.voxels, values.iou, values.ce) == (0, 1.0, 0.0)


def test_constant_cross_entropy() -> None:
    assert constant_cross_entropy(1, 4, 0.25) == pytest.approx(-(np.log(0.25) + 3 * np.log(0.75)) / 4)
    assert constant_cross_entropy(1, 2, 0.0) == pytest.approx(-(np.log(1e-7) + np.log(1 - 1e-7)) / 2)
    assert constant_cross_entropy(0, 0, 0.3) == 0


@pytest.mark.parametrize("side", [256, 128, 64, 16, 1])
def test_a_coarser_grid_has_the_occupied_shares_of_its_cells(
    grids: tuple[Bools, Bools, Bools], side: int
) -> None:
    full, step = grids[0], SIDE // side
    plain = full.reshape(side, step, side, step, side, step).mean(axis=(1, 3, 5), dtype=np.float64)
    found = reduced(full, side)
    assert found.dtype == np.float32 and found.shape == (side,) * 3 and found.flags.c_contiguous
    assert (found == plain).all()


def test_cells_that_do_not_fit_are_shared_out(grids: tuple[Bools, Bools, Bools]) -> None:
    """Each of 40 cells has 6.4 along an axis: the occupied volume stays."""
    found = reduced(grids[0], 40)
    assert found.mean(dtype=np.float64) == pytest.approx(grids[0].mean(), abs=1e-6)
