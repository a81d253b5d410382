"""Files beside the poses of a trajectory: health.json and depth_calibration.json."""

from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from kinectbench.core.artefacts.stored import (
    DegreesInFile,
    MillimetresInFile,
    MillisecondsInFile,
    ScaledPart,
    Stored,
    StoredPart,
    optional,
)
from kinectbench.core.geometry import TERMS, DepthCalibration
from kinectbench.core.types import Float64

Grade = Literal["good", "fair", "not good"]
GRADES: tuple[Grade, ...] = ("not good", "fair", "good")  # rising
# Files of older versions name millimetres, which no recording promised.
OLDER_GRADES: dict[object, Grade] = {"5 mm": "good", "10 mm": "fair"}
Source = Literal["trust", "refine", "tracked"]
Recommendation = Literal["trust", "refine", "ignore"]
FrameState = Literal["tracked", "relocalised", "lost", "rejected"]

Millimetres = MillimetresInFile | None


class LostStretch(StoredPart):
    """A run of frames in which the camera was lost."""

    first_frame: int = Field(description="its first frame")
    last_frame: int = Field(description="its last frame")
    from_s: float | None = optional("when it begins, seconds from the first frame")
    to_s: float | None = optional("when it ends, likewise")
    reason: str = Field("", description="the most frequent reason")


class Jump(StoredPart):
    """A step between frames in which the camera moves far faster than in the other steps."""

    from_frame: int = Field(description="the frame before it")
    to_frame: int = Field(description="the next frame with a pose")
    moved_m: float = Field(description="how far the camera moves, metres")
    times_as_fast: float = Field(description="its speed, divided by the 95th percentile of all steps")


class RejectedFrame(ScaledPart):
    """A frame that was left out because its depth disagrees with its given pose."""

    frame: int = Field(description="its index")
    stamp_ns: int | None = optional("its depth stamp, nanoseconds")
    residual_m: Millimetres = optional("median absolute residual, as given, mm")
    shift_m: Millimetres = optional("shift of its points to agree with other frames, mm")
    turn_rad: DegreesInFile | None = optional("turn of its camera to agree, degrees")
    reason: str = Field("", description="reason in words")


class ConstraintCounts(StoredPart):
    """The number of constraints in the pose graph, by kind."""

    odometry: int = Field(0, description="constraints between consecutive keyframes")
    covisible: int = Field(0, description="constraints between keyframes near in time")
    loop: int = Field(0, description="constraints where a place is seen again")
    refused: int = Field(0, description="constraints refused, not in the graph")


class LoopClosure(ScaledPart):
    """Two keyframes that see the same place again, and the result of their registration."""

    a: int = Field(description="first keyframe's frame")
    b: int = Field(description="second keyframe's frame")
    residual_m: Millimetres = optional("rms distance, point to plane, mm")
    overlap: float | None = optional("share of b's points that can be compared with a")
    inlier_share: float | None = optional("share of these points that agree")
    correction_m: Millimetres = optional("disagreement with the final poses, mm")
    correction_rad: DegreesInFile | None = optional("likewise, as angle, degrees")
    weight: float | None = optional("weight left by the robust kernel, 0 to 1")
    believed: bool = Field(description="whether its weight is at least half")


class GivenFigures(ScaledPart):
    """The agreement of a given trajectory with the depth."""

    disagreeing: tuple[int, ...] = Field((), description="frames whose depth disagrees with it")
    median_shift_m: Millimetres = optional("median disagreement with near frames, mm")
    distant_shift_m: Millimetres = optional("median disagreement with distant frames, mm")
    distant_unmatched: float | None = optional(
        "share of distant frame pairs that should match but fit nowhere near"
    )
    largest_jump_m: Millimetres = optional("largest jump; 0: none; mm")
    refined_apart_m: Millimetres = optional("rms distance between given and refined poses, mm")
    distant_residual_m: Millimetres = optional("residual of distant frames, poses as given, mm")
    refined_distant_residual_m: Millimetres = optional("the same residual with refined poses, mm")


class Covisibility(StoredPart):
    """For pairs of keyframes, the share of the first one's points that the second one sees."""

    keyframes: tuple[int, ...] = Field((), description="up to 60 keyframes with a pose")
    share: list[list[float]] = Field([], description="[i][j]: share of the points of keyframe i that j sees")


class FrameHealth(ScaledPart):
    """Results of tracking for one frame; unknown values are null."""

    frame: int = Field(description="its index")
    state: FrameState = Field("tracked", description="whether it has a pose, and if not, why")
    residual_m: Millimetres = optional("residual to other frames, mm")
    shift_m: Millimetres = optional("possible error of its pose, mm")
    inlier_share: float | None = optional("share of its points that agree with other frames")
    speed_m_per_s: float | None = optional("camera speed since the frame before, m/s")
    turn_rad_per_s: float | None = optional("camera's rate of turn, rad/s")
    blur: float | None = optional("colour blur: the recording's median sharpness, divided by the frame's")


