"""Read a reference mesh, from a scanner or a CAD program, and use it as the truth of a recording.

The file is untrusted. The mesh has to be closed; it is registered to the fused object, which it replaces. The
rules of `judge` refuse the mesh of another object. Nothing of a reference is unknown: a cell is inside the
mesh, or it is not the object.
"""

from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

import numpy as np
from scipy import ndimage

from kinectbench.core import RecordingError, SegmentationError, ShapeError, printable, read_plain
from kinectbench.core.artefacts.object import BoxPart, LabelCounts, QualityFile, ReferenceTruth
from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import (
    Grid,
    TriangleMesh,
    is_closed,
    joined_vertices,
    outwards,
    transform_points,
)
from kinectbench.core.glb_file import read_glb
from kinectbench.core.mesh_files import MAX_FILE_BYTES, read_obj, read_ply_surface
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.core.voxels.solid import costs_too_much, voxelize_solid
from kinectbench.core.voxels.view_grids import object_cube
from kinectbench.stages.reference.judge import RegisteredReference, register_reference
from kinectbench.stages.segment.find.floor import Floor
from kinectbench.stages.segment.find.pieces import fit_box
from kinectbench.stages.segment.judge.quality import BOX_DECIMALS_M, BOX_DECIMALS_RAD, OF_REPORT
from kinectbench.stages.segment.object_model import ObjectModel
from kinectbench.stages.segment.solid.evidence import SHELL_M
from kinectbench.stages.segment.solid.grids import FLOOR_LAYERS, REFERENCE_VOXEL_M, object_grid, surround_grid
from kinectbench.stages.segment.solid.solid import SolidShape

SUFFIXES = (".ply", ".obj", ".glb")
# Nothing of a room is farther away, in any unit.
FARTHEST_M = 1e6
# No mesh of another instrument lies nearer to a fused surface than a share of its error. Residuals of exact
# meshes on simulated builds were .06 to .28 % of the diagonal, half a millimetre and more of a chair; a mesh
# that was itself fused from the recording lies at .006 mm, with an error of 2.5 mm.
LEAST_NOISE = 0.05
# Keys of the fused truth's quality that also hold for a reference: they describe frames, not the solid.
OF_FRAMES = ("selection", *OF_REPORT)


@dataclass(frozen=True)
class Reference:
    """A reference mesh.

    Attributes:
        mesh: in a frame of its own, metres.
        closed: whether every edge has two faces, which run along it in opposite directions.
        sha256: of the file's bytes.
    """

    mesh: TriangleMesh
    closed: bool
    sha256: str


def read_reference(path: Path) -> Reference:
    """Read a mesh in metres.

    Raises:
        RecordingError: it is no readable .ply, .obj or .glb, or has no face with an area, or a vertex that is
            not finite or beyond 10^6 m.
    """
    where = printable(str(path), 300)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise RecordingError(
            f"{where}: not a mesh that is read; save it as .ply, .obj or .glb", what="bad-mesh"
        )
    try:
        content = read_plain(path, MAX_FILE_BYTES)
        if suffix == ".ply":
            points, triangles, _ = read_ply_surface(content)
        else:
            points, triangles = (read_obj if suffix == ".obj" else read_glb)(content)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise RecordingError(
            f"{where}: cannot be read as a mesh ({reason}); name a mesh (.ply, .obj or .glb)", what="bad-mesh"
        ) from error
    if not len(triangles):
        raise RecordingError(f"{where}: no mesh, as it has no faces; name one that has", what="bad-mesh")
    if not (np.abs(points) <= FARTHEST_M).all():  # nor NaN
        raise RecordingError(
            f"{where}: a vertex is not finite, or beyond {FARTHEST_M:g} m; export the mesh again",
            what="bad-mesh",
        )
    vertices, faces = joined_vertices(points, triangles.astype(np.int32))
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    if not np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() > 0:
        raise RecordingError(f"{where}: its faces have no area; export the mesh again", what="bad-mesh")
    return Reference(TriangleMesh(vertices, faces), is_closed(faces), sha256(content).hexdigest())


def reference_as_truth(model: ObjectModel, path: Path) -> ObjectModel:
    """Return the object with a reference mesh in place of the fused shape.

    The mesh at `path`, in metres and any frame, is registered to the fused object.

    Raises:
        RecordingError: the mesh cannot be read.
        ShapeError: it is open, or cannot be voxelised.
        SegmentationError: it does not fit the object, or is too large for voxels of the object's size.
    """
    reference = read_reference(path)
    if not reference.closed:
        raise ShapeError(
            f"{path}: the reference mesh is open, or not consistently oriented; close it, or leave "
            "`reference` out and use `kinectbench compare-truth`",
            what="open-mesh",
        )
    fit = register_reference(model, reference.mesh)
    if fit.refused is not None or fit.pose is None:
        raise SegmentationError(
            f"{path}: the reference mesh does not fit the object: {fit.refused}", what="other-mesh"
        )
    posed = reference.mesh.transformed(fit.pose.T)
    mesh = TriangleMesh(posed.vertices, outwards(posed.vertices, posed.faces))
    shape = _solid(mesh, model.floor, model.box.yaw_rad, model.shape.grid.voxel_size_m, path)
    around = surround_grid(shape.grid, model.floor)
    box = fit_box(transform_points(model.floor.T_floor_world, mesh.vertices), model.box.yaw_rad, 0.0)
    changed = replace(
        model,
        box=box,
        shape=shape,
        surround=around,
        surround_labels=np.full(around.shape, Label.OTHER, np.uint8),
    )
    return replace(changed, quality=_quality(changed, reference, fit, path.name))


