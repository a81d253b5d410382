"""Voxel grids: mesh to solid, depth to partial, resampling, packing."""
