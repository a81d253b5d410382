"""What the tracker found: a state and a pose for every frame, and what ties the keyframes to each other."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry.depth import NO_CALIBRATION, DepthCalibration
from kinectbench.core.types import Float64
from kinectbench.stages.track.registration import Registration

State = Literal["tracked", "relocalised", "lost"]
TieKind = Literal["odometry", "covisible", "loop"]


@dataclass(frozen=True)
class Tie:
    """Two keyframes registered to each other.

    Attributes:
        a: index of the one frame, in the sequence.
        b: index of the other.
        registration: of b to a.
        kind: odometry: consecutive; covisible: near in time; loop: a place seen again.
        weight: 0 to 1, what the robust kernel of the pose graph left of it.
    """

    a: int
    b: int
    registration: Registration
    kind: TieKind
    weight: float = 1.0

    @property
    def T_a_b(self) -> Float64:
        """(4, 4), as it was measured."""
        return self.registration.T_target_source


@dataclass(frozen=True)
class Tracked:
    """A tracked sequence of n frames.

    Attributes:
        T_world_camera: (n, 4, 4), NaN where lost.
        states: (n,) tracked: followed from the frame before; relocalised: joined again after a gap; lost.
        reasons: per lost frame, why.
        keyframes: (k,) int64 frame indices, ascending.
        ties: what was kept.
        refused: ties of keyframes that were tried and not believed, with a weight of 0.
        residual_m: (n,) rms point-to-plane residual of each frame to other keyframes; NaN where unknown.
        noise_m: (n,) what the noise of a Kinect's depth alone would make of that residual; NaN where unknown.
        inlier_share: (n,) share of its points that agree with them; NaN where unknown.
        degenerate: (n,) bool, its depth alone leaves a motion open (as one plane in view does).
        sharpness: of the colour, by frame, where it was read (`image_sharpness`).
        calibration: of the depth, as the poses were found with it.
        readout_s: of the rolling shutter that was undone in all frames; 0: none.
        color_delay_s: by how much colour was found to be taken later than depth, likewise.
    """

    T_world_camera: Float64
    states: tuple[State, ...]
    reasons: dict[int, str]
    keyframes: NDArray[np.int64]
    ties: tuple[Tie, ...]
    refused: tuple[Tie, ...]
    residual_m: Float64
    noise_m: Float64
    inlier_share: Float64
    degenerate: NDArray[np.bool_]
    sharpness: Mapping[int, float] = field(default_factory=dict)
    calibration: DepthCalibration = NO_CALIBRATION
    readout_s: float = 0.0
    color_delay_s: float = 0.0
