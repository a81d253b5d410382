"""Scores against plain numpy: every metric and protocol of random predictions, computed a second time.

The second computation takes its formulas from the paper and uses nothing of `kinectbench.scoring`:
the grids are unpacked, a prediction becomes float64, cubes of other sizes are upsampled by
`scipy.ndimage.zoom`, thresholds are searched by counting voxels. Of some pairs nothing is known, or nothing
of what is hidden: there every figure has to be null in both.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from builds import build_root
from figures import Figure, arguments, at_most, equals, run, stated
from numpy.typing import NDArray
from scipy import ndimage
from score_surfaces import surface_of, surface_reference
from synthetic_release import synthetic_settings, write_build

from kinectbench.core.types import Bools
from kinectbench.core.voxels.pair_file import pair_bytes, read_pair
from kinectbench.release.publish.publish import publish
from kinectbench.release.release import Release, Target, open_release

MAX_DIFFERENCE = 1e-6
METRICS = ("iou", "ce", "precision", "recall", "f1")
SURFACES = (
    "chamfer_mm",
    "f_score_1pct",
    "f_score_2pct",
    "f_score_10mm",
    "f_score_20mm",
    "surface_dice",
    "normal_consistency",
)
RECORDINGS = (  # as in tests/synthetic_release.py: the shapes differ by recording and view
    *((f"chair_{n:02d}", "chair", f"chair_{n:02d}", "test", 3) for n in range(4)),
    *((f"table_{n:02d}", "table", f"table_{n:02d}", "test", 3) for n in range(4)),
    ("chair_90", "chair", "chair_90", "validation", 2),
    ("table_90", "table", "table_90", "validation", 2),
)
PROTOCOLS = ("paper", "known", "occluded")
# Pairs of simple shapes of whose true shape nothing is known, and nothing of what the view did not see.
NOTHING_KNOWN = ("chair_00/000", "table_01/002")
ONLY_SEEN_KNOWN = ("chair_02/001", "table_03/000")
Reals = NDArray[np.float64]
# Metric → value; null where a protocol says nothing of the pair.
Figures = dict[str, float | None]


def _zoomed(values: Reals, side: int) -> Reals:
    """Trilinear, by the half-pixel convention."""
    if len(values) == side:
        return values
    return np.asarray(
        ndimage.zoom(values, side / len(values), order=1, grid_mode=True, mode="nearest"), np.float64
    )


def _smooth(rng: np.random.Generator, full: Bools, side: int) -> Reals:
    """Random values in [0, 1] of a side, higher in the truth, some of them exactly 0, 1 or a threshold."""
    coarse = _zoomed(full.astype(float), side)
    blobs = _zoomed(
        rng.random((max(side // 8, 8),) * 3), side
    )  # so that there are no millions of surface cells
    values = 0.5 * coarse + 0.5 * blobs + 0.15 * rng.random((side,) * 3) - 0.1
    exact = rng.random((side,) * 3)
    values = np.where(exact < 0.1, np.round(values * 20) / 20, values)
    clipped: Reals = np.clip(values, 0, 1)
    return clipped


def _flipped(rng: np.random.Generator, full: Bools) -> Bools:
    flipped: Bools = np.roll(full, int(rng.integers(1, 9)), axis=int(rng.integers(3))) ^ (
        rng.random(full.shape) < 0.001
    )
    return flipped


KINDS: dict[str, Callable[[np.random.Generator, Bools], NDArray[Any]]] = {
    "bool": _flipped,
    "uint8": lambda rng, full: _flipped(rng, full).astype(np.uint8),
    "float16": lambda rng, full: _smooth(rng, full, 256).astype(np.float16),
    "float32": lambda rng, full: _smooth(rng, full, 256).astype(np.float32),
    "32 a side": lambda rng, full: _smooth(rng, full, 32).astype(np.float32),
    "40 a side": lambda rng, full: _smooth(rng, full, 40).astype(np.float16),
}


@dataclass(frozen=True)
class Case:
    """One prediction as float64 on the 256-grid, and its truth as booleans."""

    y: Reals
    full: Bools
    known: Bools
    seen: Bools
    voxel_size_m: float = 1.0
    surface_sigma_m: float = 0.0

    def counted(self, protocol: str) -> Bools:
        """The voxels that a protocol counts."""
        masks = {"paper": np.ones_like(self.known), "known": self.known, "occluded": self.known & ~self.seen}
        return masks[protocol]

    def is_left_out(self, protocol: str) -> bool:
        """Whether a protocol counts no voxel, or of the shape where it looks knows no voxel."""
        looked_at = ~self.seen if protocol == "occluded" else np.ones_like(self.seen)
        counted = self.counted(protocol)
        return not counted.any() or bool((self.full & looked_at).any() and not (self.full & counted).any())


def read_case(pair_file: Path, prediction: Path) -> Case:
    """Read both with plain numpy."""
    with np.load(pair_file) as pair:
        full, known, seen = (
            np.unpackbits(pair[name], axis=-1).astype(bool) for name in ("full", "known", "seen")
        )
        voxel_m, sigma_m = float(pair["voxel_size_m"]), float(pair["surface_sigma_m"])
    y = _zoomed(np.load(prediction).astype(np.float64), 256)
    return Case(y, full, known, seen, voxel_m, sigma_m)


def reference(case: Case, threshold: float, protocol: str) -> Figures:
    """The paper's four metrics and F1, over the voxels that the protocol counts."""
    if case.is_left_out(protocol):
        return dict.fromkeys(METRICS)
    counted = case.counted(protocol)
    y, full = case.y[counted], case.full[counted]
    above = y > threshold
    hit, union = np.count_nonzero(above & full), np.count_nonzero(above | full)
    clipped = np.clip(y, 1e-7, 1 - 1e-7)
    return {
        "iou": hit / union,
        "ce": float(-np.mean(np.log(np.where(full, clipped, 1 - clipped)))),
        "precision": hit / np.count_nonzero(above),
        "recall": hit / np.count_nonzero(full),
        "f1": 2 * hit / (np.count_nonzero(above) + np.count_nonzero(full)),
    }


