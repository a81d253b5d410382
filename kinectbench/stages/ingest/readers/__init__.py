"""The table of readers, one for each format; it selects a reader, and detects how depth is coded."""

import importlib
from collections.abc import Collection, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import RESULTS, IntrinsicsError, RecordingError, StorageError, listed, printable
from kinectbench.core.artefacts.manifest import Manifest
from kinectbench.core.even_choice import evenly
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.stamps import NS_PER_S
from kinectbench.settings.models import CameraSettings
from kinectbench.settings.pick import PICK_FILE
from kinectbench.stages.ingest.depth_codes import ROTATED_SCALES, SAMPLED_IMAGES, Pattern, find_pattern
from kinectbench.stages.ingest.images import FLOAT_SCALE, DamagedImageError, decode_depth_png
from kinectbench.stages.ingest.known_names import misnamed, visible
from kinectbench.stages.ingest.readers.color_only import without_depth
from kinectbench.stages.ingest.readers.foreign_files import FOREIGN, foreign_file
from kinectbench.stages.ingest.recording import OF_SOME_FORMATS, FileRecording, Recording, read_image_file
from kinectbench.stages.ingest.sources import check_count, check_link, check_there, files_below

# name -> "module:class"; the first reader that recognises a path reads it, so special layouts come first.
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
# What makes a folder of images a recording.
COMMON_NAMES = ("depth", "color", "rgb", "depth.txt", "rgb.txt")
# Limits of native units of 16-bit depth per metre: the range of depth is then from 6.5 cm to kilometres.
LEAST_DEPTH_SCALE, MOST_DEPTH_SCALE = 1e-3, 1e6
# Largest number of files and folders to search for recordings, and for a hint beside a path that is no
# recording.
LOOKED_AT, LOOKED_AT_FOR_HINT = 1_000_000, 1000
# Units per metre: depth with rotated bits is in millimetres.
MM_SCALE = 1000.0


@cache
def reader_of(name: str) -> type[Recording]:
    """Return the class of the reader with this name in FORMATS."""
    module, _, class_name = FORMATS[name].partition(":")
    reader: type[Recording] = getattr(importlib.import_module(module), class_name)
    return reader


def name_suffixes() -> tuple[str, ...]:
    """Return the suffixes that recordings' names may have, such as ".bag"."""
    return tuple(sorted({suffix for name in FORMATS for suffix in reader_of(name).suffixes}))


def format_of(path: Path) -> str | None:
    """Return the name of a folder's or file's format, by layout and first bytes; None if unknown."""
    return next((name for name in FORMATS if reader_of(name).recognises(path)), None)


def says_intrinsics(path: Path) -> bool:
    """Whether a recording's format can store intrinsics; False for klg, redwood_zip and unknown formats.

    The readers of klg and redwood_zip use the intrinsics of the format's usual camera.
    """
    return format_of(path) not in (None, "klg", "redwood_zip")


def open_recording(
    path: Path, camera: CameraSettings | None = None, *, follow_links: bool = False
) -> Recording:
    """Open a recording of any known format.

    `camera` overrides the recording's values. Without `follow_links`, a recording with links is refused.

    Raises:
        RecordingError: the recording is missing, of unknown format, or unusable.
    """
    try:
        reader = reader_of(_known_format(path))
        _files_of(reader, path, follow_links)
        settings = camera or CameraSettings()
        recording = reader.open(path, settings)
        for scale in (recording.depth_scale, settings.depth_scale or recording.depth_scale):
            _check_scale(path, scale)
        check_count(path, len(recording))
        return _with_depth_code(_with_corrections(_with_unused(recording, settings), settings), settings)
    except OSError as error:
        raise RecordingError(
            f"{error.filename or path}: cannot be read ({error.strerror})", what="unreadable"
        ) from error


def _known_format(path: Path) -> str:
    """Return the name of a folder's or file's format (`format_of`), or raise an error that helps the user."""
    check_there(path)
    if not (path.is_dir() or path.is_file()):
        raise RecordingError(
            f"{path}: is neither a folder nor a plain file; correct the path", what="not-found"
        )
    name = format_of(path)
    if name is None:
        raise RecordingError(_unknown(path), what="unknown-format")
    return name


def source_files(path: Path, *, follow_links: bool = False) -> list[Path]:
    """List every file of a recording, sorted: the path itself, or all files of the folder except hidden ones.

    The file with the point clicked on the object is not included, because it is a setting. Files outside the
    folder that belong to the recording come last. A folder is listed only once its format is known.

    Args:
        path: the folder or file; it may itself be a link.
        follow_links: whether files and folders in it may be links, too.

    Raises:
        RecordingError: the format is unknown, or the recording contains links that must not be followed,
            something that is no plain file, or too many files.
    """
    try:
        files = _files_of(reader_of(_known_format(path)), path, follow_links)
        return [file for file in files if file != path / PICK_FILE]
    except OSError as error:
        raise RecordingError(
            f"{error.filename or path}: cannot be read ({error.strerror})", what="unreadable"
        ) from error


