"""Everything the page shows of one recording, collected from its build folder."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from kinectbench.config import RecordingSettings
from kinectbench.errors import StorageError
from kinectbench.failures import FAILED_JSON
from kinectbench.geometry import transform_points
from kinectbench.report import images, looks, pictures, stored
from kinectbench.report.frames import FramePicture, frame_pictures
from kinectbench.report.pictures import Mesh
from kinectbench.report.plan import PlanView, draw_plan
from kinectbench.voxels.pair_file import read_pair

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class Tile:
    """One pair: a picture of partial and full side by side, with its figures."""

    view: str
    frame: str
    picture: str
    containment: str
    residual: str


@dataclass(frozen=True)
class RecordingPart:
    """One section of the page; pictures are `data:` addresses.

    Attributes:
        settings: the recording's own settings.
        health: figures of the trajectory, or None.
        quality: figures of the object, or None.
        plan: the path seen from above, or None.
        object_pictures: the object from a few sides.
        frames: some views as recorded.
        tiles: every pair.
        refused: (view, frame, reason) of every frame refused as a view ("" for the view), and refused pair.
        containment: median over the pairs, as text.
        residual: median over the pairs, as text.
        missing: what is not built yet.
        failed: why the last build of it failed, one line, or "".
    """

    settings: RecordingSettings
    health: stored.Figures | None
    quality: stored.Figures | None
    plan: Markup | None
    object_pictures: tuple[str, ...]
    frames: tuple[FramePicture, ...]
    tiles: tuple[Tile, ...]
    refused: tuple[tuple[str, str, str], ...]
    containment: str
    residual: str
    missing: tuple[str, ...]
    failed: str = ""


def collect(settings: RecordingSettings, folder: Path) -> RecordingPart:
    """Collect what the stages made of one recording so far.

    Raises:
        StorageError: a file is damaged.
        PairError: a pair file is missing or damaged.
    """
    health = stored.read_figures(folder / "trajectory" / "health.json")
    cameras_world = stored.read_trajectory(folder / "trajectory" / "trajectory.txt")
    T_floor_world = stored.read_floor(folder / "object" / "floor.json")
    mesh = _object_in_floor(folder / "object" / "mesh.ply", T_floor_world)
    frames = frame_pictures(folder / "views")
    pairs_path = folder / "pairs" / "pairs.json"
    listed = stored.read_json(pairs_path) or {}
    rows = stored.rows_of(pairs_path, listed, "pairs")
    missing = {
        "trajectory": cameras_world is None,
        "floor": T_floor_world is None,
        "object": mesh is None,
        "views": not frames,
        "pairs": not listed,
    }
    return RecordingPart(
        settings=settings,
        health=health,
        quality=stored.read_figures(folder / "object" / "quality.json"),
        plan=_plan(cameras_world, T_floor_world, mesh, health),
        object_pictures=looks.object_pictures(mesh) if mesh else (),
        frames=frames,
        tiles=tuple(_tile(folder / "pairs", row, T_floor_world) for row in rows),
        refused=(
            *_refused_frames(folder / "views" / "views.json"),
            *(
                (row["view"], stored.text_of(row.get("frame")), str(row.get("reason", "")))
                for row in stored.rows_of(pairs_path, listed, "refused")
            ),
        ),
        containment=_percent(_median(rows, "containment")),
        residual=_millimetres(_median(rows, "residual_m")),
        missing=tuple(name for name, absent in missing.items() if absent),
        failed=_failed(folder / FAILED_JSON),
    )


def _failed(path: Path) -> str:
    """Which stage failed and why, "" if none did."""
    failure = stored.read_json(path) or {}
    return ": ".join(str(failure[key]) for key in ("stage", "error") if failure.get(key))


def _refused_frames(path: Path) -> list[tuple[str, str, str]]:
    """("", frame, reason) of every frame that was refused as a view."""
    rows = (stored.read_json(path) or {}).get("refused", [])
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise StorageError(f"{path}: 'refused' is not a list of objects; build this recording again")
    return [("", stored.text_of(row.get("frame")), str(row.get("reason", ""))) for row in rows]


def _frame_numbers(value: Any) -> list[int]:
    """Indices in a list of numbers or of objects with a `frame`, ascending."""
    entries = value if isinstance(value, list) else []
    found = [entry.get("frame") if isinstance(entry, Mapping) else entry for entry in entries]
    return sorted({frame for frame in found if isinstance(frame, int) and frame >= 0})


def _object_in_floor(path: Path, T_floor_world: Float64 | None) -> Mesh | None:
    if T_floor_world is None or not path.exists():
        return None
    mesh = pictures.read_mesh(path)
    return Mesh(transform_points(T_floor_world, mesh.vertices_m), mesh.triangles)


def _plan(
    cameras_world: Float64 | None,
    T_floor_world: Float64 | None,
    mesh: Mesh | None,
    health: stored.Figures | None,
) -> Markup | None:
    if cameras_world is None or T_floor_world is None:
        return None
    cameras_floor = T_floor_world @ cameras_world
    left_out_floor = _left_out(cameras_floor, health.values if health else {})
    # Only numbers of our own making go into the drawing: it is safe as it is.
    return Markup(draw_plan(PlanView(cameras_floor, left_out_floor, looks.outlines(mesh) if mesh else [])))


def _left_out(cameras_floor: Float64, health: Mapping[str, Any]) -> Float64:
    """Positions (k, 3) of the frames left out, between their neighbours in the trajectory.

    Only where the rows of the trajectory are told apart: one for each frame, or one for each frame kept.
    """
    n_frames, rejected = health.get("frames"), _frame_numbers(health.get("rejected"))
    if not isinstance(n_frames, int) or not len(rejected):
        return np.zeros((0, 3))
    kept = np.arange(n_frames)
    if len(cameras_floor) != n_frames:
        kept = np.setdiff1d(kept, [*rejected, *_frame_numbers(health.get("lost"))])
    if len(kept) != len(cameras_floor):
        return np.zeros((0, 3))
    return np.stack([np.interp(rejected, kept, cameras_floor[:, axis, 3]) for axis in range(3)], axis=-1)


def _tile(folder: Path, row: Mapping[str, Any], T_floor_world: Float64 | None) -> Tile:
    pair = read_pair(folder / f"{row['view']}.npz")
    # Where the floor is not known, up is what was up in the view.
    R_world_grid = pair.T_world_grid[:3, :3]
    up_grid = np.array([0.0, -1, 0]) if T_floor_world is None else T_floor_world[2, :3] @ R_world_grid
    picture = looks.pair_picture(pair.partial, pair.full, pair.voxel_size_m, up_grid)
    return Tile(
        view=row["view"],
        frame=stored.text_of(row.get("frame")),
        picture=images.data_uri(picture),
        containment=_percent(_number(row.get("containment"))),
        residual=_millimetres(_number(row.get("residual_m"))),
    )


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _median(rows: list[dict[str, Any]], key: str) -> float | None:
    values = [v for v in (_number(row.get(key)) for row in rows) if v is not None]
    return float(np.median(values)) if values else None


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.1f} %"


def _millimetres(value_m: float | None) -> str:
    return "–" if value_m is None else f"{1000 * value_m:.1f} mm"
