"""Meshes for the tests of `synthesize`, and a folder of them in the ShapeNet layout."""

from pathlib import Path

import numpy as np
import trimesh

from kinectbench.core.geometry import TriangleMesh

# Seat, back at +z, one armrest at +x: y is up, and no mirror image or turn of it is itself.
BOXES = (
    ((-0.3, 0.30, -0.3), (0.3, 0.40, 0.3)),
    ((-0.3, 0.35, 0.22), (0.3, 0.95, 0.3)),
    ((0.22, 0.35, -0.3), (0.3, 0.60, 0.25)),
    ((-0.3, 0.00, -0.3), (-0.22, 0.35, -0.22)),
)


def mesh_of(shape: trimesh.Trimesh) -> TriangleMesh:
    return TriangleMesh(np.asarray(shape.vertices, float), np.asarray(shape.faces, np.int32))


def asymmetric(scale: float = 1.0) -> trimesh.Trimesh:
    """Overlapping boxes, each closed."""
    shape = trimesh.util.concatenate([trimesh.creation.box(bounds=bounds) for bounds in BOXES])
    shape.apply_scale(scale)
    return shape


def inside_asymmetric(points: np.ndarray) -> np.ndarray:
    """Which of the points (..., 3) lie in `asymmetric()`."""
    inside = np.zeros(points.shape[:-1], bool)
    for low, high in BOXES:
        inside |= np.all((points > low) & (points < high), axis=-1)
    return inside


def open_box() -> trimesh.Trimesh:
    """A box without its lid."""
    box = trimesh.creation.box([0.5, 0.4, 0.3])
    return trimesh.Trimesh(box.vertices, box.faces[box.face_normals[:, 1] < 0.5], process=False)


def write_shapenet(root: Path, chairs: int = 3, tables: int = 3) -> Path:
    """ShapeNet v2 chairs, v1 tables; the first table is open."""
    for n in range(chairs):
        path = root / "03001627" / f"c{n}" / "models" / "model_normalized.obj"
        path.parent.mkdir(parents=True)
        asymmetric(1 + 0.1 * n).export(path)
    for n in range(tables):
        path = root / "04379243" / f"t{n}" / "model.obj"
        path.parent.mkdir(parents=True)
        (open_box() if n == 0 else trimesh.creation.box([0.5, 0.4, 0.3 + 0.05 * n])).export(path)
    return root
