"""Rigid transforms, cameras, planes, boxes and grids: numpy only, no state."""

from kinectbench.geometry.box import OrientedBox
from kinectbench.geometry.camera import Camera
from kinectbench.geometry.grid import Grid
from kinectbench.geometry.mesh import TriangleMesh
from kinectbench.geometry.rigid import (
    closest_rotation,
    interpolate_rigid,
    invert_rigid,
    quaternion_xyzw_from_rotation,
    rigid,
    rotation_angle_rad,
    rotation_from_quaternion_xyzw,
    transform_points,
)

__all__ = [
    "Camera",
    "Grid",
    "OrientedBox",
    "TriangleMesh",
    "closest_rotation",
    "interpolate_rigid",
    "invert_rigid",
    "quaternion_xyzw_from_rotation",
    "rigid",
    "rotation_angle_rad",
    "rotation_from_quaternion_xyzw",
    "transform_points",
]