def surface_again(case: Case, threshold: float) -> dict[str, Figures]:
    """The surface metrics by protocol, from what it counts to what is known."""
    ours, theirs = surface_of(case.y > threshold), surface_of(case.full)
    lengths = case.voxel_size_m, case.surface_sigma_m
    again: dict[str, Figures] = {}
    for name in PROTOCOLS:
        trusted = case.counted("paper" if name == "paper" else "known")
        again[name] = dict.fromkeys(SURFACES)
        if not case.is_left_out(name):
            again[name] |= surface_reference(ours, theirs, case.counted(name), trusted, *lengths)
    return again


def difference(found: float | None, expected: float | None) -> float:
    """Of two figures; 0 of two that are null, infinite where only one is."""
    if found is None or expected is None:
        return 0.0 if found is expected else float("inf")
    return abs(found - expected)


def searched_threshold(cases: list[Case]) -> float:
    """The threshold in [0.1, 0.9], steps of 0.05, of the best mean IoU over all voxels; ties: the lowest."""
    means = [
        np.mean(
            [
                np.count_nonzero((c.y > k / 20) & c.full) / np.count_nonzero((c.y > k / 20) | c.full)
                for c in cases
            ]
        )
        for k in range(2, 19)
    ]
    return (int(np.argmax(means)) + 2) / 20


def write_predictions(release: Release, folder: Path, turn: int) -> None:
    """One random prediction for each pair; every turn, each pair gets another kind."""
    for index, target in enumerate(release.targets):
        with np.load(release.pair_path(target)) as pair:
            full = np.unpackbits(pair["full"], axis=-1).astype(bool)
        make = [*KINDS.values()][(index + turn) % len(KINDS)]
        path = prediction_file(folder, target)
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, make(np.random.default_rng([turn, index]), full))


def prediction_file(folder: Path, target: Target) -> Path:
    """Where a prediction lies."""
    path: Path = folder / target.recording / f"{target.view}.npy"
    return path


