"""`han-like`, after Han et al.: a global network at 32^3, and a local one that refines patches to 256^3.

Source: Han et al., High-Resolution Shape Completion Using Deep Neural Networks for Global Structure and Local
Geometry Inference, ICCV 2017. Its description covers an LSTM over projected depth images beside a 3-D fully
convolutional network, then patches of 32^3 cells with the global structure as guidance, and end-to-end
training. The paper's layer sizes are not known to us. Ours give 7.5 M parameters, the number in 3D-RecGAN++'s
table. The loss, the choice of patches and the six directions of projection are our choices too.
"""

from collections.abc import Iterator

import torch
from torch import Generator, Tensor, nn
from torch.nn import functional

from kinectbench.networks.layers import KERNEL, Doubling, narrowed, xavier
from kinectbench.networks.network import Network, TruthBatch, reduced_partial

# All of these values are ours.
GLOBAL_CELLS, PATCH_CELLS, OUTPUT_CELLS = 32, 32, 256
PATCHES = OUTPUT_CELLS // PATCH_CELLS
GLOBAL_CHANNELS, LOCAL_CHANNELS = (48, 96, 192), (36, 72, 144)
IMAGE_CHANNELS, IMAGE_VECTOR, CONTEXT_VECTOR, CONTEXT_CHANNELS = (16, 32, 64), 176, 256, 32
BOTTOM_CELLS = 4
TAUGHT_PATCHES = 8
# A patch stays coarse if all its coarse probabilities are below this, or all above one minus this.
DECIDED = 0.02


class Downward(nn.ModuleList):
    """A sequence of convolutions 4^3 of stride 2; the forward pass returns the outputs of all of them."""

    def __init__(self, inputs: int, channels: tuple[int, ...]) -> None:
        """Make the layers, given the input's channels and the channels after each convolution."""
        layers = zip([inputs, *channels], channels, strict=False)
        super().__init__(nn.Conv3d(a, b, KERNEL, stride=2, padding=1) for a, b in layers)

    def forward(self, x: Tensor) -> list[Tensor]:
        """Return the output of every level of x (b, c, n, n, n), the finest first."""
        levels = []
        for layer in self:
            x = functional.leaky_relu(layer(x), 0.2)
            levels.append(x)
        return levels


class Upward(nn.Module):
    """Transposed convolutions with skip connections up to the finest level, then one logit per voxel."""

    def __init__(self, inputs: int, channels: tuple[int, ...]) -> None:
        """Make the layers, given the channels of the input and of `Downward`'s levels, the finest first."""
        super().__init__()
        outputs = [*reversed(channels[:-1]), channels[0]]
        skips = [0, *reversed(channels[:-1])]
        self.layers = nn.ModuleList(
            Doubling(below + skip, above)
            for below, skip, above in zip([inputs, *outputs], skips, outputs, strict=False)
        )
        self.last = nn.Conv3d(channels[0], 1, 3, padding=1)

    def forward(self, x: Tensor, levels: list[Tensor]) -> Tensor:
        """Return logits at the resolution of `Downward`'s input, given bottom features and all levels."""
        finer = [None, *reversed(levels[:-1])]
        for layer, level in zip(self.layers, finer, strict=True):
            x = functional.relu(layer(x if level is None else torch.cat([x, level], dim=1)))
        return self.last(x)


class SixSides(nn.Module):
    """Encodes depth images of the partial view from six sides; an LSTM reads them one after another."""

    def __init__(self, channels: tuple[int, ...], divisor: int) -> None:
        """Make the layers, given the channels of the image convolutions.

        `divisor` divides the lengths of an image's vector and of the LSTM's state.
        """
        super().__init__()
        vector, context = IMAGE_VECTOR // divisor, CONTEXT_VECTOR // divisor
        self.convolutions = nn.ModuleList(
            nn.Conv2d(a, b, KERNEL, stride=2, padding=1)
            for a, b in zip([1, *channels], channels, strict=False)
        )
        self.to_vector = nn.Linear(channels[-1] * 8 * 8, vector)
        self.lstm = nn.LSTM(vector, context, batch_first=True)
        self.from_context = nn.Linear(context, narrowed(CONTEXT_CHANNELS, divisor) * BOTTOM_CELLS**3)

    def forward(self, partial: Tensor) -> Tensor:
        """Return context features (b, c, 4, 4, 4) of partial views (b, 1, 64, 64, 64)."""
        x = six_depth_images(partial).flatten(0, 1)
        for layer in self.convolutions:
            x = functional.relu(layer(x))
        vectors = functional.relu(self.to_vector(x.flatten(1))).unflatten(0, (len(partial), 6))
        _, (last, _) = self.lstm(vectors)
        return functional.relu(self.from_context(last[0])).unflatten(1, (-1, *3 * [BOTTOM_CELLS]))


