"""Does training on fused truth help? One small network, taught in four ways, tested on held-out objects.

Objects are simulated and built as recordings are. Each pair of theirs then exists four times, in the same
cube and seen from the same side:

    a  noise-free depth, the exact shape
    b  depth of the simulated sensor, the exact shape
    c  depth of the simulated sensor, the fused shape: what a benchmark of recordings has
    d  as b, but what the fused truth does not know is left out of the loss

The same network learns from each for the same number of steps, from the same seeds, and is tested on depth of
the simulated sensor with the exact shape, of other objects of the same families. Pairs that a build refuses
are in none of the four. The threshold is chosen on objects that are neither learnt from nor tested on, by
their exact shapes, or is 0.5. Intervals are those of a bootstrap that draws families, objects of each, and
seeds anew: they hold for other objects and other seeds.

    python benchmarks/training_truth.py --build DIR             # some 90 minutes of two cores; goes on in DIR
"""

import argparse
import json
import shutil
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from builds import CORES, run_on_build
from figures import Figure, arguments, at_least, told
from numpy.typing import NDArray

from kinectbench.core.errors import KinectBenchError
from kinectbench.core.storage import canonical_json, replaced_file, sha256_file, sha256_text
from kinectbench.core.types import Float64
from kinectbench.core.voxels.pair_file import Pair, pack, pair_bytes, unpack
from kinectbench.core.voxels.view_grids import partial_grids
from kinectbench.engine.artefact import VERSIONS
from kinectbench.engine.parallel import build
from kinectbench.engine.stages import Job
from kinectbench.lab.evaluate.build import read_build, register
from kinectbench.lab.evaluate.pairs import grid_in_truth
from kinectbench.lab.evaluate.solid import iou
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.lab.simulate.truth import Truth, mesh_occupancy, read_truth, truth_folder
from kinectbench.lab.synthesize.views import DepthCamera
from kinectbench.scoring.counts import THRESHOLDS
from kinectbench.settings.models import BenchmarkSettings

WAYS = {
    "a": "noise-free depth, exact shape",
    "b": "sensor's depth, exact shape",
    "c": "sensor's depth, fused shape",
    "d": "as b, what fusion does not know left out",
}
FAMILIES = ("chair", "table", "bench", "couch", "open_box", "bookshelf", "lamp", "open_cabinet")
# Seeds of the objects of each family, by what they are for; more learn than must, as some cannot be built.
SEEDS = {"train": range(6), "validation": range(100, 101), "test": range(200, 202)}
LEAST_OBJECTS = 40
VIEWS = 8
# Of a test object's pairs every second is predicted, which takes as long as learning.
TESTED = slice(None, None, 2)
# As preset known-v1, a third of its frames at a quarter of its pixels: a minute of one core.
RECORDING: dict[str, Any] = {
    "path": {"frames": 60, "rate_hz": 10 / 3, "elevation_rad": 0.48, "swing_rad": 0.305, "swings": 2.5},
    "sensor": {"width": 320, "height": 240},
}
CONFIG: dict[str, Any] = {
    "network": {"kind": "3d-recae", "channel_divisor": 8, "output_cells": 128, "initial_weights": "he"},
    "loss": {"kind": "cross-entropy", "tile_cells": 64},
}
BATCH, RATE = 4, 1e-3
RESAMPLES = 4000


class Thing(NamedTuple):
    """An object and what it is for."""

    family: str
    seed: int
    split: str

    @property
    def name(self) -> str:
        """Of its recording."""
        return f"{self.family}_{self.seed:03d}"


THINGS = tuple(
    Thing(family, seed, split) for split, seeds in SEEDS.items() for seed in seeds for family in FAMILIES
)


