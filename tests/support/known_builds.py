"""Builds whose errors are known: made from the truth itself, perfect or with chosen errors."""

import json
import shutil
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import manifold3d
import numpy as np
from analytic_scenes import MemoryFrames
from numpy.typing import NDArray

from kinectbench.core.artefacts.object import BoxPart, QualityFile
from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.artefacts.trajectory import TrajectoryHealth
from kinectbench.core.artefacts.views import PairRow, PairsFile
from kinectbench.core.geometry import (
    Camera,
    Grid,
    OrientedBox,
    TriangleMesh,
    invert_rigid,
    rigid,
    rotation_from_quaternion_xyzw,
    transform_points,
)
from kinectbench.core.geometry.camera import DepthRenderer
from kinectbench.core.geometry.mesh import write_ply
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory, write_trajectory
from kinectbench.core.types import Float64
from kinectbench.core.voxels.pair_file import Pair, pair_bytes
from kinectbench.core.voxels.point_cells import sample_surface
from kinectbench.engine.artefact import Artefact
from kinectbench.engine.stages import STAGES, Job
from kinectbench.lab.evaluate.build import Build
from kinectbench.lab.simulate.truth import SurfaceTruth, Truth, mesh_occupancy
from kinectbench.settings.models import PairSettings
from kinectbench.stages.pairs import full_shape, make_pair
from kinectbench.stages.sample_views.alignment import ViewAlignment
from kinectbench.stages.sample_views.view_fit import ViewFit
from kinectbench.stages.sample_views.views import View, Views, write_views
from kinectbench.stages.segment.find.floor import Floor
from kinectbench.stages.segment.find.planes import floor_frame
from kinectbench.stages.segment.object_model import ObjectModel, write_object
from kinectbench.stages.segment.solid.solid import SolidShape

CAMERA = Camera(320, 240, 262.5, 262.5, 159.5, 119.5)
DEPTH_SCALE = 20000.0
FRAMES, VIEW_FRAMES = 60, (3, 17, 32, 44, 58)
SURFACE_SAMPLES = 40_000
VOXEL_M, COARSE_VOXEL_M = 0.005, 0.02
# An upright chair somewhere in a world that is not upright.
T_WORLD_OBJECT = rigid(rotation_from_quaternion_xyzw([-0.55, 0.3, -0.2, 0.75]), [0.31, -0.17, 1.9])
# Corners (low, high) of the chair's boxes, object frame, metres; one armrest, so that nothing is symmetric.
LEGS = [((x, y, 0.0), (x + 0.045, y + 0.045, 0.44)) for x in (-0.2, 0.145) for y in (-0.18, 0.125)]
CHAIR = [
    *LEGS,
    ((-0.2, -0.18, 0.42), (0.19, 0.17, 0.47)),
    ((-0.2, 0.14, 0.45), (0.19, 0.17, 0.85)),
    ((-0.2, -0.1, 0.63), (-0.155, 0.16, 0.67)),
    ((-0.2, -0.1, 0.45), (-0.155, -0.05, 0.65)),
]


@dataclass(frozen=True)
class Known:
    """A truth and a build of it whose errors are known."""

    truth: Truth
    build: Build
    sequence: Sequence
    pairs: dict[str, Pair]


def chair(dilated_m: float = 0.0) -> manifold3d.Manifold:
    """The chair, or all points that are at most `dilated_m` away from it; object frame."""
    return manifold3d.Manifold.batch_boolean(
        [_rounded_box(np.array(low), np.array(high), dilated_m) for low, high in CHAIR],
        manifold3d.OpType.Add,
    )


def _rounded_box(low: Float64, high: Float64, radius_m: float) -> manifold3d.Manifold:
    if radius_m == 0:
        return manifold3d.Manifold.cube(high - low).translate(low)
    ball = manifold3d.Manifold.sphere(radius_m, 48)
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, 8).T
    return manifold3d.Manifold.batch_hull([ball.translate(corner) for corner in corners])


def mesh_of(solid: manifold3d.Manifold) -> TriangleMesh:
    """The closed surface of a solid."""
    mesh = solid.to_mesh64()
    return TriangleMesh(np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int32))


def orbit(n: int = FRAMES) -> Float64:
    """Cameras (n, 4, 4) on a wavy circle about the object, truth's world."""
    angle = np.linspace(0, 1.9 * np.pi, n)
    places = np.stack([1.6 * np.cos(angle), 1.6 * np.sin(angle), 1.1 + 0.25 * np.sin(3 * angle)], axis=1)
    return np.stack([T_WORLD_OBJECT @ _looking_at(place, np.array([0, 0, 0.42])) for place in places])


def _looking_at(place: Float64, target: Float64) -> Float64:
    forward = (target - place) / np.linalg.norm(target - place)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    return rigid(np.stack([right, np.cross(forward, right), forward], axis=1), place)


