"""How an ObjectModel is stored: floor.json, mesh.ply, volume.npz, surround.npz, quality.json."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.errors import StorageError
from kinectbench.geometry import Grid, OrientedBox
from kinectbench.mesh_file import read_ply, write_ply
from kinectbench.segmentation.floor import Floor
from kinectbench.shape.object_model import ObjectModel
from kinectbench.shape.solid import SolidShape
from kinectbench.voxels.npz import npz_bytes, read_npz
from kinectbench.workspace import pretty_json


def write_object(model: ObjectModel, folder: Path) -> None:
    """Write the object's files.

    volume.npz: `solid` (nx, ny, nz) bool, `labels` uint8 (0 free, 1 other, 2 surface, 3 interior, 4 unknown),
    `probability` float16, `voxel_size_m`, `T_world_grid` (4, 4); surround.npz: `labels` on a coarse grid.
    """
    floor, shape = model.floor, model.shape
    floor_json = {
        "format_version": 1,
        "plane_world": floor.plane_world.tolist(),
        "T_floor_world": floor.T_floor_world.tolist(),
        "noise_m": round(floor.noise_m, 6),
        "inlier_share": round(floor.inlier_share, 4),
        "tilt_rad": round(floor.tilt_rad, 4),
        "found": floor.found,
    }
    (folder / "floor.json").write_text(pretty_json(floor_json))
    write_ply(shape.mesh, folder / "mesh.ply")
    volume = {
        "format_version": np.asarray(1),
        "solid": shape.solid,
        "labels": shape.labels,
        "probability": shape.probability.astype(np.float16),
        **_grid_arrays(shape.grid),
    }
    (folder / "volume.npz").write_bytes(npz_bytes(volume, level=1))
    surround = {"labels": model.surround_labels, **_grid_arrays(model.surround)}
    (folder / "surround.npz").write_bytes(npz_bytes(surround, level=1))
    (folder / "quality.json").write_text(pretty_json(model.quality))


def read_object(folder: Path) -> ObjectModel:
    """Read the files that `write_object` wrote.

    Raises:
        StorageError: a file is missing or damaged.
    """
    volume, surround = read_npz(folder / "volume.npz"), read_npz(folder / "surround.npz")
    try:
        floor_json = json.loads((folder / "floor.json").read_text())
        quality = json.loads((folder / "quality.json").read_text())
        floor = Floor(
            np.array(floor_json["plane_world"]),
            np.array(floor_json["T_floor_world"]),
            floor_json["noise_m"],
            floor_json["inlier_share"],
            floor_json["tilt_rad"],
            floor_json["found"],
        )
        box = OrientedBox(
            tuple(quality["box"]["center_m"]), tuple(quality["box"]["size_m"]), quality["box"]["yaw_rad"]
        )
        shape = SolidShape(
            _grid(volume, volume["solid"]),
            volume["solid"],
            volume["labels"],
            volume["probability"].astype(np.float32),
            read_ply(folder / "mesh.ply"),
        )
        coarse = _grid(surround, surround["labels"])
        sigma_m = float(quality["surface_sigma_m"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise StorageError(
            f"{folder}: the stored object is damaged ({error}); `kinectbench build --force` makes it again"
        ) from error
    return ObjectModel(floor, box, shape, coarse, surround["labels"], sigma_m, quality)


def _grid_arrays(grid: Grid) -> dict[str, NDArray[Any]]:
    return {"voxel_size_m": np.asarray(grid.voxel_size_m), "T_world_grid": grid.T_world_grid}


def _grid(arrays: dict[str, NDArray[Any]], values: NDArray[Any]) -> Grid:
    nx, ny, nz = values.shape
    return Grid((nx, ny, nz), float(arrays["voxel_size_m"]), arrays["T_world_grid"])
