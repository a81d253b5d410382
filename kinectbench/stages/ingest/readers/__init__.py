"""One reader for each format of folder or log; and the table by which a reader is found, bags included."""

import importlib
import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from kinectbench.core.errors import RecordingError
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.stamps import NS_PER_S
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.depth_coding import with_depth_code
from kinectbench.stages.ingest.readers.color_only import without_depth
from kinectbench.stages.ingest.recording import Recording

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
    "folder": "kinectbench.stages.ingest.readers.folder:FolderRecording",
}


TRUTH = "truth.json"


def reader_of(name: str) -> type[Recording]:
    """The class that reads the format of that name in FORMATS."""
    module, _, class_name = FORMATS[name].partition(":")
    reader: type[Recording] = getattr(importlib.import_module(module), class_name)
    return reader


def name_suffixes() -> tuple[str, ...]:
    """How names of recordings of all formats can end, such as ".bag"."""
    return tuple(sorted({suffix for name in FORMATS for suffix in reader_of(name).suffixes}))


def format_of(path: Path) -> str | None:
    """The name of the format that a folder or file is in, by layout and first bytes; None if unknown."""
    return next((name for name in FORMATS if reader_of(name).recognises(path)), None)


def open_recording(path: Path, camera: CameraSettings | None = None) -> Recording:
    """Open a recording of any known format.

    Args:
        path: folder or file.
        camera: values that win over what the recording says.

    Raises:
        RecordingError: it is not there, its format is unknown, or it cannot be used.
    """
    if not path.exists():
        raise RecordingError(f"{path}: there is no such file or folder; correct the recording's `path:`")
    try:
        name = format_of(path)
        if name is None:
            raise RecordingError(_unknown(path))
        settings = camera or CameraSettings()
        recording = reader_of(name).open(path, settings)
        return with_depth_code(_with_delays(recording, settings), settings)
    except OSError as error:
        raise RecordingError(f"{error.filename or path}: cannot be read ({error.strerror})") from error


def source_files(path: Path) -> list[Path]:
    """Every file of a recording, sorted: the path itself, or all in the folder that are not hidden.

    Files outside the folder that belong to it come last.
    """
    if path.is_file():
        return [path]
    with suppress(OSError):
        name = format_of(path)
        beside = () if name is None else reader_of(name).files_beside(path)
        return [*sorted(_walk(path)), *beside]
    return sorted(_walk(path))


def find_recordings(folder: Path) -> list[tuple[Path, str]]:
    """Every recording in a folder and below, as (path, format), sorted; none lies inside another.

    A folder that cannot be read, that begins with a dot, or that holds the truth of a simulated recording is
    passed over.
    """
    try:
        if (folder / TRUTH).is_file():
            return []
        name = format_of(folder)
        if name is not None:
            return [(folder, name)]
        children = sorted(folder.iterdir()) if folder.is_dir() and not folder.is_symlink() else []
    except OSError:
        return []
    found = [find_recordings(child) for child in children if not child.name.startswith(".")]
    return [recording for recordings in found for recording in recordings]


def _with_delays(recording: Recording, camera: CameraSettings) -> Recording:
    """The recording with the stamps of its given poses moved back; its reader moved those of colour."""
    given, delay_ns = recording.given_trajectory, round(camera.trajectory_delay_s * NS_PER_S)
    if given is not None:
        given = GivenTrajectory(given.stamps_ns - delay_ns, given.T_world_camera)
    return replace(
        recording,
        given_trajectory=given,
        color_delay_s=camera.color_delay_s,
        trajectory_delay_s=camera.trajectory_delay_s,
    )


def _walk(folder: Path) -> Iterator[Path]:
    seen: set[str] = set()
    for root, folders, files in os.walk(folder, followlinks=True):
        real = os.path.realpath(root)
        if real in seen:  # a link to a folder above would go round for ever
            folders.clear()
            continue
        seen.add(real)
        folders[:] = [name for name in folders if not name.startswith(".")]
        yield from (Path(root) / name for name in files if not name.startswith("."))


def _unknown(path: Path) -> str:
    known = f"the formats that are read are {', '.join(FORMATS)}; `kinectbench formats` says what each needs"
    if path.is_dir() and not any(path.iterdir()):
        return f"{path}: the folder is empty; {known}"
    inside = find_recordings(path) if path.is_dir() else []
    said = None if inside else without_depth(path)
    if said is not None:
        return said
    hint = f". Did you mean {inside[0][0]}?" if inside else ""
    return f"{path}: not a recording of a known format; {known}{hint}"
