"""What the stage `segment` decides on, of objects that `known.py` has built, beside the truth."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import transform_points
from kinectbench.core.geometry.mesh import read_own_ply
from kinectbench.core.types import Bools
from kinectbench.core.voxels.observation import Observation, merge, ray_width_m
from kinectbench.engine.steps import read_tracked
from kinectbench.lab.evaluate.build import read_build, register_build
from kinectbench.lab.evaluate.surface import ReferenceSurface
from kinectbench.lab.simulate.objects import families
from kinectbench.lab.simulate.truth import mesh_occupancy, read_truth, truth_folder
from kinectbench.settings.models import FusionSettings, SegmentationSettings
from kinectbench.stages.fuse import observe
from kinectbench.stages.fuse.depth_range import grid_range_m
from kinectbench.stages.segment.find.hints import floor_hint
from kinectbench.stages.segment.find.object import find_floor_and_object
from kinectbench.stages.segment.solid.evidence import FloorLayers
from kinectbench.stages.segment.solid.grids import (
    REFERENCE_VOXEL_M,
    floor_layers,
    median_distance_m,
    middle_world,
    object_grid,
)

SPLITS = {
    "looked-at": [name for name, family in families().items() if family.looked_at],
    "reported-only": [name for name, family in families().items() if not family.looked_at],
    "all": list(families()),
}


@dataclass(frozen=True)
class Observed:
    """One object.

    Attributes:
        name: of the recording.
        family: of the object.
        halves: what the odd and the even frames say.
        whole: what both say.
        neighbours: bool, voxels near the surface of a neighbour.
        layers: about the floor.
        ray_width_m: of the frames at the object.
        true: bool, the voxel's middle lies in the true solid.
        distance_m: float32, of the voxel's middle from the true surface.
    """

    name: str
    family: str
    halves: tuple[Observation, Observation]
    whole: Observation
    neighbours: Bools
    layers: FloorLayers
    ray_width_m: float
    true: Bools
    distance_m: NDArray[np.float32]


def observed(root: Path, recordings: Path, families: Sequence[str]) -> Iterator[Observed]:
    """Every object of the families that was built up to `segment`, one after the other.

    Args:
        root: what `known.py` was given as --build.
        recordings: its recordings, with their truth.
        families: which.
    """
    for folder in sorted((root / "build").iterdir()):
        family = folder.name.partition("-")[0].rstrip("0123456789")
        if family in families and (folder / "object").is_dir():
            yield _observed(folder, recordings / folder.name, family)


def _observed(build: Path, recording: Path, family: str) -> Observed:
    sequence, trajectory = read_tracked(build)[:2]
    # Rules are chosen for these voxels (`stages.segment.resolution`).
    fusion, segmentation = FusionSettings(voxel_size_m=REFERENCE_VOXEL_M), SegmentationSettings()
    scene = read_own_ply(build / "reconstruction" / "mesh.ply")
    chosen = find_floor_and_object(scene, trajectory, None, segmentation, floor_hint(sequence, trajectory))
    grid = object_grid(chosen.box, chosen.floor, REFERENCE_VOXEL_M)
    frames = trajectory.good_frames
    reach_m = grid_range_m(trajectory.T_world_camera[frames], grid, fusion)
    fusion = fusion.model_copy(update={"max_depth_m": reach_m})
    odd, even = (observe(sequence, trajectory, frames[k::2], grid, fusion) for k in (0, 1))
    truth = read_truth(truth_folder(recording))
    registration = register_build(read_build(build), truth)
    in_truth = replace(grid, T_world_grid=registration.T_truth_built @ grid.T_world_grid)
    cells = np.moveaxis(np.indices(grid.shape), 0, -1).reshape(-1, 3)
    middles = transform_points(in_truth.T_world_grid, (cells + 0.5) * grid.voxel_size_m)
    distance_m = ReferenceSurface(truth.mesh_world).distance_m(middles).astype(np.float32)
    return Observed(
        name=build.name,
        family=family,
        halves=(odd, even),
        whole=merge(odd, even),
        neighbours=chosen.neighbours(grid),
        layers=floor_layers(chosen.floor, segmentation, REFERENCE_VOXEL_M),
        ray_width_m=ray_width_m(
            sequence.camera,
            trajectory.median_pose_sigma_m,
            median_distance_m(trajectory, middle_world(grid)),
        ),
        true=mesh_occupancy(truth.mesh_world, in_truth),
        distance_m=distance_m.reshape(grid.shape),
    )
