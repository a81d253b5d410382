"""What was built of one simulated object against its truth: a row of the ground truth's table."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from builds import read_json
from numpy.typing import NDArray
from solid_recipes import RECIPES, poisson

from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.geometry.camera import DepthRenderer
from kinectbench.core.geometry.mesh import read_own_ply
from kinectbench.core.types import Bools
from kinectbench.engine.steps import read_tracked
from kinectbench.lab.evaluate.build import Build, BuildRegistration, read_build, register_build
from kinectbench.lab.evaluate.evaluation import Evaluation, evaluate
from kinectbench.lab.evaluate.solid import canonical_cube, compare_on, grid_iou
from kinectbench.lab.simulate.truth import Truth, mesh_occupancy, read_truth
from kinectbench.settings.models import FusionSettings, SegmentationSettings
from kinectbench.stages.fuse.reconstruction import observe
from kinectbench.stages.sample_views.masks import inner_silhouette
from kinectbench.stages.segment.object_model import ObjectModel
from kinectbench.stages.segment.solid.grids import FLOOR_LAYERS

# Calibration is asked for this near to the surface, and wherever nothing is known.
NEAR_VOXELS = 4
BINS = 10
OURS = "ours"


@dataclass(frozen=True)
class Row:
    """One object.

    Attributes:
        name: of the recording.
        family: of the object.
        evaluation: what `kinectbench evaluate` says.
        quality: the content of quality.json.
        recipes: IoU on the object's own voxels, of ours and of simpler recipes.
        hull_unknown: unknown empty space within the true shape's convex hull, over the shape's volume.
        calibration: (BINS, 3) voxels, sum of their probabilities, how many are inside.
        dropped: share of valid depth on the object that the masks drop, of each view.
        residual_m: median depth residual of each pair.
        sensor_residual_m: the same of the true shape, seen by the true camera: the sensor's own noise.
        misfit_m: median distance of the rendered shape from the depth without noise, of each pair.
    """

    name: str
    family: str
    evaluation: Evaluation
    quality: QualityFile
    recipes: dict[str, float]
    hull_unknown: float
    calibration: NDArray[np.float64]
    dropped: NDArray[np.float64]
    residual_m: NDArray[np.float64]
    sensor_residual_m: NDArray[np.float64]
    misfit_m: NDArray[np.float64]


@dataclass(frozen=True)
class Task:
    """What to measure: a recording's name, its object's family, its build and its truth."""

    name: str
    family: str
    build: Path
    truth: Path


def measure_row(task: Task) -> Row:
    """Measure one build."""
    build = task.build
    built, truth = read_build(build), read_truth(task.truth)
    assert built.model is not None
    registration = register_build(built, truth)
    pairs = read_json(build / "pairs" / "pairs.json")["pairs"]
    sensor_residual_m, misfit_m = _without_noise(build, built, truth, registration)
    return Row(
        name=task.name,
        family=task.family,
        evaluation=evaluate(built, truth),
        quality=built.model.quality,
        recipes=_recipes(build, built.model, truth, registration),
        hull_unknown=_hull_unknown(built.model, truth, registration),
        calibration=_calibration(built.model, _true(built.model, truth, registration)),
        dropped=np.array([row["dropped_share"] for row in pairs]),
        residual_m=np.array([row["residual_m"] for row in pairs]),
        sensor_residual_m=sensor_residual_m,
        misfit_m=misfit_m,
    )


def _true(model: ObjectModel, truth: Truth, registration: BuildRegistration) -> Bools:
    grid = model.shape.grid
    return mesh_occupancy(
        truth.mesh_world, replace(grid, T_world_grid=registration.T_truth_built @ grid.T_world_grid)
    )


def _recipes(
    build: Path, model: ObjectModel, truth: Truth, registration: BuildRegistration
) -> dict[str, float]:
    """IoU of every recipe above the cut at the floor, where none of the simple ones means anything."""
    built = read_build(build)
    assert built.trajectory is not None
    sequence, grid = read_tracked(build)[0], model.shape.grid
    seen = observe(sequence, built.trajectory, built.trajectory.good_frames, grid, FusionSettings())
    above = FLOOR_LAYERS + max(1, round(SegmentationSettings().floor_cut_m / grid.voxel_size_m))
    true = _true(model, truth, registration)[:, :, above:]
    solids = {name: recipe(seen) for name, recipe in RECIPES.items()}
    solids["Poisson"] = poisson(read_own_ply(build / "reconstruction" / "mesh.ply"), seen, above)
    solids[OURS] = model.shape.solid
    return {name: grid_iou(solid[:, :, above:], true) for name, solid in solids.items()}


def _hull_unknown(model: ObjectModel, truth: Truth, registration: BuildRegistration) -> float:
    import trimesh

    grid = canonical_cube(truth)
    solids = compare_on(grid, model, truth, registration)
    mesh = trimesh.Trimesh(truth.mesh_world.vertices, truth.mesh_world.faces, process=False).convex_hull
    hull = mesh_occupancy(TriangleMesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)), grid)
    return float((hull & ~solids.true & ~solids.known).sum() / solids.true.sum())


def _without_noise(
    folder: Path, built: Build, truth: Truth, registration: BuildRegistration
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What the sensor's noise makes of a residual, and what is left of ours without it; both (pairs,) metres.

    Both inside the silhouettes eroded by 2 px, as the residual of a pair.
    """
    assert built.model is not None and built.views is not None
    sequence = read_tracked(folder)[0]
    ours, exact = DepthRenderer(built.model.shape.mesh), DepthRenderer(truth.mesh_world)
    noise_m, misfit_m = [], []
    for view in (view for view in built.views if view.name in (built.pair_names or ())):
        T_truth_camera = truth.T_world_camera[registration.true_frame[view.frame]]
        measured_m, true_m = sequence.depth_m(view.frame), exact.depth_m(sequence.camera, T_truth_camera)
        rendered_m = ours.depth_m(sequence.camera, view.alignment.T_world_camera)
        valid = inner_silhouette(true_m) & (measured_m > 0)
        if not (valid & inner_silhouette(rendered_m)).any():
            continue
        noise_m.append(np.median(np.abs(measured_m - true_m)[valid]))
        valid &= inner_silhouette(rendered_m)
        misfit_m.append(np.median(np.abs(rendered_m - true_m)[valid]))
    return np.array(noise_m), np.array(misfit_m)


def _calibration(model: ObjectModel, true: Bools) -> NDArray[np.float64]:
    from scipy import ndimage

    shape = model.shape
    near = ndimage.binary_dilation(shape.solid, iterations=NEAR_VOXELS)
    near &= ~ndimage.binary_erosion(shape.solid, iterations=NEAR_VOXELS)
    near |= shape.labels == Label.UNKNOWN
    near[:, :, :FLOOR_LAYERS] = False
    probability, inside = shape.probability[near].astype(np.float64), true[near]
    bins = np.minimum((probability * BINS).astype(int), BINS - 1)
    columns = (np.ones_like(probability), probability, inside.astype(np.float64))
    return np.column_stack([np.bincount(bins, column, BINS) for column in columns])
