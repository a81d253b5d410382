"""Load, clean and check a model's mesh, and choose the rule that fills it."""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh
from numpy.typing import NDArray

from kinectbench.core import ShapeError, printable
from kinectbench.core.geometry import TriangleMesh, rigid, three_corners
from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.voxels.seeable import SeeableSolid, seeable_solid
from kinectbench.lab.simulate.objects import make_object
from kinectbench.lab.synthesize.models import Model

# Files keep vertices in float32. Steps of more than this share of the longest side (three tenths of a cell)
# change the shape: a release with 0.26 of a cell verifies, one with 0.52 does not (1 m, 10 and 20 km off).
MOST_STEP = 0.3 / 252
# Options before a texture's name, such as `-s 1 1 1 -clamp on`. Source: the MTL format (Alias|Wavefront).
OPTIONS = re.compile(r"^(-[a-z]+\s+((on|off|[rgbmlz]|sphere|cube_\w+|[-+.\d][-+.\de]*)\s+)*)*", re.IGNORECASE)


@dataclass(frozen=True)
class CheckedMesh:
    """A cleaned mesh from which pairs can be made.

    Attributes:
        mesh: the mesh, in the model's own frame and unit, without duplicate vertices and collapsed triangles.
        rule: how its inside is found: "winding" (by winding number) if it is closed, else "six-rays" (the
            paper authors' rule for open meshes); "seeable" if `seeable` is set.
        notes: remarks for the user, one line each.
        seeable: its seeable solid (`core.voxels.seeable`), which includes space that no camera could see;
            None: only the inside of the mesh is solid.
    """

    mesh: TriangleMesh
    rule: str
    notes: tuple[str, ...] = ()
    seeable: SeeableSolid | None = None


def load_model(model: Model, max_faces: int) -> CheckedMesh:
    """Load the mesh of a model, or draw it by its seed; clean and check it.

    Raises:
        ShapeError: the model cannot be used; the message says why, without the model's name.
    """
    if not model.path:
        return check_mesh(make_object(model.category, model.seed).mesh, max_faces)
    path = Path(model.path)
    notes = missing_materials(path) if path.suffix.lower() == ".obj" else ()
    checked = check_mesh(_load(path), max_faces)
    return CheckedMesh(checked.mesh, checked.rule, (*checked.notes, *notes))


def as_seeable(checked: CheckedMesh, up_axis: Literal["y", "z"]) -> CheckedMesh:
    """Add the mesh's seeable solid (`core.voxels.seeable`): space that no camera could see is solid, too.

    The model stands on a plane at its lowest point. An open mesh is returned unchanged, with a note.

    Args:
        checked: the mesh; its unit is a metre.
        up_axis: axis of its frame that points up.
    """
    if checked.rule != "winding":
        note = "is not closed: what a camera could see of it is not asked"
        return replace(checked, notes=(*checked.notes, note))
    vertices = checked.mesh.vertices
    up = "xyz".index(up_axis)
    # Rotation from z up to the model's axes: the identity, or y up (x, z, -y).
    R = np.eye(3) if up_axis == "z" else np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    T_world_upright = rigid(R, np.eye(3)[up] * vertices[:, up].min())
    limits = SensorLimits.of_size(float(np.ptp(vertices, axis=0).max()))
    seeable = seeable_solid(checked.mesh, T_world_upright, limits)
    return replace(checked, rule="seeable", seeable=seeable)


