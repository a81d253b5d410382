"""The convention in which poses are stored: their direction, the camera's axes, quaternions and the unit."""

from dataclasses import dataclass, fields

import numpy as np

from kinectbench.core.geometry import (
    invert_rigid,
    quaternion_xyzw_from_rotation,
    rigid,
    rotation_from_quaternion_xyzw,
)
from kinectbench.core.types import Float64

# Names of camera axes, and R_camera_optical for each.
AXES: dict[str, Float64] = {
    "optical": np.eye(3),
    "opengl": np.diag([1.0, -1.0, -1.0]),
    "robot": np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
}
AXES_IN_WORDS = {
    "optical": "",
    "opengl": "OpenGL axes (y up, z backward)",
    "robot": "robot axes (x forward, z up)",
}
IMAGES: dict[str, Float64] = {
    "upright": np.eye(3),
    "mirrored": np.diag([-1.0, 1.0, 1.0]),
    "y_up": np.diag([1.0, -1.0, 1.0]),
    "turned": np.diag([-1.0, -1.0, 1.0]),
}
IMAGES_IN_WORDS = {
    "upright": "",
    "mirrored": "images mirrored left to right",
    "y_up": "y of the camera and of the world mirrored (y up, as in ICL-NUIM)",
    "turned": "images turned upside down",
}


@dataclass(frozen=True)
class PoseConvention:
    """A convention in which given poses may be stored; the defaults are the convention poses should have.

    Attributes:
        inverse: whether the poses map the world to the camera.
        axes: the camera's axes, a key of AXES: "optical", "opengl" or "robot".
        wxyz: whether quaternions are stored as w, x, y, z instead of x, y, z, w.
        images: a key of IMAGES: "upright", "mirrored" left to right, "turned" upside down, or "y_up", if the
            y axis of the camera points up, as where ICL-NUIM states a negative fy.
        unit_m: the poses' unit of length in metres: 0.001 for millimetres.
    """

    inverse: bool = False
    axes: str = "optical"
    wxyz: bool = False
    images: str = "upright"
    unit_m: float = 1.0

    @property
    def changes(self) -> int:
        """The number of attributes that differ from their defaults."""
        return sum(getattr(self, field.name) != field.default for field in fields(self))

    def text(self) -> str:
        """Return the differences from the default convention, in words."""
        parts = [
            "world to camera (inverse)" if self.inverse else "",
            AXES_IN_WORDS[self.axes],
            "quaternions in the order w x y z" if self.wxyz else "",
            IMAGES_IN_WORDS[self.images],
            f"lengths {self.unit_m:g} times as long" if self.unit_m != 1 else "",
        ]
        return ", ".join(part for part in parts if part) or "as given"

    def setting(self) -> str:
        """Return the camera setting by which poses are read in this convention; "" for other images."""
        keys = [
            "inverse: true" if self.inverse else "",
            f"axes: {self.axes}" if self.axes != "optical" else "",
            "wxyz: true" if self.wxyz else "",
            f"unit_m: {self.unit_m:g}" if self.unit_m != 1 else "",
        ]
        said = ", ".join(filter(None, keys))
        return f"{{trajectory_reading: {{{said}}}}}" if said and self.images == "upright" else ""

    def apply(self, poses: Float64) -> Float64:
        """Convert poses (n, 4, 4), parsed as if in the default convention, to T_world_camera; NaN stays NaN.

        The result has optical axes and is in metres.
        """
        known = np.isfinite(poses[:, 0, 0])
        T = poses[known]
        if self.wxyz:
            quaternions_wxyz = quaternion_xyzw_from_rotation(T[:, :3, :3])
            T[:, :3, :3] = rotation_from_quaternion_xyzw(np.roll(quaternions_wxyz, -1, axis=1))
        if self.inverse:
            T = invert_rigid(T)
        T[:, :3, 3] *= self.unit_m
        T = T @ rigid(AXES[self.axes], np.zeros(3))
        mirror = rigid(IMAGES[self.images], np.zeros(3))
        read = np.full_like(poses, np.nan)
        read[known] = mirror @ T @ mirror
        return read
