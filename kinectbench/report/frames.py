"""A few views as they were recorded, with their masks."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinectbench.errors import StorageError
from kinectbench.report import images, stored

FRAMES_SHOWN = 6
FRAME_PX = 320


@dataclass(frozen=True)
class FramePicture:
    """One view as recorded: its picture with the mask, and its colour where that is apart."""

    view: str
    frame: str
    masked: str
    color: str | None


def frame_pictures(folder: Path) -> tuple[FramePicture, ...]:
    """Some of the views, evenly chosen."""
    path = folder / "views.json"
    listed = stored.read_json(path) or {}
    rows = stored.rows_of(path, listed, "views")
    chosen = np.unique(np.linspace(0, len(rows) - 1, min(FRAMES_SHOWN, len(rows))).astype(int))
    registered = listed.get("color_registered") is not False
    shown = [_frame(folder, rows[i], registered) for i in chosen]
    return tuple(frame for frame in shown if frame)


def _frame(folder: Path, row: Mapping[str, Any], registered: bool) -> FramePicture | None:
    """One view; None if its files are not there."""
    paths = {kind: folder / f"{row['view']}.{kind}" for kind in ("color.jpg", "depth.png", "mask.png")}
    color_path = paths["color.jpg"] if paths["color.jpg"].exists() else None
    color = images.read_color(color_path) if color_path else None
    if registered and color is not None:
        picture = color
    elif paths["depth.png"].exists():
        picture = images.depth_picture(images.read_gray(paths["depth.png"]))
    else:
        return None
    if paths["mask.png"].exists():
        mask = images.read_gray(paths["mask.png"]) > 0
        if mask.shape != picture.shape[:2]:
            raise StorageError(f"{paths['mask.png']}: not as large as the view; build the views again")
        picture = images.overlay_mask(picture, mask)
    beside = images.data_uri(images.shrunk(color, FRAME_PX)) if color is not None and not registered else None
    masked = images.data_uri(images.shrunk(picture, FRAME_PX))
    return FramePicture(row["view"], stored.text_of(row.get("frame")), masked, beside)
