"""Scoring against what a user would write: ratios of CPU time, interleaved, each with its accuracy check."""

import io
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from figures import Figure, arguments, at_least, at_most, run, stated
from numpy.typing import NDArray
from references import upsample
from scipy import ndimage
from scipy.spatial import cKDTree

from kinectbench.core.artefacts.counted import Tally
from kinectbench.core.types import Bools
from kinectbench.core.voxels.pair_file import pack
from kinectbench.core.voxels.resample import CORNER_ALIGNED, upsampled_planes
from kinectbench.core.voxels.solid import packed_shell
from kinectbench.scoring.counts import THRESHOLDS, cross_entropy, ious, protocol_counts, tally
from kinectbench.scoring.prediction_file import load_prediction
from kinectbench.scoring.surface_kernels import cells_of, nearest_cells
from kinectbench.scoring.truth import PackedTruth

SIDE = 256


def ball(centre: tuple[int, int, int], radius: float) -> Bools:
    x, y, z = ((np.arange(SIDE) + 0.5 - c) ** 2 for c in centre)
    inside: Bools = x[:, None, None] + y[:, None] + z <= radius**2
    return inside


def naive(values: NDArray[Any], full: Bools) -> tuple[list[float], float]:
    """The definitions, threshold by threshold, in float64."""
    y = values.astype(np.float64)
    found = []
    for p in THRESHOLDS:
        above = y > p
        found.append((above & full).sum() / (above | full).sum())
        (above & full).sum() / above.sum(), (above & full).sum() / full.sum()
    clipped = np.clip(y, 1e-7, 1 - 1e-7)
    return found, float(-np.mean(full * np.log(clipped) + (1 - full) * np.log(1 - clipped)))


def careful(values: NDArray[Any], full: Bools) -> tuple[list[float], float]:
    """One sort into bins for all thresholds, and the logarithm of what is needed only."""
    y = values.astype(np.float64)
    bins = [
        np.bincount(np.searchsorted(THRESHOLDS, y[part], side="left"), minlength=18) for part in (full, ~full)
    ]
    hit, wrong = (found[::-1].cumsum()[::-1][1:] for found in bins)
    clipped = np.clip(y, 1e-7, 1 - 1e-7)
    loss = np.log(clipped[full]).sum() + np.log(1 - clipped[~full]).sum()
    return list(hit / (full.sum() + wrong)), float(-loss / y.size)


def ours(counted: Tally) -> tuple[list[float], float]:
    counts = protocol_counts(counted, "paper")
    return ious(counts).tolist(), cross_entropy(counts)


def interleaved(rounds: int, *functions: Callable[[], Any]) -> tuple[list[float], list[Any]]:
    """Least CPU seconds of each, and what each returned."""
    results = [function() for function in functions]  # compiled, and warm
    best = [np.inf] * len(functions)
    for _ in range(rounds):
        for n, function in enumerate(functions):
            started = time.process_time()
            results[n] = function()
            best[n] = min(best[n], time.process_time() - started)
    return best, results


def difference(first: tuple[list[float], float], second: tuple[list[float], float]) -> float:
    return float(np.abs(np.array([*first[0], first[1]]) - [*second[0], second[1]]).max())


