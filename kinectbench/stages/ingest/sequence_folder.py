"""A Sequence on disk: written from a recording frame by frame, read at random.

camera.json           `CameraFile`: the camera, and facts about the whole recording
frames.json           `FramesFile`: where each frame lies
depth/000000.kbd      uint16 in native units, 0 = no measurement, as `depth_code` packs it; PNG in version 1
color/000000.jpg|png  as it was encoded; a PNG where it was brought onto the pixels of depth
mask/000000.png       0 or 255 = the object; only if the recording has masks
given_trajectory.txt  TUM text, camera to world; only if the recording has one
"""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from hashlib import blake2b
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.sequence import AGAIN, CameraFile, FrameRow, FramesFile
from kinectbench.core.errors import GivenPosesError, KinectBenchError, RecordingError, StorageError
from kinectbench.core.sequence import Sequence, UpSample, depth_in_metres
from kinectbench.core.storage import storage_errors
from kinectbench.core.threads import ahead
from kinectbench.core.trajectory.trajectory_file import read_trajectory_file, trajectory_text
from kinectbench.core.types import Bools, Progress
from kinectbench.core.untrusted import UNPACKED_BYTES, read_plain
from kinectbench.stages.ingest.depth_code import decode_depth, encode_depth
from kinectbench.stages.ingest.images import (
    DamagedImageError,
    decode_color_bgr,
    decode_depth_png,
    decode_mask,
    encode_png,
)
from kinectbench.stages.ingest.plausibility import FrameChecks, trajectory_problem
from kinectbench.stages.ingest.recording import RawFrame, Recording
from kinectbench.stages.ingest.registration import ColorRegistration

TRAJECTORY = "given_trajectory.txt"
DEPTH_SUFFIX = ".kbd"


class Watch(Protocol):
    """Observes frames while they are written."""

    def see(self, index: int, frame: RawFrame) -> None:
        """Check a frame of the recording."""
        ...

    def warnings(self) -> list[str]:
        """Warnings after the last frame, one line each."""
        ...

    def scale_warnings(self) -> list[str]:
        """Evidence against depth_scale and intrinsics, one line each."""
        ...


def write_sequence(
    recording: Recording,
    folder: Path,
    progress: Progress | None = None,
    *,
    needs_trajectory: bool = True,
    watch: Watch | None = None,
) -> list[str]:
    """Write a recording into an empty folder, holding one frame at a time, and check it on the way.

    Args:
        recording: what to write; its damaged frames are left out while they are less than 5 %.
        folder: is made if it is not there.
        progress: called with (frames done, frames in all) after each.
        needs_trajectory: refuse a recording whose given trajectory is broken or of another time; else it is
            left out with a warning.
        watch: is shown each frame that is whole, as it was recorded, and adds its warnings.

    Returns:
        Warnings, one line each; they are stored in camera.json too.

    Raises:
        RecordingError: the recording cannot be used; the message says what is wrong and where.
        StorageError: the folder cannot be written.
    """
    problem = trajectory_problem(recording)
    if problem and needs_trajectory:
        raise GivenPosesError(f"{problem}; `trajectory: ignore` does without it")
    with storage_errors(folder):
        for name in ("depth", "color"):
            (folder / name).mkdir(parents=True, exist_ok=True)
    checks = FrameChecks(recording)
    rows = _write_frames(recording, folder, checks, progress, watch)
    warnings = [*recording.warnings, *checks.verdict()]
    if problem:
        warnings.append(f"{problem}; it is ignored")
    if watch:
        warnings += watch.warnings()
    head = _head(recording, len(rows), warnings, watch.scale_warnings() if watch else [], problem)
    with storage_errors(folder):
        head.write(folder)
        FramesFile(rows=tuple(rows)).write(folder)
        if recording.given_trajectory is not None and not problem:
            (folder / TRAJECTORY).write_text(trajectory_text(recording.given_trajectory), encoding="utf-8")
    return warnings


def _head(
    recording: Recording, frames: int, warnings: list[str], scale_warnings: list[str], trajectory_error: str
) -> CameraFile:
    """Facts about the whole recording; empty keys are left out."""
    calibrated = recording.color_calibration is not None
    others: dict[str, Any] = {} if recording.up_world is None else {"up_world": recording.up_world}
    if scale_warnings:
        others["doubts"] = tuple(scale_warnings)
    if recording.up_cameras:
        others["up_cameras"] = tuple((each.stamp_ns, *each.up_camera) for each in recording.up_cameras)
    return CameraFile(
        format_version=CameraFile.FORMAT_VERSION,
        **asdict(recording.camera),
        depth_scale=recording.depth_scale,
        color_registered=recording.color_registered or calibrated,
        registered_by="recording" if recording.color_registered else "calibration" if calibrated else None,
        source_format=recording.format,
        frames=frames,
        warnings=tuple(warnings),
        trajectory_error=trajectory_error,
        **others,
    )


