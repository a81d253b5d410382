"""Known means known: simulated objects of every family, tracked without poses, against the truth.

Nothing is said of their undersides, or, with --underside truly, that they are closed, where they are.

Families are looked at or only reported (`kinectbench.lab.simulate.objects`): rules are chosen on the first.
What lies in --build is brought up to date and measured; recordings are simulated where they are missing. One
object takes one to five minutes on one core. Where the bar of a furniture's IoU is an earlier value,
--against names the JSON of an earlier run on the same recordings.
"""

import argparse
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from builds import CORES, build_root
from figures import Figure, arguments, at_least, at_most, run, stated
from guided_walk import guided_figures
from known_observations import SPLITS
from known_rows import NotBuilt, Row, Task, as_json, line, mean_of, measure_row, print_tables
from known_sheets import draw_sheets
from tracking_recordings import simulated

from kinectbench.engine.parallel import build
from kinectbench.engine.processes import submit_all, worker_pool
from kinectbench.engine.stages import Job
from kinectbench.lab.evaluate.known import calibration_error, equal_bins
from kinectbench.lab.simulate.objects import families, make_object
from kinectbench.lab.simulate.presets import PRESETS, preset_spec
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.lab.simulate.truth import truth_folder
from kinectbench.settings.models import BenchmarkSettings

SEEDS = (41, 42, 43)
# `auto` records what is at most so large from near, as a thing on a table, and everything else as known-v1.
AUTO, TABLE_TOP_M = "auto", 0.4
LARGE_PRESET, NEAR_PRESET = "known-v1", "near-v1"
NEAR_CHANGES = {"path": {"frames": 180, "rate_hz": 10.0}}
# As many calibration bins of each object as all weigh the same.
COPIES = 100


@dataclass(frozen=True)
class Recording:
    """One recording that is asked for."""

    name: str
    family: str
    path: str
    spec: SimulationSpec


def recordings(
    families: Sequence[str], seeds: Sequence[int], paths: Sequence[str], overrides: Sequence[str]
) -> list[Recording]:
    """Each object along each path, family by family for each seed."""
    result = []
    for seed in seeds:
        for family in families:
            for path in paths:
                preset, changes = path, {"object": f"{family}:seed={seed}", "seed": seed, "save_depth": False}
                if path == AUTO:
                    size_m = float(np.ptp(make_object(family, seed).mesh.vertices, axis=0).max())
                    preset = NEAR_PRESET if size_m <= TABLE_TOP_M else LARGE_PRESET
                    changes |= NEAR_CHANGES if preset == NEAR_PRESET else {}
                name = f"{family}{seed}" + ("" if path == AUTO else f"-{path.rpartition('-v')[0]}")
                result.append(Recording(name, family, preset, preset_spec(preset, changes, overrides)))
    return result


def measured(
    root: Path, folder: Path, chosen: Sequence[Recording], truly: bool, upto: str, workers: int
) -> tuple[list[Row], list[NotBuilt]]:
    """Simulate and build what is not there yet, and measure; a line per object as it is done."""
    with worker_pool(workers) as pool:
        places = [found.result() for found in submit_all(pool, _simulated, [(one, folder) for one in chosen])]
    settings = BenchmarkSettings.model_validate(
        {
            "name": "known",
            "recordings": [
                {
                    "id": one.name,
                    "path": str(place.resolve()),
                    "category": one.family,
                    "underside": "closed" if truly and families()[one.family].closed_below else "unseen",
                    # Nobody can follow a camera that jumps: such recordings bring their poses.
                    "trajectory": "trust" if one.spec.path.order == "shuffled" else "ignore",
                }
                for one, place in zip(chosen, places, strict=True)
            ],
        }
    )
    jobs = [Job(settings, recording, root) for recording in settings.recordings]
    outcomes = build(jobs, upto=upto, workers=workers)
    tasks, missing, rows = [], [], []
    for one, place, job, outcome in zip(chosen, places, jobs, outcomes, strict=True):
        if outcome.error:
            missing.append(NotBuilt(one.name, one.family, outcome.error))
        else:
            tasks.append(Task(one.name, one.family, one.path, job.build, truth_folder(place)))
    with worker_pool(workers) as pool:
        for done in submit_all(pool, measure_row, tasks):
            found = done.result()
            if isinstance(found, NotBuilt):
                missing.append(found)
            else:
                rows.append(found)
                print(line(found), flush=True)
    return rows, missing


