"""Fusion against its bars: speed beside Open3D's VoxelBlockGrid, accuracy on shapes and scans, memory.

Scans are simulated recordings of a Kinect v1 around furniture, with true poses and with our tracker's; they
are judged on what the camera saw of the object, in a 2 m cube at 5 mm. Memory is the peak of a process of
its own: the object in its cube at 5 mm, and the whole room at 10 mm. With --cache, recordings are kept.
"""

import argparse
from collections.abc import Sequence as Rows
from pathlib import Path

from builds import build_root
from figures import Figure, arguments, at_most, run
from fusion_scans import SETTINGS, at_object_scale, scan_figures
from fusion_shapes import shape_figures
from fusion_speed import speed_figures
from memory import peak_mb
from tracking_recordings import OBJECTS, ingested, object_spec, sequence_in, simulated, true_poses

from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.engine.processes import submit_all, worker_pool
from kinectbench.lab.simulate.truth import read_truth, truth_folder
from kinectbench.settings.models import FusionSettings
from kinectbench.stages.fuse import fuse

OBJECT_MB, ROOM_MB = 1000.0, 4000.0
ROOM_DEPTH_M = 8.0


def measure_all(options: argparse.Namespace) -> Rows[Figure]:
    """All figures, those of shapes and speed first."""
    with build_root(options.cache) as cache:
        recording = simulated(object_spec("chair", 1, "orbit-v1"), cache / "chair1")
        truth = read_truth(truth_folder(recording))
        figures = shape_figures()
        with ingested(recording) as folder:
            figures += speed_figures(sequence_in(folder), truth)
            tasks = [(folder, recording, scale) for scale in ("object", "room")]
            for task, bar in zip(tasks, (OBJECT_MB, ROOM_MB), strict=True):
                with worker_pool(1) as pool:
                    used_mb = submit_all(pool, fused_peak_mb, [task])[0].result()
                figures.append(at_most(f"{task[2]}: peak memory, MB", used_mb, bar))
        return figures + scan_figures(OBJECTS[: options.objects], cache)


def fused_peak_mb(task: tuple[Path, Path, str]) -> float:
    """Peak memory of this process, which is a fresh one, after fusing a sequence at a scale."""
    folder, recording, scale = task
    sequence = sequence_in(folder)
    trajectory = Trajectory(sequence.stamps_ns, true_poses(sequence), "trust")
    settings = FusionSettings(scene_voxel_size_m=0.01, max_depth_m=ROOM_DEPTH_M)
    if scale == "object":
        sequence = at_object_scale(sequence, read_truth(truth_folder(recording)))
        settings = SETTINGS
    fuse(sequence, trajectory, settings)
    return peak_mb()


if __name__ == "__main__":
    parser = arguments(__doc__)
    parser.add_argument("--cache", type=Path, metavar="DIR", help="keep recordings there")
    parser.add_argument("--objects", type=int, default=len(OBJECTS), choices=range(1, 13), help="scans")
    chosen = parser.parse_args()
    run(chosen, lambda: measure_all(chosen))
