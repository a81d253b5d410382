"""How Views are stored, views.json with depth, colour and mask images; and the table of the pairs."""

import json
import math
from collections.abc import Sequence as Rows
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.alignment import Alignment
from kinectbench.errors import StorageError
from kinectbench.sequence import Sequence
from kinectbench.view_fit import ViewFit
from kinectbench.views import View, Views
from kinectbench.workspace import pretty_json

JPEG_QUALITY = 90


def write_views(views: Views, sequence: Sequence, folder: Path) -> None:
    """Write views.json and, for each view, depth (uint16 mm), mask (255 = object) and colour (JPEG)."""
    for view in views.views:
        depth_mm = np.rint(sequence.depth_m(view.frame) * 1000).astype(np.uint16)
        (folder / f"{view.name}.depth.png").write_bytes(_encode(".png", depth_mm))
        (folder / f"{view.name}.mask.png").write_bytes(_encode(".png", view.mask.astype(np.uint8) * 255))
        encoded = sequence.frames.color_encoded(view.frame)
        if encoded is not None:
            (folder / f"{view.name}.color.jpg").write_bytes(_jpeg(*encoded))
    rows = [
        {
            "view": view.name,
            "frame": view.frame,
            "stamp_ns": view.stamp_ns,
            "reason": view.reason,
            "T_world_camera": view.alignment.T_world_camera.tolist(),
            "moved_m": _rounded(view.alignment.moved_m),
            "turned_rad": _rounded(view.alignment.turned_rad),
            "blur": view.blur,
            "pose_residual_m": view.pose_residual_m,
        }
        | {name: _rounded(value) for name, value in asdict(view.fit).items()}
        for view in views.views
    ]
    content = {
        "format_version": 1,
        "color_registered": sequence.color_registered,
        "views": rows,
        "refused": [{"frame": frame, "reason": reason} for frame, reason in views.refused],
        "warnings": views.warnings,
    }
    (folder / "views.json").write_text(pretty_json(content))


def read_views(folder: Path) -> list[View]:
    """Read the views and their masks back.

    Raises:
        StorageError: a file is missing or damaged.
    """
    import cv2

    views = []
    try:
        for row in json.loads((folder / "views.json").read_text())["views"]:
            path = folder / f"{row['view']}.mask.png"
            mask = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE)
            if mask is None:
                raise StorageError(f"{path}: not a readable PNG; `kinectbench build --force` makes it again")
            fit = ViewFit(**{name: row[name] for name in ViewFit.__dataclass_fields__})
            pose = Alignment(np.array(row["T_world_camera"]), row["moved_m"], row["turned_rad"])
            chosen = row["view"], row["frame"], row["stamp_ns"], row["reason"]
            health = row.get("blur"), row.get("pose_residual_m")
            views.append(View(*chosen, pose, np.asarray(mask) > 0, fit, *health))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise StorageError(
            f"{folder}: the stored views are damaged ({error}); `kinectbench build --force` makes it again"
        ) from error
    return views


def write_pairs_table(made: Rows[dict[str, Any]], refused: Rows[dict[str, Any]], folder: Path) -> None:
    """Write pairs.json: the figures of every pair, and the refused views with reasons."""
    content = {"format_version": 1, "pairs": list(made), "refused": list(refused)}
    (folder / "pairs.json").write_text(pretty_json(content))


def _rounded(value: float) -> float | int | None:
    if isinstance(value, int):
        return value
    return round(value, 6) if math.isfinite(value) else None


def _jpeg(suffix: str, data: bytes) -> bytes:
    """Colour as JPEG: as it was recorded if it is one, else encoded once."""
    import cv2

    if suffix in (".jpg", ".jpeg"):
        return data
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise StorageError("a stored colour image is damaged; `kinectbench build --force` makes it again")
    encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
    return bytes(encoded.tobytes())


def _encode(suffix: str, image: NDArray[Any]) -> bytes:
    import cv2

    return bytes(cv2.imencode(suffix, image)[1].tobytes())