def _simulated(task: tuple[Recording, Path]) -> Path:
    one, folder = task
    return simulated(one.spec, folder / one.name)


def bars(
    rows: Sequence[Row], missing: Sequence[NotBuilt], truly: bool, earlier: Sequence[Any]
) -> list[Figure]:
    """The bars on truth, for furniture and for all other objects; and figures that are only stated."""
    furniture = [row for row in rows if row.is_furniture]
    others = [row for row in rows if not row.is_furniture]
    figures = [stated("objects", len(rows)), at_most("objects that were not built", len(missing), 0)]
    figures += _shares(furniture, others, truly)
    figures += _estimates(rows)
    if earlier:
        figures += _against(furniture, {row["name"]: row for row in earlier})
    figures += _surfaces(rows)
    return figures


def _shares(furniture: Sequence[Row], others: Sequence[Row], truly: bool) -> Iterator[Figure]:
    """What is known and wrong, and what is not known; how much of that is said counts with the word only."""
    groups = (("furniture", furniture, 0.001, 0.95, 0.10), ("others", others, 0.003, 0.87, 0.20))
    for name, rows, gross, known_iou, not_known in groups:
        if not rows:
            continue
        yield at_most(f"{name}: known_gross_share, greatest", max(row.known_gross for row in rows), gross)
        right = sum(row.known_gross <= gross for row in rows)
        yield stated(
            f"{name}: objects up to {gross:.1%}", f"{right} of {len(rows)}{_bounds(right, len(rows))}"
        )
        yield stated("above it", [_with(row, row.known_gross) for row in rows if row.known_gross > gross])
        yield from _mean(f"{name}: IoU on known, mean", rows, lambda row: row.known_iou, at_least, known_iou)
        share = f"{name}: true volume not known, mean"
        mean = float(np.mean([row.not_known for row in rows]))
        yield at_most(share, mean, not_known) if truly else stated(share, mean)
    couches = [row for row in furniture if row.family == "couch"]
    if couches and truly:
        yield at_most("couches: true volume not known, greatest", max(row.not_known for row in couches), 0.12)
    every = [*furniture, *others]
    for name, near in (("solid", _near_solid), ("air", _near_air)) if every else ():
        yield from _mean(f"unknown_near_measured, {name}, mean", every, near, at_most, 0.06)
        worst = max(every, key=lambda row: near(row) or 0)
        yield stated(f"the same, {name}, greatest", _with(worst, near(worst)))


def _bounds(right: int, of: int) -> str:
    """The share's 95 % bounds by Clopper and Pearson (Biometrika 26, 1934), in words."""
    from scipy.stats import beta

    low = float(beta.ppf(0.025, right, of - right + 1)) if right else 0.0
    high = float(beta.ppf(0.975, right + 1, of - right)) if right < of else 1.0
    return f" ({low:.0%} to {high:.0%})"


def _near_solid(row: Row) -> float | None:
    return row.near_solid


def _near_air(row: Row) -> float | None:
    return row.near_air


