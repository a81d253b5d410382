"""Intrinsics of folders that ScanNet's tools export: rows `m_calibrationDepthIntrinsic = ...` in info.txt."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinectbench.core.errors import IntrinsicsError
from kinectbench.core.trajectory.text_rows import parse_floats, text_rows
from kinectbench.core.types import Float64
from kinectbench.core.untrusted import read_head
from kinectbench.stages.ingest.intrinsics import Intrinsics, rig_calibration
from kinectbench.stages.ingest.recording import ColorCalibration


@dataclass(frozen=True)
class ScannetRig:
    """The cameras of one rig, from a file.

    Attributes:
        file: the file, or the recording where none says it.
        depth: of the depth camera.
        color: the transform of colour to depth, or None if missing.
        registered: colour is registered to depth, whatever the file states.
    """

    file: Path
    depth: Intrinsics
    color: ColorCalibration | None = None
    registered: bool = False


DEPTH_INTRINSIC = "calibrationDepthIntrinsic"


def is_info(file: Path) -> bool:
    """Whether the file describes the cameras of such a recording."""
    return file.is_file() and DEPTH_INTRINSIC.encode() in read_head(file)


def read_info(file: Path, color_px: tuple[int, int]) -> ScannetRig:
    """Read info.txt: `name = numbers` in each row, matrices as 16 numbers row by row.

    Args:
        file: `info.txt` or `_info.txt`.
        color_px: width and height of the colour images; 0, 0 where there is none.

    Raises:
        RecordingError: depth's intrinsics are missing, or a row does not hold the numbers it should.
    """
    rows = {}
    for where, row in text_rows(file):
        key, _, value = (part.strip() for part in row.partition("="))
        rows[key.removeprefix("m_")] = (where, value.split())
    K = _matrix(rows, DEPTH_INTRINSIC)
    if K is None:
        raise IntrinsicsError(
            f"{file}: has no row 'm_calibrationDepthIntrinsic = ' with the 16 numbers of a 4x4"
        )
    width, height, scale = (_number(rows, key) for key in ("depthWidth", "depthHeight", "depthShift"))
    if scale is not None and not scale > 0:
        raise IntrinsicsError(f"{file}: 'm_depthShift' must be above 0 (native units per metre)")
    depth = Intrinsics.of_matrix(K, scale)
    if width and height:
        depth = replace(depth, width=int(width), height=int(height))
    K_color = _matrix(rows, "calibrationColorIntrinsic")
    if K_color is None:
        return ScannetRig(file, depth)
    color_place, depth_place = (
        np.eye(4) if place is None else place
        for place in (_matrix(rows, f"calibration{name}Extrinsic") for name in ("Color", "Depth"))
    )
    return ScannetRig(file, depth, rig_calibration(K_color, color_px, color_place, depth_place, file.parent))


def _matrix(rows: dict[str, tuple[str, list[str]]], key: str) -> Float64 | None:
    where, words = rows.get(key, ("", []))
    if not words:
        return None
    if len(words) != 16:
        raise IntrinsicsError(f"{where}: '{key}' holds {len(words)} numbers, not the 16 of a 4x4 matrix")
    return np.array(parse_floats(words, where)).reshape(4, 4)


def _number(rows: dict[str, tuple[str, list[str]]], key: str) -> float | None:
    where, words = rows.get(key, ("", []))
    value = parse_floats(words[:1], where) if words else []
    if value and not (np.isfinite(value[0]) and 0 <= value[0] < 1e6):
        raise IntrinsicsError(f"{where}: '{key}' is {value[0]:g}, which it cannot be")
    return value[0] if value else None
