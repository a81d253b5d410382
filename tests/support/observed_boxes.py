"""What many frames say of things made of boxes that stand on a floor: observations without a camera."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from kinectbench.core.geometry import Grid, rigid, rotation_from_quaternion_xyzw
from kinectbench.core.voxels.observation import Observation
from kinectbench.stages.segment.solid.evidence import FloorLayers

# Of a room: how deep it goes below the floor, and up to where floor and object cannot be told apart.
BELOW_M, CUT_M = 0.02, 0.02
T_WORLD_GRID = rigid(rotation_from_quaternion_xyzw([0.1, 0.5, -0.2, 0.8]), [1.0, -0.5, 0.2])


@dataclass(frozen=True)
class Room:
    """A grid of some voxel size, on whose floor things stand.

    Attributes:
        voxel_m: edge of a voxel, metres.
        size_m: of the grid, metres; its first 20 mm upwards lie below the floor.
    """

    voxel_m: float
    size_m: tuple[float, float, float]

    @property
    def grid(self) -> Grid:
        nx, ny, nz = (round(length_m / self.voxel_m) for length_m in self.size_m)
        return Grid((nx, ny, nz), self.voxel_m, T_WORLD_GRID)

    @property
    def layers(self) -> FloorLayers:
        return FloorLayers(round(BELOW_M / self.voxel_m), round(CUT_M / self.voxel_m))

    def nothing(self) -> np.ndarray:
        """No voxel."""
        return np.zeros(self.grid.shape, bool)

    def centers(self) -> np.ndarray:
        """Cell centres with the floor at z = 0."""
        index = np.stack(np.meshgrid(*map(np.arange, self.grid.shape), indexing="ij"), -1)
        return (index + 0.5) * self.voxel_m - [0, 0, BELOW_M]

    def box_distance(self, low: ArrayLike, high: ArrayLike) -> np.ndarray:
        """Signed distance of a box, negative inside."""
        p, middle, half = self.centers(), np.add(low, high) / 2, np.subtract(high, low) / 2
        q = np.abs(p - middle) - half
        distance: np.ndarray = np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(axis=-1), 0)
        return distance

    def within(self, low: ArrayLike, high: ArrayLike) -> np.ndarray:
        """The voxels whose middle lies in a box, bool."""
        return self.box_distance(low, high) < 0

    def observation(
        self,
        distance_m: np.ndarray,
        hidden: np.ndarray | None = None,
        floor: bool = True,
        truncation_m: float | None = None,
    ) -> Observation:
        """What many frames from all around say: nothing deeper than the truncation, nor where hidden.

        The truncation is four voxels if it is not given.
        """
        if truncation_m is None:
            truncation_m = 4 * self.voxel_m
        if floor:
            distance_m = np.minimum(distance_m, self.centers()[..., 2])
        seen = distance_m > -truncation_m
        if hidden is not None:
            seen &= ~hidden
        tsdf = np.where(seen, np.clip(distance_m, -truncation_m, truncation_m), 0).astype(np.float32)
        free = np.where(seen & (distance_m > self.voxel_m), 20, 0).astype(np.uint16)
        surface = np.where(seen & (np.abs(distance_m) <= self.voxel_m), 20, 0).astype(np.uint16)
        weight = np.where(seen, np.float32(5), np.float32(0))
        return Observation(self.grid, tsdf, weight, free, surface)


def looked_into(outer_m: np.ndarray, hole_m: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Distance of what the frames measured of a body with a hole that they looked into in part.

    Where they did not, they measured the body from outside only, as if it had no hole.

    Args:
        outer_m: distance of the body without its hole.
        hole_m: distance of the hole, negative in it.
        seen: bool, where frames looked into the hole.
    """
    return np.where(seen, np.maximum(outer_m, -hole_m), outer_m)


# The little room of most scenes.
ROOM = Room(0.005, (0.32, 0.24, 0.4))
VOXEL_M, GRID, LAYERS = ROOM.voxel_m, ROOM.grid, ROOM.layers
SHAPE, FLOOR_LAYERS, CUT_LAYERS = GRID.shape, LAYERS.below, LAYERS.contact
TRUNCATION_M = 4 * VOXEL_M
centers, box_distance, within, observation = ROOM.centers, ROOM.box_distance, ROOM.within, ROOM.observation

# A body that stands on the floor; no camera sees where it does.
BODY = ((0.06, 0.05, -1.0), (0.26, 0.19, 0.3))


def bin_seen_to(height_m: float) -> np.ndarray:
    """Distance of `BODY` with a cavity, its walls and bottom 20 mm thick: nobody looked below a height."""
    cavity_m = box_distance((0.08, 0.07, 0.02), (0.24, 0.17, 1.0))
    return looked_into(box_distance(*BODY), cavity_m, centers()[..., 2] > height_m)


def body_with_a_crack(width_m: float) -> np.ndarray:
    """Distance of `BODY` with a crack across its top, that was looked into 60 mm deep."""
    crack_m = box_distance((0.16 - width_m / 2, 0.0, 0.02), (0.16 + width_m / 2, 0.24, 1.0))
    return looked_into(box_distance(*BODY), crack_m, centers()[..., 2] > 0.24)


def cupboard_seen_to(y_m: float) -> np.ndarray:
    """Distance of `BODY` with a compartment that is open towards y: nobody looked farther in than that."""
    inner_m = box_distance((0.08, 0.07, 0.02), (0.24, 1.0, 0.28))
    return looked_into(box_distance(*BODY), inner_m, centers()[..., 1] > y_m)
