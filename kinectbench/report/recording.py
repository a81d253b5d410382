"""Collect from a recording's build folder everything that the page shows of the recording."""

from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from markupsafe import Markup

from kinectbench.core import StorageError, images
from kinectbench.core.artefacts.manifest import Failed
from kinectbench.core.artefacts.object import FloorFile, QualityFile
from kinectbench.core.artefacts.object_grids import ObjectVolume, unmeasured_faces
from kinectbench.core.artefacts.sequence import CameraFile
from kinectbench.core.artefacts.stored import Stored
from kinectbench.core.artefacts.trajectory import TrajectoryHealth
from kinectbench.core.artefacts.views import PairRow, PairsFile, ViewsFile
from kinectbench.core.geometry import TriangleMesh, read_own_ply
from kinectbench.core.medians import known_median
from kinectbench.core.trajectory.trajectory import read_poses
from kinectbench.core.turntable import QUALITY, turntable
from kinectbench.core.types import Bools, Float64
from kinectbench.core.voxels.pair_file import read_pair
from kinectbench.engine.stages import STAGES, Job, current_stages
from kinectbench.report import page_pictures
from kinectbench.report.figures import StageFigures, health_figures, per_cent, quality_figures, text_of
from kinectbench.report.plan import draw_plan
from kinectbench.report.recording_list import millimetres
from kinectbench.report.unseen import ObjectPicture, object_pictures
from kinectbench.settings.models import RecordingSettings

File = TypeVar("File", bound=Stored)


@dataclass(frozen=True)
class Tile:
    """A pair on the page, as texts.

    Attributes:
        view: name of the view.
        frame: number of its frame.
        picture: picture of partial and full shape as a `data:` URL.
        containment: share of the partial inside the full shape.
        residual: median difference between measured and rendered depth.
        unknown: share of the true shape that is not known.
    """

    view: str
    frame: str
    picture: str
    containment: str
    residual: str
    unknown: str


@dataclass(frozen=True)
class RecordingPart:
    """The page's contents about one recording; pictures are `data:` URLs.

    Attributes:
        settings: the recording's own settings.
        health: statistics of the trajectory; None if there are none.
        quality: statistics of the object; None if there are none.
        turntable: a strip of pictures of the object from all around; None if there is none.
        plan: the camera's path seen from above; None if there is none.
        object_pictures: pictures of the object from a few sides, with unseen parts in colour.
        frames: pictures of some recorded views.
        tiles: every pair.
        refused: (view, frame, reason) of every refused pair and of every frame that was refused as a view.
            Such a frame has "" as its view.
        containment: median containment over the pairs, as text.
        residual: median residual over the pairs, as text.
        missing: results that are not built yet, of "trajectory", "floor", "object", "views" and "pairs".
        outdated: results, of the same five, that are not shown because they were made with another version,
            other settings or other inputs.
        failed: the stage at which the last build failed, and why, one line; or "".
    """

    settings: RecordingSettings
    health: StageFigures | None
    quality: StageFigures | None
    turntable: str | None
    plan: Markup | None
    object_pictures: tuple[ObjectPicture, ...]
    frames: tuple[page_pictures.FramePicture, ...]
    tiles: tuple[Tile, ...]
    refused: tuple[tuple[str, str, str], ...]
    containment: str
    residual: str
    missing: tuple[str, ...]
    outdated: tuple[str, ...] = ()
    failed: str = ""


