"""The encoding of a folder's depth images: by the settings, else by the pixels."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.errors import RecordingError
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.images import FLOAT_SCALE, DamagedImageError, decode_depth_png
from kinectbench.stages.ingest.recording import FileRecording, Recording, read_image_file
from kinectbench.stages.ingest.rotated_depth import SAMPLED_IMAGES, find_pattern

# Units a metre: bits are rotated in depth that is kept in millimetres.
MM_SCALE = 1000.0


def with_depth_code(recording: Recording, camera: CameraSettings) -> Recording:
    """The recording with its depth decoded by the detected code.

    Rotated depth is looked for where depth is PNG in mm and the settings give no `depth_scale`. In a layout
    whose depth usually is rotated (`often_rotated`) it is no news, and multiples of eight are enough;
    elsewhere a warning says so.

    Raises:
        RecordingError: the settings name a code, and its depth is not PNG images.
    """
    if not isinstance(recording, FileRecording):
        if camera.depth_code is None:
            return recording
        raise RecordingError(
            f"{recording.path}: `depth_code` is of depth images in PNG files, which a {recording.format} "
            "recording has not; remove it",
            what="unused-setting",
        )
    if camera.depth_code == "float16":
        return replace(recording, depth_code="float16", depth_scale=FLOAT_SCALE)
    if camera.depth_code is not None:
        return replace(recording, depth_code=camera.depth_code)
    if camera.depth_scale is not None or recording.depth_scale != MM_SCALE:
        return recording
    pattern = find_pattern(_some_depth(recording))
    if recording.often_rotated:
        return replace(recording, depth_code="rotated" if pattern.possible else "plain")
    if not pattern.found:
        return recording
    what = f"{recording.path}: nearly every depth value is a multiple of 8"
    if pattern.likely:
        note = f"{what}: its bits are rotated, as SUN3D's are, and are put back; if not, `depth_code: plain`"
        return replace(recording, depth_code="rotated", warnings=(*recording.warnings, note))
    note = f"{what}: it is read in mm; if its bits are rotated, as SUN3D's are, give `depth_code: rotated`"
    return replace(recording, warnings=(*recording.warnings, note))


def _some_depth(recording: FileRecording) -> Iterator[NDArray[np.uint16]]:
    """Some depth images as they are stored, evenly over the recording; codes for none are 0."""
    count = len(recording)
    for index in np.unique(np.linspace(0, count - 1, min(SAMPLED_IMAGES, count)).astype(int)).tolist():
        file = recording.places[index].depth
        try:
            yield recording.clean_depth(decode_depth_png(read_image_file(file), str(file)), index)
        except DamagedImageError:
            continue