class TrajectoryHealth(ScaledPart, Stored):
    """health.json: measures of a trajectory's quality, without ground truth; see docs/tracking.md."""

    FILE: ClassVar[str] = "health.json"

    format_version: int = Field(1, description="version of this file's format")
    source: Source = Field(description="trust: the given poses; refine: these, corrected; tracked: found")
    verdict: str = Field(description="what the poses are good for, and why, in a sentence")
    grade: Annotated[Grade, BeforeValidator(lambda grade: OLDER_GRADES.get(grade, grade))] = Field(
        description="verdict in short; no bound on any error"
    )
    recommended: Recommendation | None = optional("what to do with a given trajectory; null without one")
    warnings: tuple[str, ...] = Field((), description="what people should know, one line each")
    frames: int = Field(description="frames of the recording")
    tracked: int = Field(description="frames with a pose")
    lost: tuple[int, ...] = Field((), description="frames without a pose, except rejected ones")
    lost_stretches: tuple[LostStretch, ...] = Field((), description="runs of lost frames")
    jumps: tuple[Jump, ...] = Field((), description="steps far faster than the others")
    relocalised: tuple[int, ...] = Field((), description="frames found again after a gap")
    rejected: tuple[RejectedFrame, ...] = Field(
        (), description="frames left out: depth disagrees with the given pose"
    )
    degenerate: tuple[int, ...] = Field(
        (), description="frames whose depth alone leaves some motion undetermined"
    )
    unchecked: int | None = optional("frames that overlap others too little to be checked")
    keyframes: tuple[int, ...] = Field((), description="frames that others are compared with")
    median_shift_m: Millimetres = optional("median possible error of the poses, mm")
    max_shift_m: Millimetres = optional("largest of these errors, mm")
    median_residual_m: Millimetres = optional("median residual of frames with a pose, mm")
    held_out_residual_m: Millimetres = optional("median residual of frames that are no keyframes, mm")
    sensor_noise_m: Millimetres = optional("the same residual from sensor noise alone, mm")
    path_length_m: float | None = Field(
        None, alias="path_length_m", description="the camera path's length, m"
    )
    open_path_m: float | None = Field(
        None, alias="open_path_m", description="path outside every believed loop, m"
    )
    open_gap_s: float | None = optional("longest time without a pose that no believed loop spans, seconds")
    arc_rad: DegreesInFile | None = optional("angle walked around what cameras look at, degrees")
    ties: ConstraintCounts = Field(ConstraintCounts(), description="constraints of the pose graph")
    loop_correction_m: Millimetres = optional(
        "rms disagreement of believed loops with the poses, without one in twenty that may be off, mm"
    )
    loops: tuple[LoopClosure, ...] = Field((), description="loop closures in the pose graph")
    refused_loops: tuple[LoopClosure, ...] = Field((), description="loop closures tried, but not believed")
    given: GivenFigures | None = optional("check of a given trajectory; null without one")
    readout_s: MillisecondsInFile | None = Field(
        None,
        alias="readout_ms",
        description="rolling shutter that was corrected: from first row to last, ms; null: none",
    )
    color_delay_s: MillisecondsInFile | None = Field(
        None,
        alias="color_delay_ms",
        description="delay of colour after depth, which is corrected, ms; null: none",
    )
    covisibility: Covisibility = Field(Covisibility(), description="what keyframes see of each other")
    per_frame: tuple[FrameHealth, ...] = Field((), description="a row for each frame")

    @model_validator(mode="after")
    def _rows_of_its_frames(self) -> Self:
        frames = [row.frame for row in self.per_frame]
        if len(set(frames)) < len(frames) or any(not 0 <= frame < self.frames for frame in frames):
            raise ValueError(
                f"'per_frame' names a frame twice, or one that is not among the {self.frames} frames"
            )
        return self

    def pose_sigma_m(self) -> Float64:
        """Standard deviation of each frame's pose (n,), as a shift of its points, metres; NaN if unknown."""
        sigma_m = np.full(self.frames, np.nan)
        for row in self.per_frame:
            sigma_m[row.frame] = np.nan if row.shift_m is None else row.shift_m
        return sigma_m


class StoredDepthCalibration(Stored):
    """depth_calibration.json: the depth correction that was used to estimate the poses."""

    FILE: ClassVar[str] = "depth_calibration.json"

    formula: str = Field(
        "1 / true depth = 1 / depth + sum of coefficient * P_i(x) * P_j(y); P: Legendre, "
        "x = (2 u + 1) / width - 1, y = (2 v + 1) / height - 1",
        description="formula that the coefficients belong to",
    )
    terms: list[tuple[int, int]] = Field(TERMS, description="orders (i, j) of each coefficient")
    coefficients_per_m: list[float] = Field(description="coefficient of each term, 1/m")

    @model_validator(mode="after")
    def _known_terms(self) -> Self:
        if self.terms != TERMS or len(self.coefficients_per_m) != len(TERMS):
            raise ValueError(f"holds other terms than the {len(TERMS)} that are known")
        return self

    @property
    def calibration(self) -> DepthCalibration:
        """The stored correction as a `DepthCalibration`."""
        return DepthCalibration(np.array(self.coefficients_per_m, np.float64))
