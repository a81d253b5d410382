"""The guide beside a recording at 30 Hz: the age of its picture, its tracking, and its memory."""

import tempfile
import time
from pathlib import Path

import numpy as np
from figures import Figure, at_most, equals, stated
from memory import watched_workers

from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.association import poses_at
from kinectbench.core.trajectory.compare import compare_poses, has_pose
from kinectbench.core.types import Float64, Int64
from kinectbench.record.devices.replay import Replay
from kinectbench.record.guide.process import GuideProcess
from kinectbench.record.recorder import record
from kinectbench.settings.models import CameraSettings, TrackingSettings
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence
from kinectbench.stages.track import track

HZ, AGE_MS, OLDEST_MS, ATE_TIMES, GUIDE_MB, GAP_S = 30.0, 200.0, 500.0, 1.3, 1500.0, 0.01


def ate_m(sequence: Sequence, T_world_camera: Float64, stamps_ns: Int64) -> float:
    """Of poses, against those that came with the recording, metres."""
    assert sequence.given_trajectory is not None
    T_true = poses_at(sequence.given_trajectory, stamps_ns, GAP_S)
    both = has_pose(T_world_camera) & has_pose(T_true)
    return compare_poses(T_world_camera[both], T_true[both]).ate_m.rmse


def guide_figures(folder: Path, settings: CameraSettings | None) -> list[Figure]:
    """Record a recording that has its true poses, with the guide beside it; then track it as a build does."""
    source = open_recording(folder, settings)
    speed = HZ * float(np.median(np.diff(source.stamps_ns))) / 1e9
    added_s: list[float] = []
    with tempfile.TemporaryDirectory() as name, watched_workers() as peaks:
        guide = GuideProcess()
        out = Path(name) / "out"
        done = record(
            Replay(folder, speed, settings),
            out,
            observers=[guide],
            progress=lambda frames, passed_s: added_s.append(time.monotonic()),
        )
        time.sleep(0.2)  # the memory is looked at once more
        guide.close()
        write_sequence(source, Path(name) / "sequence")
        sequence = read_sequence(Path(name) / "sequence")
        offline = track(sequence, "ignore", TrackingSettings())
        ours = ate_m(sequence, offline.T_world_camera, sequence.stamps_ns)
        written_ns = open_recording(out).stamps_ns
    said = [each for each in guide.said if each.number < len(added_s)]
    age_ms = 1000 * np.array([each.done_s - added_s[each.number] for each in said])
    poses = np.array(
        [np.full((4, 4), np.nan) if s.T_world_camera is None else s.T_world_camera for s in said]
    )
    live = ate_m(sequence, poses, written_ns[[each.number for each in said]])
    return [
        equals(f"guide: frames written of {len(source)}", done.frames, len(source)),
        stated("guide: missed, dropped", [done.missed, done.dropped]),
        stated("guide: frames that it looked at, lost", [len(said), int((~has_pose(poses)).sum())]),
        at_most("guide: age of its picture, median, ms", float(np.median(age_ms)), AGE_MS),
        at_most("guide: age of its picture, 99 %, ms", float(np.quantile(age_ms, 0.99)), OLDEST_MS),
        stated("guide: ATE live and offline, mm", [round(1000 * live, 2), round(1000 * ours, 2)]),
        at_most("guide: ATE over that offline", live / ours, ATE_TIMES),
        at_most("guide: peak memory, MB", max(peaks.values()), GUIDE_MB),
    ]
