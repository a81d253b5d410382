"""Read a probe of a recording: some of its frames at low resolution, and a few at full size."""

import hashlib
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from kinectbench.core import RecordingError
from kinectbench.core.encoded_images import decoded_image
from kinectbench.core.even_choice import evenly
from kinectbench.core.geometry import Camera
from kinectbench.core.sequence import counts_frames, depth_in_metres
from kinectbench.stages.ingest.images import DamagedImageError, OddImageError, decode_color_bgr, image_header
from kinectbench.stages.ingest.plausibility import MAX_DAMAGED, check_color, check_size
from kinectbench.stages.ingest.recording import RawFrame, Recording

# Longer recordings are read in runs: a long one in the middle, two at the ends to measure clock drift, and
# short ones elsewhere; 342 frames in all. Chosen by hand.
ALL_FRAMES = 250
END_RUN = 60
LONG_RUN, SHORT_RUN, SHORT_RUNS = 150, 12, 8
WHOLE_FRAMES, FEW_FRAMES = 16, 8
DEPTH_COLUMNS = 160
GRAY_COLUMNS = 320


@dataclass(frozen=True)
class SmallFrame:
    """A frame at low resolution.

    Attributes:
        index: index in the recording.
        stamp_ns: stamp of depth, nanoseconds.
        depth_m: (height, width) float32 metres, every n-th pixel of every n-th row; 0 = none.
        gray: (height, width) uint8, colour as grey, in another size than depth; None if there is no colour.
        digest: hash of the full depth image, to find repeated ones.
    """

    index: int
    stamp_ns: int
    depth_m: NDArray[np.float32]
    gray: NDArray[np.uint8] | None
    digest: bytes


@dataclass(frozen=True)
class WholeFrame:
    """A frame as recorded.

    Attributes:
        index: index in the recording.
        depth: (height, width) uint16, native units, 0 = none.
        bgr: (height, width, 3) uint8, the decoded colour, of any size; None if there is no colour.
    """

    index: int
    depth: NDArray[np.uint16]
    bgr: NDArray[np.uint8] | None


@dataclass(frozen=True)
class Probe:
    """The sample of a recording that the checks use.

    Attributes:
        recording: the opened recording.
        frames: the sampled frames at low resolution, in order, without the damaged and the refused frames.
        whole: some of these frames at full size, evenly spread.
        damaged: the error of each sampled frame that is damaged.
        refused: the error of each sampled frame that is not damaged, but unreadable or of another size or
            kind than the others. But if 5 % of the frames or more have another size, those whose depth has
            another size are not refused: they stay in `frames`.
        depth_step_px: the stride n of the small depth images.
    """

    recording: Recording
    frames: tuple[SmallFrame, ...]
    whole: tuple[WholeFrame, ...]
    damaged: tuple[RecordingError, ...]
    refused: tuple[RecordingError, ...]
    depth_step_px: int

    @property
    def where(self) -> str:
        """The recording's path, as findings name it."""
        return str(self.recording.path)

    @property
    def looked_at(self) -> int:
        """The number of sampled frames, those that cannot be used included."""
        return len(self.frames) + len(self.damaged) + len(self.refused)

    @property
    def small_camera(self) -> Camera:
        """The intrinsics of the small depth images, whose pixel i is pixel n * i of the full image."""
        return self.recording.camera.every(self.depth_step_px)

    @property
    def counts_frames(self) -> bool:
        """Whether the recording has no times, so that its stamps only count frames."""
        return counts_frames(self.recording.stamps_ns)

    def neighbours(self) -> Iterator[tuple[SmallFrame, SmallFrame]]:
        """Yield each pair of sampled frames that are consecutive in the recording."""
        for first, second in zip(self.frames, self.frames[1:], strict=False):
            if second.index == first.index + 1:
                yield first, second

    def runs(self) -> list[tuple[SmallFrame, ...]]:
        """Split the sampled frames into runs of frames that are consecutive in the recording."""
        indices = np.array([frame.index for frame in self.frames])
        cuts = [0, *(np.flatnonzero(np.diff(indices) != 1) + 1).tolist(), len(indices)]
        return [self.frames[start:end] for start, end in pairwise(cuts) if end > start]

    def longest_run(self) -> tuple[SmallFrame, ...]:
        """Return the longest of the runs, () without frames."""
        return max(self.runs(), key=len, default=())


