"""TUM RGB-D folders: `depth.txt`, `rgb.txt`, optionally `groundtruth.txt`; depth in 1/5000 m."""

from functools import partial
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from kinectbench.core import RecordingError, printable
from kinectbench.core.sequence import GivenTrajectory, UpSample
from kinectbench.core.trajectory.stamps import (
    check_unit,
    counted_ns,
    first_by_stamp,
    no_times,
    parse_stamp_ns,
)
from kinectbench.core.trajectory.text_rows import parse_floats, text_rows
from kinectbench.core.trajectory.trajectory_file import read_given, read_trajectory_file
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.gravity import up_at_rest
from kinectbench.stages.ingest.intrinsics import HELD, read_color_calibration, said_warnings
from kinectbench.stages.ingest.intrinsics_files import (
    JSON_FILES,
    MATRIX_FILES,
    find_intrinsics,
    named_like_intrinsics,
)
from kinectbench.stages.ingest.json_values import read_json_object
from kinectbench.stages.ingest.known_names import clashing, first_named, in_any_case, misnamed
from kinectbench.stages.ingest.pairing import pair_by_time, pair_images
from kinectbench.stages.ingest.readers.folder import DepthFormat
from kinectbench.stages.ingest.readers.pose_files import unread_poses, with_y_down
from kinectbench.stages.ingest.recording import (
    COLOR_DELAY,
    MASKS_FOLDER,
    Evidence,
    FileRecording,
    FrameFiles,
    first_depth_size,
    unmatched_masks,
    with_masks,
)
from kinectbench.stages.ingest.sources import listed_name

DEPTH_SCALE = 5000.0
# Names of the lists, the first that exists is read: OpenLORIS also lists depth on the pixels of colour.
DEPTH_LISTS, COLOR_LISTS = ("aligned_depth.txt", "depth.txt"), ("rgb.txt", "color.txt")
BESIDE = ("groundtruth.txt", "accelerometer.txt")
# Size and intrinsics of colour that the benchmark's page "File Formats" states; its recordings hold none.
TUM_PX = (640, 480)
TUM_STATES = (
    "; if this is of the TUM benchmark, its page states for freiburg1 `{fx: 517.3, fy: 516.5, cx: 318.6, "
    "cy: 255.3}`, freiburg2 `{fx: 520.9, fy: 521, cx: 325.1, cy: 249.7}`, freiburg3 `{fx: 535.4, fy: 539.2, "
    "cx: 320.1, cy: 247.6}`"
)
# Value of `accelerometer_axes` in camera.json: accelerometer.txt has the optical axes of the depth camera.
DEPTH_AXES = "depth"


