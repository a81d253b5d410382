"""How a given trajectory can be meant: direction, axes, order of the quaternion, unit, mirrored images."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import (
    invert_rigid,
    quaternion_xyzw_from_rotation,
    rigid,
    rotation_from_quaternion_xyzw,
)

Float64 = NDArray[np.float64]

# What the axes of a camera are called, and R_camera_optical for each.
AXES: dict[str, Float64] = {
    "optical": np.eye(3),
    "opengl": np.diag([1.0, -1.0, -1.0]),
    "robot": np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
}
SAID_AXES = {
    "optical": "",
    "opengl": "OpenGL axes (y up, z backward)",
    "robot": "robot axes (x forward, z up)",
}
IMAGES: dict[str, Float64] = {"upright": np.eye(3), "mirrored": np.diag([-1.0, 1.0, 1.0])}
OTHER_UNITS = (0.001, 1000.0, 0.1, 10.0, 0.2, 5.0)


@dataclass(frozen=True)
class Reading:
    """One way to read poses.

    Attributes:
        inverse: they map the world to the camera.
        axes: a key of AXES.
        wxyz: what was read as x, y, z, w of the quaternion is w, x, y, z.
        images: a key of IMAGES.
        unit_m: their unit of length is so many metres, if depth is in metres.
    """

    inverse: bool = False
    axes: str = "optical"
    wxyz: bool = False
    images: str = "upright"
    unit_m: float = 1.0

    @property
    def changes(self) -> int:
        """How many things are other than said."""
        return (
            self.inverse
            + (self.axes != "optical")
            + self.wxyz
            + (self.images != "upright")
            + (self.unit_m != 1)
        )

    def text(self) -> str:
        """What is other than said, in words."""
        parts = [
            "world to camera (inverse)" if self.inverse else "",
            SAID_AXES[self.axes],
            "quaternions in the order w x y z" if self.wxyz else "",
            "images mirrored left to right" if self.images == "mirrored" else "",
            f"lengths {self.unit_m:g} times as long" if self.unit_m != 1 else "",
        ]
        return ", ".join(part for part in parts if part) or "as given"

    def apply(self, poses: Float64) -> Float64:
        """T_world_camera (n, 4, 4) in optical axes and metres from poses (n, 4, 4) as they were read."""
        T = poses.copy()
        if self.wxyz:
            T[:, :3, :3] = rotation_from_quaternion_xyzw([_rolled(pose) for pose in poses])
        if self.inverse:
            T = invert_rigid(T)
        T[:, :3, 3] *= self.unit_m
        T = T @ rigid(AXES[self.axes], np.zeros(3))
        mirror = rigid(IMAGES[self.images], np.zeros(3))
        return np.asarray(mirror @ T @ mirror)


def likely_readings() -> Iterator[Reading]:
    """The readings that are tried first, "as given" before all."""
    yield from _of_unit(1.0)
    yield from (Reading(unit_m=unit_m) for unit_m in OTHER_UNITS)
    yield from (Reading(inverse, images="mirrored") for inverse in (False, True))


def further_readings() -> Iterator[Reading]:
    """The readings that are tried where none of the likely ones fits."""
    for unit_m in OTHER_UNITS:
        yield from (reading for reading in _of_unit(unit_m) if reading.changes > 1)


def _of_unit(unit_m: float) -> Iterator[Reading]:
    for inverse in (False, True):
        for wxyz in (False, True):
            for axes in AXES:
                yield Reading(inverse, axes, wxyz, "upright", unit_m)


def _rolled(pose: Float64) -> Float64:
    """The quaternion x y z w of a pose whose w x y z were read as x y z w."""
    w, x, y, z = quaternion_xyzw_from_rotation(pose[:3, :3])
    return np.array([x, y, z, w])
