"""How a Reconstruction is stored: mesh.ply and volume.npz."""

from pathlib import Path

import numpy as np

from kinectbench.fusion.blocks import in_cubes
from kinectbench.fusion.reconstruction import Reconstruction
from kinectbench.mesh_file import write_ply
from kinectbench.voxels.npz import npz_bytes


def write_reconstruction(reconstruction: Reconstruction, folder: Path) -> None:
    """Write the surface and the volume, its blocks joined to cubes of 16^3.

    volume.npz: `blocks` (n, 3) int32, `tsdf` and `weight` (n, 16, 16, 16) float16 in metres and 1/mm^2,
    `free` and `surface` (n, 16, 16, 16) uint16 votes, `voxel_size_m`, `T_world_grid` (4, 4).
    """
    volume = reconstruction.volume
    write_ply(reconstruction.mesh, folder / "mesh.ply")
    values = {
        "tsdf": volume.tsdf.astype(np.float16),
        "weight": np.minimum(volume.weight, 6e4).astype(np.float16),
        "free": volume.free,
        "surface": volume.surface,
    }
    cubes = {name: in_cubes(volume.blocks, of_blocks) for name, of_blocks in values.items()}
    arrays = {
        "format_version": np.asarray(1),
        "blocks": cubes["tsdf"][0],
        **{name: of_cubes for name, (_, of_cubes) in cubes.items()},
        "voxel_size_m": np.asarray(volume.voxel_size_m),
        "T_world_grid": volume.T_world_grid,
    }
    (folder / "volume.npz").write_bytes(npz_bytes(arrays, level=1))
