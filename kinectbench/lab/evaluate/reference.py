"""Compare a built object with a reference mesh from elsewhere, such as a scan; write reference.json."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from kinectbench.core import RecordingError, StorageError, replaced_file, sha256_file
from kinectbench.core.artefacts.manifest import Manifest
from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.artefacts.reference import ComparedMesh, DirectionPart, DirectionsPart, ReferenceFile
from kinectbench.core.geometry import TriangleMesh, invert_rigid, transform_points
from kinectbench.core.types import Bools, Float64
from kinectbench.core.voxels.known_cells import known_in
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.core.voxels.solid import costs_too_much, voxelize_solid
from kinectbench.core.voxels.view_grids import object_cube
from kinectbench.lab.evaluate.solid import grid_iou, known_iou
from kinectbench.stages.pairs import full_shape
from kinectbench.stages.reference.judge import RegisteredReference, register_reference
from kinectbench.stages.reference.truth import SUFFIXES, read_reference
from kinectbench.stages.segment.object_model import MESH, ObjectModel, read_object

# Path of the mesh in an object's folder, as in YCB's archives of Google's scanner.
YCB_MESH = "google_16k/nontextured.ply"
# A part of the reference was seen if it lies this near to a measured sample, or in free space.
NEAR_M = 0.02
# Faces within 45 degrees of the vertical count as looking up or down.
STEEP = np.sqrt(0.5)
# Decimals of the written values: micrometres, and millionths of a ratio.
DECIMALS = 6


def find_references(folder: Path, names: Mapping[str, str]) -> dict[str, Path]:
    """Find each recording's reference mesh in a folder, by the recording's id or the name of its object.

    A mesh is called `<name>.ply`, `<name>.obj` or `<name>.glb`, or lies where YCB's archives have it:
    `<object>/google_16k/nontextured.ply`.

    Args:
        folder: the folder of meshes.
        names: {id of a recording: name of its object}.

    Returns:
        {id of a recording: path of its mesh}, without recordings that have none.

    Raises:
        RecordingError: the folder does not exist, or has none of the meshes.
    """
    if not folder.is_dir():
        raise RecordingError(f"{folder}: no such folder; name that of the meshes", what="not-found")
    found = {}
    for name, thing in names.items():
        plain = (folder / f"{stem}{suffix}" for stem in (name, thing) for suffix in SUFFIXES)
        paths = (*plain, folder / thing / YCB_MESH)
        if (path := next((path for path in paths if path.is_file()), None)) is not None:
            found[name] = path
    if not found:
        raise RecordingError(
            f"{folder}: holds no mesh named as a recording or its object, such as {next(iter(names))}.ply",
            what="not-found",
        )
    return found


def compare_reference(folder: Path, path: Path) -> tuple[ComparedMesh, ReferenceFile]:
    """Compare the built object of a recording with a reference mesh, and add the result to reference.json.

    Earlier results of other meshes for the same object are kept. An unreadable reference.json is replaced.

    Args:
        folder: `build/<recording>/`, built at least up to the object.
        path: file of the reference mesh.

    Returns:
        The metrics of this mesh, and the whole content of reference.json.

    Raises:
        RecordingError: the mesh cannot be used.
        StorageError: the object is missing or damaged.
    """
    reference = read_reference(path)
    model = read_object(folder / "object")
    found = reference_figures(model, register_reference(model, reference.mesh), reference.closed).model_copy(
        update={
            "reference": _named_mesh(path),
            "sha256": reference.sha256,
            **({"itself": True} if reference.sha256 in _truths(folder / "object") else {}),
        }
    )
    fingerprint = Manifest.read(folder / "object").fingerprint
    try:
        before = ReferenceFile.read_if_there(folder)
    except StorageError:
        before = None
    if before is not None and before.object_fingerprint == fingerprint:
        whole = before.with_new(found)
    else:
        whole = ReferenceFile.of([found], fingerprint)
    with replaced_file(folder / whole.FILE) as temporary:
        temporary.write_text(whole.text(), encoding="utf-8")
    return found, whole


def _named_mesh(path: Path) -> str:
    """Return a mesh's name in reference.json: its path if relative, else its last folder and file name.

    The folder is part of it because all simulated meshes are called object.ply. The rest of an absolute path
    is omitted, because it may be private.
    """
    return Path(*path.parts[-2:]).as_posix() if path.is_absolute() else path.as_posix()


def _truths(folder: Path) -> Iterator[str]:
    """Yield the SHA-256 of the built mesh file, and of the reference mesh that quality.json names."""
    yield sha256_file(folder / MESH)
    if (truth := QualityFile.read(folder).truth) is not None:
        yield truth.sha256


def reference_figures(model: ObjectModel, fit: RegisteredReference, closed: bool) -> ComparedMesh:
    """Return the metrics of an object against a reference; the mesh's name and hash are left empty.

    `fit` is by `register_reference`; `closed` tells whether the reference's mesh is closed.
    """
    head = ComparedMesh(reference="", sha256="", refused=fit.refused, closed=closed)
    if fit.pose is None:
        return head
    T, T_floor_world = fit.pose.T, model.floor.T_floor_world
    if fit.scale is None:  # far off
        return head.model_copy(
            update={"T_world_reference": T, "residual_m": round(fit.pose.residual_m, DECIMALS)}
        )
    f_5mm, f_10mm = _f_scores(model, fit, T, (0.005, 0.01))
    whole, known = solids_iou(model, fit.theirs.mesh.transformed(T)) if closed else (None, None)
    axis_floor = None
    if fit.symmetric_axis_floor is not None:
        axis_floor = tuple(round(float(value), 4) for value in fit.symmetric_axis_floor)
    return head.model_copy(
        update={
            "T_world_reference": T,
            "residual_m": round(fit.pose.residual_m, DECIMALS),
            "scale": round(fit.scale, DECIMALS),
            "mirrored_m": None if fit.mirrored_m is None else round(fit.mirrored_m, DECIMALS),
            **({"mirror_fits_as_well": True} if fit.mirror_as_well else {}),
            "runner_up": fit.runner_up,
            "symmetric_axis_floor": axis_floor,
            "f_score_5mm": round(f_5mm, DECIMALS),
            "f_score_10mm": round(f_10mm, DECIMALS),
            "iou": None if known is None else round(known, DECIMALS),
            "whole_iou": None if whole is None else round(whole, DECIMALS),
            "directions": _by_direction(fit, T, T_floor_world),
        }
    )


def _f_scores(
    model: ObjectModel, fit: RegisteredReference, T: Float64, thresholds_m: tuple[float, ...]
) -> list[float]:
    """Return an F-score for each threshold, over surface that the recording observed.

    Precision is over the object's measured surface. Recall is over those parts of the reference that lie in
    free space or near measured surface. Distances are exact, from points to triangles.
    `T` (4, 4) maps the reference to the object's world.
    """
    ours, theirs = fit.ours, fit.theirs
    there = theirs.distance_m(transform_points(invert_rigid(T), ours.points[ours.counted]))
    other = transform_points(T, theirs.points)
    here = ours.distance_m(other)
    _, measured = ours.faced(other, theirs.normals @ T[:3, :3].T)
    here = here[_is_free(model, other) | ((here < NEAR_M) & measured)]
    scores = []
    for threshold_m in thresholds_m:
        precision, recall = (float((way < threshold_m).mean()) if len(way) else 0.0 for way in (there, here))
        scores.append(2 * precision * recall / (precision + recall) if precision + recall else 0.0)
    return scores


def _is_free(model: ObjectModel, points_world: Float64) -> Bools:
    """Return whether each of the points (n, 3) lies in a voxel labelled free: (n,) bool."""
    grid = model.shape.grid
    cells = np.floor(transform_points(grid.T_grid_world, points_world) / grid.voxel_size_m).astype(np.int64)
    inside = np.asarray(((cells >= 0) & (cells < grid.shape)).all(axis=1))
    at = np.where(inside[:, None], cells, 0)
    return np.asarray(inside & (model.shape.labels[tuple(at.T)] == Label.FREE))


def _by_direction(fit: RegisteredReference, T: Float64, T_floor_world: Float64) -> DirectionsPart:
    """Return mean distances, signed and absolute, of the measured surface from the reference.

    There is one mean for faces that point up, one for faces that point down, and one for all others. A
    positive mean: the measured surface is too far out. `T` (4, 4) maps the reference to the object's world.
    `T_floor_world` (4, 4) maps this world to a frame whose z is up.
    """
    ours, theirs = fit.ours, fit.theirs
    points, normals = ours.points[ours.counted], ours.normals[ours.counted]
    back = transform_points(invert_rigid(T), points)
    far_m = theirs.distance_m(back)
    nearest = transform_points(T, theirs.points[theirs.tree.query(back)[1]])
    signed_m = far_m * np.sign(((points - nearest) * normals).sum(axis=1))
    up = normals @ T_floor_world[2, :3]
    which = {"up": up > STEEP, "down": up < -STEEP, "side": np.abs(up) <= STEEP}
    return DirectionsPart(
        **{
            name: DirectionPart(
                share=round(float(of.mean()), 4),
                mean_m=round(float(signed_m[of].mean()), DECIMALS) if of.any() else None,
                absolute_m=round(float(far_m[of].mean()), DECIMALS) if of.any() else None,
            )
            for name, of in which.items()
        }
    )


def solids_iou(model: ObjectModel, mesh: TriangleMesh) -> tuple[float | None, float | None]:
    """Return the IoU of the object and a closed mesh, over all 256^3 cells and over known cells only.

    `mesh` is in the object's world. Both values are None if the mesh is too costly to voxelise. The second is
    None if no cell of the mesh is known.
    """
    ours = model.shape.mesh
    grid = object_cube(
        np.concatenate([ours.vertices, mesh.vertices]), invert_rigid(model.floor.T_floor_world)
    )
    cells = transform_points(grid.T_grid_world, mesh.vertices) / grid.voxel_size_m
    if costs_too_much(cells[:, :2], mesh.faces, grid.shape[:2]):
        return None, None
    one, other = (unpack(voxelize_solid(each.vertices, each.faces, grid)) for each in (ours, mesh))
    known = unpack(known_in(*full_shape(model).known, grid))
    return grid_iou(one, other), known_iou(one, other, known)