def collect(job: Job, folder: Path) -> RecordingPart:
    """Collect the current results of one recording; outdated results are only named.

    Args:
        job: the recording, with the settings that its build must have.
        folder: `build/<recording>/`.

    Raises:
        StorageError: a file is damaged.
        PairError: a pair file is missing or damaged.
    """
    current = current_stages(folder, job)

    def read(stage: str, model: type[File]) -> File | None:
        """Read a stage's file; None if the stage is not current or has no such file."""
        return model.read_if_there(current[stage]) if stage in current else None

    health, floor = read("track", TrajectoryHealth), read("segment", FloorFile)
    cameras_world = read_poses(current["track"]).T_world_camera if "track" in current else None
    T_floor_world = None if floor is None else floor.T_floor_world
    quality, mesh, unseen, turning = read("segment", QualityFile), None, np.zeros(0, bool), None
    frontiers = quality.frontiers if quality else ()
    if T_floor_world is not None:
        mesh, unseen = _mesh(current["segment"], T_floor_world)
        turning = _turntable(mesh, T_floor_world, current.get("fuse"))
    plan = None
    if cameras_world is not None and T_floor_world is not None:
        cameras_floor = T_floor_world @ cameras_world
        left_out_floor = _left_out(cameras_floor, health)
        outlines = page_pictures.outlines(mesh) if mesh else []
        plan = draw_plan(cameras_floor, left_out_floor, outlines, frontiers)
    views, pairs = read("sample-views", ViewsFile), read("pairs", PairsFile)
    frames = () if views is None else page_pictures.frame_pictures(folder / "views", views)
    rows = () if pairs is None else pairs.pairs
    refused = (*(views.refused if views else ()), *(pairs.refused if pairs else ()))
    failed = Failed.read_if_there(folder)
    absent = (
        ("trajectory", "track", cameras_world is None),
        ("floor", "segment", T_floor_world is None),
        ("object", "segment", mesh is None),
        ("views", "sample-views", not frames),
        ("pairs", "pairs", pairs is None),
    )
    old = {s.name for s in STAGES if s.name not in current and (folder / s.folder).is_dir()}
    return RecordingPart(
        settings=job.recording,
        health=None if health is None else health_figures(health, read("ingest", CameraFile)),
        quality=None if quality is None else quality_figures(quality),
        turntable=turning,
        plan=plan,
        object_pictures=object_pictures(mesh, unseen, frontiers) if mesh else (),
        frames=frames,
        tiles=tuple(_tile(folder / "pairs", row, T_floor_world) for row in rows),
        refused=tuple((row.view or "", text_of(row.frame), row.reason) for row in refused),
        containment=per_cent(known_median(row.containment for row in rows)),
        residual=millimetres(known_median(row.residual_m for row in rows)),
        missing=tuple(name for name, stage, is_absent in absent if is_absent and stage not in old),
        outdated=tuple(name for name, stage, is_absent in absent if is_absent and stage in old),
        failed=": ".join(filter(None, (failed.stage, failed.error))) if failed else "",
    )


def _turntable(mesh_floor: TriangleMesh, T_floor_world: Float64, reconstruction: Path | None) -> str:
    """Return pictures of the object from all sides, in one strip: a `data:` URL.

    The object is coloured if the scene's mesh is. `reconstruction` is the folder with that mesh, or None.
    """
    scene_floor = None
    if reconstruction and (reconstruction / "mesh.ply").is_file():
        scene_floor = read_own_ply(reconstruction / "mesh.ply", colors=True).transformed(T_floor_world)
    return images.data_uri(turntable(mesh_floor, scene_floor), QUALITY)


def _mesh(folder: Path, T_floor_world: Float64) -> tuple[TriangleMesh, Bools]:
    """Read the object's closed mesh, floor frame, and a mask (m,) of its faces that were not measured."""
    mesh_world = read_own_ply(folder / "mesh.ply")
    if not len(mesh_world.faces):
        raise StorageError(f"{folder / 'mesh.ply'}: has no faces; delete the folder and build it again")
    volume = ObjectVolume.read(folder)
    unseen = unmeasured_faces(mesh_world, volume.grid, volume.labels)
    return mesh_world.transformed(T_floor_world), unseen


def _left_out(cameras_floor: Float64, health: TrajectoryHealth | None) -> Float64:
    """Return the camera positions of rejected frames: (k, 3), floor frame, metres.

    They are interpolated between other frames. The result is empty unless the trajectory has a row for each
    frame, or for each frame that was kept.
    """
    if health is None or not health.rejected:
        return np.zeros((0, 3))
    rejected = sorted({row.frame for row in health.rejected})
    kept = np.arange(health.frames)
    if len(cameras_floor) != health.frames:
        kept = np.setdiff1d(kept, [*rejected, *health.lost])
    if len(kept) != len(cameras_floor):
        return np.zeros((0, 3))
    return np.stack([np.interp(rejected, kept, cameras_floor[:, axis, 3]) for axis in range(3)], axis=-1)


def _tile(folder: Path, row: PairRow, T_floor_world: Float64 | None) -> Tile:
    pair = read_pair(folder / f"{row.view}.npz")
    # Without a known floor, up is up in the view.
    R_world_grid = pair.T_world_grid[:3, :3]
    up_grid = np.array([0.0, -1, 0]) if T_floor_world is None else T_floor_world[2, :3] @ R_world_grid
    picture = page_pictures.pair_picture(pair.partial, pair.full, pair.voxel_size_m, up_grid)
    return Tile(
        view=row.view,
        frame=text_of(row.frame),
        picture=images.data_uri(picture),
        containment=per_cent(row.containment),
        residual=millimetres(row.residual_m),
        unknown=per_cent(pair.unknown_share),
    )
