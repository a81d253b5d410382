"""Ground truth against the truth: pairs and masks of simulated recordings, held against the simulator's.

A recording counts if its truth lies beside it (`recordings/chair_01` has `recordings/chair_01.truth`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from builds import built, run_on_build
from figures import Figure, arguments, at_least, stated
from numpy.typing import NDArray

from kinectbench.core.voxels.pair_file import read_pair, unpack
from kinectbench.engine.stages import Job
from kinectbench.lab.simulate.truth import Truth, mesh_occupancy, read_truth, truth_folder
from kinectbench.settings.file import load_benchmark
from kinectbench.settings.models import BenchmarkSettings
from kinectbench.stages.sample_views.views import View, read_views

REPOSITORY = Path(__file__).resolve().parents[2]
MIN_IOU = 0.70
MIN_MASK_IOU = 0.93


@dataclass(frozen=True)
class PairAgainstTruth:
    """One pair and its view against the truth, on the pair's own 256-grid.

    Attributes:
        full: IoU of `full` with the true solid, over all voxels.
        known: the same over the `known` ones.
        shell: IoU of `shell` with the true solid, over all voxels.
        not_known: share of the true solid that is not `known`.
        mask: IoU of the view's mask with the true silhouette, both on valid depth pixels.
    """

    full: float
    known: float
    shell: float
    not_known: float
    mask: float


def settings_with_truth(folder: Path, overrides: Sequence[str] = ()) -> BenchmarkSettings:
    """The settings of a benchmark, reduced to recordings with truth beside them; paths made absolute."""
    settings = load_benchmark(folder / "benchmark.yaml", overrides)
    found = [r.model_copy(update={"path": str((folder / r.path).resolve())}) for r in settings.recordings]
    return settings.model_copy(
        update={"recordings": [r for r in found if truth_folder(Path(r.path)).is_dir()]}
    )


def against_truth(job: Job) -> list[PairAgainstTruth]:
    """Every pair of a built recording against the truth."""
    truth = read_truth(truth_folder(job.source))
    views = [v for v in read_views(job.build / "views") if (job.build / "pairs" / f"{v.name}.npz").is_file()]
    return [_against_truth(job, view, truth) for view in views]


def _against_truth(job: Job, view: View, truth: Truth) -> PairAgainstTruth:
    pair = read_pair(job.build / "pairs" / f"{view.name}.npz")
    full, shell, known = unpack(pair.full), unpack(pair.shell), unpack(pair.known)
    solid = mesh_occupancy(truth.mesh_world, pair.grid)
    valid = _image(job.build / "views" / f"{view.name}.depth.png") > 0
    silhouette = truth.mask(view.frame)
    return PairAgainstTruth(
        full=iou(full, solid),
        known=iou(full & known, solid & known),
        shell=iou(shell, solid),
        not_known=1 - np.count_nonzero(solid & known) / np.count_nonzero(solid),
        mask=iou(view.mask & valid, silhouette & valid),
    )


def iou(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    """Intersection over union."""
    return float(np.count_nonzero(a & b) / np.count_nonzero(a | b))


def _image(path: Path) -> NDArray[np.uint16]:
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))


def figures_of(results: dict[str, list[PairAgainstTruth]]) -> list[Figure]:
    """The figures over all pairs and per object, keyed by recording."""
    pairs = [pair for row in results.values() for pair in row]
    found = [stated("recordings with truth", len(results)), stated("pairs", len(pairs))]
    bars = {"full": MIN_IOU, "known": MIN_IOU, "shell": None, "mask": MIN_MASK_IOU, "not_known": None}
    names = {
        "full": "IoU of `full` with the true solid, all voxels",
        "known": "IoU of `full` with the true solid, `known` voxels",
        "shell": "IoU of `shell` with the true solid, all voxels",
        "mask": "IoU of the mask with the true silhouette, valid depth",
        "not_known": "share of the true solid that is not `known`",
    }
    for key, name in names.items():
        values = np.array([getattr(pair, key) for pair in pairs])
        objects = {recording: _mean(row, key) for recording, row in results.items()}
        bar, worst = bars[key], (max if key == "not_known" else min)
        mean = float(values.mean())
        found.append(stated(f"{name}: mean", mean) if bar is None else at_least(f"{name}: mean", mean, bar))
        found.append(stated("    worst pair", float(worst(values))))
        found.extend(stated(f"    mean of {recording}", value) for recording, value in objects.items())
    return found


def _mean(row: list[PairAgainstTruth], key: str) -> float:
    return float(np.mean([getattr(pair, key) for pair in row]))


def measure(folder: Path, root: Path, overrides: Sequence[str] = ()) -> list[Figure]:
    """Build what has truth, and hold it against it."""
    jobs = built(settings_with_truth(folder, overrides), root)
    return figures_of({job.recording.id: against_truth(job) for job in jobs})


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument(
        "benchmark", type=Path, nargs="?", default=REPOSITORY, help="folder of benchmark.yaml"
    )
    run_on_build(parser, lambda options, root: measure(options.benchmark, root))


if __name__ == "__main__":
    main()
