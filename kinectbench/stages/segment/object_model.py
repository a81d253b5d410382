"""The object as the value of the stage `segment`, and how it is stored."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import StorageError
from kinectbench.core.artefacts.object import FloorCandidate, FloorFile, QualityFile
from kinectbench.core.artefacts.object_grids import ObjectVolume, Surround
from kinectbench.core.artefacts.stored import known, number
from kinectbench.core.geometry import Grid, OrientedBox, read_own_ply, write_ply
from kinectbench.stages.segment.find.floor import Floor
from kinectbench.stages.segment.find.floor_choice import REASONS
from kinectbench.stages.segment.solid.solid import SolidShape

MESH = "mesh.ply"


@dataclass(frozen=True)
class ObjectModel:
    """The object that every view is compared with.

    Attributes:
        floor: the floor and frame `floor`.
        box: upright box around the object, floor frame.
        shape: solid, labels, probability and closed mesh on a fine grid around the object.
        surround: coarse grid around the fine one, which holds the cube of any pair.
        surround_labels: uint8 of the coarse grid's shape: FREE, OTHER or UNKNOWN.
        surface_sigma_m: standard deviation of the fused surface, metres.
        quality: how good it is, for people and scores; no later stage computes with it.
    """

    floor: Floor
    box: OrientedBox
    shape: SolidShape
    surround: Grid
    surround_labels: NDArray[np.uint8]
    surface_sigma_m: float
    quality: QualityFile


def write_object(model: ObjectModel, folder: Path) -> None:
    """Write floor.json, mesh.ply, volume.npz, surround.npz and quality.json."""
    floor, shape = model.floor, model.shape
    known_if: dict[str, Any] = {} if floor.scale == 1 else {"scale": round(floor.scale, 4)}
    if floor.choice.candidates:
        known_if["candidates"] = _candidates(floor)
    FloorFile(
        plane_world=floor.plane_world,
        T_floor_world=floor.T_floor_world,
        noise_m=round(floor.noise_m, 6),
        inlier_share=round(floor.inlier_share, 4),
        tilt_rad=known(floor.tilt_rad, 4),
        found=floor.found,
        **known_if,
    ).write(folder)
    write_ply(shape.mesh, folder / MESH)
    probability = shape.probability.astype(np.float16)
    ObjectVolume(shape.grid, shape.solid, shape.labels, probability, shape.underside).write(folder)
    Surround(model.surround, model.surround_labels).write(folder)
    model.quality.write(folder)


def _candidates(floor: Floor) -> tuple[FloorCandidate, ...]:
    """Return the planes among which the floor was chosen, as floor.json has them."""
    return tuple(
        FloorCandidate(
            plane_world=each.plane,
            inlier_share=round(each.inlier_share, 4),
            cameras_above_share=round(each.above_share, 4),
            below_share=round(each.below_share, 4),
            under_share=round(each.under_share, 4),
            tilt_rad=round(each.tilt_rad, 4),
            evidence=round(each.evidence, 5),
            refused=REASONS[each.reason] if each.reason else None,
        )
        for each in floor.choice.candidates
    )


def read_object(folder: Path) -> ObjectModel:
    """Read the files that `write_object` wrote.

    Raises:
        StorageError: a file is missing or damaged.
    """
    stored, quality = FloorFile.read(folder), QualityFile.read(folder)
    volume, surround = ObjectVolume.read(folder), Surround.read(folder)
    if quality.box is None or quality.surface_sigma_m is None:
        raise StorageError(
            f"{folder / QualityFile.FILE}: without `box` or `surface_sigma_m`; {QualityFile.ADVICE}"
        )
    floor = Floor(
        stored.plane_world,
        stored.T_floor_world,
        stored.noise_m,
        stored.inlier_share,
        number(stored.tilt_rad),
        stored.found is not False,
        1.0 if stored.scale is None else stored.scale,
    )
    shape = SolidShape(
        volume.grid,
        volume.solid,
        read_own_ply(folder / MESH),
        volume.labels,
        volume.probability.astype(np.float32),
        volume.underside,
    )
    sigma_m = quality.surface_sigma_m
    return ObjectModel(floor, quality.box.box(), shape, surround.grid, surround.labels, sigma_m, quality)