def _estimates(rows: Sequence[Row]) -> Iterator[Figure]:
    """The estimated IoU, its interval, and the probability."""
    held = [row.in_interval for row in rows if row.in_interval is not None]
    if held:
        yield at_least("IoU within the interval, share of objects", float(np.mean(held)), 0.95)
        yield stated("objects", f"{sum(held)} of {len(held)}{_bounds(sum(held), len(held))}")
        closed = [row for row in rows if not row.has_frontier]
        ajar = [row for row in rows if row.has_frontier and row.not_known <= 0.2]
        groups = (("no frontier", closed, 0.08), ("a frontier, at most 20 % unknown", ajar, 0.20))
        for name, some, bar in groups:
            widths = [row.high - row.low for row in some if row.high is not None and row.low is not None]
            if widths:
                yield at_most(f"{name}: high - low, median", float(np.median(widths)), bar)
    else:
        yield stated("IoU within the interval", "quality.json has none")
    off = {row.name: row.off for row in rows if row.off is not None}
    if off:
        yield at_most("estimated_iou: median error", float(np.median(np.abs([*off.values()]))), 0.03)
        silent = [row for row in rows if abs(row.off or 0) > 0.10 and not (row.has_frontier and row.warnings)]
        yield at_most("estimated_iou off by over .10, and nothing says so: objects", len(silent), 0)
        yield stated("which", [_with(row, row.off) for row in silent])
        yield stated("of these with the verdict `good`", sum(not row.warnings for row in silent))
    known = [
        abs(row.estimated_known - row.known_iou) for row in rows if row.estimated_known and row.known_iou
    ]
    if known:
        yield at_most("estimated_known_iou: median error", float(np.median(known)), 0.03)
        inside = [bool(row.known_in_interval) for row in rows if row.known_in_interval is not None]
        yield at_least("IoU on known within its interval, share of objects", float(np.mean(inside)), 0.95)
    yield from _mean(
        "calibration error, mean of the objects'", rows, lambda row: row.calibration, at_most, 0.03
    )
    bins = [each for row in rows for each in row.bins]
    pooled = equal_bins(
        np.repeat([each.mean_probability for each in bins], COPIES),
        np.repeat([each.inside_share for each in bins], COPIES),
    )
    yield stated("calibration error, all objects' bins together", calibration_error(pooled))


def _against(furniture: Sequence[Row], earlier: dict[str, Any]) -> Iterator[Figure]:
    """The IoU of furniture against that of an earlier run."""
    both = [(row, float(earlier[row.name]["iou"])) for row in furniture if row.name in earlier]
    if not both:
        return
    gains = {row.name: row.iou - before for row, before in both}
    yield at_least(
        "furniture: IoU gained against the earlier run, mean", float(np.mean([*gains.values()])), 0.005
    )
    for family in dict.fromkeys(row.family for row, _ in both):
        gain = float(np.mean([gains[row.name] for row, _ in both if row.family == family]))
        yield at_least(f"{family}: IoU gained, mean", gain, -0.005)


def _surfaces(rows: Sequence[Row]) -> Iterator[Figure]:
    """Where the surface lies, and how much of it is there."""
    for name, side in (("upper faces", "up"), ("sides", "side"), ("undersides", "down")):
        before, after = (_mean_bias(rows, side, refined) for refined in (False, True))
        if after is not None and before is not None:
            yield stated(f"bias of measured {name}, mean, mm", 1000 * before)
            met = abs(after) <= 0.0004
            yield Figure(f"the same after refinement, {name}, mm", 1000 * after, "within 0.4", met)
    before_m = mean_of(rows, lambda row: row.refined.measured_distance_m)
    refined_m = mean_of(rows, lambda row: row.refined.refined_distance_m)
    if before_m is not None and refined_m is not None:
        yield stated("measured surface: mean distance, mm", 1000 * before_m)
        yield at_most("measured surface: mean distance after refinement, mm", 1000 * refined_m, 0.8)
    scene_f = mean_of(rows, lambda row: row.scene_f)
    if scene_f is not None:  # only the object is searched in it
        yield stated("fused scene: F at 5 mm, what was seen, mean", scene_f)
    fused = {row.name: row.fused_f for row in rows if row.fused_f is not None}
    if fused:
        measured = "fused object, what was measured: F at 5 mm"
        yield at_least(f"{measured}, mean", float(np.mean([*fused.values()])), 0.97)
        yield at_least(f"{measured}, least", min(fused.values()), 0.93)
    yield from _mean(
        "closed mesh: F at 5 mm, what was seen, mean", rows, lambda row: row.mesh_f, at_least, 0.97
    )


