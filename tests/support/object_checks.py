"""What is checked of simulated objects: closed, of one piece, standing, thick enough, hollow, varied."""

import functools
from collections.abc import Sequence

import numpy as np
import open3d as o3d
import trimesh
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from kinectbench.core.geometry import TriangleMesh
from kinectbench.lab.simulate.objects import make_object
from kinectbench.lab.simulate.objects.shapes import Subject


@functools.cache
def drawn(family: str, seed: int) -> Subject:
    """An object, drawn once."""
    return make_object(family, seed)


def checked(subject: Subject) -> trimesh.Trimesh:
    """The mesh as it is, without merging its vertices."""
    return trimesh.Trimesh(subject.mesh.vertices, subject.mesh.faces, process=False)


Numbers = Sequence[float]


def scene(subject: Subject) -> o3d.t.geometry.RaycastingScene:
    """What rays are cast at: the solid's surface."""
    found = o3d.t.geometry.RaycastingScene()
    vertices, faces = subject.mesh.vertices.astype(np.float32), subject.mesh.faces.astype(np.uint32)
    found.add_triangles(o3d.core.Tensor.from_numpy(vertices), o3d.core.Tensor.from_numpy(faces))
    return found


def reach_m(subject: Subject, origin_m: ArrayLike, direction: ArrayLike) -> float:
    """Distance along one ray to the surface; infinite where it leaves."""
    ray = np.concatenate([origin_m, np.array(direction) / np.linalg.norm(direction)]).astype(np.float32)
    return float(scene(subject).cast_rays(o3d.core.Tensor.from_numpy(ray[None]))["t_hit"].numpy()[0])


def is_solid(subject: Subject, points_m: ArrayLike) -> np.ndarray:
    """Whether points (n, 3) lie in the solid, (n,)."""
    points = np.atleast_2d(points_m).astype(np.float32)
    solid: np.ndarray = scene(subject).compute_occupancy(o3d.core.Tensor.from_numpy(points)).numpy() > 0.5
    return solid


def closed(mesh: TriangleMesh | trimesh.Trimesh) -> trimesh.Trimesh:
    """A mesh as it is, without merging its vertices; it has to be watertight, its faces of one winding."""
    found = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert found.is_watertight and found.is_winding_consistent
    return found


def check_closed(subject: Subject) -> trimesh.Trimesh:
    """The mesh of an object, which is one watertight piece made of watertight pieces."""
    mesh = closed(subject.mesh)
    assert mesh.body_count == 1
    # Merging vertices at single precision, as readers of PLY files do, leaves it closed.
    assert trimesh.Trimesh(subject.mesh.vertices.astype(np.float32), subject.mesh.faces).is_watertight
    for piece in subject.pieces:
        assert closed(piece.mesh).volume > 0, piece.name
    return mesh


def check_solid(
    subject: Subject, low_m: Numbers, high_m: Numbers, litres: Numbers, steady_m: float = 0.01
) -> None:
    """One watertight piece that stands, within bounds of its size, metres, and of its volume, litres."""
    mesh = check_closed(subject)
    low, high = mesh.bounds
    assert low[2] == 0
    assert np.allclose((low + high)[:2], 0, atol=1e-12)
    assert np.all(high - low >= low_m) and np.all(high - low <= high_m), high - low
    assert litres[0] < 1000 * mesh.volume < litres[1], 1000 * mesh.volume
    # It does not tip over: its centre of mass lies well inside the hull of what touches the floor.
    sides = ConvexHull(mesh.vertices[mesh.vertices[:, 2] < 0.002, :2]).equations
    assert (sides[:, :2] @ mesh.center_mass[:2] + sides[:, 2]).max() < -steady_m


def check_thickness(subject: Subject, least_m: float) -> None:
    """Faces that look in nearly opposite directions lie `least_m` apart, but for one point in 1000."""
    mesh = checked(subject)
    points, faces = trimesh.sample.sample_surface(mesh, 6000, seed=1)
    normals = mesh.face_normals[faces]
    rays = np.concatenate([points - 1e-5 * normals, -normals], axis=1).astype(np.float32)
    met = scene(subject).cast_rays(o3d.core.Tensor.from_numpy(rays))
    thick_m, behind = met["t_hit"].numpy(), met["primitive_normals"].numpy()
    wall = (normals * behind).sum(axis=1) < -0.9
    assert wall.mean() > 0.1
    assert (thick_m[wall] < least_m).mean() < 0.001, np.sort(thick_m[wall])[:20]


def check_variety(family: str, seeds: Sequence[int], taller: float) -> None:
    """Other seeds, other objects, the highest `taller` times the lowest; the same seed, the same vertices."""
    subjects = [drawn(family, seed) for seed in seeds]
    assert len({round(checked(subject).volume, 7) for subject in subjects}) == len(subjects)
    heights = [subject.mesh.vertices[:, 2].max() for subject in subjects]
    assert max(heights) > taller * min(heights)
    # Its largest part is seldom dark.
    largest = [max(subject.pieces, key=lambda piece: np.ptp(piece.mesh.vertices)) for subject in subjects]
    assert np.mean([0.4 <= piece.albedo <= 0.8 for piece in largest]) >= 0.7
    again = make_object(family, seeds[1])
    assert np.array_equal(again.mesh.vertices, drawn(family, seeds[1]).mesh.vertices)
    assert np.array_equal(again.mesh.faces, drawn(family, seeds[1]).mesh.faces)