def _files_of(reader: type[Recording], path: Path, follow_links: bool) -> list[Path]:
    """List the files of a recording whose reader is known; see `source_files`."""
    if not path.is_dir():
        return [path]
    beside = reader.files_beside(path)
    for file in beside:
        check_link(file, follow_links=follow_links)
    return [*files_below(path, follow_links=follow_links), *beside]


def find_recordings(folder: Path, most: int = LOOKED_AT) -> list[tuple[Path, str]]:
    """Return (path, format) of every recording in a folder and below, sorted. Recordings are not nested.

    A folder is skipped, with all below it, if it is unreadable, starts with a dot, was made by a build, or
    contains the ground truth of a simulated recording. A link is looked at, but not what lies below it. At
    most `most` files and folders are looked at.
    """
    return list(_recordings_below(folder, iter(range(most))))


def recordings_inside(recording: Path, read: Collection[Path]) -> list[tuple[Path, str]]:
    """Find further recordings in those subfolders of a recording that its own reader does not read.

    Args:
        recording: the folder or file of a recording; hidden subfolders and results are skipped.
        read: folders from which its reader reads; a subfolder that contains one is part of the recording.

    Returns:
        Pairs (path, format), sorted.

    Raises:
        OSError: the folder cannot be read.
    """
    if not recording.is_dir():
        return []
    folders = [
        child
        for child in sorted(recording.iterdir())
        if child.is_dir()
        and not (child.name.startswith(".") or child.name in RESULTS)
        and not any(each.is_relative_to(child) for each in read)
    ]
    numbers = iter(range(LOOKED_AT))
    return [found for folder in folders for found in _recordings_below(folder, numbers)]


def _recordings_below(folder: Path, numbers: Iterator[int]) -> Iterator[tuple[Path, str]]:
    """Search as `find_recordings` does; each visited path takes an item of `numbers`, until it has none."""
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
    """Whether a stage made the folder; a manifest.json of another program does not count."""
    try:
        return Manifest.read_if_there(folder) is not None
    except StorageError:
        return False


def _check_scale(path: Path, scale: float) -> None:
    """Refuse an impossible depth scale, whatever its source."""
    if not LEAST_DEPTH_SCALE <= scale <= MOST_DEPTH_SCALE:  # false for NaN
        raise IntrinsicsError(
            f"{path}: 1 m cannot be {scale:g} units of 16-bit depth; correct the recording's depth scale, or "
            "give `camera: {depth_scale: ...}` (units a metre, such as 1000 or 5000)"
        )


def _with_unused(recording: Recording, camera: CameraSettings) -> Recording:
    """Return the recording, with a warning on settings that are given but do not apply to its format."""
    silent, given = CameraSettings(), (name for name in OF_SOME_FORMATS if name not in recording.uses)
    unused = [f"`{name}`" for name in given if getattr(camera, name) != getattr(silent, name)]
    if not unused:
        return recording
    what = (
        f"{', '.join(unused)} under `camera:` is of other formats than {recording.format}, and is not applied"
    )
    return replace(recording, warnings=(*recording.warnings, f"{recording.path}: {what}: remove it"))


def _with_corrections(recording: Recording, camera: CameraSettings) -> Recording:
    """Apply the settings' delay and convention to given poses; the reader has corrected colour itself."""
    given, delay_ns = recording.given_trajectory, round(camera.trajectory_delay_s * NS_PER_S)
    if given is not None:
        read = camera.trajectory_reading
        poses = given.T_world_camera if read is None else read.convention().apply(given.T_world_camera)
        given = GivenTrajectory(given.stamps_ns - delay_ns, poses)
    return replace(
        recording,
        given_trajectory=given,
        color_delay_s=camera.color_delay_s if "color_delay_s" in recording.uses else 0.0,
        trajectory_delay_s=camera.trajectory_delay_s,
        trajectory_read=camera.trajectory_reading is not None,
    )