def check_mesh(mesh: TriangleMesh, max_faces: int) -> CheckedMesh:
    """Clean a mesh of at most `max_faces`, check it, and choose the rule that fills it.

    Equal vertices are merged, and triangles that collapse are dropped. A mesh counts as closed if every edge
    is used equally often in both directions, no triangle occurs twice, and its volume is positive: then the
    winding number of a point is the number of bodies that contain it.

    Raises:
        ShapeError: the mesh is empty, too large, damaged, without area, not finite, inside out, or too far
            from its origin.
    """
    if len(mesh.faces) > max_faces:
        raise ShapeError(f"{len(mesh.faces)} faces, more than {max_faces}", what="bad-mesh")
    if len(mesh.faces) == 0:
        raise ShapeError("it is empty: not a single triangle", what="bad-mesh")
    used = np.unique(mesh.faces)
    if used[0] < 0 or used[-1] >= len(mesh.vertices):
        raise ShapeError("a triangle names a vertex that is not there", what="bad-mesh")
    if not np.isfinite(mesh.vertices[used]).all():
        raise ShapeError("a vertex is not a finite number (NaN or infinite)", what="bad-mesh")
    clean = _cleaned(mesh.keep_faces(np.ones(len(mesh.faces), dtype=bool)))
    dropped = len(mesh.faces) - len(clean.faces)
    a, b, c = (clean.vertices[clean.faces[:, corner]] for corner in range(3))
    if not np.cross(b - a, c - a).any():
        raise ShapeError("no triangle has an area", what="bad-mesh")
    step = float(np.abs(clean.vertices).max() * np.finfo(np.float32).eps)
    if step > MOST_STEP * np.ptp(clean.vertices, axis=0).max():
        where = f"so far from its origin that files would keep it in steps of {step:.2g} of its unit"
        raise ShapeError(f"{where}; move it to its origin", what="bad-mesh")
    notes = (f"{dropped} triangles with two corners at one place left out",) if dropped else ()
    if not _is_closed(clean.faces):
        return CheckedMesh(clean, "six-rays", notes)
    volume = clean.volume_m3
    if volume < 0:
        raise ShapeError("it is inside out: its volume is negative", what="bad-mesh")
    return CheckedMesh(clean, "winding" if volume > 0 else "six-rays", notes)


def missing_materials(path: Path) -> tuple[str, ...]:
    """Return a note for each missing file of an OBJ file: material libraries, and their textures."""
    notes = []
    for library in _named(path, "mtllib"):
        if not _is_file(library):
            notes.append(f"material {printable(library.name)} is missing; the shape is whole")
            continue
        gone = {texture.name for texture in _named(library, "map_") if not _is_file(texture)}
        notes += [f"texture {printable(name)} is missing; the shape is whole" for name in sorted(gone)]
    return tuple(notes)


def _is_file(path: Path) -> bool:
    """Return whether a file exists; False if its name is too long for the disk."""
    try:
        return path.is_file()
    except OSError:
        return False


def _named(path: Path, keyword: str) -> list[Path]:
    """Return the paths that a text file names in lines that begin with a keyword; [] if it is unreadable."""
    try:
        with path.open(encoding="utf-8", errors="replace") as lines:
            found = [line.split(maxsplit=1) for line in lines if line.lstrip().lower().startswith(keyword)]
    except OSError:
        return []
    names = [OPTIONS.sub("", value[1].strip()).replace("\\", "/") for value in found if len(value) == 2]
    return [path.parent / name for name in names]


def _load(path: Path) -> TriangleMesh:
    """Load all triangles of a mesh file, with the transforms of its scene graph applied."""
    try:
        loaded = trimesh.load(path, force="mesh", process=False, skip_materials=True)
        vertices = np.asarray(loaded.vertices, dtype=np.float64).reshape(-1, 3)
        return TriangleMesh(vertices, np.asarray(loaded.faces, dtype=np.int32).reshape(-1, 3))
    except Exception as error:  # readers raise any exception
        text = " ".join(str(error).split())[:120]
        raise ShapeError(f"cannot be read ({type(error).__name__}: {text})", what="bad-mesh") from error


def _cleaned(mesh: TriangleMesh) -> TriangleMesh:
    """Merge equal vertices and drop degenerate triangles.

    A triangle with collinear corners is kept: without it, its neighbours' edges would not meet.
    """
    places, which = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = which.reshape(-1).astype(np.int32)[mesh.faces]
    # Sorted so that neighbours in space are neighbours in memory: voxelising a large mesh is twice as fast.
    faces = faces[np.argsort(faces.min(axis=1), kind="stable")]
    return TriangleMesh(places, faces).keep_faces(three_corners(faces))


def _is_closed(faces: NDArray[np.int32]) -> bool:
    """Return whether every edge is used equally often in both directions, and no triangle occurs twice."""
    if len(np.unique(np.sort(faces, axis=1), axis=0)) < len(faces):
        return False
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    forwards = np.where(edges[:, 0] < edges[:, 1], 1, -1)
    low, high = edges.min(axis=1), edges.max(axis=1)
    _, which = np.unique(low * (int(faces.max()) + 1) + high, return_inverse=True)
    return not np.bincount(which.reshape(-1), weights=forwards).any()
