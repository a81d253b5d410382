"""The setting that says how given poses are stored."""

from typing import Literal

from pydantic import Field

from kinectbench.core.trajectory.pose_convention import PoseConvention
from kinectbench.settings.base import Settings


class TrajectoryReading(Settings):
    """How given poses are stored, if not as camera to world, in metres, with z ahead and y down.

    It is applied to the depth camera's poses: where a file gives those of another camera, the reader has
    moved them before.
    """

    inverse: bool = Field(False, description="whether they map the world to the camera")
    axes: Literal["optical", "opengl", "robot"] = Field(
        "optical",
        description="the camera's axes; opengl: y up, z backward (Blender, NeRF); robot: x forward, z up",
    )
    wxyz: bool = Field(False, description="whether quaternions are stored as w x y z")
    unit_m: float = Field(
        1.0, ge=1e-6, le=1e6, description="their unit of length, metres; millimetres: 0.001"
    )

    def convention(self) -> PoseConvention:
        """Return the convention in which the poses are stored."""
        return PoseConvention(self.inverse, self.axes, self.wxyz, unit_m=self.unit_m)
