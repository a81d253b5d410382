"""What poses that nobody could check cost the fused surface, by their share and by how far they are off.

Scans are simulated recordings whose exact poses are moved. Some frames are checked: their poses are off by
3 mm, and say so. The others are unchecked and off by what a column names. F at 5 mm is that of the visible
surface of the object, mean over the scans. With --cache, recordings are kept.
"""

import argparse
from collections.abc import Sequence as Rows
from dataclasses import replace
from pathlib import Path

import numpy as np
from builds import build_root
from figures import Figure, arguments, run, told
from fusion_scans import SETTINGS, at_object_scale, object_figures
from tracking_recordings import ingested, object_spec, part, sequence_in, simulated

from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.lab.simulate.truth import Truth, read_truth, truth_folder
from kinectbench.settings.models import TrackingSettings
from kinectbench.stages.fuse import fuse
from kinectbench.stages.track import track

SCANS = (("chair", 1), ("table", 2), ("couch", 3))
STRIDE = 5
CHECKED_OFF_M = 0.003
UNCHECKED_OFF_M = (0.0, 0.01, 0.02)


def moved(trajectory: Trajectory, checked_frames: int, off_m: float) -> Trajectory:
    """A trajectory of which some frames, drawn at random, say how far they are off, and the others don't."""
    generator = np.random.default_rng(0)
    good = generator.permutation(trajectory.good_frames)
    sigma_m = np.full(len(trajectory.stamps_ns), np.nan)
    sigma_m[good[:checked_frames]] = CHECKED_OFF_M
    directions = generator.normal(size=(len(sigma_m), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    T_world_camera = trajectory.T_world_camera.copy()
    T_world_camera[:, :3, 3] += directions * np.where(np.isnan(sigma_m), off_m, CHECKED_OFF_M)[:, None]
    return replace(trajectory, T_world_camera=T_world_camera, pose_sigma_m=sigma_m)


def f_scores(sequence: Sequence, truth: Truth) -> list[float]:
    """F at 5 mm for each number of checked frames and each column, row by row."""
    true = track(sequence, "trust", TrackingSettings())
    frames, near = len(true.good_frames), at_object_scale(sequence, truth)
    found = []
    for checked_frames in (0, 1, frames // 2, frames):
        for off_m in UNCHECKED_OFF_M:
            mesh = fuse(near, moved(true, checked_frames, off_m), SETTINGS).mesh
            found.append(object_figures(mesh, truth).visible.scores[0].f)
    return found


def measure_all(options: argparse.Namespace) -> Rows[Figure]:
    """A line for each share of checked frames."""
    rows = []
    with build_root(options.cache) as cache:
        for family, seed in SCANS:
            recording = simulated(object_spec(family, seed, "orbit-v1"), Path(cache) / f"{family}{seed}")
            with ingested(recording) as folder:
                sequence = sequence_in(folder)
                scan = part(sequence, np.arange(0, len(sequence), STRIDE))
                truth = read_truth(truth_folder(recording))
                rows.append(f_scores(scan, replace(truth, T_world_camera=truth.T_world_camera[::STRIDE])))
    means = np.mean(rows, axis=0).reshape(4, -1)
    columns = ", ".join(f"{1000 * off_m:.0f} mm" for off_m in UNCHECKED_OFF_M)
    lines = [", ".join(f"{f:.3f}" for f in mean) for mean in means]
    named = zip(("none", "one frame", "half", "all"), lines, strict=True)
    return [told(f"F at 5 mm, checked: {share}; the others off by {columns}", line) for share, line in named]


if __name__ == "__main__":
    parser = arguments(__doc__)
    parser.add_argument("--cache", type=Path, metavar="DIR", help="keep recordings there")
    chosen = parser.parse_args()
    run(chosen, lambda: measure_all(chosen))
