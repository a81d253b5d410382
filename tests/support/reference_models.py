"""Built objects that are made of exact meshes, to hold reference meshes against."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial.transform import Rotation

from kinectbench.core.artefacts.object import BoxPart, QualityFile
from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import Grid, OrientedBox, TriangleMesh, rigid
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.core.voxels.solid import voxelize_solid
from kinectbench.lab.simulate.objects import make_object
from kinectbench.stages.segment.find.floor import Floor
from kinectbench.stages.segment.find.planes import floor_frame
from kinectbench.stages.segment.object_model import ObjectModel
from kinectbench.stages.segment.solid.solid import SolidShape

VOXEL_M, MARGIN = 0.006, 8
# An upright object somewhere in a world that is not upright.
T_WORLD_FLOOR = rigid(Rotation.from_euler("xyz", [70, 20, -50], degrees=True).as_matrix(), [0.3, -0.2, 1.9])


def drawn(name: str) -> TriangleMesh:
    """A simulated object such as `chair:5`, upright on z = 0, metres."""
    family, _, seed = name.partition(":")
    mesh = make_object(family, int(seed or 0)).mesh
    return TriangleMesh(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32))


def moved(mesh: TriangleMesh, seed: int) -> tuple[TriangleMesh, NDArray[np.float64]]:
    """The mesh after a random rigid motion (4, 4), and that."""
    T = rigid(Rotation.random(random_state=seed).as_matrix(), [1.0, -2.0, 0.5])
    return mesh.transformed(T), T


def model_of(upright: TriangleMesh, unknown_below_m: float = 0.0) -> ObjectModel:
    """An object whose mesh is exact, measured but for faces that look down; in a world by `T_WORLD_FLOOR`.

    Args:
        upright: on z = 0.
        unknown_below_m: nothing is known below this height.
    """
    low, high = upright.vertices.min(axis=0), upright.vertices.max(axis=0)
    cells = -(-(np.ceil((high - low) / VOXEL_M).astype(int) + 2 * MARGIN) // 8) * 8
    T_floor_grid = rigid(np.eye(3), low - MARGIN * VOXEL_M)
    nx, ny, nz = map(int, cells)
    grid = Grid((nx, ny, nz), VOXEL_M, T_WORLD_FLOOR @ T_floor_grid)
    mesh = upright.transformed(T_WORLD_FLOOR)
    solid = unpack(voxelize_solid(mesh.vertices, mesh.faces, grid))
    # As deep as a face that is half a voxel off reaches.
    core = ndimage.binary_erosion(solid, iterations=2)
    labels = np.where(solid, np.where(core, Label.INTERIOR, Label.SURFACE), Label.FREE).astype(np.uint8)
    labels[:, :, :MARGIN] = Label.OTHER
    labels[:, :, : MARGIN + 1][solid[:, :, : MARGIN + 1]] = Label.INTERIOR  # it stands on its underside
    labels[:, :, : MARGIN + int(unknown_below_m / VOXEL_M)] = Label.UNKNOWN
    around = Grid((16, 16, 16), 0.5, T_WORLD_FLOOR @ rigid(np.eye(3), [-4.0, -4.0, -4.0]))
    plane = np.append(T_WORLD_FLOOR[:3, 2], -T_WORLD_FLOOR[:3, 2] @ T_WORLD_FLOOR[:3, 3])
    x, y, z = map(float, (low + high) / 2)
    length, width, height = map(float, high - low)
    box = OrientedBox((x, y, z), (length, width, height))
    quality = QualityFile(box=BoxPart.of(box, 4, 5), surface_sigma_m=0.0)
    shape = SolidShape(grid, solid, mesh, labels, solid.astype(np.float32), np.zeros_like(solid))
    surround = np.full(around.shape, Label.FREE, np.uint8)
    return ObjectModel(Floor(plane, floor_frame(plane), 0.0, 1.0), box, shape, around, surround, 0.0, quality)