def _solid(mesh: TriangleMesh, floor: Floor, yaw_rad: float, voxel_size_m: float, path: Path) -> SolidShape:
    """Voxelise the inside of a mesh on a grid around it, turned by `yaw_rad` about the floor's normal.

    Voxels in the mesh are SURFACE down to the depth at which a fused surface counts as measured, and INTERIOR
    below that. Voxels outside are OTHER. `path` is for messages.
    """
    vertices_floor = transform_points(floor.T_floor_world, mesh.vertices)
    box = fit_box(vertices_floor, yaw_rad, 0.0)
    # What is held, or registered low, reaches below the floor.
    below = int(np.ceil(-float(vertices_floor[:, 2].min()) / voxel_size_m))
    grid = object_grid(box, floor, voxel_size_m, layers=FLOOR_LAYERS + max(0, below))
    finest = object_cube(mesh.vertices, grid.T_world_grid)
    if _costs_too_much(mesh, grid) or _costs_too_much(mesh, finest):
        raise ShapeError(
            f"{path}: too many of the {len(mesh.faces)} faces lie across each other; simplify the mesh",
            what="bad-mesh",
        )
    solid = unpack(voxelize_solid(mesh.vertices, mesh.faces, grid))
    if not solid.any():
        raise ShapeError(f"{path}: the mesh encloses nothing; close and orient it", what="bad-mesh")
    depth_voxels = ndimage.distance_transform_edt(solid)
    labels = np.where(solid, Label.INTERIOR, Label.OTHER).astype(np.uint8)
    labels[solid & (depth_voxels <= SHELL_M / REFERENCE_VOXEL_M)] = Label.SURFACE
    return SolidShape(grid, solid, mesh, labels, solid.astype(np.float32), np.zeros_like(solid))


def _costs_too_much(mesh: TriangleMesh, grid: Grid) -> bool:
    cells = transform_points(grid.T_grid_world, mesh.vertices) / grid.voxel_size_m
    return costs_too_much(cells[:, :2], mesh.faces, grid.shape[:2])


def _quality(model: ObjectModel, reference: Reference, fit: RegisteredReference, name: str) -> QualityFile:
    """Make the quality.json of a reference that is the truth; no part of it is fused, so no IoU is estimated.

    `fit` is the reference's registration to the fused object, and `name` is its file name.
    """
    assert fit.pose is not None and fit.scale is not None, "it fits"
    shape, fused, warnings = model.shape, model.quality, list[str]()
    other = fit.runner_up
    if other is not None and other.fits_as_well and fit.symmetric_axis_floor is None:
        warnings.append(
            f"the reference mesh also fits turned by {np.degrees(other.turn_rad):.0f}°: what no camera saw "
            "may be on the wrong side"
        )
    if fit.pose.residual_m < LEAST_NOISE * model.surface_sigma_m:
        warnings.append(
            f"the reference mesh lies {fit.pose.residual_m * 1000:.2g} mm from the fused surface, whose own "
            f"error is {model.surface_sigma_m * 1000:.2g} mm: was it made of this recording?"
        )
    kept = {key: getattr(fused, key) for key in OF_FRAMES if key in fused.model_fields_set}
    return QualityFile(
        **kept,
        format_version=1,
        verdict="look at the warnings" if warnings else "good",
        warnings=tuple(warnings),
        doubts=tuple(warnings),
        surface_sigma_m=model.surface_sigma_m,
        unknown_share=0.0,
        unknown_air_share=0.0,
        volume_m3=round(int(shape.solid.sum()) * shape.grid.voxel_size_m**3, 6),
        labels=LabelCounts(**{each.name.lower(): int((shape.labels == each).sum()) for each in Label}),
        box=BoxPart.of(model.box, BOX_DECIMALS_M, BOX_DECIMALS_RAD),
        method="a reference mesh, registered to the fused surface",
        truth=ReferenceTruth(
            kind="reference mesh",
            reference=name,
            sha256=reference.sha256,
            residual_m=round(fit.pose.residual_m, 6),
            scale=round(fit.scale, 6),
        ),
    )