class ProbeBuilder:
    """Builds a probe from frames as they are read."""

    def __init__(self, recording: Recording, indices: NDArray[np.int64], whole: int = WHOLE_FRAMES) -> None:
        """Prepare to gather the frames `indices` (increasing), `whole` of them also at full size."""
        self.indices = indices
        self._wanted = frozenset(indices.tolist())
        self._whole_at = frozenset(indices[evenly(len(indices), whole)].tolist())
        self._recording = recording
        self._step = max(1, round(recording.camera.width / DEPTH_COLUMNS))
        self._frames: list[SmallFrame] = []
        self._whole: list[WholeFrame] = []

    def take(self, index: int, raw: RawFrame) -> None:
        """Add a frame to the probe if its index is one of `indices`.

        Raises:
            DamagedImageError: the frame's colour cannot be decoded.
        """
        if index not in self._wanted:
            return
        step = self._step
        whole = index in self._whole_at
        bgr = decode_color_bgr(raw.color[1], f"colour of {raw.name}") if whole and raw.color else None
        gray = _gray(raw)
        depth_m = depth_in_metres(raw.depth[::step, ::step], self._recording.depth_scale)
        digest = hashlib.blake2b(raw.depth.tobytes(), digest_size=16).digest()
        self._frames.append(SmallFrame(index, raw.stamp_ns, depth_m, gray, digest))
        if whole:
            self._whole.append(WholeFrame(index, raw.depth, bgr))

    def probe(
        self,
        damaged: Sequence[RecordingError] = (),
        refused: Sequence[RecordingError] = (),
        without: Collection[int] = (),
    ) -> Probe:
        """Return the probe of the gathered frames, without those whose index is in `without`."""
        frames = tuple(frame for frame in self._frames if frame.index not in without)
        whole = tuple(frame for frame in self._whole if frame.index not in without)
        return Probe(self._recording, frames, whole, tuple(damaged), tuple(refused), self._step)


def probe_recording(recording: Recording, few: bool = False) -> Probe:
    """Read the probe of a recording: every frame if there are at most 250, else up to 342 frames in runs.

    With `few`, at most eight frames are read, evenly spread.
    """
    count = len(recording)
    indices = evenly(count, FEW_FRAMES) if few else frames_to_read(count)
    gathering = ProbeBuilder(recording, indices)
    damaged: list[RecordingError] = []
    refused: list[RecordingError] = []
    odd: dict[int, RecordingError] = {}
    odd_color: dict[int, RecordingError] = {}
    for index in indices.tolist():
        try:
            frame = recording.frame(index)
            gathering.take(index, frame)
            for check, found in ((check_size, odd), (check_color, odd_color)):
                try:
                    check(frame, recording)
                except OddImageError as error:
                    found[index] = error
        except RecordingError as error:
            whole = isinstance(error, OddImageError) or not isinstance(error, DamagedImageError)
            (refused if whole else damaged).append(error)
    if len(odd.keys() | odd_color.keys()) >= MAX_DAMAGED * len(indices):
        odd = {}  # too many for a build to leave out; the depth check reports their sizes
    return gathering.probe(damaged, [*refused, *(odd_color | odd).values()], [*odd, *odd_color])


def frames_to_read(count: int) -> NDArray[np.int64]:
    """Return the indices of the frames to read from a recording of `count` frames, increasing."""
    if count <= ALL_FRAMES:
        return np.arange(count)
    middle = (count - LONG_RUN) // 2
    starts = np.linspace(0, count - SHORT_RUN, SHORT_RUNS).astype(np.int64)
    runs = [np.arange(start, start + SHORT_RUN) for start in starts]
    ends = [np.arange(END_RUN), np.arange(count - END_RUN, count)]
    return np.unique(np.concatenate([*runs, *ends, np.arange(middle, middle + LONG_RUN)]))


def _gray(raw: RawFrame) -> NDArray[np.uint8] | None:
    """Return a frame's colour as grey, reduced 8, 4 or 2 times if that leaves a width of 320 pixels or more.

    The result is None if the frame has no colour.
    """
    if raw.color is None:
        return None
    data, name = raw.color[1], f"colour of {raw.name}"
    _, width, _ = image_header(data, name)
    flags = (cv2.IMREAD_REDUCED_GRAYSCALE_8, cv2.IMREAD_REDUCED_GRAYSCALE_4, cv2.IMREAD_REDUCED_GRAYSCALE_2)
    fitting = (flag for flag, by in zip(flags, (8, 4, 2), strict=True) if width >= by * GRAY_COLUMNS)
    try:
        return np.asarray(decoded_image(data, next(fitting, cv2.IMREAD_GRAYSCALE)), np.uint8)
    except ValueError as error:
        raise DamagedImageError(f"{name}: {error}") from error
