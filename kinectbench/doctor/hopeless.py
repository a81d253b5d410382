"""What no build should begin with: found on eight frames, before all of them are read."""

from kinectbench.doctor.depth import check_depth
from kinectbench.doctor.look import take_look
from kinectbench.doctor.optics import check_intrinsics
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
