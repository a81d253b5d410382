"""Limits of a depth camera and of its positions: the lengths that define which space is air.

Air is the space that a camera within these limits could see (`core.voxels.seeable`). The settings take their
defaults from here; this file imports no heavy library.
"""

from dataclasses import astuple, dataclass

# Objects this small stand on a table, recorded from 0.5 to 1 m, where ten pixels are 10 to 20 mm.
SMALL_M, NEAR_LINE_M = 0.4, 0.02


@dataclass(frozen=True)
class SensorLimits:
    """Limits of a sensor and of its positions; all lengths in metres.

    Attributes:
        line_width_m: width of a line of sight. No depth camera measures through narrower gaps: 30 mm are ten
            pixels of a Kinect at 1.6 m, the width of its matching window.
        near_m: minimum range; 0.4 m is that of a Kinect v1 in near mode.
        camera_size_m: diameter of the ball that stands for a hand-held camera; it must not cross the object.
        camera_height_m: smallest height of the ball's centre above the plane that the object stands on.
    """

    line_width_m: float = 0.03
    near_m: float = 0.4
    camera_size_m: float = 0.15
    camera_height_m: float = 0.05

    @classmethod
    def of_size(cls, longest_m: float) -> "SensorLimits":
        """Return default limits: lines of sight 20 mm wide if the longest side is below 0.4 m, else 30 mm."""
        return cls(line_width_m=NEAR_LINE_M) if longest_m < SMALL_M else cls()

    def enlarged(self, scale: float) -> "SensorLimits":
        """Return the limits with every length divided by `scale`, for a world in units of `scale` metres."""
        return SensorLimits(*(length_m / scale for length_m in astuple(self)))


DEFAULT_LIMITS = SensorLimits()