def _unknown(path: Path) -> str:
    known = f"the formats that are read are {', '.join(FORMATS)}; `kinectbench formats` says what each needs"
    if path.is_dir() and not any(path.iterdir()):
        return f"{path}: the folder is empty; give the folder or the file of a recording"
    inside = find_recordings(path, LOOKED_AT_FOR_HINT) if path.is_dir() else []
    above = next((folder for folder in path.parents[:2] if path.is_file() and format_of(folder)), None)
    if above is not None:
        return f"{path}: is one file of a recording; give its folder, {above}"
    if len(inside) > 1:
        names = listed(printable(str(found.relative_to(path))) for found, _ in inside)
        return f"{path}: holds several recordings ({names}); give the path of one"
    misspelt = "".join(f"; {line}" for line in misnamed(path, COMMON_NAMES))
    reason = None if inside else without_depth(path, name_suffixes())
    if reason is not None:
        return f"{reason}{misspelt}"
    others = [path] if path.is_file() else [] if inside else visible(path, *FOREIGN)
    for file in others:
        if file.is_file() and (reason := foreign_file(file)) is not None:
            return reason
    hint = f". Did you mean {inside[0][0]}?" if inside else misspelt
    return f"{path}: not a recording of a known format; {known}{hint}"


def _with_depth_code(recording: Recording, camera: CameraSettings) -> Recording:
    """Set the recording's depth code: the one that the settings give, or else the one that is detected.

    Rotated bits are searched for if depth is PNG in mm or 0.1 mm. If the settings give `depth_scale`, they
    only give a warning. If they give `depth_code: rotated`, the values decide the unit. In a layout that
    usually has rotated bits (`often_rotated`), multiples of eight suffice as evidence, without a warning.
    """
    of_bits = camera.depth_code in ("rotated", "float16")
    if not isinstance(recording, FileRecording) or (of_bits and recording.float_scale is not None):
        if camera.depth_code is None:
            return recording
        raise RecordingError(
            f"{recording.path}: `depth_code: {camera.depth_code}` is of depth images in PNG files, which "
            f"this {recording.format} recording has not; remove it",
            what="unused-setting",
        )
    if camera.depth_code == "float16":
        return replace(recording, depth_code="float16", depth_scale=FLOAT_SCALE)
    if camera.depth_code not in (None, "rotated"):
        return replace(recording, depth_code=camera.depth_code)
    in_mm = camera.depth_scale is None and recording.depth_scale == MM_SCALE
    if camera.depth_code == "rotated":
        recording = replace(recording, depth_code="rotated")
    elif not in_mm and camera.depth_scale not in ROTATED_SCALES:
        return recording
    pattern = find_pattern(_some_depth(recording))
    if recording.often_rotated and in_mm:
        return replace(recording, depth_code="rotated" if pattern.possible else "plain")
    return _by_pattern(recording, pattern, in_mm=in_mm) if pattern.found else recording


def _by_pattern(recording: FileRecording, pattern: Pattern, *, in_mm: bool) -> Recording:
    """Set the depth code and scale that the values of depth (`pattern.found`) suggest, and warn of them.

    Only a warning is added if the recording states another scale than mm (`in_mm` is false).
    """
    what = f"{recording.path}: nearly every depth value is a multiple of 8"
    tenths, whose = ("", "SUN3D") if pattern.units == MM_SCALE else ("; its unit is 0.1 mm", "APC")
    written = f"`depth_code: rotated, depth_scale: {pattern.units:g}`" if tenths else "`depth_code: rotated`"
    if recording.depth_code == "rotated":
        if not (in_mm and tenths) or recording.often_rotated:
            return recording
        note = f"{recording.path}: in mm some of its depth would be beyond 16 m: its unit is taken as 0.1 mm"
        return replace(recording, depth_scale=pattern.units, warnings=(*recording.warnings, note))
    if in_mm and pattern.likely:
        undone = f"its bits are rotated, as {whose}'s are, and are put back{tenths}"
        note = f"{what}: {undone}; if not, `depth_code: plain`"
        if pattern.likelier_units != pattern.units:
            note += f"; in mm its median is {pattern.median / MM_SCALE:.2f} m: if its unit is 0.1 mm, "
            note += "`depth_scale: 10000`"
        return replace(
            recording, depth_code="rotated", depth_scale=pattern.units, warnings=(*recording.warnings, note)
        )
    unit = "mm" if in_mm else f"{recording.depth_scale:g} units per metre"
    note = f"{what}: it is read in {unit}; if its bits are rotated, as {whose}'s are, give {written}"
    return replace(recording, warnings=(*recording.warnings, note))


def _some_depth(recording: FileRecording) -> Iterator[NDArray[np.uint16]]:
    """Yield some depth images as stored, evenly spread; codes for no measurement become 0."""
    count = len(recording)
    for index in evenly(count, SAMPLED_IMAGES).tolist():
        file = recording.places[index].depth
        try:
            yield recording.clean_depth(decode_depth_png(read_image_file(file), str(file)), index)
        except DamagedImageError:
            continue
