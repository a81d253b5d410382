"""Small things on a table among others, from .45 to .75 m, looking down 30 to 80 degrees.

Rules were chosen with the objects of `CHOSEN_ON` in view; the others are only reported. Each is chosen
without a box, and compared with the truth. What lies in --build is brought up to date and measured;
recordings are simulated where they are missing.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from builds import CORES, build_root
from figures import Figure, arguments, at_least, at_most, run, told
from tracking_recordings import simulated

from kinectbench.core.errors import KinectBenchError
from kinectbench.core.geometry import TriangleMesh, invert_rigid, transform_points
from kinectbench.engine.parallel import build
from kinectbench.engine.processes import submit_all, worker_pool
from kinectbench.engine.stages import Job
from kinectbench.lab.evaluate.build import read_build, register
from kinectbench.lab.evaluate.solid import canonical_cube, compare_on, overlap
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.lab.simulate.truth import Truth, is_truth, read_truth, truth_folder
from kinectbench.settings.models import BenchmarkSettings

CHOSEN_ON = tuple(
    (family, seed) for family in ("mug", "kettle", "toy_animal", "shoe", "vase") for seed in (1, 2)
)
REPORTED = tuple(
    (family, seed) for family in ("bottle", "toy_car", "watering_can", "helmet") for seed in (1, 2, 3)
)
SOLID = ("kettle", "toy_animal", "bottle", "toy_car")
FRAMES = 100
# 30 to 80 degrees, around and a little farther; 0.6 m less or more by a quarter at most.
PATH = {
    "frames": FRAMES,
    "rate_hz": 10.0,
    "distance_m": 0.6,
    "reach_share": 0.12,
    "lowest_m": 0.1,
    "elevation_rad": float(np.radians(55)),
    "swing_rad": float(np.radians(25)),
    "swings": 2.5,
}
# Warnings that name what may be wrong with a solid: a side, an opening or a hollow that nobody saw, and depth
# that is missing. Another warning excuses no solid that is worse than its interval says.
NAMES_THE_CAUSE = (
    "no frame looks at the object's side",
    "nobody looked",
    "nobody saw",
    "was never measured nor enclosed",
    "a hollow that no frame looked into",
    "gave no depth",
    "makes no surface",
)
# The boxes around the built and the true solid overlap by so much if it is the object that was chosen (own
# choice: a neighbour's does not overlap at all, one that touches it makes it twice as large).
SAME_BOX_IOU = 0.6


@dataclass(frozen=True)
class Row:
    """One object.

    Attributes:
        name: of the recording.
        family: of the object.
        error: why it was not built, or "".
        box_iou: of the boxes around the built and the true solid.
        iou: of the solids, 256^3.
        known_iou: over what is known.
        estimated: `estimated_iou`.
        low: `estimated_iou_low`.
        voxel_mm: edge of its voxels.
        warnings: of quality.json.
    """

    name: str
    family: str
    error: str = ""
    box_iou: float = 0.0
    iou: float = 0.0
    known_iou: float = 0.0
    estimated: float = 1.0
    low: float = 1.0
    voxel_mm: float = 0.0
    warnings: tuple[str, ...] = ()

    @property
    def chosen(self) -> bool:
        """Whether it is this object that was chosen."""
        return not self.error and self.box_iou >= SAME_BOX_IOU

    @property
    def below(self) -> bool:
        """Whether it is worse than its interval says."""
        return not self.error and self.iou < self.low

    @property
    def causes(self) -> tuple[str, ...]:
        """The warnings that name what may be wrong with it."""
        return tuple(w for w in self.warnings if any(words in w for words in NAMES_THE_CAUSE))

    @property
    def silently_wrong(self) -> bool:
        """Whether it is worse than its interval says, and no warning names a cause."""
        return self.below and not self.causes


def spec_of(family: str, seed: int, pixels: int) -> SimulationSpec:
    """A thing on a table, with poses."""
    return SimulationSpec.model_validate(
        {
            "object": f"{family}:seed={seed}",
            "seed": seed,
            "world": "first_camera",
            "path": PATH,
            "scene": {"stands_on": "table", "clutter": 4},
            "sensor": {"width": pixels, "height": pixels * 3 // 4},
            "save_depth": False,
        }
    )


@dataclass(frozen=True)
class Recording:
    """What is to be recorded: its name, its object's family, how, and what benchmark.yaml says besides."""

    name: str
    family: str
    spec: SimulationSpec
    said: Mapping[str, Any] = field(default_factory=dict)


def measured(root: Path, chosen: Sequence[Recording], trajectory: str, workers: int) -> list[Row]:
    """Simulate and build what is not there yet, and measure; a line per object as it is done."""
    tasks = [(one.spec, root / "recordings" / one.name) for one in chosen]
    with worker_pool(workers) as pool:
        places = [found.result() for found in submit_all(pool, _simulated, tasks)]
    asked_for = [
        {"id": one.name, "path": str(place.resolve()), "category": one.family, "trajectory": trajectory}
        | dict(one.said)
        for one, place in zip(chosen, places, strict=True)
    ]
    settings = BenchmarkSettings.model_validate({"name": "tabletop", "recordings": asked_for})
    jobs = [Job(settings, recording, root) for recording in settings.recordings]
    outcomes = build(jobs, upto="segment", workers=workers)
    rows = []
    with worker_pool(workers) as pool:
        asked = [
            (one.name, one.family, job.build, truth_folder(place), outcome.error or "")
            for one, job, place, outcome in zip(chosen, jobs, places, outcomes, strict=True)
        ]
        for found in submit_all(pool, _row, asked):
            rows.append(found.result())
            print(line(rows[-1]), flush=True)
    return rows


