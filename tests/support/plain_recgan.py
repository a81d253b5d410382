"""The forward pass of 3D-RecGAN++ in plain numpy, from the tensors as TensorFlow names and lays them.

Channels last, "SAME" padding, nothing of the package: what the converted network is held against.
"""

from collections.abc import Mapping
from itertools import product

import numpy as np
from numpy.typing import NDArray

Grid = NDArray[np.float64]
Tensors = Mapping[str, NDArray[np.float32]]


def convolved(x: Grid, weights: Grid, bias: Grid) -> Grid:
    """4^3, stride 1: (n, n, n, in) and [4, 4, 4, in, out]; one cell before, two behind."""
    n = len(x)
    padded = np.pad(x, [(1, 2)] * 3 + [(0, 0)])
    out = np.zeros((n, n, n, weights.shape[-1])) + bias
    for i, j, k in product(range(4), repeat=3):
        out += padded[i : i + n, j : j + n, k : k + n] @ weights[i, j, k]
    return out


def doubled(x: Grid, weights: Grid, bias: Grid) -> Grid:
    """4^3, stride 2, transposed: (n, n, n, in) and [4, 4, 4, out, in]; each cell is spread over 4^3."""
    n = len(x)
    out = np.zeros((2 * n + 2,) * 3 + (weights.shape[3],))
    for i, j, k in product(range(4), repeat=3):
        out[i : i + 2 * n : 2, j : j + 2 * n : 2, k : k + 2 * n : 2] += x @ weights[i, j, k].T
    return out[1:-1, 1:-1, 1:-1] + bias


def pooled(x: Grid) -> Grid:
    n = len(x) // 2
    pooled: Grid = x.reshape(n, 2, n, 2, n, 2, -1).max(axis=(1, 3, 5))
    return pooled


def plain_generator(tensors: Tensors, partial: NDArray[np.bool_]) -> Grid:
    """Occupancy (256, 256, 256) of a partial view (64, 64, 64), both in the authors' axes."""
    t = {name: values.astype(np.float64) for name, values in tensors.items()}
    levels = [partial[..., None].astype(np.float64)]
    for k in range(1, 5):
        x = convolved(levels[-1], t[f"aeu/e{k}_w"], t[f"aeu/e{k}_b"])
        levels.append(pooled(np.where(x > 0, x, 0.2 * x)))
    vector = np.maximum(levels[-1].reshape(-1) @ t["aeu/fc1_w"] + t["aeu/fc1_b"], 0)
    x = np.maximum(vector @ t["aeu/fc2_w"] + t["aeu/fc2_b"], 0).reshape(levels[-1].shape)
    for k in range(1, 6):
        x = np.concatenate([x, levels[-k]], axis=3)
        x = np.maximum(doubled(x, t[f"aeu/d{k}_w"], t[f"aeu/d{k}_b"]), 0)
    return 1 / (1 + np.exp(-doubled(x, t["aeu/dlast_w"], t["aeu/dlast_b"])[..., 0]))


def plain_discriminator(tensors: Tensors, partial: NDArray[np.bool_], shape: NDArray[np.bool_]) -> Grid:
    """The features of a view (64, 64, 64) and a shape (256, 256, 256)."""
    view = partial.reshape(256, 256, 4)
    x = np.concatenate([view, shape], axis=2)[..., None].astype(np.float64)
    for k in range(1, 7):
        x = _strided(x, tensors[f"dis/d{k}_w"].astype(np.float64), tensors[f"dis/d{k}_b"])
        if k < 6:
            x = np.where(x > 0, x, 0.2 * x)
    return 1 / (1 + np.exp(-x.reshape(-1)))


def _strided(x: Grid, weights: Grid, bias: NDArray[np.float32]) -> Grid:
    """4^3, stride 2, "SAME": of an odd side the one cell more of padding stands behind."""
    sides = [-(-n // 2) for n in x.shape[:3]]
    total = [(side - 1) * 2 + 4 - n for side, n in zip(sides, x.shape[:3], strict=True)]
    padded = np.pad(x, [(count // 2, count - count // 2) for count in total] + [(0, 0)])
    out: Grid = np.zeros((*sides, weights.shape[-1])) + bias
    for i, j, k in product(range(4), repeat=3):
        a, b, c = (slice(s, s + 2 * side - 1, 2) for s, side in zip((i, j, k), sides, strict=True))
        out += padded[a, b, c] @ weights[i, j, k]
    return out