def prepare(thing: Thing, root: Path) -> str | None:
    """Simulate and build an object, and write its pairs in the four ways; says why it cannot be used."""
    spec = RECORDING | {"object": f"{thing.family}:seed={thing.seed}", "seed": thing.seed}
    key = sha256_text(canonical_json({"spec": spec, "views": VIEWS, "versions": VERSIONS}))[:16]
    recording, done = root / "recordings" / thing.name, root / "pairs" / thing.name / f"done-{key}"
    if done.is_file():
        return done.read_text(encoding="utf-8") or None
    for folder in (recording, truth_folder(recording), root / "build" / thing.name, done.parent):
        shutil.rmtree(folder, ignore_errors=True)  # of an earlier version, or unfinished
    simulate(SimulationSpec.model_validate(spec), recording)
    settings = BenchmarkSettings.model_validate(
        {
            "name": "training-truth",
            "recordings": [{"id": thing.name, "path": str(recording), "category": thing.family}],
            "views": {"count": VIEWS},
        }
    )
    job = Job(settings, settings.recordings[0], root)
    (outcome,) = build([job], workers=1)
    problem = str(outcome.error) if outcome.error else ""
    if not problem:
        found = read_build(job.build)
        truth = read_truth(truth_folder(recording))
        registration = register(found, truth)
        eye = DepthCamera(truth.mesh_world, found.camera)
        frames = {view.name: view.frame for view in found.views or ()}
        for name in found.pair_names or ():
            T_world_camera = truth.T_world_camera[registration.true_frame[frames[name]]]
            for way, pair in four_ways(found.pair(name), truth, eye, T_world_camera).items():
                path = root / "pairs" / thing.name / way / f"{name}.npz"
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(pair_bytes(pair))
        problem = "" if found.pair_names else "no pair"
    done.parent.mkdir(parents=True, exist_ok=True)
    with replaced_file(done) as temporary:
        temporary.write_text(problem, encoding="utf-8")
    return problem or None


def four_ways(pair: Pair, truth: Truth, eye: DepthCamera, T_world_camera: Float64) -> dict[str, Pair]:
    """A built pair with each input and truth; the true camera (4, 4) says where its cube lies."""
    grid = grid_in_truth(pair, T_world_camera)
    exact, everywhere = pack(mesh_occupancy(truth.mesh_world, grid)), np.full_like(pair.known, 255)
    fine, coarse = partial_grids(eye.depth_m(T_world_camera), eye.camera, T_world_camera, grid)
    return {
        "a": replace(pair, partial=coarse, partial_256=fine, full=exact, known=everywhere),
        "b": replace(pair, full=exact, known=everywhere),
        "c": pair,
        "d": replace(pair, full=exact),
    }


def learn(way: str, seed: int, steps: int, root: Path, names: dict[str, list[str]]) -> list[list[float]]:
    """IoU of each test object at each threshold after training, then those of validation: rows of objects."""
    import torch

    from kinectbench.networks.config import MethodSettings
    from kinectbench.networks.data import PairFile, batches
    from kinectbench.networks.registry import make_network
    from kinectbench.networks.steps import Learner

    torch.set_num_threads(1)
    config = MethodSettings.model_validate(
        {
            "name": way,
            **CONFIG,
            "loss": {**CONFIG["loss"], "unknown": "mask" if way == "d" else "count"},
            "training": {"batch": BATCH, "learning_rate": RATE, "schedule": "cosine", "seed": seed},
        }
    )
    files = [path for name in names["train"] for path in sorted((root / "pairs" / name / way).glob("*.npz"))]
    pairs = [PairFile(path, sha256_file(path)) for path in files]
    looked_at = names["test"] + names["validation"]
    known = {
        "config": config.model_dump(mode="json"),
        "steps": steps,
        "pairs": [pair.sha256 for pair in pairs],
    }
    key = sha256_text(canonical_json(known | {"looked_at": looked_at}))
    kept = root / "runs" / f"{way}-{seed}-{key[:16]}.json"
    if kept.is_file():
        rows: list[list[float]] = json.loads(kept.read_text(encoding="utf-8"))
        return rows
    network = make_network(config.network, seed)
    learner = Learner(network, config, "cpu", (0, 1))
    for step, batch in enumerate(batches(pairs, config, range(steps), "cpu")):
        learner.step(batch, step, 0, step / steps)
    rows = [_curve(network, root / "pairs" / name / "b", config) for name in looked_at]
    kept.parent.mkdir(parents=True, exist_ok=True)
    with replaced_file(kept) as temporary:
        temporary.write_text(json.dumps(rows), encoding="utf-8")
    return rows


