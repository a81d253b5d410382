"""Opening a recording that may be wrong: what stops it is found, and the rest is looked at all the same."""

from pathlib import Path

from kinectbench.config import CameraSettings
from kinectbench.doctor.finding import Finding
from kinectbench.errors import RecordingError
from kinectbench.ingest.recording import Recording
from kinectbench.ingest.registry import open_recording

# Focal length of a Kinect, as a share of the width.
USUAL_FOCAL = 525 / 640
UNKNOWN = {"fx": 1.0, "fy": 1.0, "cx": 0.0, "cy": 0.0}


def open_anyhow(path: Path, settings: CameraSettings | None) -> tuple[Recording | None, list[Finding]]:
    """Open a recording; where only its intrinsics stand in the way, with those of a Kinect in their place.

    Returns:
        The recording, or None; and what was found.
    """
    try:
        return open_recording(path, settings), []
    except RecordingError as error:
        complaint = str(error)
    try:
        size = open_recording(path, _with(settings, UNKNOWN)).camera
    except RecordingError:
        return None, [Finding("unreadable", "stops", complaint, str(path))]
    focal = USUAL_FOCAL * size.width
    usual = {"fx": focal, "fy": focal, "cx": (size.width - 1) / 2, "cy": (size.height - 1) / 2}
    found = Finding(
        "intrinsics", "stops", complaint, str(path), "all else is judged with intrinsics like a Kinect's"
    )
    return open_recording(path, _with(settings, usual)), [found]


def _with(settings: CameraSettings | None, values: dict[str, float]) -> CameraSettings:
    said = settings.model_dump(exclude_none=True) if settings else {}
    for key in ("width", "height"):
        said.pop(key, None)
    return CameraSettings(**{**said, **values})
