"""Check each frame of a recording, and the whole recording, while it is written."""

import math

import numpy as np

from kinectbench.core import RecordingError
from kinectbench.core.artefacts.sequence import DAMAGED_FRAME
from kinectbench.core.trajectory.stamps import format_stamp
from kinectbench.stages.ingest.images import OddImageError, advised, image_header
from kinectbench.stages.ingest.recording import RawFrame, Recording

# `track` needs at least this many poses.
MIN_FRAMES = 3
# The share of damaged frames must be below this.
MAX_DAMAGED = 0.05
# Range of an indoor recording's median depth, metres; the typical value is its logarithmic middle.
NEAREST_M, FARTHEST_M, TYPICAL_M = 0.15, 15.0, 1.5
# Units per metre in public recordings: mm, TUM, 0.1 mm, m, cm, 1/256 m and 0.01 mm.
COMMON_SCALES = (1000.0, 5000.0, 10000.0, 1.0, 100.0, 256.0, 100000.0)
# What to do about too few frames, if no image has depth, and about images of two sizes.
RECORD_MORE = "record some hundred, all around the object"
FIND_DEPTH = "check which stream or folder holds depth"
KEEP_SIZE, SEPARATE = "a recording must keep one size", "separate the two cameras or settings"
RESIZE_COLOR = (
    "bring colour to depth's size; or, where it is not registered, leave it out, or state `color_registered: "
    "false`, with the calibration if it is known, in camera.json (of TUM and plain folders)"
)
# Number of frames, and stride along rows and columns, for the median depth.
SAMPLED_FRAMES, SAMPLED_EVERY_PX = 50, 4


