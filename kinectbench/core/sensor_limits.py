"""Limits of a depth camera and of its positions: the lengths that define air.

`core.voxels.seeable` has the definition. The settings have their defaults from here, so that this file loads
no heavy library.
"""

from dataclasses import astuple, dataclass

# Things so small stand on a table and are recorded from 0.5 to 1 m, where ten pixels are 10 to 20 mm.
SMALL_M, NEAR_LINE_M = 0.4, 0.02


@dataclass(frozen=True)
class SensorLimits:
    """Limits of a sensor and of its positions; all lengths in metres.

    Attributes:
        line_width_m: a line of sight is as wide. Through less no depth camera measures: 30 mm are ten pixels
            of a Kinect at 1.6 m, and as many as its matching window has.
        near_m: minimum range: that of a Kinect v1 in near mode.
        camera_size_m: diameter of the ball that is moved without crossing the object: a camera in a hand.
        camera_height_m: its centre is at least so high above the plane that the object stands on.
    """

    line_width_m: float = 0.03
    near_m: float = 0.4
    camera_size_m: float = 0.15
    camera_height_m: float = 0.05

    @classmethod
    def of_size(cls, longest_m: float) -> "SensorLimits":
        """Lines of 30 mm; 20 mm for things shorter than 0.4 m, which are recorded from close by."""
        return cls(line_width_m=NEAR_LINE_M) if longest_m < SMALL_M else cls()

    def enlarged(self, scale: float) -> "SensorLimits":
        """The same limits in a world scaled by 1 / scale."""
        return SensorLimits(*(length_m / scale for length_m in astuple(self)))


DEFAULT_LIMITS = SensorLimits()
