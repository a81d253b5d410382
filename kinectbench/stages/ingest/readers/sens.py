"""ScanNet's .sens files (version 4), read frame by frame; a truncated file is read to its end.

Layout, little-endian (ScanNet's SensReader): `u32 4, u64 length, name`, four float32 4x4 matrices (colour
intrinsic and extrinsic, depth intrinsic and extrinsic), `i32 colour compression (0 raw, 1 PNG, 2 JPEG), i32
depth compression (0 raw, 1 zlib, 2 occi), u32 colour width, height, depth width, height, f32 depth shift, u64
frames`; per frame a float32 4x4 camera to world, `u64 colour stamp, depth stamp, colour bytes, depth bytes`
and the data. Metres = depth / shift; stamps are microseconds.
"""

import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, ClassVar, NamedTuple, Self

import numpy as np

from kinectbench.core import IntrinsicsError, RecordingError, is_too_large, open_plain, read_head, size_of
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.stamps import NS_PER_S
from kinectbench.core.trajectory.trajectory_file import rigid_or_none, trajectory_from_matrices
from kinectbench.core.types import Float64
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.images import encode_png
from kinectbench.stages.ingest.intrinsics import Intrinsics, rig_calibration, scale_warnings
from kinectbench.stages.ingest.readers.klg import NS_PER_US, PackedFrame, PackedRecording, timed
from kinectbench.stages.ingest.sources import check_count

START = struct.Struct("<IQ")
MATRICES = struct.Struct("<64f")
FACTS = struct.Struct("<iiIIIIfQ")
FRAME = struct.Struct("<16f4Q")
VERSION = 4
LONGEST_NAME, SHORT_NAME = 4096, 64
COLOR_SUFFIXES = {1: ".png", 2: ".jpg"}
RAW, ZLIB = 0, 1
# Later stamps are invalid.
LATEST_NS = 2**53 * NS_PER_US


class SensHead(NamedTuple):
    """The header of a .sens file; extrinsics: camera to rig, metres; depth_shift: depth units per metre."""

    color_intrinsic: Float64
    color_extrinsic: Float64
    depth_intrinsic: Float64
    depth_extrinsic: Float64
    color_compression: int
    depth_compression: int
    color_px: tuple[int, int]
    depth_px: tuple[int, int]
    depth_shift: float
    frames: int


