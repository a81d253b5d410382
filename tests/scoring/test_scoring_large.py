"""Tables of many rows, objects and categories: time and memory grow with them, no faster."""

import json
import time
import tracemalloc
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr
from score_rows import row

from kinectbench.core.artefacts.score_columns import ROWS_IN_JSON
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.artefacts.targets import Target
from kinectbench.core.types import Float64
from kinectbench.core.untrusted_text import OBJECT_VALUES
from kinectbench.report.tables import truth_of_objects
from kinectbench.scoring import uncertainty
from kinectbench.scoring.assemble import _validation
from kinectbench.scoring.derived_values import derived_values
from kinectbench.scoring.thresholds import Thresholds
from kinectbench.scoring.uncertainty import bootstrap_interval, sign_flip_ps, student_interval

EARLIER = [0.14906275222793647, 0.4262096330836071]
Groups = list[tuple[Float64, Float64]]


def groups(*counts: int, metrics: int = 12) -> Groups:
    rng = np.random.default_rng(3)
    return [(rng.random((k, metrics)) ** 2, rng.integers(1, 50, k).astype(float)) for k in counts]


def test_pairs_that_are_all_unknown_are_counted_once() -> None:
    rows = [row("chair", n, 0, None) for n in range(60_000)] + [row("chair", 60_000, 0, 0.5)]
    started = time.process_time()
    found = derived_values(rows, ["known"], {}, {}, complete=True)
    assert time.process_time() - started < 10  # with a scan for each: over a minute
    assert len(found["all_unknown_pairs"]["known"]) == 60_000
    assert found["by_category"]["known"]["chair"].pairs == 1


def test_validation_pairs_without_a_prediction_are_counted_once() -> None:
    pairs = [Target(f"r{n}", "o", "000", "chair", "validation", f"r{n}", "0" * 64) for n in range(8_000)]
    release: Any = SimpleNamespace(split=lambda _: pairs)
    results: Any = dict.fromkeys(pairs)
    started = time.process_time()
    found = _validation(release, results, Thresholds({}, "validation"), pairs[1:])
    assert time.process_time() - started < 3  # with a scan for each: 16 s
    assert found is not None and found.predicted == 1


def test_a_table_with_the_most_rows_in_it_can_be_read() -> None:
    """With all figures of a row, and what is kept of each pair and recording beside its rows."""
    frozen = json.loads((Path(__file__).parent / "frozen_scores.json").read_text(encoding="utf-8"))["rows"][
        :3
    ]
    quality = {"verdict": "good", "warnings": ["w" * 60] * 40}
    hashes = {"truth": "0" * 64, "prediction": f"blake3:{'0' * 64}"}

    def text_of(pairs: int) -> str:
        names = [f"a_recording_{number:06d}" for number in range(pairs)]
        rows = [
            {**of, "recording": name, "iou_by_threshold": [0.1234567890123456] * 17}
            for name in names
            for of in frozen
        ]
        values = {
            "rows": rows,
            "hashes": {f"{name}/000": hashes for name in names},
            "truth_unknown_share": dict.fromkeys(names, 0.25),
            "truth_quality": dict.fromkeys(names, quality),
        }
        return ScoreTable.model_validate_json(json.dumps({"method": "a", **values})).text()

    few, many = text_of(20), text_of(220)
    pairs = ROWS_IN_JSON // 3
    assert (len(many) - len(few)) / 200 * pairs < ScoreTable.MAX_BYTES
    signs = [sum(text.count(sign) for sign in ",[" + "{" * OBJECT_VALUES) for text in (few, many)]
    assert (signs[1] - signs[0]) / 200 * pairs < ScoreTable.MAX_VALUES
    assert (len(many) - len(few)) / 200 > 6000  # no less than a real one


def test_the_truth_of_many_objects_is_looked_up_once() -> None:
    rows = tuple(row("chair", n, 0, None if n % 2 else 0.5) for n in range(6000))
    shares = {of.object: 0.25 for of in rows}
    one = ScoreTable(method="one", rows=rows, truth_unknown_share=shares)
    started = time.process_time()
    found = truth_of_objects([one, one.model_copy(update={"rows": rows[:10]}), one], "known")
    assert time.process_time() - started < 10  # with a scan for each object: over a minute
    assert len(found) == 6000 and sum(left for *_, left in found) == 3000


def test_what_is_drawn_at_once_changes_no_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    given = groups(3, 40, 7)
    whole = bootstrap_interval(given)
    assert whole is not None and whole[0].tolist() == EARLIER
    monkeypatch.setattr(uncertainty, "DRAWN_AT_ONCE", 1 << 15)
    np.testing.assert_array_equal(bootstrap_interval(given), whole)


def test_the_memory_of_an_interval_is_bounded() -> None:
    given = groups(2000)
    tracemalloc.start()
    bootstrap_interval(given)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 120 << 20  # 190 MB for each thousand resamples


@pytest.mark.parametrize("counts", [(5000,), (3000, 5, 4), (2000, 2000), (3,) * 700])
def test_the_interval_of_many_objects_is_that_of_resamples(
    counts: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    given = groups(*counts, metrics=1)
    if max(counts) == 3:  # with other weights the mean of a ratio of three is biased, which is not imitated
        given = [(values, np.ones(3)) for values, _ in given]
    found = bootstrap_interval(given)
    monkeypatch.setattr(uncertainty, "MOST_RESAMPLED", 10**9)
    drawn = bootstrap_interval(given)
    assert found is not None and drawn is not None
    # 10,000 resamples place an end to within 2.6 % of the width.
    assert np.abs(found - drawn).max() < 0.04 * (drawn[0, 1] - drawn[0, 0])


@pytest.mark.parametrize("counts", [(200_000,), (3,) * 60_000])
def test_no_number_of_objects_takes_long(counts: tuple[int, ...]) -> None:
    given = groups(*counts)
    started = time.process_time()
    found = bootstrap_interval(given)
    assert time.process_time() - started < 10  # resampled: minutes
    assert found is not None
    if len(counts) == 1:
        expected = student_interval(*given[0])
        assert expected is not None
        assert np.abs(found - expected).max() < 0.04 * np.ptp(expected, axis=1).min()


def test_no_number_of_objects_takes_long_to_compare() -> None:
    rng = np.random.default_rng(1)
    differences = rng.normal(0.003, 1, (2, 100_000))
    started = time.process_time()
    tracemalloc.start()
    found = sign_flip_ps(differences)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert time.process_time() - started < 10 and peak < 300 << 20
    # With so many the sum is normal: Hoeffding, The large-sample power of tests based on permutations, 1952.
    of_normal = 2 * ndtr(-np.abs(differences.sum(axis=1)) / np.sqrt((differences**2).sum(axis=1)))
    assert found == pytest.approx(of_normal.tolist(), abs=0.03)
