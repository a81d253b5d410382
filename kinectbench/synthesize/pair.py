"""One synthetic pair: depth by a virtual camera, and the whole shape in the same orientation."""

from dataclasses import dataclass

import numpy as np

from kinectbench.synthesize.mesh_check import CheckedMesh
from kinectbench.synthesize.render import DepthCamera
from kinectbench.synthesize.settings import SynthesisSettings
from kinectbench.synthesize.views import ViewAngles, camera_pose
from kinectbench.voxels.framing import object_cube
from kinectbench.voxels.open_mesh import voxelize_open
from kinectbench.voxels.packed_containment import packed_containment
from kinectbench.voxels.packed_shell import packed_shell
from kinectbench.voxels.pair_file import Pair
from kinectbench.voxels.seen_cells import seen_cells
from kinectbench.voxels.solid import voxelize_solid
from kinectbench.voxels.view_grids import partial_grids

VOXELIZERS = {"winding": voxelize_solid, "six-rays": voxelize_open}


@dataclass(frozen=True)
class MadePair:
    """A pair, and why it must not be used, or None."""

    pair: Pair
    refused: str | None


def make_pair(
    checked: CheckedMesh, eye: DepthCamera, view: ViewAngles, settings: SynthesisSettings
) -> MadePair:
    """See a model from one side, and voxelise what is seen and all of it in one cube.

    The cube is the paper's: around the full shape's box in the view's axes. The world's frame is the
    model's own, and its unit stands for a metre. All cells are known, and the surface is exact.

    Args:
        checked: the model.
        eye: the virtual camera before it.
        view: the orientation.
        settings: `up_axis` and `min_containment` count.
    """
    mesh, camera = checked.mesh, eye.camera
    T_world_camera = camera_pose(eye.corners_world, view, camera, settings.up_axis)
    depth_m = eye.depth_m(T_world_camera)
    grid = object_cube(eye.corners_world, T_world_camera)
    full = VOXELIZERS[checked.rule](mesh.vertices, mesh.faces, grid)
    partial_256, partial = partial_grids(depth_m, camera, T_world_camera, grid)
    pair = Pair(
        partial=partial,
        partial_256=partial_256,
        full=full,
        shell=packed_shell(full),
        known=np.full_like(full, 255),
        seen=seen_cells(depth_m, camera, T_world_camera, grid, noisy=False),
        T_world_grid=grid.T_world_grid,
        T_world_camera=T_world_camera,
        K=camera.K,
        voxel_size_m=grid.voxel_size_m,
        surface_sigma_m=0.0,
        framing="object",
        partial_rule="any",
        occupancy_rule=checked.rule,
    )
    return MadePair(pair, _reason(pair, settings.min_containment))


def _reason(pair: Pair, min_containment: float) -> str | None:
    """Why a pair must not be used, or None."""
    if not pair.full.any():
        return "no cell's centre lies in the shape: its walls are thinner than a cell"
    if not pair.partial.any():
        return "the camera sees nothing of the shape"
    inside = packed_containment(pair.partial, pair.full)
    if inside < min_containment:
        return f"containment is {inside:.3f}, below {min_containment}"
    return None