@dataclass(frozen=True, kw_only=True)
class SensRecording(PackedRecording):
    """A .sens file; its intrinsics and extrinsics calibrate colour relative to depth."""

    format: ClassVar[str] = "sens"
    looks_for: ClassVar[str] = "a .sens file of ScanNet (version 4)"
    suffixes: ClassVar[tuple[str, ...]] = (".sens",)
    color_first: ClassVar[bool] = True

    head: SensHead

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the path is named .sens, or starts with version 4 and a short printable name."""
        if not path.is_file():
            return False
        if path.suffix.lower() in cls.suffixes:
            return True
        start = read_head(path, START.size + SHORT_NAME)
        if len(start) < START.size:
            return False
        version, length = START.unpack_from(start)
        name = start[START.size : START.size + length]
        return version == VERSION and 0 < length <= SHORT_NAME and len(name) == length and name.isascii()

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """Read the header and find the frames, without decoding any."""
        with open_plain(path) as file:
            head = _read_head(file, path)
            frames, matrices, cut = _find_frames(file, head, path)
        if not frames:
            raise RecordingError(
                f"{path}: {'is cut off, and no' if cut else 'no'} frame in it is whole", what="no-frame"
            )
        warnings = (
            [f"{path}: {cut}: {len(frames)} of {head.frames} frames are whole and are read"] if cut else []
        )
        if len({frame.stamp_ns for frame in frames}) == 1 or max(f.stamp_ns for f in frames) > LATEST_NS:
            # Some files have no stamps: their frames count seconds.
            frames = [frame._replace(stamp_ns=index * NS_PER_S) for index, frame in enumerate(frames)]
        frames, order, faults = timed(frames, path)
        places = tuple(frames[i] for i in order)
        intrinsics = Intrinsics.of_matrix(head.depth_intrinsic, head.depth_shift).overridden_by(settings)
        stamps_ns = [place.stamp_ns for place in places]
        trajectory, lost = _trajectory(stamps_ns, [matrices[i] for i in order], head, path)
        camera = intrinsics.camera(head.depth_px, path)
        color = Intrinsics.of_matrix(head.color_intrinsic)
        calibration = rig_calibration(color, head.color_px, head.color_extrinsic, head.depth_extrinsic, path)
        registered = calibration is not None and calibration.lies_on(camera)
        return cls(
            path=path,
            head=head,
            places=places,
            camera=camera,
            depth_scale=intrinsics.depth_scale or head.depth_shift,
            color_registered=registered,
            color_calibration=None if registered else calibration,
            given_trajectory=trajectory,
            warnings=(*warnings, *faults, *scale_warnings(path, head.depth_shift, settings), *lost),
        )

    def is_raw(self, depth: bytes, size: int) -> bool:
        """Whether depth is declared raw, and has the matching length."""
        return self.head.depth_compression == RAW and super().is_raw(depth, size)

    def color(self, data: bytes, name: str) -> tuple[str, bytes] | None:
        """Return the colour of a frame as encoded, or as PNG if it is raw."""
        suffix = COLOR_SUFFIXES.get(self.head.color_compression)
        if not data or suffix is not None:
            return (suffix, data) if data and suffix else None
        width, height = self.head.color_px
        if len(data) != 3 * width * height:
            return None
        rgb = np.frombuffer(data, np.uint8).reshape(height, width, 3)
        return ".png", encode_png(np.ascontiguousarray(rgb[..., ::-1]))


def _read_head(file: BinaryIO, path: Path) -> SensHead:
    start = file.read(START.size)
    if len(start) < START.size:
        raise RecordingError(f"{path}: the file is cut off before its first frame; copy it again")
    version, length = START.unpack(start)
    if version != VERSION:
        raise RecordingError(
            f"{path}: is of version {version}; only version {VERSION} can be read", what="unsupported"
        )
    if length > LONGEST_NAME:
        raise RecordingError(f"{path}: the name of its sensor has {length} bytes: the file is damaged")
    file.seek(length, os.SEEK_CUR)
    remainder = file.read(MATRICES.size + FACTS.size)
    if len(remainder) < MATRICES.size + FACTS.size:
        raise RecordingError(f"{path}: the file is cut off before its first frame; copy it again")
    matrices = np.array(MATRICES.unpack_from(remainder), np.float64).reshape(4, 4, 4)
    color, depth, *sides, shift, frames = FACTS.unpack_from(remainder, MATRICES.size)
    color_px, depth_px = (sides[0], sides[1]), (sides[2], sides[3])
    if min(depth_px) <= 0 or is_too_large(*depth_px):
        raise RecordingError(f"{path}: its depth is {depth_px[0]}x{depth_px[1]}: the file is damaged")
    if depth not in (RAW, ZLIB):
        raise RecordingError(
            f"{path}: depth compression {depth} cannot be read; only raw (0) and zlib (1)", what="unsupported"
        )
    if not (np.isfinite(shift) and shift > 0):
        raise IntrinsicsError(f"{path}: its depth shift is {shift:g}, not above 0: the file is damaged")
    of_color, of_depth = (matrices[0], matrices[1]), (matrices[2], matrices[3])
    return SensHead(*of_color, *of_depth, color, depth, color_px, depth_px, shift, frames)


def _find_frames(file: BinaryIO, head: SensHead, path: Path) -> tuple[list[PackedFrame], list[Float64], str]:
    """Find complete frames in file order, their poses (4, 4), and "is cut off" if frames are lost, or ""."""
    frames: list[PackedFrame] = []
    matrices: list[Float64] = []
    position, size = file.tell(), size_of(file)
    while len(frames) < head.frames:
        check_count(path, len(frames) + 1)
        if position + FRAME.size > size:
            return frames, matrices, "is cut off"
        file.seek(position)
        *matrix, _, depth_us, color_bytes, depth_bytes = FRAME.unpack(file.read(FRAME.size))
        start = position + FRAME.size
        if start + color_bytes + depth_bytes > size:
            return frames, matrices, "is cut off"
        frames.append(PackedFrame(depth_us * NS_PER_US, start, depth_bytes, color_bytes))
        matrices.append(np.array(matrix, np.float64).reshape(4, 4))
        position = start + color_bytes + depth_bytes
    return frames, matrices, ""


def _trajectory(
    stamps_ns: list[int], matrices: list[Float64], head: SensHead, path: Path
) -> tuple[GivenTrajectory | None, list[str]]:
    """Return the trajectory of the depth camera (None if every frame was lost), and warnings."""
    if not any(np.isfinite(matrix).all() for matrix in matrices):
        return None, []
    T_camera_depth = rigid_or_none(head.depth_extrinsic)
    if T_camera_depth is not None:
        matrices = [m @ T_camera_depth if np.isfinite(m).all() else m for m in matrices]
    return trajectory_from_matrices(stamps_ns, matrices, str(path))