class HanLike(Network):
    """The whole network, 7.5 M parameters: `coarse` predicts at 32^3, `patch` predicts parts of 256^3."""

    def __init__(self, divisor: int = 1) -> None:
        """Make the network; hidden channels and vectors are divided by `divisor`."""
        super().__init__(input_cells=64, output_cells=OUTPUT_CELLS)
        wide, local, images = (
            tuple(narrowed(count, divisor) for count in counts)
            for counts in (GLOBAL_CHANNELS, LOCAL_CHANNELS, IMAGE_CHANNELS)
        )
        self.views = SixSides(images, divisor)
        self.volume_down = Downward(1, wide)
        bottom = wide[-1] + narrowed(CONTEXT_CHANNELS, divisor)
        self.volume_up = Upward(bottom, wide)
        self.patch_down = Downward(2, local)
        self.guidance = nn.Linear(bottom + 3, local[-1])
        self.patch_up = Upward(local[-1], local)
        xavier(self)

    def coarse(self, partial: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits (b, 1, 32, 32, 32), and the global structure (b, c) that guides patches."""
        levels = self.volume_down(reduced_partial(partial, GLOBAL_CELLS))
        bottom = torch.cat([levels[-1], self.views(partial)], dim=1)
        return self.volume_up(bottom, levels), bottom.mean(dim=(2, 3, 4))

    def patch(self, cells: Tensor, structure: Tensor, corners: Tensor) -> Tensor:
        """Return logits (p, 1, 32, 32, 32) of patches.

        Args:
            cells: (p, 2, 32, 32, 32) float32, coarse probability and partial view, resampled to the 256^3
                grid.
            structure: (p, c) global structure of each patch's shape.
            corners: (p, 3) int64, the index of each patch along each axis.
        """
        levels = self.patch_down(cells)
        place = (corners.to(cells.dtype) + 0.5) / PATCHES - 0.5
        guided = levels[-1] + self.guidance(torch.cat([structure, place], dim=1))[:, :, None, None, None]
        return self.patch_up(guided, levels)

    def taught(
        self, partial: Tensor, truth: TruthBatch, generator: Generator
    ) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        """Yield (logits, targets, weights) of the coarse grid, and then of some patches of each shape.

        At most eight patches are drawn from those that the shape's surface crosses or nears; if there are
        none, from all.
        """
        logits, structure = self.coarse(partial)
        target, weight = truth.at(GLOBAL_CELLS)
        yield logits, target, weight
        targets, weights = truth.at(OUTPUT_CELLS)
        probability = logits.sigmoid()
        for index in range(len(partial)):
            corners = _drawn(target[index, 0], generator)
            cells = patch_inputs(probability[index], partial[index], corners)
            yield (
                self.patch(cells, structure[[index] * len(corners)], corners),
                _cut(targets[index], corners),
                _cut(weights[index], corners),
            )

    def forward(self, partial: Tensor) -> Tensor:
        """Return logits (b, 1, 256, 256, 256), given partial views (b, 1, 64, 64, 64).

        Where the coarse grid is undecided, they are refined patch by patch. Elsewhere they are the
        interpolated logits of the coarse grid.
        """
        logits, structure = self.coarse(partial)
        probability = logits.float().sigmoid()
        out = functional.interpolate(logits.float(), size=OUTPUT_CELLS, mode="trilinear", align_corners=False)
        for index in range(len(partial)):
            corners = torch.nonzero(_undecided(probability[index, 0]))
            for some in corners.split(TAUGHT_PATCHES):
                inputs = patch_inputs(probability[index], partial[index], some)
                patches = self.patch(inputs, structure[[index] * len(some)], some)
                for cells, (i, j, k) in zip(patches, (some * PATCH_CELLS).tolist(), strict=True):
                    ends = (slice(i, i + PATCH_CELLS), slice(j, j + PATCH_CELLS), slice(k, k + PATCH_CELLS))
                    out[(index, slice(None), *ends)] = cells.to(out.dtype)
        return out


def six_depth_images(partial: Tensor) -> Tensor:
    """Return depth images of grids (b, 1, n, n, n) from their six sides: (b, 6, 1, n, n).

    A value is the distance to the first set cell, in units of the grid's side; 1 if no cell is set.
    """
    count = partial.shape[-1]
    images = []
    for axis in (2, 3, 4):
        for grid in (partial, partial.flip(axis)):
            first = grid.argmax(dim=axis).to(partial.dtype) / count
            images.append(torch.where(grid.amax(dim=axis) > 0, first, torch.ones_like(first)))
    return torch.stack(images, dim=1)


def patch_inputs(probability: Tensor, partial: Tensor, corners: Tensor) -> Tensor:
    """Return the inputs of the local network for p patches: (p, 2, 32, 32, 32).

    Args:
        probability: (1, 32, 32, 32) coarse prediction; it is resampled trilinearly, with its outermost cells
            repeated beyond the border.
        partial: (1, 64, 64, 64) partial view; each cell becomes 4^3 cells.
        corners: (p, 3) int64, the index of each patch along each axis.
    """
    # With one more cell on each side, a patch's own cells are resampled as in the whole grid.
    around = functional.pad(probability[None], [1] * 6, mode="replicate")[0]
    coarse = _cut(around, corners, GLOBAL_CELLS // PATCHES, 2)
    scale = PATCH_CELLS * PATCHES // GLOBAL_CELLS
    wide = functional.interpolate(coarse, scale_factor=scale, mode="trilinear", align_corners=False)
    inner = slice(scale, scale + PATCH_CELLS)
    seen = functional.interpolate(_cut(partial, corners, partial.shape[-1] // PATCHES), size=PATCH_CELLS)
    return torch.cat([wide[:, :, inner, inner, inner], seen], dim=1)


def _cut(grid: Tensor, corners: Tensor, cells: int = PATCH_CELLS, more: int = 0) -> Tensor:
    """Return patches (p, c, n, n, n) of a grid (c, m, m, m), where n = `cells` + `more`.

    `corners` (p, 3) are the patches' indices along each axis. Patches start every `cells` cells; neighbours
    overlap by `more` cells.
    """
    n = cells + more
    places = (corners * cells).tolist()
    return torch.stack([grid[:, i : i + n, j : j + n, k : k + n] for i, j, k in places])


def _undecided(probability: Tensor) -> Tensor:
    """Return which of the 8^3 patches a coarse grid (32, 32, 32) leaves undecided: bool, (8, 8, 8).

    A patch is decided if its 4 x 4 x 4 coarse cells, and the coarse cells that border it, are all at most
    `DECIDED` or all at least 1 - `DECIDED`.
    """
    cells = GLOBAL_CELLS // PATCHES
    highest = functional.max_pool3d(probability[None, None], cells + 2, cells, 1)[0, 0]
    lowest = -functional.max_pool3d(-probability[None, None], cells + 2, cells, 1)[0, 0]
    return (highest > DECIDED) & (lowest < 1 - DECIDED)


def _drawn(target: Tensor, generator: Generator) -> Tensor:
    """Draw up to eight patches that the surface of a coarse truth (32, 32, 32) crosses or nears: (p, 3).

    The result has the patches' indices. If there are no such patches, draw from all patches.
    """
    corners = torch.nonzero(_undecided(target))
    if not len(corners):
        corners = torch.nonzero(torch.ones(3 * (PATCHES,), device=target.device))
    order = torch.randperm(len(corners), generator=generator, device=generator.device)
    return corners[order[:TAUGHT_PATCHES].to(corners.device)]