class TumRecording(FileRecording):
    """A folder in the layout of the TUM RGB-D benchmark; colour is registered to depth.

    Intrinsics come from `camera.json` in the folder, from ETH3D's `calibration.txt`, or from the settings.
    """

    format: ClassVar[str] = "tum"
    uses: ClassVar[frozenset[str]] = COLOR_DELAY
    looks_for: ClassVar[str] = "a folder with depth.txt (and rgb.txt, groundtruth.txt, camera.json)"
    evidence: ClassVar[Evidence] = "copy"
    verified: ClassVar[str] = "fr3/cabinet and fr1/xyz (TUM, CC BY 4.0)"

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder has a depth.txt."""
        return in_any_case(path, "depth.txt").is_file()

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """Read the lists, pair colour with depth, and read the trajectory."""
        (depth_list, color_list), warnings = _lists(path)
        depth_rows = _read_rows(depth_list)
        if not depth_rows:
            raise RecordingError(
                f"{depth_list}: lists no images; export the recording again", what="no-depth"
            )
        color_rows = _read_rows(color_list) if color_list.is_file() else []
        why = no_times([stamp_ns for stamp_ns, _ in depth_rows])
        if why:
            depth_rows, color_rows = _counted(depth_rows), _counted(color_rows)
            warnings += [f"{depth_list}: its stamps are no times ({why}); its rows are counted instead"]
        depth, depth_ns, depth_warnings = _in_order(depth_rows, depth_list)
        color, color_ns, color_warnings = _in_order(color_rows, color_list)
        warnings += [*depth_warnings, *color_warnings]
        delay_s, where = settings.color_delay_s, str(path)
        if why:  # counted stamps do not relate two streams
            stems = ([file.stem for _, file in rows] for rows in (depth, color))
            partners, _ = pair_images(*stems, delay_s=delay_s, where=where)
        else:
            streams_ns = ([stamp_ns for stamp_ns, _ in rows] for rows in (depth, color))
            partners = pair_by_time(*streams_ns, delay_s=delay_s, where=where)
        files = tuple(
            FrameFiles(stamp_ns, file, None if partner is None else color[partner][1])
            for (stamp_ns, file), partner in zip(depth, partners.of_depth, strict=True)
        )
        files = with_masks(files, path)
        recorded, camera_file = find_intrinsics(path, settings, DEPTH_SCALE)
        intrinsics, size_px = recorded.overridden_by(settings), first_depth_size(files)
        stored = DepthFormat.of(files, settings.depth_scale)
        up = _measured_up(path, camera_file, [ns for ns, _ in depth])
        trajectory, pose_warnings, error = read_given(lambda: _poses(path, len(depth) if why else None))
        if trajectory is not None and intrinsics.y_up:
            trajectory, note = with_y_down(trajectory, path)
            pose_warnings = [*pose_warnings, note]
        return cls(
            path=path,
            places=files,
            camera=intrinsics.camera(size_px, path, partial(_camera_hint, size_px)),
            depth_scale=stored.depth_scale or intrinsics.depth_scale or DEPTH_SCALE,
            float_scale=stored.float_scale,
            channels=stored.channels,
            kind=stored.kind,
            color_registered=True if recorded.color_registered is None else recorded.color_registered,
            color_calibration=read_color_calibration(camera_file) if camera_file else None,
            recorded=(tuple(depth_ns), () if why else tuple(color_ns)),
            given_trajectory=trajectory,
            trajectory_error=error,
            up_cameras=up,
            warnings=(
                *warnings,
                *partners.warnings,
                *stored.warnings,
                *said_warnings(path, recorded, settings),
                *pose_warnings,
                *unmatched_masks(path, files),
            ),
        )


def _camera_hint(size_px: tuple[int, int], path: Path) -> str:
    """Return the end of an error message on missing intrinsics: where they may stand."""
    of_tum = size_px == TUM_PX and in_any_case(path, BESIDE[0]).is_file()
    return named_like_intrinsics(path) or (TUM_STATES if of_tum else "")


def _lists(path: Path) -> tuple[tuple[Path, Path], list[str]]:
    """Return the lists of depth and colour, which may not exist, and warnings on what is not read."""
    depth, color = (first_named(path, names) for names in (DEPTH_LISTS, COLOR_LISTS))
    absent = (MASKS_FOLDER,) if color else (*COLOR_LISTS, MASKS_FOLDER)
    others = ({*DEPTH_LISTS, *COLOR_LISTS} - {*absent}, BESIDE, JSON_FILES, MATRIX_FILES)
    clashes = clashing(path, sorted({name for names in others for name in names}))
    notes = [f"{path}: {line}" for line in (*misnamed(path, absent), *clashes)]
    depth, color = depth or path / DEPTH_LISTS[-1], color or path / COLOR_LISTS[0]
    if depth.name.lower() == DEPTH_LISTS[-1]:
        return (depth, color), notes
    note = (
        f"{depth}: is read, and not {DEPTH_LISTS[-1]}: its depth lies on colour's pixels, so that fx ... cy"
    )
    return (depth, color), [f"{note} must be those of colour", *notes]


def _poses(path: Path, frames: int | None) -> tuple[GivenTrajectory | None, list[str]]:
    truth = in_any_case(path, "groundtruth.txt")
    return read_trajectory_file(truth, frames) if truth.is_file() else (None, unread_poses(path))


def _measured_up(path: Path, camera_file: Path | None, stamps_ns: list[int]) -> tuple[UpSample, ...]:
    """Read up at some frames from accelerometer.txt, if camera.json says that its axes are depth's.

    Recordings of the benchmark itself have this file, too, but in the axes of the Kinect's sensor.
    """
    file = in_any_case(path, "accelerometer.txt")
    if camera_file is None or camera_file.suffix.lower() != ".json" or not file.is_file():
        return ()
    if read_json_object(camera_file, HELD).get("accelerometer_axes") != DEPTH_AXES:
        return ()
    rows = [(where, row.split()) for where, row in text_rows(file)]
    bad = next((where for where, words in rows if len(words) != 4), None)
    if bad is not None:
        raise RecordingError(f"{bad}: is not 'stamp ax ay az'; correct or remove the line")
    times_ns = np.array([parse_stamp_ns(words[0], where) for where, words in rows], np.int64)
    order = np.argsort(times_ns, kind="stable")
    measured = np.array([parse_floats(words[1:], where) for where, words in rows]).reshape(-1, 3)[order]
    read = measured.tolist()
    return tuple(up_at_rest(times_ns[order], lambda index: tuple(read[index]), stamps_ns, np.eye(3)))


def _read_rows(path: Path) -> list[tuple[int, Path]]:
    """Read rows `stamp file` as (nanoseconds, path), in the order of the file."""
    rows = []
    for where, row in text_rows(path):
        words = row.split(maxsplit=1)
        if len(words) != 2:
            raise RecordingError(f"{where}: '{printable(row)}' is not 'stamp file'")
        try:
            file = path.parent / listed_name(path.parent, words[1])
        except ValueError as error:
            raise RecordingError(f"{where}: {error}") from error
        rows.append((parse_stamp_ns(words[0], where), file))
    return rows


def _counted(rows: list[tuple[int, Path]]) -> list[tuple[int, Path]]:
    """Return the rows, with stamps of 0 s, 1 s, 2 s and so on instead of their own."""
    return [(stamp_ns, file) for stamp_ns, (_, file) in zip(counted_ns(len(rows)), rows, strict=True)]


def _in_order(
    rows: list[tuple[int, Path]], path: Path
) -> tuple[list[tuple[int, Path]], list[int], list[str]]:
    """Return (rows by stamp without repeated stamps, all stamps in the file's order, warnings).

    Raises:
        RecordingError: the stamps are in micro- or nanoseconds.
    """
    stamps_ns = [stamp for stamp, _ in rows]
    order, warnings = first_by_stamp(stamps_ns, str(path), "rows")
    return [rows[i] for i in order], stamps_ns, [*warnings, *check_unit(stamps_ns, str(path))]
