"""A small training loop: logistic regression on a pair's partial view, scored after every epoch.

    python examples/train.py benchmark/ --epochs 3

Each coarse cell is predicted from a few features of its column of sight and its place. It learns little, and
needs only numpy; put your network in the place of `Model`. Where torch is installed, `kinectbench.load`
gives a torch Dataset, which `torch.utils.data.DataLoader(dataset, batch_size=None)` reads in parallel.
"""

import argparse

import numpy as np
from numpy.typing import NDArray

import kinectbench
from kinectbench.core.types import Float32

CELLS = 32


def features(partial: NDArray[np.bool_]) -> Float32:
    """(CELLS^3, 6): behind the partial, near it, and where in the box."""
    coarse = partial.reshape(CELLS, 2, CELLS, 2, CELLS, 2).any(axis=(1, 3, 5))
    behind = np.maximum.accumulate(coarse, axis=2)
    near = np.zeros_like(coarse)
    for axis in range(3):
        near |= np.roll(coarse, 1, axis) | np.roll(coarse, -1, axis)
    place = np.abs(np.indices(coarse.shape) / (CELLS - 1) - 0.5)
    return np.stack([np.ones(coarse.shape), behind, near, *place], axis=-1).reshape(-1, 6).astype(np.float32)


class Model:
    """Logistic regression."""

    def __init__(self) -> None:
        self.weights = np.zeros(6, np.float32)

    def predict(self, partial: NDArray[np.bool_]) -> Float32:
        """(CELLS, CELLS, CELLS) in [0, 1]."""
        logits = features(partial) @ self.weights
        return (1 / (1 + np.exp(-logits))).reshape(CELLS, CELLS, CELLS)

    def step(self, partial: NDArray[np.bool_], target: Float32, weight: Float32, rate: float) -> None:
        """One step of gradient descent on the cross-entropy of the known cells."""
        error = (self.predict(partial) - target) * weight
        self.weights -= rate * features(partial).T @ error.ravel() / weight.sum()


def coarse(grid: NDArray[np.bool_]) -> Float32:
    """The share of each block that is set."""
    block = len(grid) // CELLS
    return grid.reshape(CELLS, block, CELLS, block, CELLS, block).mean(axis=(1, 3, 5), dtype=np.float32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("benchmark")
    parser.add_argument("--epochs", type=int, default=3)
    options = parser.parse_args()

    dataset = kinectbench.load(options.benchmark)
    # A benchmark of a few recordings may have no training split: then learn on validation.
    training = dataset.split("train") if len(dataset.split("train")) else dataset.split("validation")
    if not len(training):
        parser.error(
            "no train or validation pairs in this release; make some: "
            "kinectbench synthesize chairs --category chair --train 4 --validation 1 --test 1"
        )
    model = Model()
    for epoch in range(options.epochs):
        for item in training:
            model.step(item["partial"], coarse(item["full"]), coarse(item["known"]) + 1e-6, rate=1.0)
        scorer = kinectbench.Scorer(dataset, method="logistic", surface=False)  # quick
        for split in ("validation", "test"):  # validation chooses the thresholds
            for item in dataset.split(split):
                scorer.update(item["pair_id"], model.predict(item["partial"]))
        overall = scorer.result().overall
        assert overall is not None
        known = overall["known"]
        print(f"epoch {epoch + 1}: IoU {known['iou']:.3f}, CE {known['ce']:.3f} ({known['pairs']} pairs)")


if __name__ == "__main__":
    main()
