"""A Sequence on disk: written from a recording frame by frame, and read in any order.

camera.json           `CameraFile`: the camera, and facts about the whole recording
frames.json           `FramesFile`: the list of frames
depth/000000.kbd      uint16 in native units, 0 = no measurement, packed by `depth_code`; PNG in version 1
color/000000.jpg|png  as encoded; PNG if it was registered to depth
mask/000000.png       0 or 255 = the object; only if the recording has masks
given_trajectory.txt  TUM text, camera to world; only if the recording has one
"""

from dataclasses import asdict, dataclass
from hashlib import blake2b
from heapq import nsmallest
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import (
    UNPACKED_BYTES,
    GivenPosesError,
    KinectBenchError,
    RecordingError,
    StorageError,
    read_plain,
    storage_errors,
)
from kinectbench.core.artefacts.sequence import AGAIN, SKETCH_DIGESTS, CameraFile, FrameRow, FramesFile
from kinectbench.core.sequence import Sequence, UpSample
from kinectbench.core.threads import ahead
from kinectbench.core.trajectory.trajectory_file import read_trajectory_file, trajectory_text
from kinectbench.core.types import Bools, Progress
from kinectbench.stages.ingest.depth_code import decode_depth
from kinectbench.stages.ingest.images import decode_depth_png, decode_mask
from kinectbench.stages.ingest.partial_sequence import PartialSequence, go_on_from
from kinectbench.stages.ingest.plausibility import trajectory_problem
from kinectbench.stages.ingest.recording import RawFrame, Recording
from kinectbench.stages.ingest.sequence_writer import DEPTH_SUFFIX, SequenceWriter, Watch

TRAJECTORY = "given_trajectory.txt"


def write_sequence(
    recording: Recording,
    folder: Path,
    progress: Progress | None = None,
    *,
    needs_trajectory: bool = True,
    watch: Watch | None = None,
    partial: PartialSequence | None = None,
) -> list[str]:
    """Write a recording into an empty folder, one frame at a time, and check each frame.

    Args:
        recording: the recording; damaged frames are left out if they are fewer than 5 %.
        folder: the folder; created if missing.
        progress: called with (finished frames, all frames) after each frame.
        needs_trajectory: whether to refuse a recording whose given trajectory is broken or overlaps no frame
            in time; otherwise the trajectory is dropped with a warning.
        watch: receives each undamaged frame as recorded, and adds warnings.
        partial: first frames that were stored earlier; they are used if they belong to this recording.

    Returns:
        Warnings, one line each; camera.json has them, too.

    Raises:
        RecordingError: the recording is unusable; the message says what is wrong and where.
        StorageError: the folder cannot be written.
    """
    problem = trajectory_problem(recording)
    if problem and needs_trajectory:
        raise GivenPosesError(f"{problem}; `trajectory: ignore` does without it")
    writer = SequenceWriter(recording, folder)
    if partial is not None:
        go_on_from(partial, writer)
        if watch:
            _show_stored(writer, watch)
    writer.take(len(recording), progress, watch)
    rows = writer.rows
    warnings = [*recording.warnings, *writer.checks.verdict()]
    if problem:
        warnings.append(f"{problem}; it is ignored")
    if watch:
        warnings += watch.warnings()
    head = _head(recording, writer, warnings, watch.camera_faults() if watch else [], problem)
    with storage_errors(folder):
        head.write(folder)
        FramesFile(rows=tuple(rows)).write(folder)
        if recording.given_trajectory is not None and not problem:
            (folder / TRAJECTORY).write_text(trajectory_text(recording.given_trajectory), encoding="utf-8")
    return warnings


def _show_stored(writer: SequenceWriter, watch: Watch) -> None:
    """Pass to `watch` the stored frames that it wants; they are read faster than recorded frames."""
    recording, frames = writer.checks.recording, FolderFrames(writer.folder, tuple(writer.rows))
    wanted = {row.recorded: row for row in writer.rows if row.recorded is not None}
    wanted = {index: row for index, row in wanted.items() if watch.wants(index)}

    def stored(row: FrameRow) -> RawFrame:
        depth, color = frames.depth_native(row.index), frames.color_encoded(row.index)
        return RawFrame(row.depth, row.stamp_ns, depth, color)

    registered = recording.color_calibration is not None and not recording.color_registered
    read = map(recording.frame, wanted) if registered else ahead(stored, wanted.values())
    for index, frame in zip(wanted, read, strict=True):
        watch.see(index, frame)