def make_truth(folder: Path) -> Truth:
    """The chair's truth; the silhouettes of the views' frames are written into `folder`."""
    mesh = mesh_of(chair()).transformed(T_WORLD_OBJECT)
    cameras, renderer = orbit(), DepthRenderer(mesh)
    points, normals = sample_surface(mesh.vertices, mesh.faces, SURFACE_SAMPLES, np.random.default_rng(7))
    seen = np.zeros(len(points), np.uint16)
    for T_world_camera in cameras:
        seen += _visible(points, normals, T_world_camera, renderer.depth_m(CAMERA, T_world_camera))
    (folder / "masks").mkdir(parents=True)
    for frame in VIEW_FRAMES:
        silhouette = renderer.depth_m(CAMERA, cameras[frame]) > 0
        cv2.imwrite(str(folder / "masks" / f"{frame:06d}.png"), silhouette.astype(np.uint8) * 255)
    stamps_ns = 10**18 + np.arange(FRAMES, dtype=np.int64) * 33_333_000
    return Truth(
        folder=folder,
        subject="chair of boxes",
        origin="union of boxes",
        mesh_world=mesh,
        T_world_object=T_WORLD_OBJECT,
        camera=CAMERA,
        stamps_ns=stamps_ns,
        T_world_camera=cameras,
        surface=SurfaceTruth(points, normals, seen),
    )


