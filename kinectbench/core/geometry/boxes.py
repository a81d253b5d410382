"""An upright box in the floor frame, turned about the vertical; and a regular voxel grid in the world."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry.rigid import invert_rigid, rigid, transform_points
from kinectbench.core.types import Bools, Float64


def yaw_rotation(yaw_rad: float) -> Float64:
    """Return the (3, 3) rotation about z by `yaw_rad`, counter-clockwise seen from above."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


# A pose as in a row of a trajectory: x, y, z in metres, then a quaternion x, y, z, w.
Pose = tuple[float, float, float, float, float, float, float]


class BoxAnchor(NamedTuple):
    """An image of the recording; its pose identifies the floor frame in which a box was chosen.

    Attributes:
        frame: index of the image in the sequence.
        camera_floor: its camera's pose in the floor frame: x, y, z in metres, and a quaternion x, y, z, w.
        depth_sha256: first 16 digits of the SHA-256 of its depth; None: not known.
    """

    frame: int
    camera_floor: Pose
    depth_sha256: str | None = None


@dataclass(frozen=True)
class OrientedBox:
    """A box in frame `floor` (z up, floor at z = 0).

    Attributes:
        center_m: (3,) centre, metres.
        size_m: (3,) edge lengths, metres.
        yaw_rad: turn about z, radians, counter-clockwise seen from above.
        anchor: identifies the floor frame of a box that the user chose; None: not known.
    """

    center_m: tuple[float, float, float]
    size_m: tuple[float, float, float]
    yaw_rad: float = 0.0
    anchor: BoxAnchor | None = None

    @property
    def T_floor_box(self) -> Float64:
        """(4, 4), maps the box's frame (origin at its centre) to the floor frame."""
        return rigid(yaw_rotation(self.yaw_rad), self.center_m)

    def grown(self, margin_m: float) -> "OrientedBox":
        """Return the box with every side moved out by `margin_m`, metres; without its anchor."""
        x, y, z = (edge + 2 * margin_m for edge in self.size_m)
        return OrientedBox(self.center_m, (x, y, z), self.yaw_rad)

    def corners_floor(self) -> Float64:
        """Return the eight corners (8, 3) in the floor frame, metres."""
        signs = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5], indexing="ij"))
        local = signs.reshape(3, 8).T * np.array(self.size_m)
        return transform_points(self.T_floor_box, local)

    def contains(self, points_floor: NDArray[np.floating]) -> Bools:
        """Which of the points (..., 3), floor frame, lie inside or on the box: bool (...)."""
        local = (points_floor - np.array(self.center_m)) @ self.T_floor_box[:3, :3]
        inside: Bools = np.all(np.abs(local) <= np.array(self.size_m) / 2, axis=-1)
        return inside


@dataclass(frozen=True)
class Grid:
    """A regular grid: the centre of cell i is `(i + 0.5) * voxel_size_m` in frame `grid`; x, y, z in C order.

    Attributes:
        shape: number of cells along x, y and z.
        voxel_size_m: edge of a cell in metres.
        T_world_grid: (4, 4) float64, maps the grid's own frame to the world.
    """

    shape: tuple[int, int, int]
    voxel_size_m: float
    T_world_grid: Float64

    @property
    def T_grid_world(self) -> Float64:
        """(4, 4), maps the world to the grid's own frame."""
        return invert_rigid(self.T_world_grid)

    @property
    def size_m(self) -> Float64:
        """Edge lengths (3,) of the whole grid in metres."""
        return np.array(self.shape, dtype=np.float64) * self.voxel_size_m

    def coarser(self, factor: int) -> "Grid":
        """Return the grid over the box with cells `factor` times as large; `factor` must divide the shape."""
        nx, ny, nz = (n // factor for n in self.shape)
        return Grid((nx, ny, nz), self.voxel_size_m * factor, self.T_world_grid)