def _curve(network: Any, folder: Path, config: Any) -> list[float]:
    """Mean IoU over an object's views at each of the seventeen thresholds, against the exact shape."""
    from kinectbench.networks.validate import completed
    from kinectbench.scoring.counts import protocol_counts, tally
    from kinectbench.scoring.metrics import ious
    from kinectbench.scoring.truth import read_parts, read_truth

    curves = []
    for path in sorted(folder.glob("*.npz"))[TESTED]:
        sha256 = sha256_file(path)
        (partial,) = read_parts(path, sha256, ("partial",))
        counted = tally(completed(network, unpack(partial), config, "cpu"), read_truth(path, sha256))
        curves.append(ious(protocol_counts(counted, "paper")))
    return [float(value) for value in np.mean(curves, axis=0)]


def at_threshold(rows: NDArray[np.float64], tests: int, index: int | None = None) -> Float64:
    """IoU of each test object, (tests,), at one threshold: that which suits the validation objects best."""
    best = int(np.argmax(rows[tests:].mean(axis=0))) if index is None else index
    return rows[:tests, best]


def measure(options: argparse.Namespace, root: Path) -> Sequence[Figure]:
    """Prepare all objects, train every way from every seed, and compare."""
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        problems = list(pool.map(prepare, THINGS, [root] * len(THINGS)))
        usable = [thing for thing, problem in zip(THINGS, problems, strict=True) if problem is None]
        names = {split: [thing.name for thing in usable if thing.split == split] for split in SEEDS}
        if len(names["test"]) < len(FAMILIES) or not names["validation"]:
            raise KinectBenchError("too few objects could be built")
        runs = [(way, seed) for seed in range(options.seeds) for way in WAYS]
        count = len(runs)
        ways, seeds = zip(*runs, strict=True)
        found = pool.map(learn, ways, seeds, [options.steps] * count, [root] * count, [names] * count)
        tables = dict(zip(runs, (np.array(rows) for rows in found), strict=True))
    families = [thing.family for thing in usable if thing.split == "test"]
    figures = [
        at_least("objects that are learnt from", len(names["train"]), LEAST_OBJECTS),
        told("objects that are tested on, families", f"{len(families)}, {len(set(families))}"),
        told("pairs that are learnt from", sum(len(_pairs(root, name)) for name in names["train"])),
        told(
            "IoU of fused and exact shapes that are learnt from", round(_fused_iou(root, names["train"]), 3)
        ),
    ]
    for words, index in (("best threshold", None), ("threshold 0.5", THRESHOLDS.index(0.5))):
        # (seeds, objects) of each way
        values = {
            way: np.array(
                [at_threshold(tables[way, seed], len(families), index) for seed in range(options.seeds)]
            )
            for way in WAYS
        }
        for way, what in WAYS.items():
            figures.append(told(f"{words}: {way} ({what}), IoU", with_interval(values[way], families)))
        for way in ("a", "c", "d"):
            difference = values[way] - values["b"]
            each = ", ".join(f"{value:+.3f}" for value in difference.mean(axis=1))
            text = f"{with_interval(difference, families)}; by seed {each}"
            figures.append(told(f"{words}: {way} - b", text))
    return figures


def with_interval(values: Float64, families: Sequence[str]) -> str:
    """The mean of (seeds, objects), with a 95 % interval of families, objects and seeds drawn anew."""
    rng, of = np.random.default_rng(0), np.array(families)
    groups = [np.flatnonzero(of == family) for family in dict.fromkeys(families)]
    means = []
    for _ in range(RESAMPLES):
        drawn = [groups[index] for index in rng.integers(len(groups), size=len(groups))]
        objects = np.concatenate([rng.choice(group, len(group)) for group in drawn])
        means.append(values[np.ix_(rng.integers(len(values), size=len(values)), objects)].mean())
    low, high = np.quantile(means, [0.025, 0.975])
    return f"{values.mean():.3f} ({low:.3f} to {high:.3f})"


def _pairs(root: Path, name: str) -> Sequence[Path]:
    return sorted((root / "pairs" / name / "b").glob("*.npz"))


def _fused_iou(root: Path, names: Sequence[str]) -> float:
    """How good the truth is that way c learns from."""
    from kinectbench.core.voxels.pair_file import read_pair

    return float(
        np.mean(
            [
                iou(unpack(read_pair(path.parents[1] / "c" / path.name).full), unpack(read_pair(path).full))
                for name in names
                for path in _pairs(root, name)
            ]
        )
    )


def main() -> None:
    parser = arguments(__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--jobs", type=int, default=CORES)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=160, help=f"of {BATCH} pairs each")
    run_on_build(parser, measure)


if __name__ == "__main__":
    main()