def _visible(
    points: Float64, normals: Float64, T_world_camera: Float64, depth_m: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Points that face the camera and are no farther than what it sees there, within 10 mm."""
    points_camera = transform_points(invert_rigid(T_world_camera), points)
    u, v = np.rint(CAMERA.project(points_camera)).astype(int).T
    inside = (u >= 0) & (u < CAMERA.width) & (v >= 0) & (v < CAMERA.height)
    surface_m = depth_m[np.where(inside, v, 0), np.where(inside, u, 0)]
    facing = ((T_world_camera[:3, 3] - points) * normals).sum(axis=1) > 0
    visible: NDArray[np.bool_] = inside & facing & (points_camera[:, 2] < surface_m + 0.01)
    return visible


def known_build(
    truth: Truth,
    *,
    dilated_m: float = 0.0,
    unknown_above_m: float | None = None,
    T_built_truth: Float64 | None = None,
) -> Known:
    """A build that is the truth itself, but for the errors asked for.

    Args:
        truth: by `make_truth`.
        dilated_m: the object's mesh is the solid dilated by this.
        unknown_above_m: labels above this height (a multiple of 20 mm) are unknown.
        T_built_truth: (4, 4), the build has another world than the truth.
    """
    T = np.eye(4) if T_built_truth is None else T_built_truth
    cameras = T @ truth.T_world_camera
    mesh = mesh_of(chair(dilated_m)).transformed(T @ T_WORLD_OBJECT)
    sequence = _sequence(truth)
    model = _model(truth, mesh, T, unknown_above_m)
    views = tuple(
        _view(f"{k:03d}", frame, truth, cameras[frame], sequence) for k, frame in enumerate(VIEW_FRAMES)
    )
    shape = full_shape(model)
    made = {view.name: make_pair(view, sequence, shape, PairSettings()).pair for view in views}
    pairs = {name: pair for name, pair in made.items() if pair is not None}
    n = len(truth.stamps_ns)
    health = TrajectoryHealth(source="tracked", verdict="known", grade="good", frames=n, tracked=n)
    build = Build(
        stamps_ns=truth.stamps_ns,
        camera=sequence.camera,
        depth_m=sequence.depth_m,
        given=None,
        scene=lambda: mesh,
        trajectory=Trajectory(truth.stamps_ns, cameras, "tracked", health=health),
        model=model,
        views=views,
        valid_depth=lambda view: sequence.depth_m(view.frame) > 0,
        pair_names=tuple(pairs),
        pair=pairs.__getitem__,
    )
    return Known(truth, build, sequence, pairs)


def noisy(build: Build, sigma_m: float, seed: int) -> Build:
    """The same build, whose trajectory has normal noise on every position, per axis."""
    assert build.trajectory
    cameras = build.trajectory.T_world_camera.copy()
    cameras[:, :3, 3] += np.random.default_rng(seed).normal(size=(len(cameras), 3)) * sigma_m
    return replace(build, trajectory=replace(build.trajectory, T_world_camera=cameras))


def _sequence(truth: Truth) -> Sequence:
    """Exact depth of the object alone, with a wall 3 m away."""
    renderer = DepthRenderer(truth.mesh_world)

    def depth(index: int) -> NDArray[np.uint16]:
        rendered_m = renderer.depth_m(CAMERA, truth.T_world_camera[index])
        return np.rint(np.where(rendered_m > 0, rendered_m, 3.0) * DEPTH_SCALE).astype(np.uint16)

    return Sequence(CAMERA, DEPTH_SCALE, truth.stamps_ns, True, None, MemoryFrames(depth))


def _view(name: str, frame: int, truth: Truth, T_world_camera: Float64, sequence: Sequence) -> View:
    fit = ViewFit(int(truth.mask(frame).sum()), 1.0, 0.0, 0.0, 1.0, 0.0)
    pose = ViewAlignment(T_world_camera, 0.0, 0.0)
    return View(name, frame, int(sequence.stamps_ns[frame]), "random", pose, truth.mask(frame), fit)


def _model(truth: Truth, mesh: TriangleMesh, T: Float64, unknown_above_m: float | None) -> ObjectModel:
    """The object with labels on upright grids: of 5 mm around it, of 20 mm 2.4 m wide around that."""
    plane = truth.floor_plane_world @ invert_rigid(T)
    fine = Grid((112, 112, 192), VOXEL_M, rigid(np.eye(3), [-0.28, -0.28, -0.02]))
    coarse = Grid((120, 120, 120), COARSE_VOXEL_M, rigid(np.eye(3), [-1.2, -1.2, -0.8]))
    solid = mesh_occupancy(truth.mesh_world, replace(fine, T_world_grid=T_WORLD_OBJECT @ fine.T_world_grid))
    labels = np.where(solid, np.uint8(Label.INTERIOR), np.uint8(Label.FREE))
    around = np.full(coarse.shape, Label.FREE, np.uint8)
    if unknown_above_m is not None:
        for grid, of_grid in ((fine, labels), (coarse, around)):
            first = round((unknown_above_m - grid.T_world_grid[2, 3]) / grid.voxel_size_m)
            of_grid[:, :, first:] = Label.UNKNOWN
    fine, coarse = (replace(g, T_world_grid=T @ T_WORLD_OBJECT @ g.T_world_grid) for g in (fine, coarse))
    box = OrientedBox((0.0, 0.0, 0.425), (0.4, 0.36, 0.85))
    quality = QualityFile(box=BoxPart.of(box, 4, 5), surface_sigma_m=0.0)
    shape = SolidShape(fine, solid, mesh, labels, solid.astype(np.float32), np.zeros_like(solid))
    return ObjectModel(Floor(plane, floor_frame(plane), 0.0, 1.0), box, shape, coarse, around, 0.0, quality)


def write_build(known: Known, folder: Path) -> None:
    """Write a build as `kinectbench build` would: `build/<recording>/`."""
    build = known.build
    assert build.trajectory and build.scene and build.model and build.views
    for stage in ("sequence/depth", "trajectory", "reconstruction", "object", "views", "pairs"):
        (folder / stage).mkdir(parents=True)
    camera = {**asdict(CAMERA), "format_version": 1, "depth_scale": DEPTH_SCALE, "color_registered": True}
    (folder / "sequence" / "camera.json").write_text(json.dumps(camera))
    rows = [
        {"index": i, "stamp_ns": stamp_ns, "depth": f"depth/{i:06d}.png", "color": None}
        for i, stamp_ns in enumerate(build.stamps_ns.tolist())
    ]
    (folder / "sequence" / "frames.json").write_text(json.dumps(rows))
    for row in rows:
        native = known.sequence.frames.depth_native(row["index"])
        cv2.imwrite(str(folder / "sequence" / row["depth"]), native)
    write_trajectory(build.trajectory, folder / "trajectory")
    write_ply(build.scene(), folder / "reconstruction" / "mesh.ply")
    write_object(build.model, folder / "object")
    write_views(Views(list(build.views), [], []), known.sequence, folder / "views")
    for name, pair in known.pairs.items():
        (folder / "pairs" / f"{name}.npz").write_bytes(pair_bytes(pair))
    PairsFile(pairs=tuple(PairRow(view=name) for name in known.pairs), refused=()).write(folder / "pairs")
    write_manifests(folder)


def write_manifests(folder: Path, job: Job | None = None) -> None:
    """Make the stages' folders of `build/<recording>/` current up to the last that is there.

    Folders that are missing between them are made empty.

    Args:
        folder: where they lie.
        job: with whose settings they are made; None: with none.
    """
    fingerprints: dict[str, str] = {}
    last = max(index for index, stage in enumerate(STAGES) if (folder / stage.folder).is_dir())
    for stage in STAGES[: last + 1]:
        here, inputs = folder / stage.folder, {name: fingerprints[name] for name in stage.inputs}
        inputs |= dict.fromkeys(stage.outside(job) if job else (), "of no file")
        artefact = Artefact(here, stage.name, stage.version, stage.settings(job) if job else {}, inputs)
        here.mkdir(exist_ok=True)
        with artefact.write() as made:
            shutil.copytree(here, made, dirs_exist_ok=True, ignore=shutil.ignore_patterns("manifest.json"))
        fingerprints[stage.name] = artefact.fingerprint