@dataclass(frozen=True)
class Compared:
    """Scores held against a second computation.

    Attributes:
        largest: the largest difference by metric; infinite where only one of the two is null.
        wrong: thresholds that differ, and pairs that are missing, a line each.
        left_out: `<recording>/<view> <protocol>` whose figures are null in the second computation.
    """

    largest: dict[str, float]
    wrong: list[str]
    left_out: list[str]


def compared(release: Release, folder: Path, surface: bool = False) -> Compared:
    """Score a folder and compute it again."""
    from kinectbench.scoring.score import score

    def case(target: Target) -> Case:
        return read_case(release.pair_path(target), prediction_file(folder, target))

    table = score(release, folder, method="random", protocols=PROTOCOLS, surface=surface)
    expected = {}
    for category in table.thresholds:
        validation = [case(t) for t in release.split("validation") if t.category == category]
        expected[category] = searched_threshold(validation) if validation else 0.5
    wrong = [
        f"{category}: {table.thresholds[category]:g}, not {expected[category]:g}"
        for category in expected
        if table.thresholds[category] != expected[category]
    ]
    rows = {(row.recording, row.view, row.protocol): row for row in table.rows}
    largest = dict.fromkeys((*METRICS, *(SURFACES if surface else ())), 0.0)
    left_out = []
    for target in release.split("test"):
        read, threshold = case(target), expected[target.category]
        again = {protocol: reference(read, threshold, protocol) for protocol in PROTOCOLS}
        for protocol, more in (surface_again(read, threshold) if surface else {}).items():
            again[protocol] |= more
        for protocol, values in again.items():
            row = rows[target.recording, target.view, protocol]
            left_out += [f"{target.name} {protocol}"] * (values["iou"] is None)
            for name in largest:
                largest[name] = max(largest[name], difference(getattr(row, name), values[name]))
    if table.failures or len(table.rows) != len(PROTOCOLS) * len(release.split("test")):
        wrong.append(f"{len(table.rows)} rows, failures: {table.failures}")
    return Compared(largest, wrong, left_out)


def publish_shapes(root: Path) -> Path:
    """A release of simple shapes; of some pairs nothing is known, or only what their view saw."""
    write_build(root / "build", RECORDINGS)
    for name in (*NOTHING_KNOWN, *ONLY_SEEN_KNOWN):
        recording, _, view = name.partition("/")
        path = root / "build" / recording / "pairs" / f"{view}.npz"
        pair = read_pair(path)
        known = ~pair.full if name in NOTHING_KNOWN else pair.seen
        path.write_bytes(pair_bytes(replace(pair, known=known)))
    names = [recording[0] for recording in RECORDINGS]
    return publish(synthetic_settings(RECORDINGS), root / "build", root / "benchmark", names).folder


def drawn(release: Release, count: int) -> Release:
    """Some test pairs, drawn at random, and the validation split."""
    test = release.split("test")
    chosen = np.random.default_rng(0).choice(len(test), min(count, len(test)), replace=False)
    return replace(release, targets=(*release.split("validation"), *(test[n] for n in sorted(chosen))))


def measure(root: Path, folder: Path | None, count: int) -> list[Figure]:
    """Score random predictions for pairs of a release; without one, for a small one of simple shapes."""
    release = open_release(folder or publish_shapes(root))
    release = drawn(release, count)
    write_predictions(release, root / "predictions", turn=0)
    found = compared(release, root / "predictions", surface=True)
    return [
        stated("pairs scored, each under 3 protocols", len(release.split("test"))),
        stated("kinds of prediction", list(KINDS)),
        stated("pairs left out, with their protocol", found.left_out),
        *(at_most(f"largest difference of {name}", of, MAX_DIFFERENCE) for name, of in found.largest.items()),
        equals("thresholds found otherwise", found.wrong, []),
    ]


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument(
        "--release", type=Path, help="pairs of a published benchmark (default: simple shapes)"
    )
    parser.add_argument("--pairs", type=int, default=20, help="drawn at random (default: 20)")
    options = parser.parse_args()
    with build_root(None) as root:
        run(options, lambda: measure(root, options.release, options.pairs))


if __name__ == "__main__":
    main()
