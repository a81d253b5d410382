"""What each rule of the solid earns: every one is left out in turn, on objects that `known` built.

A row for each rule: how the mean over the objects changes without it. Rules are chosen on the families that
may be looked at; the table in docs/evidence/ground-truth.md is of those that are only reported.
"""

import argparse
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

import numpy as np
from figures import Figure, arguments, run, told
from known_observations import SPLITS, Observed, observed
from rich.console import Console
from rich.table import Table

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.types import Bools
from kinectbench.lab.evaluate.known import CALIBRATED_M, GROSS_M, calibration_error, equal_bins
from kinectbench.stages.segment.solid import evidence, guess, solid

COLUMNS = ("IoU", "IoU on known", "gross %", "worst %", "not known %", "calibration")


def _as_it_is(solid_cells: Bools, *others: Any) -> Bools:
    return solid_cells


def _deep_by_distance(behind: Bools, in_front: Bools, tsdf_m: Any, voxel_m: float) -> Bools:
    beyond: Bools = behind & (tsdf_m < -max(evidence.SHELL_M, 1.5 * voxel_m))
    return beyond


# What stands in a rule's place when it is left out: module, name, value.
RULES: Mapping[str, tuple[tuple[ModuleType, str, Any], ...]] = {
    "all rules": (),
    "slits are unknown": ((evidence, "NARROWER", 1.0),),
    "deep behind a surface nothing is told": ((evidence, "SHELL_M", 1.0),),
    "the way to the surface tells depth": ((evidence, "_beyond_band", _deep_by_distance),),
    "right under the object it goes on": ((guess, "rim_voxels", lambda limits, voxel_m: 0),),
    "hidden legs are carried up": ((solid, "carried_up", _as_it_is),),
}


@dataclass(frozen=True)
class Shares:
    """Of one object: as in `Row`, but on the object's own voxels."""

    iou: float
    known_iou: float
    gross: float
    not_known: float
    calibration: float


@contextmanager
def without(rule: str) -> Iterator[None]:
    """A rule left out."""
    patches = [patch.object(module, name, value) for module, name, value in RULES[rule]]
    for each in patches:
        each.start()
    try:
        yield
    finally:
        for each in patches:
            each.stop()


def shares(one: Observed) -> Shares:
    """What the rules make of one object."""
    shape = solid.solidify(one.whole, one.excluded, evidence.Rules(one.layers, one.ray_width_m))
    true, built, known = one.true, shape.solid, shape.labels != Label.UNKNOWN
    volume = int(true.sum())
    wrong = known & (built != true) & (one.distance_m > GROSS_M)
    asked = ~known | (one.distance_m <= CALIBRATED_M)
    bins = equal_bins(shape.probability[asked].astype(np.float64), true[asked])
    return Shares(
        iou=int((built & true).sum()) / int((built | true).sum()),
        known_iou=int((built & true & known).sum()) / max(int(((built | true) & known).sum()), 1),
        gross=int(wrong.sum()) / volume,
        not_known=int((true & ~known).sum()) / volume,
        calibration=calibration_error(bins) or 0.0,
    )


def ablation(root: Path, recordings: Path, families: tuple[str, ...]) -> dict[str, list[Shares]]:
    """Every rule left out in turn, for each object."""
    found: dict[str, list[Shares]] = {rule: [] for rule in RULES}
    for one in observed(root, recordings, families):
        for rule, rows in found.items():
            with without(rule):
                rows.append(shares(one))
        print(f"{one.name}: IoU {found['all rules'][-1].iou:.3f}", flush=True)
    return found


def print_table(found: Mapping[str, list[Shares]]) -> None:
    """Means with all rules, and how they change without each."""
    table = Table("left out", *(COLUMNS))
    means: dict[str, list[float]] = {}
    columns: tuple[Callable[[list[Shares]], float], ...] = (
        lambda rows: float(np.mean([row.iou for row in rows])),
        lambda rows: float(np.mean([row.known_iou for row in rows])),
        lambda rows: 100 * float(np.mean([row.gross for row in rows])),
        lambda rows: 100 * max(row.gross for row in rows),
        lambda rows: 100 * float(np.mean([row.not_known for row in rows])),
        lambda rows: float(np.mean([row.calibration for row in rows])),
    )
    for rule, rows in found.items():
        means[rule] = [column(rows) for column in columns]
        base = means["all rules"]
        values = (
            means[rule] if rule == "all rules" else [a - b for a, b in zip(means[rule], base, strict=True)]
        )
        sign = "" if rule == "all rules" else "+"
        table.add_row(rule, *(f"{value:{sign}.{2 if 2 <= k < 5 else 4}f}" for k, value in enumerate(values)))
    Console(width=150).print(table)


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--build", type=Path, required=True, metavar="DIR", help="what known.py has built")
    parser.add_argument("--recordings", type=Path, required=True, metavar="DIR", help="of these builds")
    parser.add_argument("--split", choices=sorted(SPLITS), default="reported-only")
    parser.add_argument("--families", nargs="+", metavar="FAMILY", help="instead of --split")
    options: argparse.Namespace = parser.parse_args()

    def measure() -> list[Figure]:
        found = ablation(options.build, options.recordings, tuple(options.families or SPLITS[options.split]))
        print_table(found)
        return [told("objects", len(found["all rules"]))]

    run(options, measure)


if __name__ == "__main__":
    main()
