"""Which models are used, and in which split: seeded, by model, the same whatever the number of processes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from kinectbench.synthesize.models import LeftOut, Model
from kinectbench.synthesize.settings import SynthesisSettings


@dataclass(frozen=True)
class Dealt:
    """The models of one category.

    Attributes:
        split_of: model -> "train", "validation" or "test".
        left_out: models that were tried and are bad.
        unused: good ones or untried ones that nobody asked for.
    """

    split_of: dict[Model, str]
    left_out: tuple[LeftOut, ...]
    unused: int


# Who gets a model while there are fewer than splits.
PRIORITY = ("test", "train", "validation")

Check = Callable[[Sequence[Model]], Sequence[str | None]]


def deal(models: Sequence[Model], settings: SynthesisSettings, check: Check) -> dict[str, Dealt]:
    """Draw models and deal them to the splits, each category for itself.

    The models are shuffled by the seed and tried in that order until enough are good. With fewer good ones
    than asked for, every split shrinks in proportion. Own rule; the paper says "randomly selected".

    Args:
        models: sorted.
        settings: `seed` and the counts, which are per category.
        check: models -> why each cannot be used, or None.

    Returns:
        Category -> its models, sorted by category.
    """
    wanted = sum(settings.wanted.values())
    waiting = {name: _shuffled(models, name, settings.seed) for name in sorted({m.category for m in models})}
    good: dict[str, list[Model]] = {category: [] for category in waiting}
    bad: dict[str, list[LeftOut]] = {category: [] for category in waiting}
    while batch := [m for name, order in waiting.items() for m in order[: wanted - len(good[name])]]:
        for model, reason in zip(batch, check(batch), strict=True):
            waiting[model.category].remove(model)
            if reason is None:
                good[model.category].append(model)
            else:
                bad[model.category].append(LeftOut(model.label, reason))
    return {
        name: Dealt(_split(good[name], settings), tuple(sorted(bad[name])), len(waiting[name]))
        for name in waiting
    }


def _shuffled(models: Sequence[Model], category: str, seed: int) -> list[Model]:
    """The models of one category in the order in which they are tried."""
    here = [model for model in models if model.category == category]
    return [here[n] for n in np.random.default_rng([seed, *category.encode()]).permutation(len(here))]


def _split(good: Sequence[Model], settings: SynthesisSettings) -> dict[Model, str]:
    counts = shares(settings.wanted, len(good))
    splits = [split for split, count in counts.items() for _ in range(count)]
    return dict(zip(good, splits, strict=True))


def shares(wanted: dict[str, int], available: int) -> dict[str, int]:
    """Split -> number of models: what is wanted, or in proportion if there are too few, but one at least.

    With fewer models than splits, test comes before train before validation.
    """
    total = sum(wanted.values())
    if available >= total:
        return dict(wanted)
    asked = [split for split in PRIORITY if wanted[split]]
    if available < len(asked):
        return {split: int(split in asked[:available]) for split in wanted}
    exact = {split: available * count / total for split, count in wanted.items()}
    counts = {split: max(int(exact[split]), min(1, wanted[split])) for split in wanted}
    while sum(counts.values()) < available:
        counts[max(asked, key=lambda split: exact[split] - counts[split])] += 1
    while sum(counts.values()) > available:
        counts[max((s for s in asked if counts[s] > 1), key=lambda split: counts[split] - exact[split])] -= 1
    return counts
