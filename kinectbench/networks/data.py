"""Batches of pairs of releases. The seed determines their order, so that any step can be repeated."""

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from kinectbench.core import ReleaseError, printable
from kinectbench.core.threads import ahead, using_threads
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.networks.config import MethodSettings
from kinectbench.networks.network import TruthBatch
from kinectbench.release.release import Release, Target
from kinectbench.scoring.truth import read_parts
from kinectbench.settings.words import suggestion

_Value = TypeVar("_Value", bound=np.generic)
# Number of threads that read the next batches while the network learns from the current one.
READING_THREADS = 2


@dataclass(frozen=True)
class Batch:
    """A batch of pairs.

    Attributes:
        partial: (b, 1, 64, 64, 64) float32, the partial views.
        truth: the truth of the same pairs.
    """

    partial: Tensor
    truth: TruthBatch


class PairFile(NamedTuple):
    """The file of a pair in a release, and its expected hash."""

    path: Path
    sha256: str


def training_targets(
    releases: Sequence[Release], leave_out: Collection[str] = (), category: str | None = None
) -> tuple[tuple[Release, Target], ...]:
    """Return (release, training pair) for all training pairs, release after release.

    Args:
        releases: different releases.
        leave_out: names of objects that are not trained on.
        category: the only category that is trained on; None for all.

    Raises:
        ReleaseError: there is no release; a release has no training pairs (of the category), or their truth
            is held back; a release is given twice; or an object is trained on in one release, and is for
            validation or testing in another.
    """
    pairs: list[tuple[Release, Target]] = []
    if not releases:
        raise ReleaseError("--data: no release to train on; name one", what="no-pairs")
    for release in releases:
        release.require_truth(("train",))
        targets = [target for target in release.split("train") if target.object not in leave_out]
        if targets and category is not None:
            present = sorted({target.category for target in targets})
            targets = [target for target in targets if target.category == category]
            if not targets:
                raise ReleaseError(
                    f"{release.folder}: no training pairs of category '{printable(category)}'; "
                    f"{suggestion(category, present)}",
                    what="no-pairs",
                )
        if not targets:
            raise ReleaseError(
                f"{release.folder}: no training pairs; `kinectbench synthesize chairs --category chair "
                "--train 40 --validation 4 --test 8` makes some",
                what="no-pairs",
            )
        pairs += ((release, target) for target in targets)
    _check_apart(releases, {target.object for _, target in pairs})
    return tuple(pairs)


def unknown_objects(releases: Sequence[Release], names: Iterable[str]) -> list[str]:
    """Return those names, such as misspelt ones, that are not objects of any release."""
    objects = {target.object for release in releases for target in release.targets}
    return [name for name in names if name not in objects]


def _check_apart(releases: Sequence[Release], learnt: Collection[str]) -> None:
    """Refuse a release that is given twice, and trained objects that a release uses to validate or test."""
    if len({release.benchmark_sha256 for release in releases}) < len(releases):
        raise ReleaseError("--data: the same release is given twice; leave one out", what="overlap")
    for release in releases:
        held = {target.object for target in release.targets if target.split != "train"}
        if shared := sorted(held.intersection(learnt)):
            raise ReleaseError(
                f"{release.folder}: {shared[0]} is held out here, and a training object in another release "
                "of --data; name it in training.leave_out, or make both releases with the same numbers of "
                "models",
                what="overlap",
            )


def validation_pairs(
    releases: Sequence[Release], most: int, category: str | None = None
) -> tuple[PairFile, ...]:
    """Return up to `most` evenly spread validation pairs with public truth, of one category or of all."""
    pairs = [
        PairFile(release.pair_path(target), target.sha256)
        for release in releases
        for target in release.open_split("validation")
        if category in (None, target.category)
    ]
    count = min(most, len(pairs))
    return tuple(pairs[int((k + 0.5) * len(pairs) / count)] for k in range(count))


def pairs_of_step(step: int, pairs: int, batch: int, seed: int) -> list[int]:
    """Return the indices, from 0 to `pairs` - 1, of the `batch` pairs of a step.

    The order of pairs is shuffled for every epoch. A step may span two or more epochs.
    """
    shuffled: dict[int, NDArray[np.int64]] = {}
    chosen = []
    for place in range(step * batch, (step + 1) * batch):
        epoch, index = divmod(place, pairs)
        if epoch not in shuffled:
            shuffled[epoch] = np.random.default_rng([seed, epoch]).permutation(pairs)
        chosen.append(int(shuffled[epoch][index]))
    return chosen


def steps_in_all(pairs: int, config: MethodSettings) -> int:
    """Return the number of steps of a whole training."""
    return math.ceil(pairs * config.training.epochs / config.training.batch)


def batches(
    pairs: Sequence[PairFile],
    config: MethodSettings,
    steps: range,
    device: str,
    part: tuple[int, int] = (0, 1),
) -> Iterator[Batch]:
    """Yield this process's part of the batch of each step; the next batch is read ahead.

    `config` determines the size of a batch, seed, axes, and whether unknown voxels are masked. `part` is this
    process's rank, and the number of processes that share each batch.

    Raises:
        ReleaseError: a pair is missing or changed.
    """
    training, (rank, size) = config.training, part

    def made(step: int) -> tuple[NDArray[np.bool_], ...]:
        chosen = pairs_of_step(step, len(pairs), training.batch, training.seed)[rank::size]
        read = [_grids(pairs[index], config) for index in chosen]
        return tuple(np.stack(grids) for grids in zip(*read, strict=True))

    with using_threads(READING_THREADS):
        for partial, *truth in ahead(made, steps):
            full, *known = (bits_tensor(grid, device) for grid in truth)
            yield Batch(as_tensor(partial, device), TruthBatch(full, known[0] if known else None))


def _grids(pair: PairFile, config: MethodSettings) -> list[NDArray[np.bool_]]:
    """Return a pair's partial view, its full shape and, if unknown voxels are masked, its known cells."""
    names = ("partial", "full", "known") if config.loss.unknown == "mask" else ("partial", "full")
    parts = read_parts(pair.path, pair.sha256, names)
    return [turned_axes(unpack(part), config) for part in parts]


def turned_axes(grid: NDArray[_Value], config: MethodSettings) -> NDArray[_Value]:
    """Return a grid (n, n, n), with x and y reversed if the network has the authors' axes.

    Applied twice, it returns the original grid.
    """
    return grid[::-1, ::-1] if config.network.axes == "recgan" else grid


def bits_tensor(grids: NDArray[np.bool_], device: str) -> Tensor:
    """Return grids (b, n, n, n) as a bool tensor (b, 1, n, n, n)."""
    return torch.from_numpy(np.ascontiguousarray(grids)).to(device)[:, None]


def as_tensor(grids: NDArray[np.bool_], device: str) -> Tensor:
    """Return grids (b, n, n, n) as a float32 tensor (b, 1, n, n, n)."""
    return bits_tensor(grids, device).float()
