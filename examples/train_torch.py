"""A small 3-D network in PyTorch: trained on a release, scored after every epoch.

    python examples/train_torch.py benchmark/ --epochs 5      # needs: pip install torch

It predicts occupancy at 64^3 from the partial view at 64^3; the scorer upsamples it to 256^3 and says what
IoU this side could reach at most. It is made to be read and replaced, not to win.
"""

import argparse

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.data import DataLoader

import kinectbench

SIDE = 64


class Network(nn.Module):
    """An encoder and a decoder with skips: (1, 64, 64, 64) partial to (1, 64, 64, 64) logits."""

    def __init__(self, channels: int = 12) -> None:
        super().__init__()
        self.down = nn.ModuleList(
            nn.Conv3d(a, b, 4, stride=2, padding=1)
            for a, b in ((1, channels), (channels, 2 * channels), (2 * channels, 4 * channels))
        )
        self.up = nn.ModuleList(
            nn.ConvTranspose3d(a, b, 4, stride=2, padding=1)
            for a, b in ((4 * channels, 2 * channels), (4 * channels, channels), (2 * channels, channels))
        )
        self.last = nn.Conv3d(channels + 1, 1, 3, padding=1)

    def forward(self, partial: Tensor) -> Tensor:
        """Logits of the occupancy."""
        levels = [partial]
        for layer in self.down:
            levels.append(functional.relu(layer(levels[-1])))
        grown = levels.pop()
        for layer in self.up:
            grown = torch.cat([functional.relu(layer(grown)), levels.pop()])
        logits: Tensor = self.last(grown)
        return logits


def share(grid: Tensor) -> Tensor:
    """(256, 256, 256) bool to (1, 64, 64, 64): the share of each cell that is set."""
    return functional.avg_pool3d(grid.float()[None], len(grid) // SIDE)


def loss_of(logits: Tensor, full: Tensor, known: Tensor) -> Tensor:
    """Cross-entropy of the cells whose truth is known, as the primary protocol counts it."""
    weight = share(known)
    loss = functional.binary_cross_entropy_with_logits(logits, share(full), weight, reduction="sum")
    return loss / weight.sum()


def score(network: Network, dataset: kinectbench.Dataset) -> str:
    """One line: the primary protocol's figures on the test split, thresholds from validation."""
    scorer = kinectbench.Scorer(dataset, method="network", surface=False)  # quick
    network.eval()
    with torch.no_grad():
        for split in ("validation", "test"):
            for item in dataset.split(split):
                logits = network(torch.from_numpy(item["partial"]).float()[None])
                scorer.update(item["pair_id"], torch.sigmoid(logits)[0].numpy())
    overall = scorer.result().overall
    assert overall is not None
    known = overall["known"]
    return f"IoU {known['iou']:.3f}, CE {known['ce']:.3f} ({known['pairs']} pairs)"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("benchmark")
    parser.add_argument("--epochs", type=int, default=5)
    parser.add_argument("--workers", type=int, default=1, help="processes that read pairs")
    options = parser.parse_args()

    torch.manual_seed(0)
    dataset = kinectbench.load(options.benchmark)
    # A benchmark of a few recordings may have no training split: then learn on validation.
    training = dataset.split("train") if len(dataset.split("train")) else dataset.split("validation")
    if not len(training):
        parser.error(
            "no train or validation pairs in this release; make some: "
            "kinectbench synthesize chairs --category chair --train 4 --validation 1 --test 1"
        )
    context = "spawn" if options.workers else None
    loader = DataLoader(
        training,
        batch_size=None,
        shuffle=True,
        num_workers=options.workers,
        multiprocessing_context=context,
        persistent_workers=options.workers > 0,  # else each epoch starts them again
    )
    network = Network()
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    for epoch in range(options.epochs):
        network.train()
        losses = []
        for item in loader:
            loss = loss_of(network(item["partial"].float()[None]), item["full"], item["known"])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            losses.append(loss.item())
        mean = sum(losses) / len(losses)
        print(f"epoch {epoch + 1}: training CE {mean:.3f}; {score(network, dataset)}", flush=True)


if __name__ == "__main__":
    main()
