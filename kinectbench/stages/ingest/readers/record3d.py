"""Record3D's .r3d files: zip archives of `metadata` (JSON), and rgbd/N.jpg, N.depth and N.conf per frame.

By the app's author (in answers at github.com/marek-simonik/record3d): depth is float32 metres, confidence is
uint8, both row-major and packed by LZFSE; K is column-major, for colour of w x h pixels; a pose is quaternion
x y z w and position, camera to world in OpenGL's axes. The poses of recordings by the face camera are all
the same.
"""

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, NamedTuple, Self

import numpy as np

from kinectbench.core import GivenPosesError, IntrinsicsError, RecordingError
from kinectbench.core.geometry import rigid, rotation_from_quaternion_xyzw
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.stamps import NS_PER_S
from kinectbench.core.trajectory.trajectory_file import read_given, trajectory_from_matrices
from kinectbench.core.types import Float64
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.images import FLOAT_SCALE, DamagedImageError, quantised
from kinectbench.stages.ingest.json_values import json_numbers, number_of, object_of
from kinectbench.stages.ingest.readers.archive import Archive, holds
from kinectbench.stages.ingest.readers.phone_images import (
    GRAVITY_UP,
    OPENGL_FROM_OPTICAL,
    at_size,
    one_camera,
    scaled_to_depth,
    times_or_counted,
)
from kinectbench.stages.ingest.recording import RawFrame, Recording

NAMED = re.compile(rb"rgbd/\d{1,9}\.depth")
MEMBER = re.compile(r"rgbd/(\d{1,9})\.depth")
METADATA = "metadata"
# Depth sizes of LiDAR and of face cameras, used if an older file does not state it; no phone has larger
# depth.
USUAL_PX = ((256, 192), (640, 480), (960, 720))
LARGEST_SIDE_PX = 4096


class ArchivedFrame(NamedTuple):
    """A frame in the archive: stamp in nanoseconds, and the number in the names of its members."""

    stamp_ns: int
    number: int


@dataclass(frozen=True, kw_only=True)
class Record3dRecording(Recording):
    """A .r3d file: colour is scaled to depth's size, and depth of low confidence is dropped.

    Attributes:
        archive: reads the members.
        members: names of all members.
        min_confidence: depth with lower confidence counts as no measurement.
    """

    format: ClassVar[str] = "record3d"
    uses: ClassVar[frozenset[str]] = frozenset({"min_confidence"})
    looks_for: ClassVar[str] = "a .r3d file of Record3D (needs kinectbench[record3d])"
    up_world: ClassVar[tuple[float, float, float] | None] = GRAVITY_UP
    suffixes: ClassVar[tuple[str, ...]] = (".r3d",)

    places: tuple[ArchivedFrame, ...]
    archive: Archive = field(compare=False)
    members: frozenset[str]
    min_confidence: int

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the path is named .r3d, or is a zip archive with depth as Record3D names it."""
        return (path.is_file() and path.suffix.lower() in cls.suffixes) or holds(path, NAMED)

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """Read the metadata, and unpack the first depth image."""
        archive = Archive(path)
        members = frozenset(archive.names())
        numbers = sorted(int(match[1]) for name in members if (match := MEMBER.fullmatch(name)))
        if not numbers:
            raise RecordingError(
                f"{path}: holds no rgbd/0.depth, so there is colour only: record it with depth",
                what="no-depth",
            )
        metadata = _read_metadata(archive, members)
        stamps_ns, warnings = _stamps_ns(path, metadata, numbers)
        K, color_px, varied = _intrinsics(path, metadata)
        size_px = _depth_size(archive, metadata, color_px, numbers)
        intrinsics = scaled_to_depth(K, color_px, size_px, path).overridden_by(settings)
        trajectory, lost, error = read_given(lambda: _trajectory(path, metadata, numbers, stamps_ns))
        return cls(
            path=path,
            places=tuple(map(ArchivedFrame, stamps_ns, numbers)),
            archive=archive,
            members=members,
            min_confidence=settings.min_confidence,
            camera=intrinsics.camera(size_px, path),
            depth_scale=FLOAT_SCALE,
            float_scale=settings.depth_scale or 1.0,
            color_registered=any(name.endswith(".jpg") for name in members),
            given_trajectory=trajectory,
            trajectory_error=error,
            warnings=(*warnings, *varied, *lost),
        )

    def frame(self, index: int) -> RawFrame:
        """Unpack the members of a frame."""
        place, shape = self.places[index], (self.camera.height, self.camera.width)
        stem, size = f"rgbd/{place.number}", self.camera.height * self.camera.width
        name = f"{self.path}: {stem}.depth"
        metres = np.frombuffer(_unpacked(self.archive.read(f"{stem}.depth"), 4 * size, name), "<f4")
        with np.errstate(invalid="ignore", over="ignore"):  # values may be no depth
            depth = quantised(metres.reshape(shape) / np.float32(self.float_scale or 1.0))
        if self.min_confidence and f"{stem}.conf" in self.members:
            packed = self.archive.read(f"{stem}.conf")
            confidence = np.frombuffer(_unpacked(packed, size, f"{self.path}: {stem}.conf"), np.uint8)
            depth = np.where(confidence.reshape(shape) >= self.min_confidence, depth, np.uint16(0))
        return RawFrame(name, place.stamp_ns, depth, self._color(f"{stem}.jpg"))

    def _color(self, member: str) -> tuple[str, bytes] | None:
        """Return a frame's colour at depth's size, as `at_size` does; None if the archive lacks it."""
        if member not in self.members:
            return None
        size_px = self.camera.width, self.camera.height
        return at_size(self.archive.read(member), size_px, f"{self.path}: {member}")


def _unpacked(data: bytes, size: int, name: str) -> bytes:
    """Unpack LZFSE data to exactly `size` bytes, allocating at most one byte more."""
    try:
        import imagecodecs
    except ImportError as error:
        raise RecordingError(
            f"{name}: is packed by LZFSE; install what unpacks it with `pip install 'kinectbench[record3d]'`",
            what="no-package",
        ) from error
    try:
        unpacked = bytes(imagecodecs.lzfse_decode(data, out=size + 1))
    except imagecodecs.LzfseError as error:
        raise DamagedImageError(f"{name}: cannot be unpacked ({error})") from error
    if len(unpacked) != size:
        kind = "more than" if len(unpacked) > size else f"{len(unpacked)} bytes, not"
        raise DamagedImageError(f"{name}: unpacks to {kind} the {size} bytes of its image")
    return unpacked


def _read_metadata(archive: Archive, members: frozenset[str]) -> dict[str, object]:
    if METADATA not in members:
        raise RecordingError(f"{archive.path}: holds no {METADATA}; export it from Record3D as .r3d again")
    return object_of(archive.read(METADATA), f"{archive.path}: {METADATA}", "K, w, h and poses")


def _intrinsics(path: Path, metadata: dict[str, object]) -> tuple[Float64, tuple[int, int], list[str]]:
    """Return the pinhole matrix of colour, colour's size, and warnings."""
    width, height = (int(number_of(metadata.get(key), f"{path}: '{key}' of its metadata")) for key in "wh")
    rows = json_numbers(metadata.get("perFrameIntrinsicCoeffs"))
    if rows.ndim != 2 or rows.shape[1:] != (4,):
        K = json_numbers(metadata.get("K"))
        rows = K[[[0, 4, 6, 7]]] if K.shape == (9,) else np.full((1, 4), np.nan)
    if not np.isfinite(rows).all():
        raise IntrinsicsError(f"{path}: 'K' of its metadata must hold nine numbers")
    K, warnings = one_camera(rows, path)
    return K, (width, height), warnings


