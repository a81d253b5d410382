"""Make the pairs of one model, and write their files atomically as one artefact."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from kinectbench.core import sha256_file, sha256_text, write_below
from kinectbench.core.artefacts.object import MadeGroup, MadeModel, SynthesisedQualityFile
from kinectbench.core.artefacts.views import Refused, SynthesisedCamera, ViewRow, ViewsFile
from kinectbench.core.geometry import Camera, Grid, transform_points, write_ply
from kinectbench.core.types import Split
from kinectbench.core.voxels.open_mesh import voxelize_open
from kinectbench.core.voxels.pair_file import Packed, Pair, pack, pair_bytes, unpack
from kinectbench.core.voxels.recgan_file import recgan_file_bytes
from kinectbench.core.voxels.seen_cells import seen_cells
from kinectbench.core.voxels.solid import packed_shell, voxelize_solid
from kinectbench.core.voxels.view_grids import (
    MAX_CUT_SHARE,
    containment,
    object_cube,
    partial_grids,
    view_cube,
)
from kinectbench.engine.artefact import VERSIONS, Artefact
from kinectbench.lab.synthesize.mesh_check import CheckedMesh, as_seeable, load_model
from kinectbench.lab.synthesize.models import Model, SynthesisSettings
from kinectbench.lab.synthesize.views import DepthCamera, ViewAngles, all_views, camera_pose, virtual_camera
from kinectbench.release.exchange.layouts import recgan_path

VOXELIZERS = {"winding": voxelize_solid, "seeable": voxelize_solid, "six-rays": voxelize_open}
NOTHING_SEEN = "the camera sees nothing of the shape"
NOTHING_MEASURED = "a Kinect measures nothing of it, from 0.4 to 4.5 m; give models in metres"


def make_synthetic_pair(
    checked: CheckedMesh, eye: DepthCamera, view: ViewAngles, settings: SynthesisSettings, name: str = ""
) -> tuple[Pair, str | None]:
    """Render a model's depth in one view, and voxelise the visible part and the full shape in one cube.

    In framing `object` (the paper's), the cube is placed around the full shape's box in the view's axes; in
    framing `view`, it is placed around the visible part alone. The world frame is the model's own, in metres.
    All cells of a mesh are known. In a `SeeableSolid`, gaps that only a finer sensor could see into and walls
    thinner than a voxel are unknown. `surface_sigma_m` is 0. Of the settings, `up_axis`, `framing`, `noise`,
    `seed` and `min_containment` are used; name, view and seed determine the noise.

    Returns:
        The pair, and the reason why it must not be used, or None if it may be used.
    """
    camera = eye.camera
    T_world_camera = camera_pose(eye.corners_world, view, camera, settings.up_axis)
    noisy = settings.noise != "none"
    rng = np.random.default_rng([settings.seed, view.n, *view.steps, *name.encode()])
    depth_m = eye.kinect_depth_m(T_world_camera, rng) if noisy else eye.depth_m(T_world_camera)
    whole = grid = object_cube(eye.corners_world, T_world_camera)
    # One pixel makes a cube without a side.
    is_seen = np.count_nonzero(depth_m) >= (2 if settings.framing == "view" else 1)
    if settings.framing == "view" and is_seen:
        grid = view_cube(camera.backproject(depth_m)[depth_m > 0], T_world_camera)
    full, known = _solid(checked, grid)
    cut_share = 0.0 if grid is whole else _cut_share(grid, checked, whole)
    partial_256, partial = partial_grids(depth_m, camera, T_world_camera, grid)
    pair = Pair(
        partial=partial,
        partial_256=partial_256,
        full=full,
        shell=packed_shell(full),
        known=known,
        seen=seen_cells(depth_m, camera, T_world_camera, grid, noisy=noisy),
        T_world_grid=grid.T_world_grid,
        T_world_camera=T_world_camera,
        K=camera.K,
        voxel_size_m=grid.voxel_size_m,
        surface_sigma_m=0.0,
        framing=settings.framing,
        partial_rule="any",
        occupancy_rule=checked.rule,
    )
    if not is_seen:
        return pair, NOTHING_MEASURED if noisy else NOTHING_SEEN
    return pair, _reason(pair, settings.min_containment, cut_share)


def _solid(checked: CheckedMesh, grid: Grid) -> tuple[Packed, Packed]:
    """Return two packed bit grids: the cells in the solid, and the known cells.

    Gaps that only a finer sensor could see into, and walls thinner than a voxel (`slit`), are not known.
    """
    full = VOXELIZERS[checked.rule](checked.mesh.vertices, checked.mesh.faces, grid)
    if checked.seeable is None:
        return full, np.full_like(full, 255)
    solid = checked.seeable
    closed, slit = (pack(solid.on(grid, which)) for which in (solid.closed & ~solid.slit, solid.slit))
    return full | closed, ~(slit & ~full)


def _cut_share(grid: Grid, checked: CheckedMesh, whole: Grid) -> float:
    """Return the share of the shape that lies outside the cube `grid`, 0 to 1.

    `whole` is a grid around the whole shape, on which the shape is sampled.
    """
    corners = transform_points(grid.T_grid_world, checked.mesh.vertices)
    side_m = grid.shape[0] * grid.voxel_size_m
    if corners.min() >= 0 and corners.max() <= side_m:
        return 0.0
    cells = np.argwhere(unpack(_solid(checked, whole)[0]))
    centres = transform_points(grid.T_grid_world @ whole.T_world_grid, (cells + 0.5) * whole.voxel_size_m)
    outside = ((centres < 0) | (centres > side_m)).any(axis=1)
    return float(outside.mean()) if len(cells) else 0.0


def _reason(pair: Pair, min_containment: float, cut_share: float) -> str | None:
    """Return the reason why a pair must not be used; None if it may be."""
    if cut_share > MAX_CUT_SHARE:
        return f"the cube of framing view cuts off {cut_share:.1%} of it, more than {MAX_CUT_SHARE:.0%}"
    if not pair.full.any():
        return "no cell's centre lies in the shape: its walls are thinner than a cell"
    if not pair.partial.any():
        return NOTHING_SEEN
    inside = containment(pair.partial, pair.full)
    if inside < min_containment:
        return f"containment is {inside:.3f}, below {min_containment}"
    return None


def recgan_bytes(pair: Pair) -> tuple[bytes, bytes]:
    """Return a pair as the 3D-RecGAN authors' two files: visible part and full shape, at 256^3 cells.

    Both are cropped to the bounding box of all cells that are set in either. The key is `arr_0`, int8,
    (x, y, z, 1), with x to the left and y up: the authors' back-projection is x = -(u - w/2) z / f,
    y = -(v - h/2) z / f, so their grid is ours with x and y reversed.
    """
    seen, full = unpack(pair.partial_256), unpack(pair.full)
    occupied = seen | full
    box = tuple(
        slice(int(used[0]), int(used[-1]) + 1)
        for used in (np.flatnonzero(occupied.any(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1)))
    )
    return recgan_file_bytes(seen[box]), recgan_file_bytes(full[box])


FILES = "files"
# Settings on which an artefact does not depend: they concern only the rest of a run. But the seed also draws
# the noise: where there is some, `artefact` adds it.
ELSEWHERE = {"name", "license", "models", "categories", "seed", "train", "validation", "test"}


@dataclass(frozen=True)
class Task:
    """One model whose pairs are to be made, and its split; `work` is the folder of all models' artefacts."""

    model: Model
    split: Split
    settings: SynthesisSettings
    work: Path

    @property
    def groups(self) -> dict[str, int]:
        """Groups of views: {group: number of steps in a full turn, for each of roll, pitch and yaw}.

        "sv" (same viewing) has the angles of training. "cv" (cross viewing) has another angle step (paper);
        training has no such views. A group has all combinations of steps.
        """
        sv, cv = {"sv": self.settings.sv_steps}, {"cv": self.settings.cv_steps}
        return sv if self.split == "train" else sv | cv

    @property
    def folder(self) -> Path:
        """The artefact's folder."""
        return self.work / self.model.name

    def artefact(self) -> Artefact:
        """Return the artefact of the model's files. They depend on the settings, and on mesh file or seed."""
        source = sha256_file(Path(self.model.path)) if self.model.path else sha256_text(str(self.model.seed))
        settings = self.settings.stored(without=ELSEWHERE)
        own = {"split": self.split, "category": self.model.category, "model": self.model.name}
        if self.settings.noise != "none":
            settings["seed"] = self.settings.seed
        return Artefact(self.folder, "synthesize", VERSIONS["synthesize"], settings | own, {"mesh": source})


def make_model(task: Task) -> None:
    """Write all pairs of one model into its artefact, unless the artefact is up to date.

    Raises:
        ShapeError: the mesh cannot be used.
        StorageError: the disk is full or read-only.
    """
    artefact = task.artefact()
    if artefact.is_current():
        return
    settings = task.settings
    checked = load_model(task.model, settings.max_faces)
    if settings.solid == "seeable":
        checked = as_seeable(checked, settings.up_axis)
    eye = DepthCamera(checked.mesh, virtual_camera(settings.image_px))
    with artefact.write() as folder:
        groups = {}
        for name, steps in task.groups.items():
            pairs = (
                (view, *make_synthetic_pair(checked, eye, view, settings, task.model.name))
                for view in _drawn_views(task, steps)
            )
            write = _write_recgan if settings.layout == "recgan" else _write_release
            groups[name] = write(task, name, folder / FILES, checked, eye.camera, pairs)
        MadeModel(split=task.split, quality=_quality(task.model, checked), groups=groups).write(folder)


def _drawn_views(task: Task, steps: int) -> tuple[ViewAngles, ...]:
    """Return the views of one group: all, or `most_views` of them, drawn at random by the model's name."""
    views, most = all_views(steps), task.settings.most_views
    if most is None or most >= len(views):
        return views
    drawn = np.random.default_rng([steps, *task.model.name.encode()]).permutation(len(views))[:most]
    return tuple(views[index] for index in sorted(drawn))


def _quality(model: Model, checked: CheckedMesh) -> SynthesisedQualityFile:
    """Return a model's entry on quality for benchmark.json: filling rule, source, number of faces, notes."""
    return SynthesisedQualityFile(
        verdict="good",
        method=checked.rule,
        source=Path(model.path).name if model.path else f"{model.category}:seed={model.seed}",
        faces=len(checked.mesh.faces),
        warnings=checked.notes,
    )


Pairs = Iterator[tuple[ViewAngles, Pair, str | None]]


def _write_release(
    task: Task, group: str, files: Path, checked: CheckedMesh, camera: Camera, pairs: Pairs
) -> MadeGroup:
    """Write a group's pairs, views and object as a recording of a release; return its views and refusals."""
    recording = f"{task.model.name}-{group}"
    for name in ("pairs", "views", "objects"):
        (files / name / recording).mkdir(parents=True)
    rows, refused = [], []
    for index, (view, pair, reason) in enumerate(pairs):
        name, steps, angles_rad = f"{index:03d}", view.steps, view.angles_rad
        if reason:
            refused.append(Refused(view=name, steps=steps, angles_rad=angles_rad, reason=reason))
            continue
        (files / "pairs" / recording / f"{name}.npz").write_bytes(pair_bytes(pair))
        pose = pair.T_world_camera
        share = pair.stated_unknown_share
        rows.append(
            ViewRow(view=name, steps=steps, angles_rad=angles_rad, T_world_camera=pose, unknown_share=share)
        )
    ViewsFile(
        order="roll, pitch, yaw",
        steps_per_turn=task.groups[group],
        camera=SynthesisedCamera(**asdict(camera)),
        views=tuple(rows),
        refused=tuple(refused),
    ).write(files / "views" / recording)
    write_ply(checked.mesh, files / "objects" / recording / "mesh.ply")
    _quality(task.model, checked).write(files / "objects" / recording)
    return MadeGroup(views=tuple(row.view for row in rows), refused=tuple(row.reason for row in refused))


def _write_recgan(
    task: Task, group: str, files: Path, checked: CheckedMesh, camera: Camera, pairs: Pairs
) -> MadeGroup:
    """Write a group's pairs as the paper authors' two files each; return its views and refusals.

    `files` is the folder to write into; `pairs` are (view, pair, reason why it is refused or None).
    """
    model, names, refused = task.model, [], []
    for view, pair, reason in pairs:
        if reason:
            refused.append(reason)
            continue
        name = f"{model.name}_{view.name}"
        for kind, content in zip(("25d", "3d"), recgan_bytes(pair), strict=True):
            write_below(files / recgan_path(kind, model.category, task.split, view.n**3, name), content)
        names.append(view.name)
    return MadeGroup(views=tuple(names), refused=tuple(refused))
