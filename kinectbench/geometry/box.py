"""An upright box in the floor frame, turned about the vertical."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry.rigid import rigid, transform_points


def yaw_rotation(yaw_rad: float) -> NDArray[np.float64]:
    """The (3, 3) rotation about z by `yaw_rad`, counter-clockwise seen from above."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class OrientedBox:
    """A box in frame `floor` (z up, floor at z = 0).

    Attributes:
        center_m: (3,) centre, metres.
        size_m: (3,) edge lengths, metres.
        yaw_rad: turn about z, radians, counter-clockwise seen from above.
    """

    center_m: tuple[float, float, float]
    size_m: tuple[float, float, float]
    yaw_rad: float = 0.0

    @property
    def T_floor_box(self) -> NDArray[np.float64]:
        """(4, 4), maps the box's frame (origin at its centre) to the floor frame."""
        return rigid(yaw_rotation(self.yaw_rad), self.center_m)

    def grown(self, margin_m: float) -> "OrientedBox":
        """The box with every side moved out by `margin_m`, metres."""
        x, y, z = (edge + 2 * margin_m for edge in self.size_m)
        return OrientedBox(self.center_m, (x, y, z), self.yaw_rad)

    def corners_floor(self) -> NDArray[np.float64]:
        """The eight corners (8, 3) in the floor frame, metres."""
        signs = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5], indexing="ij"))
        local = signs.reshape(3, 8).T * np.array(self.size_m)
        return transform_points(self.T_floor_box, local)

    def contains(self, points_floor: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Which of the points (..., 3), floor frame, lie inside or on the box: bool (...)."""
        local = (points_floor - np.array(self.center_m)) @ self.T_floor_box[:3, :3]
        inside: NDArray[np.bool_] = np.all(np.abs(local) <= np.array(self.size_m) / 2, axis=-1)
        return inside
