"""How finely an object is made: voxels by its size and by what the frames resolve, and rules to their scale.

The rules for solids were chosen on furniture, with voxels of 5 mm. A small thing that is recorded from near
is to them as furniture is that is as many voxels long: they see it enlarged.
"""

from dataclasses import replace

import numpy as np

from kinectbench.core.geometry import Grid, OrientedBox, TriangleMesh
from kinectbench.core.voxels.observation import RAY_WIDTHS_VOXELS, Observation
from kinectbench.stages.segment.frontiers import Frontier
from kinectbench.stages.segment.near import enlarged_transform
from kinectbench.stages.segment.solid import SolidShape

# What the rules were chosen with; larger voxels are taken only where a person says so.
USUAL_VOXEL_M = 0.005
# No depth camera's noise leaves more to be told, from however near (own choice).
LEAST_VOXEL_M = 0.001
# An object is to be so many voxels long: a thing of 40 cm, as they stand on tables, has the usual ones (own
# choice; with 5 mm a mug's wall is one and a half).
VOXELS_LONG = 80
# Voxels are multiples of it.
STEP_M = 0.00025


def object_voxel_size_m(box: OrientedBox, ray_width_m: float) -> float:
    """Edge of an object's voxels, metres, where no setting says it (own rule).

    Args:
        box: around the object.
        ray_width_m: how wide the frames' rays are there: narrower voxels would seem to be seen through.
    """
    wanted_m = max(max(box.size_m) / VOXELS_LONG, ray_width_m / RAY_WIDTHS_VOXELS[0])
    steps = int(np.ceil(np.clip(wanted_m, LEAST_VOXEL_M, USUAL_VOXEL_M) / STEP_M - 1e-6))
    return round(steps * STEP_M, 6)


def enlarged_observation(seen: Observation, scale: float) -> Observation:
    """The same in a world that is 1 / scale times as large."""
    if scale == 1:
        return seen
    return replace(seen, grid=enlarged_grid(seen.grid, scale), tsdf=seen.tsdf / np.float32(scale))


def enlarged_grid(grid: Grid, scale: float) -> Grid:
    """A grid in a world that is 1 / scale times as large."""
    return Grid(grid.shape, grid.voxel_size_m / scale, enlarged_transform(grid.T_world_grid, scale))


def restored_shape(shape: SolidShape, grid: Grid, scale: float) -> SolidShape:
    """A solid made in the larger world, on its grid in this one."""
    if scale == 1:
        return shape
    return replace(shape, grid=grid, mesh=TriangleMesh(shape.mesh.vertices * scale, shape.mesh.faces))


def restored_frontier(found: Frontier, scale: float) -> Frontier:
    """A frontier found in the larger world, in this one."""
    (a, b), (x, y, z) = found.size_m, found.center_m
    return replace(
        found,
        area_m2=found.area_m2 * scale**2,
        size_m=(a * scale, b * scale),
        center_m=(x * scale, y * scale, z * scale),
        volume_m3=found.volume_m3 * scale**3,
    )
