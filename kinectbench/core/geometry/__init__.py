"""Rigid transforms, cameras, planes, boxes, grids, depth and meshes: functions and values without state."""

from kinectbench.core.geometry.boxes import Grid, OrientedBox
from kinectbench.core.geometry.camera import Camera
from kinectbench.core.geometry.mesh import TriangleMesh
from kinectbench.core.geometry.rigid import (
    closest_rotation,
    interpolate_rigid,
    invert_rigid,
    quaternion_xyzw_from_rotation,
    rigid,
    rotation_angle_rad,
    rotation_from_quaternion_xyzw,
    transform_points,
)
