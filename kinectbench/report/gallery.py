"""The gallery of a page: partial, truth and predictions of some pairs, as text that a browser unpacks."""

import base64
import io
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from kinectbench.errors import StorageError
from kinectbench.release.release import Release, Target
from kinectbench.report import stored
from kinectbench.report.gallery_file import Gallery, reduced
from kinectbench.report.score_model import ScoreTable
from kinectbench.scoring.truth import read_grids
from kinectbench.voxels.npz import UNREADABLE
from kinectbench.voxels.pair_file import BLOCK, Packed, pack, unpack

Float64 = NDArray[np.float64]

# Of the text; the rest of a page is its pictures.
MAX_BYTES = 4 << 20
DEFLATE_LEVEL = 6


@dataclass(frozen=True)
class PairTruth:
    """One pair as it is shown.

    Attributes:
        category: such as "chair".
        object: the thing recorded.
        up: (3,) unit vector that points up, in the grid's axes.
        partial: (64, 64, 8) uint8, packed.
        full: likewise, of the truth.
        known: likewise, where the truth is trusted: at one voxel within each cell.
    """

    category: str
    object: str
    up: Float64
    partial: Packed
    full: Packed
    known: Packed


def read_pair_truth(release: Release, target: Target) -> PairTruth:
    """Read what is shown of a pair of a release.

    Raises:
        ReleaseError: the pair file is missing, or not the published one.
    """
    path = release.pair_path(target)
    partial, full, known = read_grids(path, target.sha256, ("partial", "full", "known"))
    up = _up_grid(release.folder / "objects" / target.recording / "floor.json", path)
    return PairTruth(target.category, target.object, up, partial, reduced(full), _sampled(known))


def _up_grid(floor: Path, pair: Path) -> Float64:
    """Where up is in the grid of a pair; what was up in the view, if the floor is not known."""
    try:
        T_floor_world = stored.read_floor(floor)
    except StorageError:  # it only turns a picture
        T_floor_world = None
    up = np.zeros(3) if T_floor_world is None else T_floor_world[2, :3] @ _R_world_grid(pair)
    length = float(np.linalg.norm(up))
    return up / length if length > 0 and np.isfinite(length) else np.array([0.0, -1, 0])


def _sampled(packed: Packed) -> Packed:
    """(256, 256, 32) packed to (64, 64, 8) packed: the voxel beyond the middle of each cell."""
    middle = BLOCK // 2
    return pack(unpack(packed[middle::BLOCK, middle::BLOCK])[..., middle::BLOCK])


def _R_world_grid(path: Path) -> Float64:
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as archive:
            R: Float64 = np.asarray(archive["T_world_grid"], np.float64)[:3, :3]
    except UNREADABLE as error:
        raise StorageError(f"{path}: not a pair file ({error}); was it published whole?") from error
    return R


def gallery_json(
    tables: Sequence[ScoreTable],
    galleries: Sequence[Gallery | None],
    truths: Mapping[str, PairTruth],
    protocol: str,
) -> tuple[Markup | None, int]:
    """The gallery's data as JSON that can stand in a page, bounded in size.

    Args:
        tables: the methods.
        galleries: of each of them, or None.
        truths: pairs by name; what is not there is not shown.
        protocol: whose IoU is shown.

    Returns:
        The text, or None if there is nothing to show; and how many pairs were left out for its size.
    """
    shown_by = [
        {} if gallery is None else {name: gallery.cells[name] for name in gallery.cells if name in truths}
        for gallery in galleries
    ]
    holders = {name: sum(name in of for of in shown_by) for of in shown_by for name in of}
    room, chosen = MAX_BYTES, set()
    parts: dict[str, Any] = {}
    for name in sorted(holders, key=lambda name: (-holders[name], name)):
        packed = {
            "truth": _truth(truths[name]),
            "by": [_text(of[name]) if name in of else None for of in shown_by],
        }
        size = len(json.dumps(packed))
        if size <= room:
            room -= size
            chosen.add(name)
            parts[name] = packed
    if not chosen:
        return None, len(holders)
    names = sorted(chosen)
    methods = [
        {"name": table.method, "pairs": _scored(table, protocol, {n: parts[n]["by"][i] for n in names})}
        for i, table in enumerate(tables)
    ]
    content = {
        "protocol": protocol,
        "pairs": {name: parts[name]["truth"] for name in names},
        "methods": [method for method in methods if method["pairs"]],
    }
    return _inert(json.dumps(content, separators=(",", ":"), allow_nan=False)), len(holders) - len(chosen)


def _truth(truth: PairTruth) -> dict[str, Any]:
    grids = {name: _text(getattr(truth, name)) for name in ("partial", "full", "known")}
    up = [round(float(value), 5) for value in truth.up]
    return {"category": truth.category, "object": truth.object, "up": up, **grids}


def _scored(table: ScoreTable, protocol: str, cells: Mapping[str, str | None]) -> dict[str, Any]:
    rows = {row.pair: row for row in table.pairs(protocol)}
    return {
        name: {"iou": rows[name].iou, "threshold": rows[name].threshold, "cells": text}
        for name, text in cells.items()
        if text is not None and name in rows
    }


def _text(packed: Packed) -> str:
    return base64.b64encode(zlib.compress(packed.tobytes(), DEFLATE_LEVEL)).decode()


def _inert(text: str) -> Markup:
    """JSON without a character that could end the element it stands in."""
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)