def _head(
    recording: Recording,
    writer: SequenceWriter,
    warnings: list[str],
    faults: list[str],
    trajectory_error: str,
) -> CameraFile:
    """Return the content of camera.json after the last frame; empty optional keys are left out."""
    calibrated = recording.color_calibration is not None
    others: dict[str, Any] = {} if recording.up_world is None else {"up_world": recording.up_world}
    if faults:
        others["doubts"] = tuple(faults)
    if recording.up_cameras:
        others["up_cameras"] = tuple((each.stamp_ns, *each.up_camera) for each in recording.up_cameras)
    return CameraFile(
        format_version=CameraFile.FORMAT_VERSION,
        **asdict(recording.camera),
        depth_scale=recording.depth_scale,
        color_registered=recording.color_registered or calibrated,
        registered_by="recording" if recording.color_registered else "calibration" if calibrated else None,
        source_format=recording.format,
        frames=len(writer.rows),
        warnings=tuple(warnings),
        trajectory_error=trajectory_error,
        depth_sketch=tuple(nsmallest(SKETCH_DIGESTS, writer.depth_digests)),
        **others,
    )


def read_sequence(folder: Path) -> Sequence:
    """Open a folder written by `write_sequence`; images are read on demand.

    Raises:
        StorageError: the folder is incomplete, damaged, or of another format version.
    """
    head, listed = CameraFile.read(folder), FramesFile.read(folder)
    try:
        trajectory = read_trajectory_file(folder / TRAJECTORY)[0] if (folder / TRAJECTORY).is_file() else None
    except (OSError, KinectBenchError) as error:
        raise StorageError(f"{error}; {AGAIN}") from error
    frames = FolderFrames(folder, listed.rows)
    return Sequence(
        camera=head.camera,
        depth_scale=head.depth_scale,
        stamps_ns=listed.stamps_ns,
        color_registered=head.color_registered,
        given_trajectory=trajectory,
        trajectory_error=head.trajectory_error,
        up_world=None if head.up_world is None else np.array(head.up_world),
        up_cameras=tuple(UpSample(stamp_ns, (x, y, z)) for stamp_ns, x, y, z in head.up_cameras or ()),
        frames=frames,
        recorded=listed.recorded,
        masks=frames.mask if any(row.mask for row in listed.rows) else None,
    )


@dataclass(frozen=True)
class FolderFrames:
    """The frames in a sequence folder, by the rows of its frames.json."""

    folder: Path
    rows: tuple[FrameRow, ...]

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        """Return the depth of one frame: (height, width) uint16, 0 = no measurement.

        Raises:
            StorageError: the image is missing or damaged.
        """
        data = self._bytes(self.rows[index].depth)
        name = str(self.folder / self.rows[index].depth)
        try:
            return decode_depth(data) if name.endswith(DEPTH_SUFFIX) else decode_depth_png(data, name)
        except (ValueError, RecordingError) as error:
            raise StorageError(f"{name}: is damaged ({error}); {AGAIN}") from error

    def mask(self, index: int) -> Bools | None:
        """Return the mask that came with the recording for a frame: (height, width) bool; None if none did.

        Raises:
            StorageError: the image is missing or damaged.
        """
        name = self.rows[index].mask
        if name is None:
            return None
        try:
            return decode_mask(self._bytes(name), name)
        except RecordingError as error:
            raise StorageError(f"{self.folder / name}: is damaged; {AGAIN}") from error

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        """Return the colour of one frame as encoded: (suffix, bytes); None if it has no colour.

        Raises:
            StorageError: the image is missing.
        """
        name = self.rows[index].color
        return None if name is None else (Path(name).suffix, self._bytes(name))

    def digest(self, index: int) -> bytes:
        """Return a digest of a frame's stored depth and colour, equal for equal bytes.

        Raises:
            StorageError: an image is missing.
        """
        depth, (suffix, data) = self._bytes(self.rows[index].depth), self.color_encoded(index) or ("", b"")
        return blake2b(len(depth).to_bytes(8, "little") + depth + suffix.encode() + data).digest()

    def _bytes(self, name: str) -> bytes:
        try:
            return read_plain(self.folder / name, UNPACKED_BYTES)
        except OSError as error:
            reason = error.strerror
            raise StorageError(f"{self.folder / name}: cannot be read ({reason}); {AGAIN}") from error
