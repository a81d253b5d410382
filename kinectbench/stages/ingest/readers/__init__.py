"""One reader for each format; the table that selects a reader, bags included; and the code of its depth."""

import importlib
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.manifest import Manifest
from kinectbench.core.errors import IntrinsicsError, RecordingError, StorageError
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.stamps import NS_PER_S
from kinectbench.settings.models import CameraSettings
from kinectbench.settings.pick import PICK_FILE
from kinectbench.stages.ingest.depth_codes import SAMPLED_IMAGES, find_pattern
from kinectbench.stages.ingest.images import FLOAT_SCALE, DamagedImageError, decode_depth_png
from kinectbench.stages.ingest.readers.color_only import without_depth
from kinectbench.stages.ingest.recording import FileRecording, Recording, read_image_file
from kinectbench.stages.ingest.sources import check_count, check_link, check_there, files_below

# name -> "module:class"; the first that recognises a layout reads it, so special layouts come first.
FORMATS = {
    "realsense": "kinectbench.stages.ingest.bags.realsense:RealsenseRecording",
    "rosbag1": "kinectbench.stages.ingest.bags.rosbag1:Rosbag1Recording",
    "rosbag2": "kinectbench.stages.ingest.bags.rosbag2:Rosbag2Recording",
    "klg": "kinectbench.stages.ingest.readers.klg:KlgRecording",
    "sens": "kinectbench.stages.ingest.readers.sens:SensRecording",
    "record3d": "kinectbench.stages.ingest.readers.record3d:Record3dRecording",
    "redwood_zip": "kinectbench.stages.ingest.readers.redwood_zip:RedwoodZipRecording",
    "stray": "kinectbench.stages.ingest.readers.stray_scanner:StrayScannerRecording",
    "scanner_app": "kinectbench.stages.ingest.readers.scanner_app:ScannerAppRecording",
    "bop": "kinectbench.stages.ingest.readers.bop:BopRecording",
    "wildrgbd": "kinectbench.stages.ingest.readers.wildrgbd:WildRgbdRecording",
    "azure_kinect": "kinectbench.stages.ingest.readers.azure_kinect:AzureKinectRecording",
    "tum": "kinectbench.stages.ingest.readers.tum:TumRecording",
    "7scenes": "kinectbench.stages.ingest.readers.seven_scenes:SevenScenesRecording",
    "polycam": "kinectbench.stages.ingest.readers.polycam:PolycamRecording",
    "nerfstudio": "kinectbench.stages.ingest.readers.nerfstudio:NerfstudioRecording",
    "sun3d": "kinectbench.stages.ingest.readers.sun3d:Sun3dRecording",
    "scannet": "kinectbench.stages.ingest.readers.scannet_folder:ScannetFolderRecording",
    "ycb": "kinectbench.stages.ingest.readers.ycb:YcbRecording",
    "folder": "kinectbench.stages.ingest.readers.folder:FolderRecording",
}

TRUTH = "truth.json"
# Native units of 16-bit depth a metre: all that it can say lies within kilometres, or 6.5 cm.
LEAST_DEPTH_SCALE, MOST_DEPTH_SCALE = 1e-3, 1e6
# Enough to find a recording near a path that is none; others are not looked at.
LOOKED_AT, LOOKED_AT_FOR_HINT = 1_000_000, 1000
# Units a metre: bits are rotated in depth that is kept in millimetres.
MM_SCALE = 1000.0


@cache
def reader_of(name: str) -> type[Recording]:
    """The class that reads the format of that name in FORMATS."""
    module, _, class_name = FORMATS[name].partition(":")
    reader: type[Recording] = getattr(importlib.import_module(module), class_name)
    return reader


def name_suffixes() -> tuple[str, ...]:
    """Possible endings of recordings' names, such as ".bag"."""
    return tuple(sorted({suffix for name in FORMATS for suffix in reader_of(name).suffixes}))


def format_of(path: Path) -> str | None:
    """The name of the format that a folder or file is in, by layout and first bytes; None if unknown."""
    return next((name for name in FORMATS if reader_of(name).recognises(path)), None)


def says_intrinsics(path: Path) -> bool:
    """Whether the format of a recording has a place for intrinsics; else its reader takes the usual ones."""
    return format_of(path) not in (None, "klg", "redwood_zip")


def open_recording(
    path: Path, camera: CameraSettings | None = None, *, follow_links: bool = False
) -> Recording:
    """Open a recording of any known format.

    Args:
        path: folder or file.
        camera: values that override the recording's.
        follow_links: links in it are followed; else one that holds any is refused.

    Raises:
        RecordingError: it is not there, its format is unknown, or it cannot be used.
    """
    try:
        reader = reader_of(known_format(path))
        _files_of(reader, path, follow_links)
        settings = camera or CameraSettings()
        recording = reader.open(path, settings)
        for scale in (recording.depth_scale, settings.depth_scale or recording.depth_scale):
            _check_scale(path, scale)
        check_count(path, len(recording))
        return with_depth_code(_with_delays(recording, settings), settings)
    except OSError as error:
        raise RecordingError(
            f"{error.filename or path}: cannot be read ({error.strerror})", what="unreadable"
        ) from error