def read_sequence(folder: Path) -> Sequence:
    """Open a folder that `write_sequence` made; images are read when asked for.

    Raises:
        StorageError: the folder is incomplete, damaged or of another format version.
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
    """Frames that lie in a sequence folder.

    Attributes:
        folder: the sequence folder.
        rows: where each frame lies in it.
    """

    folder: Path
    rows: tuple[FrameRow, ...]

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        """Depth of one frame: (height, width) uint16, 0 = no measurement.

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
        """The mask that came with a frame: (height, width) bool, or None.

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
        """Colour of one frame as it was encoded: (suffix, bytes), or None.

        Raises:
            StorageError: the image is missing.
        """
        name = self.rows[index].color
        return None if name is None else (Path(name).suffix, self._bytes(name))

    def digest(self, index: int) -> bytes:
        """`frame_digest` of one frame.

        Raises:
            StorageError: an image is missing.
        """
        return frame_digest(self._bytes(self.rows[index].depth), self.color_encoded(index))

    def _bytes(self, name: str) -> bytes:
        try:
            return read_plain(self.folder / name, UNPACKED_BYTES)
        except OSError as error:
            reason = error.strerror
            raise StorageError(f"{self.folder / name}: cannot be read ({reason}); {AGAIN}") from error


def frame_digest(depth: bytes, color: tuple[str, bytes] | None) -> bytes:
    """Tells frames apart by what is stored of them: depth as `encode_depth` packs it, and encoded colour."""
    suffix, data = color or ("", b"")
    return blake2b(len(depth).to_bytes(8, "little") + depth + suffix.encode() + data).digest()


def onto_depth(recording: Recording) -> Callable[[RawFrame], RawFrame] | None:
    """The registration of a frame's colour onto depth; None if already registered or unknown."""
    if recording.color_calibration is None or recording.color_registered:
        return None
    register = ColorRegistration(recording.camera, recording.color_calibration)
    return partial(_registered, register, recording.depth_scale)


def _registered(register: ColorRegistration, depth_scale: float, frame: RawFrame) -> RawFrame:
    """A frame whose colour is brought onto its depth."""
    if frame.color is None:
        return frame
    bgr = decode_color_bgr(frame.color[1], f"colour of {frame.name}")
    if bgr.shape[1::-1] != register.color_px:
        raise RecordingError(
            f"{frame.name}: its colour is {bgr.shape[1]}x{bgr.shape[0]}, but its camera makes "
            f"{register.color_px[0]}x{register.color_px[1]}: correct the calibration, or remove it"
        )
    depth_m = depth_in_metres(frame.depth, depth_scale)
    return replace(frame, color=(".png", encode_png(register(depth_m, bgr))))


def _write_frames(
    recording: Recording, folder: Path, checks: FrameChecks, progress: Progress | None, watch: Watch | None
) -> list[FrameRow]:
    """Write every whole frame; returns the rows of frames.json."""
    register = onto_depth(recording)
    rows: list[FrameRow] = []
    # Readers are not thread-safe: a video or a database has a position.
    # Damage is noted here alone, in the order of the frames: those after them are checked ahead.
    for packed in ahead(partial(_packed, register), _checked_frames(recording, checks, progress)):
        if isinstance(packed, _Damaged):
            checks.leave_out(packed.why)
            continue
        rows.append(_write_packed(packed, len(rows), folder))
        if watch:
            watch.see(packed.index, packed.frame)
    return rows


@dataclass(frozen=True)
class _Damaged:
    """A frame that is left out; `why` names it and the damage."""

    why: str


@dataclass(frozen=True)
class _Checked:
    """A frame on its way to disk.

    Attributes:
        index: its place in the recording.
        frame: as it was recorded.
        color_suffix: of its colour image; None: it has none.
        written: as it is written: with its colour on its depth.
        depth: packed.
    """

    index: int
    frame: RawFrame
    color_suffix: str | None
    written: RawFrame
    depth: bytes = b""


def _checked_frames(
    recording: Recording, checks: FrameChecks, progress: Progress | None
) -> Iterator[_Checked | _Damaged]:
    """The frames one after another, or what damages them."""
    for index in range(len(recording)):
        try:
            frame = recording.frame(index)
            checked: _Checked | _Damaged = _Checked(index, frame, checks.check(frame), frame)
        except DamagedImageError as error:
            checked = _Damaged(str(error))
        yield checked
        if progress:
            progress(index + 1, len(recording))


def _packed(
    register: Callable[[RawFrame], RawFrame] | None, checked: _Checked | _Damaged
) -> _Checked | _Damaged:
    """Pack a frame's depth, and bring its colour onto it."""
    if isinstance(checked, _Damaged):
        return checked
    depth = encode_depth(checked.frame.depth)
    if register is None:
        return replace(checked, depth=depth)
    try:
        registered = register(checked.frame)
    except DamagedImageError as error:
        return _Damaged(str(error))
    return replace(checked, depth=depth, written=registered, color_suffix=checked.color_suffix and ".png")


def _write_packed(checked: _Checked, index: int, folder: Path) -> FrameRow:
    """Write one frame; its row."""
    frame = checked.written
    depth = f"depth/{index:06d}{DEPTH_SUFFIX}"
    color = None if frame.color is None else f"color/{index:06d}{checked.color_suffix}"
    mask = None if frame.mask is None else f"mask/{index:06d}.png"
    with storage_errors(folder):
        (folder / depth).write_bytes(checked.depth)
        if frame.color is not None:
            (folder / f"{color}").write_bytes(frame.color[1])
        if frame.mask is not None:
            (folder / "mask").mkdir(exist_ok=True)
            pixels = np.where(frame.mask, np.uint8(255), np.uint8(0))
            (folder / f"{mask}").write_bytes(encode_png(pixels))
    return FrameRow(
        index=index,
        recorded=checked.index,
        stamp_ns=frame.stamp_ns,
        depth=depth,
        color=color,
        mask=mask,
    )
