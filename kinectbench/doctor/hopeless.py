"""What no build should begin with, found on eight frames before all are read; why one may have failed."""

from kinectbench.doctor.depth import check_depth
from kinectbench.doctor.look import take_look
from kinectbench.doctor.optics import check_intrinsics
from kinectbench.doctor.trajectory import check_trajectory, fit_trajectory
from kinectbench.errors import RecordingError
from kinectbench.ingest.recording import Recording

# What ingest itself does not notice; the poses are judged by `track`, on all frames.
CHECKED = frozenset({"byte_order", "invalid_code", "intrinsics_resolution"})


def refuse_hopeless(recording: Recording) -> None:
    """Refuse a recording of which every frame is wrong in a way that a build can only end badly.

    Raises:
        RecordingError: exchanged bytes, a code read as depth, intrinsics of another size.
    """
    look = take_look(recording, few=True)
    for found in (*check_depth(look), *check_intrinsics(look)):
        if found.severity == "stops" and found.name in CHECKED:
            raise RecordingError(
                f"{found.where}: {found.what}; {found.advice} (`kinectbench inspect` says more)"
            )


def doubted_scale(recording: Recording) -> str:
    """What `inspect` says against the depth's scale where the depth is unlikely, one line; "" if nothing.

    Depth of a small thing is as near as depth with a wrong scale: this is no reason to refuse a recording,
    but the likely one if nothing can be made of it.
    """
    look = take_look(recording)
    by_depth = [found for found in check_depth(look) if found.name == "depth_scale"]
    if not by_depth:
        return ""
    by_poses = [
        found for found in check_trajectory(look, fit_trajectory(look)) if found.name == "depth_scale"
    ]
    # Poses tell the scale, the depth alone only that it is unlikely.
    found = (by_poses or by_depth)[0]
    return f"{found.where}: the depth's scale may be wrong: {found.what}; {found.advice}"
