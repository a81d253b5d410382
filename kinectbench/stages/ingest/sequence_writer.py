"""Write the frames of a sequence one by one: decode, check, pack and store each."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from hashlib import blake2b
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import RecordingError, storage_errors
from kinectbench.core.artefacts.sequence import FrameRow
from kinectbench.core.sequence import depth_in_metres
from kinectbench.core.threads import ahead
from kinectbench.core.types import Progress
from kinectbench.stages.ingest.depth_code import encode_depth
from kinectbench.stages.ingest.images import DamagedImageError, advice_on, decode_color_bgr, encode_png
from kinectbench.stages.ingest.plausibility import FrameChecks
from kinectbench.stages.ingest.recording import RawFrame, Recording
from kinectbench.stages.ingest.registration import ColorRegistration

DEPTH_SUFFIX = ".kbd"


class Watch(Protocol):
    """Observes frames while they are written, and collects warnings."""

    def wants(self, index: int) -> bool:
        """Whether `see` needs to be called for the frame with this index."""
        ...

    def see(self, index: int, frame: RawFrame) -> None:
        """Examine a frame of the recording."""
        ...

    def warnings(self) -> list[str]:
        """Return warnings after the last frame, one line each."""
        ...

    def camera_faults(self) -> list[str]:
        """Return evidence against the depth scale and the intrinsics, one line each."""
        ...


class SequenceWriter:
    """Writes the frames of a recording in order; a pickled copy may continue in another process.

    Attributes:
        folder: folder of the sequence.
        checks: checks of the frames taken so far.
        rows: rows of frames.json, one for each frame written so far.
        depth_digests: digests of the depth images written so far; one without measurement has none.
        taken: number of frames taken from the recording, damaged ones included.
    """

    def __init__(self, recording: Recording, folder: Path) -> None:
        """Create the folders of images.

        Raises:
            StorageError: the folders cannot be created.
        """
        with storage_errors(folder):
            for name in ("depth", "color"):
                (folder / name).mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self.checks = FrameChecks(recording)
        self.rows: list[FrameRow] = []
        self.depth_digests: set[str] = set()
        self.taken = 0
        self._register = onto_depth(recording)

    def take(self, count: int, progress: Progress | None = None, watch: Watch | None = None) -> None:
        """Write the next frames, until `count` frames of the recording are taken; `watch` sees each.

        Raises:
            RecordingError: a frame is unusable; damaged frames are left out instead.
            StorageError: the folder cannot be written.
        """
        # Readers are not thread-safe: a video or a database has a position. Damage is recorded only here, in
        # the order of the frames, because later frames are checked ahead.
        checked = _checked_frames(self.checks, range(self.taken, count), progress)
        for packed in ahead(partial(_packed, self._register, self.checks.recording.depth_scale), checked):
            self.taken += 1
            if isinstance(packed, _Damaged):
                self.checks.leave_out(packed.why, packed.advice)
                continue
            self.rows.append(_write_packed(packed, len(self.rows), self.folder))
            if packed.depth_digest is not None:
                self.depth_digests.add(packed.depth_digest)
            if watch:
                watch.see(packed.index, packed.frame)


def onto_depth(recording: Recording) -> Callable[[RawFrame], RawFrame] | None:
    """Make a function that registers a frame's colour to depth; None if it already is, or is uncalibrated."""
    if recording.color_calibration is None or recording.color_registered:
        return None
    register = ColorRegistration(recording.camera, recording.color_calibration)
    return partial(_registered, register, recording.depth_scale)


def _registered(register: ColorRegistration, depth_scale: float, frame: RawFrame) -> RawFrame:
    """Return the frame with its colour registered to depth."""
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


@dataclass(frozen=True)
class _Damaged:
    """A frame that is left out; `why` names the frame and the damage, `advice` is that of `advice_on`."""

    why: str
    advice: str


@dataclass(frozen=True)
class _Checked:
    """A checked frame that is to be written.

    Attributes:
        index: index in the recording.
        frame: the frame as recorded.
        color_suffix: suffix of the frame's colour image; None if it has none.
        written: the frame to write, with colour registered to depth.
        depth: packed depth.
        depth_digest: of the depth image; None if it has no measurement.
    """

    index: int
    frame: RawFrame
    color_suffix: str | None
    written: RawFrame
    depth: bytes = b""
    depth_digest: str | None = None


def _checked_frames(
    checks: FrameChecks, indices: Iterable[int], progress: Progress | None
) -> Iterator[_Checked | _Damaged]:
    """Read and check the frames of these indices; yield in order each frame, or what damage it has."""
    recording = checks.recording
    for index in indices:
        try:
            frame = recording.frame(index)
            checked: _Checked | _Damaged = _Checked(index, frame, checks.check(frame), frame)
        except DamagedImageError as error:
            checked = _Damaged(str(error), advice_on(error))
        yield checked
        if progress:
            progress(index + 1, len(recording))


def _packed(
    register: Callable[[RawFrame], RawFrame] | None, depth_scale: float, checked: _Checked | _Damaged
) -> _Checked | _Damaged:
    """Encode depth, and register colour; without registration, decode colour once to detect damage."""
    if isinstance(checked, _Damaged):
        return checked
    frame = checked.frame
    packed = replace(checked, depth=encode_depth(frame.depth), depth_digest=_digest(frame.depth, depth_scale))
    try:
        if register is not None:
            suffix = checked.color_suffix and ".png"
            return replace(packed, written=register(frame), color_suffix=suffix)
        if frame.color is not None:
            decode_color_bgr(frame.color[1], f"colour of {frame.name}")
    except DamagedImageError as error:
        return _Damaged(str(error), advice_on(error))
    return packed


def _digest(depth: NDArray[np.uint16], depth_scale: float) -> str | None:
    """Return a digest of a depth image in whole millimetres; None if nothing is measured.

    Files of other units have the same, unless their values were rounded otherwise.
    """
    depth_mm = np.rint(depth * np.float32(1000 / depth_scale)).astype(np.int32)
    return blake2b(depth_mm.tobytes(), digest_size=8).hexdigest() if depth.any() else None


def _write_packed(checked: _Checked, index: int, folder: Path) -> FrameRow:
    """Write a frame's files under the number `index`; return its row of frames.json."""
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
        index=index, recorded=checked.index, stamp_ns=frame.stamp_ns, depth=depth, color=color, mask=mask
    )