def known_format(path: Path) -> str:
    """The name of the format that a folder or file is in, as `format_of`.

    Raises:
        RecordingError: it is not there, or its format is unknown.
        OSError: it cannot be read.
    """
    check_there(path)
    if not (path.is_dir() or path.is_file()):
        raise RecordingError(
            f"{path}: is neither a folder nor a plain file; correct the recording's `path:`", what="not-found"
        )
    name = format_of(path)
    if name is None:
        raise RecordingError(_unknown(path), what="unknown-format")
    return name


def source_files(path: Path, *, follow_links: bool = False) -> list[Path]:
    """Every file of a recording, sorted: the path itself, or all in the folder that are not hidden.

    What was clicked on its object is none of them: it is asked for in benchmark.yaml, and no frame. Files
    outside the folder that belong to it come last. Nothing is listed before its format is known.

    Args:
        path: folder or file; it may be a link itself.
        follow_links: files and folders in it may be links, too.

    Raises:
        RecordingError: its format is unknown, or it holds links that are not to be followed, what is no plain
            file, or too many files.
    """
    try:
        files = _files_of(reader_of(known_format(path)), path, follow_links)
        return [file for file in files if file != path / PICK_FILE]
    except OSError as error:
        raise RecordingError(
            f"{error.filename or path}: cannot be read ({error.strerror})", what="unreadable"
        ) from error


def _files_of(reader: type[Recording], path: Path, follow_links: bool) -> list[Path]:
    """`source_files` of a recording whose reader is known: to find it, folders are listed."""
    if not path.is_dir():
        return [path]
    beside = reader.files_beside(path)
    for file in beside:
        check_link(file, follow_links=follow_links)
    return [*files_below(path, follow_links=follow_links), *beside]


def find_recordings(folder: Path, most: int = LOOKED_AT) -> list[tuple[Path, str]]:
    """Every recording in a folder and below, as (path, format), sorted; none lies inside another.

    A folder that cannot be read, that begins with a dot, that a build made, or that holds the truth of a
    simulated recording is passed over, with what lies below it.

    Args:
        folder: where they are looked for.
        most: after so many files and folders the others are not looked at.
    """
    return list(_recordings_below(folder, iter(range(most))))


def _recordings_below(folder: Path, numbers: Iterator[int]) -> Iterator[tuple[Path, str]]:
    """Like `find_recordings`; each file or folder uses up one of the numbers."""
    if next(numbers, None) is None:
        return
    try:
        if (folder / TRUTH).is_file() or _is_built(folder):
            return
        name = format_of(folder)
        if name is not None:
            yield folder, name
            return
        children = sorted(folder.iterdir()) if folder.is_dir() and not folder.is_symlink() else []
    except OSError:
        return
    for child in children:
        if not child.name.startswith("."):
            yield from _recordings_below(child, numbers)


def _is_built(folder: Path) -> bool:
    """Whether a stage made the folder; a manifest.json of another program does not say so."""
    try:
        return Manifest.read_if_there(folder) is not None
    except StorageError:
        return False


def _check_scale(path: Path, scale: float) -> None:
    """Refuse a depth scale that no recording has, from any source."""
    if not LEAST_DEPTH_SCALE <= scale <= MOST_DEPTH_SCALE:  # which NaN is not
        raise IntrinsicsError(
            f"{path}: 1 m cannot be {scale:g} units of 16-bit depth; correct the recording's depth scale, or "
            "give `camera: {depth_scale: ...}` (units a metre, such as 1000 or 5000)"
        )


def _with_delays(recording: Recording, camera: CameraSettings) -> Recording:
    """The recording with the delay of given poses removed; its reader corrected colour."""
    given, delay_ns = recording.given_trajectory, round(camera.trajectory_delay_s * NS_PER_S)
    if given is not None:
        given = GivenTrajectory(given.stamps_ns - delay_ns, given.T_world_camera)
    return replace(
        recording,
        given_trajectory=given,
        color_delay_s=camera.color_delay_s,
        trajectory_delay_s=camera.trajectory_delay_s,
    )


def _unknown(path: Path) -> str:
    known = f"the formats that are read are {', '.join(FORMATS)}; `kinectbench formats` says what each needs"
    if path.is_dir() and not any(path.iterdir()):
        return f"{path}: the folder is empty; {known}"
    inside = find_recordings(path, LOOKED_AT_FOR_HINT) if path.is_dir() else []
    reason = None if inside else without_depth(path)
    if reason is not None:
        return reason
    hint = f". Did you mean {inside[0][0]}?" if inside else ""
    return f"{path}: not a recording of a known format; {known}{hint}"


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
