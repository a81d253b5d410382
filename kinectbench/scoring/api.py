"""For people who train: a release as a dataset, and a scorer that works from memory, batch by batch."""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.counted import PairResult
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.artefacts.targets import SPLITS, check_splits
from kinectbench.core.errors import PredictionError, SettingsError
from kinectbench.core.voxels.pair_file import Pair, PairInput, checked_pair, pair_values, unpack
from kinectbench.core.voxels.resample import HALF_PIXEL
from kinectbench.release.release import Release, Target, open_release
from kinectbench.scoring.assemble import describe, make_table
from kinectbench.scoring.counts import PROTOCOLS
from kinectbench.scoring.pair_result import Counting, Job, count, count_job
from kinectbench.scoring.prediction_file import checked
from kinectbench.scoring.predictions import check_method, missing_line
from kinectbench.scoring.references import base_rates
from kinectbench.scoring.rounds import pairs_to_score
from kinectbench.scoring.score import check_missing, check_words
from kinectbench.scoring.thresholds import Thresholds, searched_thresholds, thresholds_for
from kinectbench.scoring.truth import read_truth


class Dataset:
    """The pairs of a release, or of one split; a map-style dataset as torch's DataLoader takes it.

    `dataset[i]` is a dict: `pair_id` (`<recording>/<view>`), `partial` (64, 64, 64) bool, `full` and `known`
    (256, 256, 256) bool, and `meta`: recording, object, view, category, split, voxel_size_m, T_world_grid
    and `unknown_share`, of the cells of `full` those that are not `known`. Where the truth is held back there
    is no `full`, no `known` and no `unknown_share`.
    """

    def __init__(self, release: Release, targets: Sequence[Target]) -> None:
        self.release = release
        self.targets = tuple(targets)

    def split(self, name: str) -> "Dataset":
        """The pairs of "train", "validation" or "test".

        Raises:
            SettingsError: there is no such split.
        """
        if name not in ("train", "validation", "test"):
            raise SettingsError(f"no split '{name}': choose train, validation or test")
        return type(self)(self.release, [target for target in self.targets if target.split == name])

    def __len__(self) -> int:
        return len(self.targets)

    def __repr__(self) -> str:
        there = Counter(target.split for target in self.targets)
        told = ", ".join(f"{there[split]} {split}" for split in SPLITS if there[split])
        return f"<Dataset {self.release.metadata.name}: {len(self)} pairs{f' ({told})' if told else ''}>"

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return (self[index] for index in range(len(self)))

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Read one pair; its SHA-256 is looked at each time, which takes a hundredth of the reading.

        Raises:
            ReleaseError: its file is missing, or not the published one.
            PairError: it was no pair when it was published.
        """
        target = self.targets[index]
        content, where = self.release.pair_content(target), str(self.release.pair_path(target))
        values = pair_values(content, where)
        pair: Pair | PairInput
        if target.split in self.release.metadata.held_back:
            pair, truth, of_truth = checked_pair(PairInput, values, where), {}, {}
        else:
            pair = checked_pair(Pair, values, where)
            truth = {"full": unpack(pair.full), "known": unpack(pair.known)}
            of_truth = {"unknown_share": pair.unknown_share}
        return {
            "pair_id": target.name,
            "partial": unpack(pair.partial),
            **truth,
            "meta": {
                **{
                    name: getattr(target, name)
                    for name in ("recording", "object", "view", "category", "split")
                },
                "voxel_size_m": pair.voxel_size_m,
                "T_world_grid": pair.T_world_grid,
                **of_truth,
            },
        }


def load(path: str | Path) -> Dataset:
    """Open a release; where torch is installed the result is a `torch.utils.data.Dataset` too.

    Raises:
        ReleaseError: no release there, or it was changed.
    """
    release = open_release(Path(path))
    return _dataset(release, release.targets)


def _dataset(release: Release, targets: Sequence[Target]) -> Dataset:
    return _dataset_class()(release, targets)


def _dataset_class() -> type[Dataset]:
    try:
        from torch.utils.data import Dataset as TorchDataset
    except ImportError:
        return Dataset

    def reduce(self: Dataset) -> tuple[Any, ...]:  # the class is made here: workers make it anew
        return _dataset, (self.release, self.targets)

    return type("TorchDataset", (Dataset, TorchDataset), {"__reduce__": reduce})


class Scorer:
    """Scores predictions as they are made: `update` each pair, then ask for the `result`.

    Validation pairs come first, if any: they choose the thresholds, which are fixed by the first test pair.
    """

    def __init__(
        self,
        dataset: Dataset | str | Path,
        *,
        method: str = "method",
        protocols: Sequence[str] = tuple(PROTOCOLS),
        thresholds_file: Path | None = None,
        missing: str = "error",
        upsampling: str = HALF_PIXEL,
        surface: bool = True,
    ) -> None:
        """A scorer for the test split.

        Args:
            dataset: of the release, or its path.
            method: name in the result.
            protocols: some of "paper", "known", "occluded".
            thresholds_file: see docs/scoring.md.
            missing: what a pair without a prediction is: "error" a failure, "empty" an empty grid.
            upsampling: "half-pixel" or "corner-aligned".
            surface: whether surface metrics are computed. They take most of the time: leave them out (null)
                where a network is scored after every epoch.

        Raises:
            ReleaseError: no release there, or its truth is held back.
            SettingsError: an unknown protocol, an object in two splits, or an unusable threshold file.
            PredictionError: the method has no name for one.
        """
        release = dataset.release if isinstance(dataset, Dataset) else open_release(Path(dataset))
        check_words(protocols, upsampling)
        check_method(method)
        self._missing = check_missing(missing)
        check_splits(release.targets, str(release.folder))
        self._release, self._method = release, method
        self._targets = {target.name: target for target in release.targets if target.split != "train"}
        self._counting = Counting(tuple(protocols), upsampling, surface)
        self._results: dict[Target, PairResult] = {}
        self._empty: dict[Target, PairResult] = {}
        self._thresholds: Thresholds | None = None
        self._searched = thresholds_file is None
        test = pairs_to_score(release, thresholds_file)
        if thresholds_file is not None:
            self._thresholds = thresholds_for(thresholds_file, test)

    def update(self, pair_id: str, prediction: NDArray[Any]) -> None:
        """Count one prediction; a second one of the same pair replaces the first.

        Args:
            pair_id: `<recording>/<view>` of the test or validation split.
            prediction: (n, n, n) bool, float16 or float32 in [0, 1], 1 <= n <= 512.

        Raises:
            PredictionError: it is unacceptable, the pair is unknown, or a validation pair comes too late.
            ReleaseError: the truth is missing or changed.
        """
        target = self._targets.get(pair_id)
        if target is None:
            raise PredictionError(f"{pair_id}: no pair of the test or validation split has this name")
        if target.split == "validation" and self._thresholds is not None:
            raise PredictionError(f"{pair_id}: thresholds are fixed already; update validation pairs first")
        threshold = None
        if target.split == "test":
            threshold = self._fixed().of[target.category]
        values = checked(np.asarray(prediction), pair_id)
        truth = read_truth(self._release.pair_path(target), target.sha256)
        self._results[target] = count(values, truth, self._counting, threshold)

    def result(self) -> ScoreTable:
        """The table of what was counted, that of `kinectbench score` of the same predictions.

        Without averages while test pairs are missing, or validation pairs where others of them were counted.
        """
        thresholds = self._fixed()
        empty = self._empty | self._as_empty("test", thresholds)
        missing = [*self._left("validation"), *self._left("test")]
        return make_table(
            self._release,
            self._method,
            self._results | empty,
            thresholds,
            base_rates(self._release),
            {target: missing_line(target) for target in missing if target not in empty},
            describe(self._counting, self._missing),
            empty,
        )

    def _left(self, split: str) -> list[Target]:
        """The pairs of a split that were not updated; of a validation split that is not used none."""
        if split == "validation" and not (
            self._searched and any(target.split == split for target in self._results)
        ):
            return []
        return [t for t in self._targets.values() if t.split == split and t not in self._results]

    def _as_empty(self, split: str, thresholds: Thresholds | None) -> dict[Target, PairResult]:
        """The empty grids of what is left of a split, if that is what a missing pair is."""
        found = {}
        for target in self._left(split) if self._missing == "empty" else ():
            threshold = None if thresholds is None else thresholds.of[target.category]
            path = self._release.pair_path(target)
            result = count_job(Job(target, path, None, threshold, self._counting))
            assert isinstance(result, PairResult)  # there is no file that could be wrong
            found[target] = result
        return found

    def _fixed(self) -> Thresholds:
        """The thresholds, found on the validation pairs so far where that was not done yet."""
        if self._thresholds is None:
            self._empty = self._as_empty("validation", None)
            tallies = {target: result.tally for target, result in (self._results | self._empty).items()}
            self._thresholds = searched_thresholds(self._release.targets, tallies)
        return self._thresholds