def _mean_bias(rows: Sequence[Row], side: str, refined: bool) -> float | None:
    def bias_m(row: Row) -> float | None:
        found: float | None = getattr(row.refined.face_bias_m if refined else row.bias, side)
        return found

    return mean_of(rows, bias_m)


def _mean(
    name: str,
    rows: Sequence[Row],
    value: Callable[[Row], float | None],
    held: Callable[[str, float, float], Figure],
    bar: float,
) -> Iterator[Figure]:
    mean = mean_of(rows, value)
    if mean is not None:
        yield held(name, mean, bar)


def _with(row: Row, value: float | None) -> str:
    return row.name if value is None else f"{row.name} {value:.3f}"


def _task(row: Row, root: Path, folder: Path) -> Task:
    return Task(row.name, row.family, "", root / "build" / row.name, truth_folder(folder / row.name))


def options_of() -> argparse.Namespace:
    """The command line, checked."""
    parser = arguments(__doc__)
    parser.add_argument(
        "--families", nargs="+", metavar="FAMILY", choices=list(families()), help="instead of --split"
    )
    # The bars are of families that nothing was fitted to.
    parser.add_argument("--split", choices=list(SPLITS), default="reported-only")
    parser.add_argument("--seeds", nargs="+", type=int, default=list(SEEDS), metavar="N")
    paths = [AUTO, *PRESETS]
    parser.add_argument(
        "--path", nargs="+", default=[AUTO], choices=paths, metavar="PRESET",
        help=f"presets; {AUTO}: {LARGE_PRESET}, or {NEAR_PRESET} for what is up to {TABLE_TOP_M:g} m",
    )  # fmt: skip
    parser.add_argument(
        "--set",
        nargs="+",
        default=[],
        metavar="KEY=VALUE",
        help="of the simulation, such as sensor.width=320",
    )
    parser.add_argument(
        "--underside",
        choices=("unseen", "truly"),
        default="unseen",
        help="truly: closed, of those families of which it is true",
    )
    parser.add_argument("--build", type=Path, metavar="DIR", help="build there and keep it")
    parser.add_argument(
        "--recordings", type=Path, metavar="DIR", help="simulated recordings; default: in DIR of --build"
    )
    parser.add_argument(
        "--upto", choices=("segment", "pairs"), default="segment", help="the last stage to build"
    )
    parser.add_argument("--jobs", type=int, default=CORES, metavar="N", help="processes")
    parser.add_argument("--against", type=Path, metavar="FILE", help="JSON of an earlier run")
    parser.add_argument("--guided", action="store_true", help="only a walk as the guide says, and an orbit")
    parser.add_argument("--sheets", type=Path, metavar="DIR", help="draw the objects on sheets there")
    return parser.parse_args()


def main() -> None:
    options = options_of()
    families = options.families or SPLITS[options.split]
    chosen = recordings(families, options.seeds, options.path, options.set)
    earlier = json.loads(options.against.read_text())["objects"] if options.against else []
    found: dict[str, Any] = {}

    def measure() -> list[Figure]:
        if options.guided:
            pairs = [(family, seed) for family in families for seed in options.seeds]
            return [figure for pair in pairs for figure in guided_figures(*pair)]
        folder = options.recordings or root / "recordings"
        truly = options.underside == "truly"
        rows, missing = measured(root, folder, chosen, truly, options.upto, options.jobs)
        found.update(as_json(rows, missing))
        print_tables(rows, missing)
        if options.sheets and rows:
            draw_sheets([_task(row, root, folder) for row in rows], options.sheets, options.jobs)
        return bars(rows, missing, truly, earlier)

    with build_root(options.build) as root:
        run(options, measure, found)


if __name__ == "__main__":
    main()
