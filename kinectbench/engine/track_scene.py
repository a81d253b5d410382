"""Track the camera against the whole scene; warn if the camera is static (turntable), where this fails."""

from dataclasses import replace

import numpy as np

from kinectbench.core.errors import TrackingError
from kinectbench.core.sequence import GivenTrajectory, Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Progress
from kinectbench.doctor.still import turntable_warning
from kinectbench.settings.models import TrackingSettings, TrajectoryMode
from kinectbench.stages.track import track

# What given poses of a camera on a tripod stray at most, metres.
STRAY_M = 0.02


def track_scene(
    sequence: Sequence,
    mode: TrajectoryMode | None,
    settings: TrackingSettings,
    progress: Progress | None = None,
) -> Trajectory:
    """`track`; unless given poses say that the camera moves, health.json warns of one that stands still.

    Args:
        sequence: the recording.
        mode: of a given trajectory.
        settings: what counts as disagreement.
        progress: called with (done, total).

    Raises:
        TrackingError: as `track`.
    """
    given = None if mode == "ignore" else sequence.given_trajectory
    line = "" if given is not None and _moves(given) else turntable_warning(sequence)
    try:
        trajectory = track(sequence, mode, settings, progress)
    except TrackingError as error:
        raise TrackingError(f"{error}; {line}" if line else str(error), what=error.what) from error
    if not line or trajectory.health is None:
        return trajectory
    warnings = (line, *trajectory.health.warnings)
    return replace(trajectory, health=trajectory.health.model_copy(update={"warnings": warnings}))


def _moves(given: GivenTrajectory) -> bool:
    """Whether the camera's positions vary by more than noise."""
    return bool(np.ptp(given.T_world_camera[:, :3, 3], axis=0).max() > STRAY_M)