def _depth_size(
    archive: Archive, metadata: dict[str, object], color_px: tuple[int, int], numbers: list[int]
) -> tuple[int, int]:
    """Return width and height of depth: the metadata's dw, dh, else the usual size that fits frame one."""
    where = f"{archive.path}: {METADATA}"
    if metadata.get("dw") is None or metadata.get("dh") is None:
        for long, short in USUAL_PX:
            size_px = (short, long) if color_px[0] < color_px[1] else (long, short)
            name = f"rgbd/{numbers[0]}.depth"
            with suppress(DamagedImageError):
                _unpacked(archive.read(name), 4 * long * short, f"{archive.path}: {name}")
                return size_px
        raise RecordingError(f"{where}: does not say the size of depth (dw, dh); export it again")
    width, height = (int(number_of(metadata[key], f"{where}: '{key}'")) for key in ("dw", "dh"))
    if not (0 < width <= LARGEST_SIDE_PX and 0 < height <= LARGEST_SIDE_PX):
        raise RecordingError(f"{where}: {width}x{height} is no size of depth images; export it again")
    return width, height


def _stamps_ns(path: Path, metadata: dict[str, object], numbers: list[int]) -> tuple[list[int], list[str]]:
    """Return stamps, ns (own stamps if every frame has one and they rise, else number / fps), warnings."""
    times_s, fps = json_numbers(metadata.get("frameTimestamps")), json_numbers(metadata.get("fps"))
    period_ns = round(NS_PER_S / float(fps)) if fps.ndim == 0 and 1 <= fps <= 1000 else NS_PER_S
    whole = times_s.ndim == 1 and numbers[-1] < len(times_s)
    times_s = times_s[numbers] if whole else np.zeros(0)
    return times_or_counted(times_s, [number * period_ns for number in numbers], path)


def _trajectory(
    path: Path, metadata: dict[str, object], numbers: list[int], stamps_ns: Sequence[int]
) -> tuple[GivenTrajectory | None, list[str]]:
    """Return the trajectory in optical axes, and warnings.

    The trajectory is None if there are no poses, or if all are equal (face camera).
    """
    poses = metadata.get("poses")
    if poses is None:
        return None, []
    if not isinstance(poses, list) or len(poses) <= numbers[-1]:
        count = len(poses) if isinstance(poses, list) else 0
        raise RecordingError(
            f"{path}: its metadata has {count} poses for {len(numbers)} frames; export it again",
            what="pose-count",
        )
    matrices = [_pose(path, poses[number]) for number in numbers]
    known = [T for T in matrices if T is not None]
    if len(known) > 1 and all(np.array_equal(T, known[0]) for T in known):
        return None, [f"{path}: its poses are all the same, as those of the face camera; they are ignored"]
    return trajectory_from_matrices(stamps_ns, matrices, str(path))


def _pose(path: Path, row: object) -> Float64 | None:
    if row is None:
        return None
    numbers = json_numbers(row)
    if numbers.shape != (7,):
        raise GivenPosesError(f"{path}: a pose of its metadata must hold seven numbers (x y z w, position)")
    if not np.isfinite(numbers).all() or np.linalg.norm(numbers[:4]) < 1e-6:
        return np.full((4, 4), np.nan)
    T = rigid(rotation_from_quaternion_xyzw(numbers[:4]), numbers[4:])
    return np.asarray(T @ OPENGL_FROM_OPTICAL)