def _simulated(task: tuple[SimulationSpec, Path]) -> Path:
    spec, place = task
    if spec.mesh is None:
        return simulated(spec, place)
    if not is_truth(truth_folder(place)):
        simulate(spec, place)
    return place


def _row(task: tuple[str, str, Path, Path, str]) -> Row:
    name, family, folder, truth, error = task
    if error:
        return Row(name, family, error)
    try:
        true, built = read_truth(truth), read_build(folder)
        assert built.model is not None
        model, registration = built.model, register(built, true)
        found = overlap(compare_on(canonical_cube(true), model, true, registration))
    except KinectBenchError as problem:
        return Row(name, family, str(problem))
    quality = model.quality
    return Row(
        name,
        family,
        box_iou=box_iou(model.shape.mesh.transformed(registration.T_truth_built), true),
        iou=found.iou,
        known_iou=found.known_iou or 0.0,
        estimated=quality.estimated_iou or 0.0,
        low=quality.estimated_iou_low or 0.0,
        voxel_mm=1000 * model.shape.grid.voxel_size_m,
        warnings=tuple(quality.warnings),
    )


def box_iou(built_world: TriangleMesh, truth: Truth) -> float:
    """IoU of the boxes around two meshes, along the true object's axes."""
    T = invert_rigid(truth.T_world_object)
    built, true = (transform_points(T, mesh.vertices) for mesh in (built_world, truth.mesh_world))
    low, high = np.maximum(built.min(0), true.min(0)), np.minimum(built.max(0), true.max(0))
    both = float(np.prod(np.maximum(high - low, 0)))
    return both / (float(np.prod(np.ptp(built, axis=0))) + float(np.prod(np.ptp(true, axis=0))) - both)


def line(row: Row) -> str:
    """One object in a line."""
    if row.error:
        return f"{row.name:14} {row.error}"
    told_as = "; ".join(warning[:60] for warning in row.warnings)
    return (
        f"{row.name:14} box {row.box_iou:.2f}  IoU {row.iou:.3f}  known {row.known_iou:.3f}  "
        f"est. {row.estimated:.2f} from {row.low:.2f}  {row.voxel_mm:.1f} mm  {told_as}"
    )


def bars(rows: Sequence[Row]) -> list[Figure]:
    """What is asked of them; means are over all objects: of one that was not built the IoU is 0."""
    chosen = [row for row in rows if row.chosen]
    known = [row.known_iou for row in rows]
    solid = [row.known_iou for row in rows if row.family in SOLID]
    return [
        told("objects", len(rows)),
        at_least("chosen without a box, share", len(chosen) / max(len(rows), 1), 0.9),
        told("not chosen", [row.name for row in rows if not row.chosen]),
        at_least("IoU on what is known, mean", _mean(known), 0.80),
        at_least("IoU on what is known, solid things, mean", _mean(solid), 0.85),
        told("IoU, mean", _mean([row.iou for row in rows])),
        at_most("silently wrong", sum(row.silently_wrong for row in rows), 0),
        *(told(f"below its interval, {row.name}", _why(row)) for row in rows if row.below),
    ]


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else 0.0


def _why(row: Row) -> str:
    """How far an object is below its interval, and what its warnings say of that."""
    said = "; ".join(row.causes) or "no warning names a cause"
    return f"IoU {row.iou:.2f}, known {row.known_iou:.2f}, interval from {row.low:.2f}: {said}"


def main() -> None:
    """Run from the command line."""
    parser = arguments(__doc__)
    parser.add_argument("--objects", choices=["chosen-on", "reported", "all"], default="all")
    parser.add_argument("--only", nargs="*", default=[], metavar="NAME", help="such as mug1")
    parser.add_argument("--pixels", type=int, default=320, help="width of the images")
    parser.add_argument("--trajectory", choices=["trust", "refine", "ignore"], default="trust")
    parser.add_argument("--workers", type=int, default=CORES)
    parser.add_argument("--build", type=Path, metavar="DIR", help="build there and keep it")
    options = parser.parse_args()
    objects = {"chosen-on": CHOSEN_ON, "reported": REPORTED, "all": (*CHOSEN_ON, *REPORTED)}[options.objects]
    named = [Recording(f"{one[0]}{one[1]}", one[0], spec_of(*one, options.pixels)) for one in objects]
    chosen = [one for one in named if not options.only or one.name in options.only]
    details: dict[str, Any] = {}

    def measure() -> list[Figure]:
        with build_root(options.build) as root:
            rows = measured(root, chosen, options.trajectory, options.workers)
        details["objects"] = json.loads(json.dumps([asdict(row) for row in rows]))
        return bars(rows)

    run(options, measure, details)


if __name__ == "__main__":
    main()
