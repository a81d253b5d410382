"""The ground truth against the truth: simulated furniture, tracked, fused, made solid, paired.

Seeds 28 to 30 are held out: nothing was chosen with them in view. What the others decided stands in
docs/evidence/ground-truth.md.
Builds that lie in --build are brought up to date and measured; recordings are simulated
where they are missing. All of it takes hours; --objects and --only choose.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from builds import CORES, build_root, built
from figures import Figure, arguments, at_least, at_most, run, stated
from ground_truth_rows import OURS, Row, Task, measure_row
from numpy.typing import NDArray
from tracking_recordings import FAMILIES, object_spec, simulated

from kinectbench.engine.processes import submit_all, worker_pool
from kinectbench.lab.simulate.truth import truth_folder
from kinectbench.settings.models import BenchmarkSettings

SEEDS = tuple(range(1, 31))
PRESET = "orbit-v1"


def names(objects: int, only: Sequence[str]) -> list[tuple[str, str, int]]:
    """Name, family and seed of the objects asked for."""
    every = [(f"{family}{seed}", family, seed) for seed in SEEDS for family in FAMILIES]
    return [row for row in every if row[0] in only] if only else every[:objects]


def measured(root: Path, recordings: Path, chosen: Sequence[tuple[str, str, int]]) -> list[Row]:
    """Simulate and build what is not there yet, and measure; a line per object as it is done."""
    folders = [
        simulated(object_spec(family, seed, PRESET), recordings / name) for name, family, seed in chosen
    ]
    settings = BenchmarkSettings.model_validate(
        {
            "name": "ground-truth",
            "recordings": [
                {"id": name, "path": str(folder.resolve()), "category": family, "trajectory": "ignore"}
                for (name, family, _), folder in zip(chosen, folders, strict=True)
            ],
        }
    )
    jobs = built(settings, root)
    tasks = [
        Task(name, family, job.build, truth_folder(folder))
        for (name, family, _), job, folder in zip(chosen, jobs, folders, strict=True)
    ]
    rows = []
    with worker_pool(min(CORES, len(tasks))) as pool:
        for found in submit_all(pool, measure_row, tasks):
            rows.append(found.result())
            print(line(rows[-1]), flush=True)
    return rows


def line(row: Row) -> str:
    """One object in a line."""
    solid, floor, masks, pairs = (
        row.evaluation.solid,
        row.evaluation.floor,
        row.evaluation.masks,
        row.evaluation.pairs,
    )
    assert solid and floor and masks and pairs and pairs.containment
    words = f"{row.name:8} IoU {solid.fine.iou:.3f} (64^3 {solid.coarse.iou:.3f}"
    words += f", known {solid.fine.known_iou:.3f})"
    words += f"  estimated {row.quality.estimated_iou:.3f}  unknown {solid.fine.true_unknown_share:.3f}"
    words += f" + {row.hull_unknown:.3f}  floor {np.degrees(floor.angle_rad):.2f} deg"
    words += (
        f" {1000 * floor.height_m:+.1f} mm  masks {masks.mean_valid_iou:.3f} / {masks.worst_valid_iou:.3f}"
    )
    words += f"  contained {pairs.containment.mean:.3f}  residual {1000 * np.median(row.residual_m):.2f} mm"
    others = ", ".join(f"{name} {value:.2f}" for name, value in row.recipes.items())
    return f"{words}  [{others}]"


def solid_figures(rows: Sequence[Row]) -> list[Figure]:
    """The solid, its labels, its probability and its estimate."""
    from scipy.stats import spearmanr

    solids = [row.evaluation.solid for row in rows if row.evaluation.solid]
    actual = np.array([solid.fine.iou for solid in solids])
    estimated = np.array([row.quality.estimated_iou for row in rows])
    silent = [
        row.name for row, value in zip(rows, actual, strict=True) if value < 0.7 and not row.quality.warnings
    ]
    calibration = sum(row.calibration / row.calibration[:, 0].sum() for row in rows)
    ece = float(np.abs(calibration[:, 1] - calibration[:, 2]).sum() / calibration[:, 0].sum())
    figures = [
        stated("objects", len(rows)),
        at_least("IoU at 256^3, mean", float(actual.mean()), 0.86),
        stated("IoU at 256^3, least", [f"{rows[int(np.argmin(actual))].name}", float(actual.min())]),
        at_least("IoU at 64^3, mean", float(np.mean([s.coarse.iou for s in solids])), 0.88),
        at_least("IoU on known voxels, mean", float(np.mean([s.fine.known_iou or 0 for s in solids])), 0.90),
        at_most(
            "unknown of the true shape, mean",
            float(np.mean([s.fine.true_unknown_share for s in solids])),
            0.05,
        ),
        at_most("unknown within the convex hull, mean", float(np.mean([r.hull_unknown for r in rows])), 0.10),
        at_most("objects below 0.70 without a warning", float(len(silent)), 0),
        at_most(
            "estimated against actual IoU: median error", float(np.median(np.abs(estimated - actual))), 0.04
        ),
        stated("the same: largest error", float(np.abs(estimated - actual).max())),
        at_most("expected calibration error", ece, 0.05),
    ]
    if len(rows) > 2:
        figures.append(stated("rank correlation (Spearman)", float(spearmanr(estimated, actual).statistic)))
    return figures


def recipe_figures(rows: Sequence[Row]) -> list[Figure]:
    """Ours against simpler recipes, over all objects and in each family."""
    figures = []
    for name in rows[0].recipes:
        mean = float(np.mean([row.recipes[name] for row in rows]))
        figures.append(stated(f"own voxels, above the floor's cut: IoU of {name}, mean", mean))
    for family in sorted({row.family for row in rows}):
        means = {
            name: float(np.mean([row.recipes[name] for row in rows if row.family == family]))
            for name in rows[0].recipes
        }
        best = max((name for name in means if name != OURS), key=lambda name: means[name])
        figures.append(at_most(f"{family}: by how much {best} is better", means[best] - means[OURS], 0.01))
    return figures


def stage_figures(rows: Sequence[Row]) -> list[Figure]:
    """Floor, masks and pairs."""
    floors = [row.evaluation.floor for row in rows if row.evaluation.floor]
    masks = [row.evaluation.masks for row in rows if row.evaluation.masks]
    pairs = [row.evaluation.pairs for row in rows if row.evaluation.pairs]
    contained = [p.containment.mean for p in pairs if p.containment]
    surfaces = [row.evaluation.surface for row in rows if row.evaluation.surface]
    seen = [s.visible.scores[0].f for s in surfaces]
    return [
        at_most("floor: angle, degrees, worst", float(np.degrees(max(f.angle_rad for f in floors))), 0.2),
        at_most("floor: offset, mm, worst", 1000 * max(abs(f.height_m) for f in floors), 3),
        at_least(
            "masks: IoU on valid depth, mean", float(np.mean([m.mean_valid_iou or 0 for m in masks])), 0.97
        ),
        at_least("masks: IoU on valid depth, least", min(m.worst_valid_iou or 0 for m in masks), 0.94),
        at_most(
            "masks: share of valid depth dropped, mean",
            float(np.mean([r.dropped.mean() for r in rows])),
            0.03,
        ),
        stated("closed mesh: F at 5 mm on what was seen, least", min(seen)),
        at_least("pairs: containment in the truth, mean", float(np.mean(contained)), 0.97),
        at_most(
            "pairs: depth residual, median, mm",
            1000 * _median([r.residual_m for r in rows]),
            2,
        ),
        stated(
            "the same of the true shape by the true cameras: the sensor's noise, mm",
            1000 * _median([r.sensor_residual_m for r in rows]),
        ),
        at_most(
            "pairs: the shape off the depth without noise, median, mm",
            1000 * _median([r.misfit_m for r in rows]),
            2,
        ),
    ]


def _median(values: Sequence[NDArray[np.float64]]) -> float:
    return float(np.median(np.concatenate(list(values))))


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--build", type=Path, metavar="DIR", help="build there and keep it")
    parser.add_argument(
        "--recordings", type=Path, metavar="DIR", help="simulated recordings; default: in DIR of --build"
    )
    every = len(SEEDS) * len(FAMILIES)
    parser.add_argument("--objects", type=int, default=every, help=f"how many, of {every}")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="such as chair1")
    options = parser.parse_args()
    unknown = sorted(set(options.only) - {name for name, _, _ in names(every, [])})
    if unknown:
        known = f"{', '.join(FAMILIES)} with seeds 1 to {SEEDS[-1]}"
        parser.error(f"--only: there is no {', '.join(unknown)}: {known}")

    def measure() -> list[Figure]:
        rows = measured(root, options.recordings or root / "recordings", names(options.objects, options.only))
        return [*solid_figures(rows), *recipe_figures(rows), *stage_figures(rows)]

    with build_root(options.build) as root:
        run(options, measure)


if __name__ == "__main__":
    main()
