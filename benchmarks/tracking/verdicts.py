"""What the verdict on a trajectory is worth: its grades, beside the error that simulated recordings tell.

Limits may be chosen on the families that may be looked at; the hit rates of the others are what is reported.
A grade hits if `good` poses are within 10 mm (ATE, root mean square), and `not good` ones are not. Poses are
tracked without a given trajectory, or given ones that drift or jump are trusted. With `--scans` the
recordings are those of `tests/robustness/replica.py`: a passer-by, symmetric objects, three frames a second.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "support"))

from builds import CORES, run_on_build
from figures import Figure, arguments, at_least, stated
from replica_scans import CAMERA, Scan, forty, make

from kinectbench.core.artefacts.trajectory import Grade
from kinectbench.core.errors import TrackingError
from kinectbench.core.trajectory.compare import compare_poses
from kinectbench.engine.processes import submit_all, worker_pool
from kinectbench.lab.simulate.presets import preset_spec
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.truth import read_truth, truth_folder
from kinectbench.settings.models import CameraSettings, TrackingSettings
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence
from kinectbench.stages.track import track

FAMILIES = {"looked at": ("chair", "table", "couch"), "reported": ("sideboard", "stool", "bed")}
PRESETS = (
    "orbit-v1", "arc-v1", "half-v1", "stride3-v1", "blur-v1", "jolt-v1", "outdoor-v1", "cluttered-v1",
    "steep-v1", "far-v1", "azure-v1", "phone-v1", "turns-v1", "drift-v1", "jump-v1",
)  # fmt: skip
GIVEN = ("drift-v1", "jump-v1")
FRAMES, SIZE_PX = 150, {"width": 320, "height": 240}
GOOD_M = 0.010
# Of the good ones, and of those that are not.
LEAST_HITS = 0.9


@dataclass(frozen=True)
class Judged:
    """One recording: its grade, the rms error of its poses in metres, the share of frames with a pose."""

    group: str
    name: str
    grade: Grade
    ate_m: float = np.nan
    posed_share: float = 0.0


@dataclass(frozen=True)
class Task:
    """One recording to simulate into a folder, and to track: a family by a preset, or a scan."""

    group: str
    name: str
    folder: Path
    family: str = ""
    preset: str = ""
    scan: Scan | None = None


def made(task: Task) -> tuple[Path, CameraSettings | None]:
    """Simulate the recording; it, and intrinsics that it lacks."""
    if task.scan is not None:
        make(task.scan, task.folder)
        camera = CameraSettings.model_validate(yaml.safe_load(CAMERA))
        return task.folder / f"{task.scan.name}.zip", camera
    changes = {
        "object": f"{task.family}:seed=7",
        "seed": 7,
        "save_depth": False,
        "path": {"frames": FRAMES},
        "sensor": {} if task.preset in ("azure-v1", "phone-v1") else SIZE_PX,
    }
    if task.preset not in GIVEN:
        changes["given"] = {"trajectory": "none"}
    recording = task.folder / f"{task.family}-{task.preset}"
    simulate(preset_spec(task.preset, changes), recording)
    return recording, None


def judged(task: Task) -> Judged:
    recording, camera = made(task)
    folder = recording.with_name(f"{recording.name}.sequence")
    folder.mkdir()
    write_sequence(open_recording(recording, camera), folder)
    sequence, truth = read_sequence(folder), read_truth(truth_folder(recording))
    nearest = np.abs(truth.stamps_ns - sequence.stamps_ns[:, None]).argmin(axis=1)
    true = truth.T_world_camera[nearest]
    try:
        found = track(sequence, "trust" if task.preset in GIVEN else "ignore", TrackingSettings())
    except TrackingError:
        return Judged(task.group, task.name, "not good")
    assert found.health is not None
    both = np.isfinite(found.T_world_camera[:, 0, 0]) & np.isfinite(true[:, 0, 0])
    ate_m = compare_poses(found.T_world_camera[both], true[both]).ate_m.rmse
    return Judged(task.group, task.name, found.health.grade, float(ate_m), float(both.mean()))


def by_preset(presets: list[str], root: Path) -> Iterator[Task]:
    for group, families in FAMILIES.items():
        for family in families:
            for preset in presets or PRESETS:
                yield Task(group, f"{family} {preset}", root, family=family, preset=preset)


def by_scan(seeds: list[int], root: Path) -> Iterator[Task]:
    """Those whose archives are whole."""
    for seed in seeds:
        folder = root / f"scans-{seed}"
        folder.mkdir()
        for scan in forty(seed):
            if scan.kind not in ("cut", "damaged"):
                name = f"{scan.name} {scan.object} {scan.kind}"
                yield Task(f"scans of seed {seed}", name, folder, scan=scan)


def rows(found: list[Judged], group: str) -> Iterator[Figure]:
    """How each grade of a group did, and its hit rates."""
    own = [each for each in found if each.group == group]
    for grade in ("good", "fair", "not good"):
        errors_mm = np.array([1000 * each.ate_m for each in own if each.grade == grade])
        if not len(errors_mm):
            yield stated(f"{group}: {grade}", "none")
            continue
        known_mm = errors_mm[np.isfinite(errors_mm)]
        text = f"{len(errors_mm)} recordings"
        if len(known_mm):
            middle, most = np.median(known_mm), known_mm.max()
            within = (known_mm <= 1000 * GOOD_M).mean()
            text += f", ATE median {middle:.1f} mm, largest {most:.1f} mm, {within:.0%} within 10 mm"
        yield stated(f"{group}: {grade}", text)
    good = [each.ate_m for each in own if each.grade == "good"]
    bad = [each.ate_m for each in own if each.grade == "not good"]
    if good:
        hits = float(np.mean([ate_m <= GOOD_M for ate_m in good]))
        yield at_least(f"{group}: good, and within 10 mm", hits, LEAST_HITS)
    if bad:
        misses = float(np.mean([not ate_m <= GOOD_M for ate_m in bad]))
        yield stated(f"{group}: not good, and beyond 10 mm", round(misses, 3))


def measure(options: argparse.Namespace, root: Path) -> list[Figure]:
    tasks = [*(by_scan(options.scans, root) if options.scans else by_preset(options.presets, root))]
    with worker_pool(CORES) as pool:
        found = [future.result() for future in submit_all(pool, judged, tasks)]
    figures = [
        stated(each.name, f"{each.grade}, ATE {1000 * each.ate_m:.1f} mm, {each.posed_share:.0%} with a pose")
        for each in found
    ]
    groups = dict.fromkeys(task.group for task in tasks)
    return [*figures, *(figure for group in groups for figure in rows(found, group))]


if __name__ == "__main__":
    parser = arguments(__doc__)
    parser.add_argument("--presets", nargs="*", default=[], metavar="NAME", help="only these")
    parser.add_argument(
        "--scans", nargs="*", type=int, default=[], metavar="SEED", help="replica's, of seeds"
    )
    run_on_build(parser, measure)