class FrameChecks:
    """Checks each frame against the camera of its recording, and gathers data for the checks at the end.

    Damaged frames are left out and counted.
    """

    def __init__(self, recording: Recording) -> None:
        """Start before the first frame."""
        self.recording = recording
        self._left_out: list[str] = []
        self._advice = ""
        self._seen = 0
        self._empty: list[str] = []
        self._medians: list[float] = []
        self._last_stamp_ns: int | None = None

    def check(self, frame: RawFrame) -> str | None:
        """Check one frame; return the suffix that its colour image should have, None if it has no colour.

        Raises:
            DamagedImageError: the colour image is damaged, or (OddImageError) an image has the wrong size.
            RecordingError: stamps do not increase.
        """
        check_size(frame, self.recording)
        if self._last_stamp_ns is not None and frame.stamp_ns <= self._last_stamp_ns:
            raise RecordingError(
                f"{frame.name}: its stamp {format_stamp(frame.stamp_ns)} s does not increase",
                what="bad-stamp",
            )
        suffix = check_color(frame, self.recording)
        self._last_stamp_ns = frame.stamp_ns
        self._look_at_depth(frame)
        return suffix

    def leave_out(self, why: str, advice: str = "") -> None:
        """Record that the caller leaves out a damaged frame.

        Args:
            why: names the frame and the damage.
            advice: what to do, as `advice_on` returns it.
        """
        self._advice = self._advice if self._left_out else advice
        self._left_out.append(why)

    def verdict(self) -> list[str]:
        """Judge the recording after the last frame; return warnings on frames left out and on empty depth.

        Raises:
            RecordingError: 5 % or more of the frames are left out, fewer than three frames are left, no frame
                has depth, or the depth scale is absurd.
        """
        lost, frames = len(self._left_out), len(self.recording)
        if lost and lost >= MAX_DAMAGED * frames:
            line = (
                f"{self._left_out[0]} ({lost} of {frames} frames cannot be used; "
                f"fewer than {MAX_DAMAGED:.0%} may be left out)"
            )
            raise RecordingError(advised(line, self._advice), what="too-many-damaged")
        if frames - lost < MIN_FRAMES:
            raise RecordingError(
                f"{self.recording.path}: usable frames: {frames - lost}; at least {MIN_FRAMES} are needed; "
                f"{RECORD_MORE}",
                what="too-few-frames",
            )
        warnings = [f"{DAMAGED_FRAME}{why}" for why in self._left_out]
        if len(self._empty) == self._seen:
            raise RecordingError(
                f"{self._empty[0]}: this and all {self._seen} depth images are empty (no pixel has a depth); "
                f"{FIND_DEPTH}",
                what="empty-depth",
            )
        self._check_scale()
        if self._empty:
            warnings.append(f"{len(self._empty)} depth images are empty, the first is {self._empty[0]}")
        return warnings

    def _look_at_depth(self, frame: RawFrame) -> None:
        if not frame.depth.any():
            self._empty.append(frame.name)
        else:
            sample = frame.depth[::SAMPLED_EVERY_PX, ::SAMPLED_EVERY_PX]
            valid = sample[sample > 0] if sample.any() else frame.depth[frame.depth > 0]
            self._medians.append(float(np.median(valid)))
        self._seen += 1

    def _check_scale(self) -> None:
        every = max(1, len(self.recording) // SAMPLED_FRAMES)
        native = float(np.median(self._medians[::every]))
        problem = scale_problem(native, self.recording.depth_scale)
        if not problem:
            return
        better = suggested_scale(native)
        hint = f"; at {better:g} it would be {native / better:.3g} m"
        if self.recording.float_scale is not None:  # its own units are not those of `native`
            hint = ""
        raise RecordingError(
            f"{self.recording.path}: {problem}: give its unit in benchmark.yaml, "
            f"`camera: {{depth_scale: ...}}` (units a metre{hint}); where it has "
            "poses, `kinectbench inspect` tries scales and codes by them",
            what="bad-depth-scale",
        )


def scale_problem(median: float, depth_scale: float) -> str:
    """Return an error if the median depth (native units) is implausible indoors at this scale, else ""."""
    if NEAREST_M <= median / depth_scale <= FARTHEST_M:
        return ""
    return (
        f"the median depth is {median / depth_scale:.3g} m at {depth_scale:g} native units per metre, which "
        "no room has"
    )


def suggested_scale(median: float) -> float:
    """Return the common depth scale, units per metre, that brings a median (in units) nearest to 1.5 m."""
    return min(COMMON_SCALES, key=lambda scale: abs(math.log(median / scale / TYPICAL_M)))


def check_size(frame: RawFrame, recording: Recording) -> None:
    """Refuse a frame whose depth has another size than the recording's camera.

    Raises:
        OddImageError: the size differs.
    """
    (height, width), camera = frame.depth.shape, recording.camera
    if (width, height) != (camera.width, camera.height):
        raise OddImageError(
            f"{frame.name}: depth is {width}x{height}, but the first frame's is "
            f"{camera.width}x{camera.height}: {KEEP_SIZE}",
            advice=SEPARATE,
        )


def check_color(frame: RawFrame, recording: Recording) -> str | None:
    """Check a frame's colour image; return the suffix that its file should have, None if there is no colour.

    Raises:
        DamagedImageError: the colour image is damaged.
        OddImageError: colour that is registered to depth has another size.
    """
    if frame.color is None:
        return None
    suffix, width, height = image_header(frame.color[1], f"colour of {frame.name}")
    size_px = recording.camera.width, recording.camera.height
    if recording.color_registered and (width, height) != size_px:
        raise OddImageError(
            f"{frame.name}: its colour is {width}x{height}, but its depth is {size_px[0]}x{size_px[1]}; in a "
            f"recording whose colour is registered to depth (format {recording.format}) the sizes must agree",
            advice=RESIZE_COLOR,
        )
    return suffix


def trajectory_problem(recording: Recording) -> str:
    """Return why a recording's trajectory cannot be used, in one line; "" if it can, or if there is none."""
    trajectory, stamps_ns = recording.given_trajectory, recording.stamps_ns
    if trajectory is None or not len(stamps_ns):
        return recording.trajectory_error
    first_ns, last_ns = int(trajectory.stamps_ns[0]), int(trajectory.stamps_ns[-1])
    if first_ns <= stamps_ns[-1] and last_ns >= stamps_ns[0]:
        return ""
    return (
        f"{recording.path}: the trajectory ({_span(first_ns, last_ns)}) shares no time with the frames "
        f"({_span(int(stamps_ns[0]), int(stamps_ns[-1]))}): it is of another recording or clock; correct it"
    )


def _span(first_ns: int, last_ns: int) -> str:
    return f"{format_stamp(first_ns)} to {format_stamp(last_ns)} s"
