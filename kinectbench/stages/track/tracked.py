"""The tracker's result: a state and a pose for every frame, and constraints between keyframes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import NO_CALIBRATION, DepthCalibration
from kinectbench.core.types import Float64
from kinectbench.stages.track.registration import Registration

State = Literal["tracked", "relocalised", "lost"]
ConstraintKind = Literal["odometry", "covisible", "loop"]


@dataclass(frozen=True)
class Constraint:
    """A constraint of the pose graph: two keyframes registered to each other.

    Attributes:
        a: index of the earlier frame in the sequence.
        b: index of the later frame.
        registration: registration of b to a.
        kind: odometry: consecutive keyframes; covisible: at most three keyframes apart; loop: all others.
        weight: 0 to 1, the weight that the robust kernel of the pose graph assigned.
    """

    a: int
    b: int
    registration: Registration
    kind: ConstraintKind
    weight: float = 1.0

    @property
    def T_a_b(self) -> Float64:
        """(4, 4), the measured relative pose."""
        return self.registration.T_target_source


@dataclass(frozen=True)
class Tracked:
    """A tracked sequence of n frames.

    Attributes:
        T_world_camera: (n, 4, 4), NaN where lost.
        states: (n,) tracked: followed from the previous frame; relocalised: joined again after a gap; lost.
        reasons: {frame: why it is lost}; without frames whose given pose disagrees with the depth.
        keyframes: (k,) int64 frame indices of the keyframes, ascending.
        constraints: the accepted constraints.
        refused: constraints rejected, switched off by the optimisation, or outside the world.
        residual_m: (n,) point-to-plane residual of each frame to keyframes, metres: root mean square, but the
            median absolute value for given poses; NaN where unknown.
        noise_m: (n,) the residual expected from a Kinect's depth noise alone; NaN where unknown.
        inlier_share: (n,) inlier ratio of the frame's points; NaN where unknown.
        degenerate: (n,) bool, the frame's depth has an unobservable direction (as with one plane in view).
        sharpness: sharpness of the colour (`image_sharpness`), by frame index, where colour was read.
        calibration: the depth calibration used for the poses.
        readout_s: readout time of the rolling shutter that was undone in all frames; 0: none.
        color_delay_s: estimated delay of colour relative to depth, seconds; 0: none.
    """

    T_world_camera: Float64
    states: tuple[State, ...]
    reasons: dict[int, str]
    keyframes: NDArray[np.int64]
    constraints: tuple[Constraint, ...]
    refused: tuple[Constraint, ...]
    residual_m: Float64
    noise_m: Float64
    inlier_share: Float64
    degenerate: NDArray[np.bool_]
    sharpness: Mapping[int, float] = field(default_factory=dict)
    calibration: DepthCalibration = NO_CALIBRATION
    readout_s: float = 0.0
    color_delay_s: float = 0.0