def one_pair(rounds: int) -> list[Figure]:
    rng = np.random.default_rng(0)
    full = ball((120, 128, 130), 80)
    everything = np.full((SIDE, SIDE, SIDE // 8), 255, np.uint8)
    truth = PackedTruth(pack(full), everything, pack(ball((128, 128, 20), 120)), 0.004, 0.005)
    smooth = np.clip(0.6 * full + 0.5 * rng.random(full.shape) - 0.05, 0, 1)
    near = np.array(
        [np.nextafter(np.float32(p), np.float32(s)) for p in THRESHOLDS for s in (0, 1)], np.float32
    )
    exact = rng.random(full.shape) < 0.05
    figures = []
    for dtype in (np.float16, np.float32):
        values = smooth.astype(dtype)
        values[exact] = near[rng.integers(len(near), size=int(exact.sum()))].astype(dtype)
        times, (a, b, c) = interleaved(
            rounds,
            lambda v=values: naive(v, full),
            lambda v=values: careful(v, full),
            lambda v=values: ours(tally(v, truth)),
        )
        name = np.dtype(dtype).name
        figures += [
            stated(f"{name}: naive, careful, kinectbench, cpu ms", [round(t * 1e3, 1) for t in times]),
            at_least(f"{name}: as fast as naive numpy, times", times[0] / times[2], 40),
            at_least(f"{name}: as fast as careful numpy, times", times[1] / times[2], 4),
            at_most(f"{name}: largest difference to float64", max(difference(a, c), difference(b, c)), 1e-6),
        ]
    return [*figures, *from_npz(rounds, smooth.astype(np.float16), full, truth)]


def from_npz(rounds: int, values: NDArray[Any], full: Bools, truth: PackedTruth) -> list[Figure]:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "000.npz"
        np.savez_compressed(path, values)
        content = path.read_bytes()

        def loaded() -> NDArray[Any]:
            values: NDArray[Any] = np.load(io.BytesIO(content))["arr_0"]
            return values

        times, (a, b, c) = interleaved(
            rounds,
            lambda: naive(loaded(), full),
            lambda: careful(loaded(), full),
            lambda: ours(tally(load_prediction(path), truth)),
        )
    milliseconds = [round(t * 1e3) for t in times]
    return [
        stated("load a compressed npz and score: naive, careful, kinectbench, cpu ms", milliseconds),
        at_least("load and score: as fast as naive numpy, times", times[0] / times[2], 3),
        at_least("load and score: as fast as careful numpy, times", times[1] / times[2], 3),
        at_most("load and score: largest difference", max(difference(a, c), difference(b, c)), 1e-6),
    ]


def surfaces(rounds: int) -> list[Figure]:
    figures = []
    first = packed_shell(pack(ball((128, 128, 130), 100)))
    for name, other, bar in (
        ("near", ball((126, 129, 131), 98), 1.8),
        ("far", ball((60, 60, 60), 50), 8),
    ):
        second = packed_shell(pack(other))
        points = [np.argwhere(np.unpackbits(packed, axis=-1)) for packed in (first, second)]

        def tree(a: NDArray[Any] = points[0], b: NDArray[Any] = points[1]) -> list[NDArray[Any]]:
            return [np.sort(cKDTree(t).query(q)[0]) for q, t in ((a, b), (b, a))]

        def blocks(a: NDArray[Any] = first, b: NDArray[Any] = second) -> list[NDArray[Any]]:
            sets = cells_of(a), cells_of(b)
            return [np.sort(np.sqrt(nearest_cells(*order)[0])) for order in (sets, sets[::-1])]

        times, (expected, found) = interleaved(rounds, tree, blocks)
        worst = max(float(np.abs(e - f).max()) for e, f in zip(expected, found, strict=True))
        figures += [
            stated(
                f"surface distances, {name}: cKDTree, kinectbench, cpu ms", [round(t * 1e3) for t in times]
            ),
            at_least(f"surface distances, {name}: as fast as cKDTree, times", times[0] / times[1], bar),
            at_most(f"surface distances, {name}: largest difference, cells", worst, 1e-9),
        ]
    return figures


def resampling(rounds: int) -> list[Figure]:
    values = np.random.default_rng(1).random((32, 32, 32))

    def planes() -> float:
        return sum(plane[0, 0] for plane in upsampled_planes(values, convention=CORNER_ALIGNED))

    zoomed = ndimage.zoom(values, SIDE / 32, order=1)
    worst = float(np.abs(zoomed - upsample(values, convention=CORNER_ALIGNED)).max())
    times, _ = interleaved(rounds, lambda: ndimage.zoom(values, SIDE / 32, order=1), planes)
    return [
        stated(
            "32^3 to 256^3: scipy zoom, kinectbench (plane by plane), cpu ms",
            [round(t * 1e3, 2) for t in times],
        ),
        # 89, 95 and 108 were measured on two cores that other work shared.
        at_least("32^3 to 256^3: as fast as zoom, times", times[0] / times[1], 80),
        at_most("32^3 to 256^3, corner-aligned: largest difference to zoom", worst, 1e-12),
    ]


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--rounds", type=int, default=3, help="interleaved rounds (default: 3)")
    options = parser.parse_args()
    rounds = options.rounds
    run(options, lambda: [*one_pair(rounds), *surfaces(rounds), *resampling(rounds)])


if __name__ == "__main__":
    main()
