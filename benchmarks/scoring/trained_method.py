"""Whether a trained network beats the simple methods on objects it never saw: what ships has to.

Some test pairs of each release, spread over its objects, protocol `known`: the IoU of the network and of
hull, silhouette and the nearest training shape. Each method's threshold is the one
that suits validation pairs best. An object counts once, by the mean over its pairs.

    python benchmarks/run.py trained_method runs/recae-small object/ view/ --json figures.json
"""

import argparse
import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from figures import Figure, run, stated
from numpy.typing import NDArray

from kinectbench.core.types import Float64
from kinectbench.core.voxels.pair_file import PairInput, checked_pair, pair_values, unpack
from kinectbench.networks.trained import Trained, folder_of, open_trained
from kinectbench.networks.validate import completed
from kinectbench.release.release import Release, Target, open_release
from kinectbench.scoring.baselines.inputs import MEAN_CELLS, Inputs, TrainingTruth, up_in_grid
from kinectbench.scoring.baselines.registry import BASELINES
from kinectbench.scoring.counts import ious, protocol_counts, tally
from kinectbench.scoring.truth import read_packed_truth, read_parts
from kinectbench.scoring.uncertainty import student_interval

PROTOCOL = "known"
SIMPLE = ("hull", "silhouette", "nearest")


def spread(targets: Sequence[Target], most: int) -> list[Target]:
    """Up to so many pairs of each category, evenly over its objects and views, categories together."""
    chosen = []
    for category in sorted({target.category for target in targets}):
        here = [target for target in targets if target.category == category]
        count = min(most, len(here))
        chosen += [here[int((k + 0.5) * len(here) / count)] for k in range(count)]
    return chosen


def curves(trained: Trained, release: Release, targets: Sequence[Target]) -> dict[str, NDArray[np.float64]]:
    """IoU at the seventeen thresholds by method: a row a pair."""
    rows: dict[str, list[Float64]] = {name: [] for name in (trained.config.name, *SIMPLE)}
    for target in targets:
        truth = read_packed_truth(release.pair_path(target), target.sha256)
        inputs = inputs_of(release, target)
        predictions = {
            trained.config.name: completed(
                trained.network, unpack(inputs.pair.partial), trained.config, "cpu"
            )
        }
        predictions |= {name: BASELINES[name](inputs) for name in SIMPLE}
        for name, prediction in predictions.items():
            rows[name].append(ious(protocol_counts(tally(prediction, truth), PROTOCOL)))
    return {name: np.array(found) for name, found in rows.items()}


def inputs_of(release: Release, target: Target) -> Inputs:
    """What the simple methods predict from; of the training shapes there is no mean, which takes long."""
    where = str(release.pair_path(target))
    pair = checked_pair(PairInput, pair_values(release.pair_content(target), where), where)
    return Inputs(
        pair, math.nan, up_in_grid(release, target, pair), views_to_learn_from(release, target.category)
    )


@lru_cache(maxsize=1)  # the pairs of a category follow each other
def views_to_learn_from(release: Release, category: str) -> TrainingTruth:
    """The partial views of a category's training pairs, and where their full shapes are."""
    targets = [target for target in release.split("train") if target.category == category]
    files = tuple((release.pair_path(target), target.sha256) for target in targets)
    partials = np.stack([read_parts(*file, ("partial",))[0] for file in files])
    return TrainingTruth(np.zeros((MEAN_CELLS,) * 3, np.float32), partials, files)


def by_object(values: Float64, targets: Sequence[Target]) -> Float64:
    """Means over the pairs of each object, in the order of the objects' names."""
    objects = np.array([target.object for target in targets])
    return np.array([values[objects == name].mean() for name in np.unique(objects)])


def interval(values: Float64) -> tuple[float, float]:
    """Student's 95 % interval of the mean over objects."""
    found = student_interval(values[:, None], np.ones(len(values)))
    assert found is not None
    return float(found[0, 0]), float(found[0, 1])


def measure(options: argparse.Namespace) -> Sequence[Figure]:
    """The figures of every release."""
    trained = open_trained(folder_of(options.method))
    name = trained.config.name
    figures: list[Figure] = []
    for folder in options.releases:
        release = open_release(folder)
        framing = f"{folder.name}, framing {release.metadata.framing}"
        validation = spread(release.split("validation"), max(1, options.pairs // 3))
        tests = spread(release.split("test"), options.pairs)
        # One category after the other: its training shapes are read once.
        targets = sorted([*validation, *tests], key=lambda target: target.category)
        is_test = np.array([target.split == "test" for target in targets])
        found = curves(trained, release, targets)
        best = {key: int(np.argmax(rows[~is_test].mean(axis=0))) for key, rows in found.items()}
        judged = [target for target in targets if target.split == "test"]
        means = {key: by_object(rows[is_test, best[key]], judged) for key, rows in found.items()}
        figures += [stated(f"{framing}: pairs, objects", f"{len(tests)}, {len(means[name])}")]
        for key, values in means.items():
            low, high = interval(values)
            figures += [stated(f"{framing}: IoU of {key}", f"{values.mean():.3f} ({low:.3f} to {high:.3f})")]
        for key in SIMPLE:
            more = means[name] - means[key]
            low, high = interval(more)
            text = f"{more.mean():+.3f} ({low:+.3f} to {high:+.3f})"
            figures += [Figure(f"{framing}: {name} - {key}", text, "interval above 0", low > 0)]
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("method", help="a folder of `kinectbench train`, or a name of the package's")
    parser.add_argument("releases", type=Path, nargs="+")
    parser.add_argument("--pairs", type=int, default=4, help="of each category; a third of it of validation")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    run(options, lambda: measure(options))


if __name__ == "__main__":
    main()
