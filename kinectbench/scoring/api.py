"""Python interface for training: a release as a dataset, and a scorer that counts predictions in memory."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import PredictionError, SettingsError
from kinectbench.core.artefacts.counted import PairResult
from kinectbench.core.artefacts.provenance import nearest_step
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.artefacts.targets import check_names
from kinectbench.core.voxels.resample import HALF_PIXEL
from kinectbench.release.release import Target, open_release
from kinectbench.scoring.assemble import describe, make_table
from kinectbench.scoring.base_rates import base_rates
from kinectbench.scoring.baselines.recognized import made_table
from kinectbench.scoring.dataset import Dataset as Dataset
from kinectbench.scoring.dataset import decode_sample as decode_sample
from kinectbench.scoring.dataset import load as load
from kinectbench.scoring.pair_result import PairJob, count, count_job, counting_of
from kinectbench.scoring.prediction_file import checked
from kinectbench.scoring.predictions import check_method, missing_line
from kinectbench.scoring.request import check_missing, check_words
from kinectbench.scoring.rounds import pairs_to_score
from kinectbench.scoring.thresholds import STEPS_IN_WORDS, Thresholds, searched_thresholds, thresholds_for
from kinectbench.scoring.truth import read_packed_truth


class Scorer:
    """Scores predictions as they are made: call `update` for each pair, then `result`.

    If there are validation pairs, call `update` for them first: the thresholds are chosen on them. The first
    test pair fixes the thresholds.
    """

    def __init__(
        self,
        dataset: Dataset | str | Path,
        *,
        method: str = "method",
        protocols: Sequence[str] | None = None,
        thresholds_file: Path | None = None,
        missing: str = "error",
        upsampling: str = HALF_PIXEL,
        surface: bool = True,
        own_threshold: float | None = None,
    ) -> None:
        """Make a scorer for the test split.

        Args:
            dataset: the dataset of the release, or the release's path.
            method: the method's name, for the result.
            protocols: a subset of "paper", "known", "occluded", "measured", "known-unsaid", "shell"; default:
                all that the pairs allow, except "shell".
            thresholds_file: a file with the thresholds (see docs/scoring.md); then none are chosen on
                validation pairs.
            missing: "error" counts a pair without a prediction as a failure, "empty" as an empty grid.
            upsampling: "half-pixel" or "corner-aligned".
            surface: whether surface metrics are computed. They take most of the time, so use False if a
                network is scored after every epoch.
            own_threshold: the method's own threshold for categories without validation pairs, one of 0.1,
                0.15, ... 0.9, like `threshold` in method.json.

        Raises:
            ReleaseError: the path holds no release, the release has no test pair, an object is in two splits,
                or the truth is held back.
            SettingsError: an option has an unknown value, the pairs do not allow a protocol, or the threshold
                file is unusable.
            PredictionError: `method` cannot be a method's name.
        """
        release = dataset.release if isinstance(dataset, Dataset) else open_release(Path(dataset))
        check_words(protocols, upsampling)
        check_method(method)
        self._missing = check_missing(missing)
        check_names(release.targets, str(release.folder))
        self._release, self._method = release, method
        self._targets = {target.name: target for target in release.targets if target.split != "train"}
        self._results: dict[Target, PairResult] = {}
        self._empty: dict[Target, PairResult] = {}
        self._thresholds: Thresholds | None = None
        self._searched = thresholds_file is None
        self._own = None if own_threshold is None else nearest_step(own_threshold)
        if own_threshold is not None and self._own is None:
            raise SettingsError(f"own_threshold is {own_threshold!r}: it must be one of {STEPS_IN_WORDS}")
        test = pairs_to_score(release, validation=thresholds_file is None)
        self._counting = counting_of(release, protocols, upsampling, surface)
        if thresholds_file is not None:
            self._thresholds = thresholds_for(thresholds_file, test)

    def update(self, pair_id: str, prediction: NDArray[np.generic]) -> None:
        """Score one prediction; a second prediction for the same pair replaces the first.

        Args:
            pair_id: `<recording>/<view>` of the test or validation split.
            prediction: (n, n, n) bool, float16 or float32 in [0, 1], 1 <= n <= 512.

        Raises:
            PredictionError: the prediction is invalid, the pair is unknown, or it is a validation pair and
                the thresholds are already fixed (by the first test pair, by `result` or by a threshold file).
            ReleaseError: the truth is missing or changed.
        """
        target = self._targets.get(pair_id)
        if target is None:
            raise PredictionError(
                f"{pair_id}: no pair of the test or validation split has this name", what="unknown-pair"
            )
        if target.split == "validation" and self._thresholds is not None:
            raise PredictionError(
                f"{pair_id}: thresholds are fixed already; update validation pairs first", what="order"
            )
        values = checked(np.asarray(prediction), pair_id)
        truth = read_packed_truth(
            self._release.pair_path(target), target.sha256, self._counting.further_grids
        )
        threshold = self._fixed().of[target.category] if target.split == "test" else None
        self._results[target] = count(values, truth, self._counting, threshold)

    def result(self) -> ScoreTable:
        """Return the table of scores; `kinectbench score` gives the same table for the same predictions.

        With `missing="error"`, the table has no averages if a test pair is missing, or if only some of the
        validation pairs were counted.
        """
        thresholds = self._fixed()
        empty = self._empty | self._as_empty("test", thresholds)
        missing = [*self._left("validation"), *self._left("test")]
        make = partial(
            make_table,
            self._release,
            self._method,
            self._results | empty,
            thresholds,
            base_rates(self._release),
            {target: missing_line(target) for target in missing if target not in empty},
            empty=empty,
        )
        return made_table(self._release, make, describe(self._counting, self._missing), self._counting)

    def _left(self, split: str) -> list[Target]:
        """Return the pairs of a split that have no prediction yet.

        For the validation split, the list is empty if the thresholds are from a file, or if no validation
        pair was predicted at all.
        """
        if split == "validation" and not (
            self._searched and any(target.split == split for target in self._results)
        ):
            return []
        return [t for t in self._targets.values() if t.split == split and t not in self._results]

    def _as_empty(self, split: str, thresholds: Thresholds | None) -> dict[Target, PairResult]:
        """If `missing` is "empty", score an empty grid for each missing pair of a split; else return {}."""
        grids = {}
        for target in self._left(split) if self._missing == "empty" else ():
            threshold = None if thresholds is None else thresholds.of[target.category]
            path = self._release.pair_path(target)
            result = count_job(PairJob(target, path, None, threshold, self._counting))
            assert isinstance(result, PairResult)  # an empty grid has no faults
            grids[target] = result
        return grids

    def _fixed(self) -> Thresholds:
        """Return the thresholds; if not yet fixed, choose them on the validation pairs counted so far."""
        if self._thresholds is None:
            self._empty = self._as_empty("validation", None)
            tallies = {target: result.tally for target, result in (self._results | self._empty).items()}
            self._thresholds = searched_thresholds(self._release.targets, tallies, self._own)
        return self._thresholds
