"""Folders with a transforms.json and depth: data sets of nerfstudio, or converted by it from Polycam.

By nerfstudio's page on data conventions: `fl_x, fl_y, cx, cy, w, h`, `k1, k2, p1, p2` are given for all
frames or for each; `transform_matrix` is camera to world in OpenGL's axes; the centre of the first pixel is
(0.5, 0.5). Depth is in mm, or in metres per unit of `depth_unit_scale_factor` (instant-ngp's
`integer_depth_scale`). Floats without a unit are in metres or mm, judged by their size. `mask_path` is
ignored: it marks pixels to leave out of training, not an object. The page says that z is up. But poses
computed by COLMAP are not aligned with gravity, and the file does not say whether its poses are. So the
direction of gravity counts as unknown.
"""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import GivenPosesError, IntrinsicsError, RecordingError, printable, quoted, read_head
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.stamps import NS_PER_S
from kinectbench.core.trajectory.trajectory_file import read_given, trajectory_from_matrices
from kinectbench.core.types import Float64
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.image_names import counting_key
from kinectbench.stages.ingest.images import decode_color_bgr, encode_png
from kinectbench.stages.ingest.intrinsics import Intrinsics, scale_warnings
from kinectbench.stages.ingest.json_values import json_numbers, number_of, read_json_object
from kinectbench.stages.ingest.known_names import first_file
from kinectbench.stages.ingest.readers.folder import DepthFormat
from kinectbench.stages.ingest.readers.phone_images import (
    OPENGL_FROM_OPTICAL,
    PhoneRecording,
    one_camera,
    scaled_to_depth,
)
from kinectbench.stages.ingest.recording import FrameFiles, first_color_size, first_depth_size
from kinectbench.stages.ingest.sources import check_count, listed_name
from kinectbench.stages.ingest.undistortion import Undistortion

FILE = "transforms.json"
DEPTH_KEYS = ("depth_file_path", "depth_path")
SCALE_KEYS = ("depth_unit_scale_factor", "integer_depth_scale")
PINHOLE_KEYS = ("fl_x", "fl_y", "cx", "cy")
ANGLE_KEYS, COLOR_KINDS = ("camera_angle_x", "camera_angle_y"), (".png", ".jpg", ".jpeg")
# Brown's coefficients in order; his model has no fourth radial term.
BROWN_KEYS = ("k1", "k2", "p1", "p2", "k3")
# All keys that are read, for a frame or for all frames.
FRAME_KEYS = (*PINHOLE_KEYS, *ANGLE_KEYS, *BROWN_KEYS, "w", "h", "k4", "camera_model", "transform_matrix")
MODELS = (None, "OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE")
# Unit of depth without `depth_unit_scale_factor`: nerfstudio's default.
METRES_PER_UNIT = 0.001

Frame = dict[str, object]


@dataclass(frozen=True, kw_only=True)
class NerfstudioRecording(PhoneRecording):
    """A transforms.json with depth; stamps are 0 s, 1 s, 2 s, ... in the order of the depth images' names.

    Attributes:
        undistortion: makes pinhole images; None if not needed.
    """

    format: ClassVar[str] = "nerfstudio"
    looks_for: ClassVar[str] = "a folder with transforms.json whose frames have a depth_file_path"

    undistortion: Undistortion | None = field(default=None, compare=False)

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether there is a transforms.json, and it names depth images or the folder has no depth/."""
        if not (path / FILE).is_file():
            return False
        head = read_head(path / FILE)  # contains the first frame
        return any(f'"{key}"'.encode() in head for key in DEPTH_KEYS) or not (path / "depth").is_dir()

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """Read the frames that have depth, their common camera, and their poses."""
        shared, frames, warnings = _read_frames(path)
        files = tuple(
            FrameFiles(index * NS_PER_S, path / depth, _color(path, frame))
            for index, (depth, frame) in enumerate(frames)
        )
        size_px = first_depth_size(files)
        # Values of the frame, or else of all frames; other keys are dropped.
        whole = [
            {key: home[key] for key in FRAME_KEYS for home in (shared, frame) if key in home}
            for _, frame in frames
        ]
        intrinsics, varied = _intrinsics(path, whole, first_color_size(files) or size_px, size_px)
        unit_m = number_of(_first(shared, SCALE_KEYS, METRES_PER_UNIT), f"{path / FILE}: its depth scale")
        if unit_m <= 0:
            raise IntrinsicsError(f"{path / FILE}: its depth scale must be above 0 (metres a unit)")
        said = 1 / unit_m if _first(shared, SCALE_KEYS) is not None else None
        stored = DepthFormat.of(files, settings.depth_scale or said)
        trajectory, lost, error = read_given(lambda: _trajectory(path, shared, files, whole))
        camera = intrinsics.overridden_by(settings).camera(size_px, path)
        coefficients = _distortion(path, whole)
        return cls(
            path=path,
            places=files,
            camera=camera,
            depth_scale=stored.depth_scale or settings.depth_scale or 1 / unit_m,
            float_scale=stored.float_scale,
            channels=stored.channels,
            kind=stored.kind,
            color_registered=any(file.color for file in files),
            given_trajectory=trajectory,
            trajectory_error=error,
            warnings=(
                *warnings,
                *_no_color(path, files, frames),
                *varied,
                *stored.warnings,
                *scale_warnings(path, said, settings),
                *lost,
            ),
            undistortion=Undistortion(camera, coefficients) if any(coefficients) else None,
        )

    def clean_depth(self, depth: NDArray[np.uint16], index: int) -> NDArray[np.uint16]:
        """Remove lens distortion from depth (height, width) of the camera's size."""
        return self.undistortion.depth(depth) if self.undistortion else depth

    def color(self, index: int) -> tuple[str, bytes] | None:
        """Return the colour of a frame at depth's size, without lens distortion; None if it has no colour."""
        color = super().color(index)
        if color is None or self.undistortion is None:
            return color
        bgr = decode_color_bgr(color[1], f"{self.places[index].color}")
        return ".png", encode_png(self.undistortion.color(bgr))


def _read_frames(path: Path) -> tuple[Frame, list[tuple[str, Frame]], list[str]]:
    """Read transforms.json: return values for all frames, pairs (name of depth image, frame), and warnings.

    The pairs are in numeric order of the names. Frames without depth are left out.
    """
    file = path / FILE
    content = read_json_object(file, "frames")
    frames = content.pop("frames", None)
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
        raise RecordingError(f"{file}: 'frames' must be a list of objects")
    named = [(_name(file, depth), f) for f in frames if (depth := _first(f, DEPTH_KEYS)) is not None]
    if not named:
        raise RecordingError(
            f"{file}: none of its {len(frames)} frames has a depth_file_path, so there is colour only: "
            "export it with depth, as from a camera or phone that measures it",
            what="no-depth",
        )
    check_count(file, len(named))
    alone = len(frames) - len(named)
    warnings = [f"{file}: {alone} frames have no depth_file_path and were left out"] if alone else []
    return content, sorted(named, key=lambda row: counting_key(row[0])), warnings


def _first(shared: Frame, keys: tuple[str, ...], default: object = None) -> object:
    return next((shared[key] for key in keys if shared.get(key) is not None), default)


def _name(file: Path, name: object) -> str:
    """Check that a name from the JSON file leads to a path inside the recording's folder; return it."""
    try:
        if not isinstance(name, str):
            raise ValueError("is no name")
        return listed_name(file.parent, name)
    except ValueError as error:
        raise RecordingError(
            f"{file}: {quoted(name)} does not name a file inside the recording's folder", what="link"
        ) from error


def _color(path: Path, frame: Frame) -> Path | None:
    """Find a frame's colour file; for instant-ngp and in Blender's data sets its name may lack a suffix."""
    name = frame.get("file_path")
    if name is None:
        return None
    whole = _name(path / FILE, name)
    return first_file(path / f"{whole}{suffix}" for suffix in ("", *COLOR_KINDS))


def _no_color(path: Path, files: tuple[FrameFiles, ...], frames: list[tuple[str, Frame]]) -> list[str]:
    """Return a warning about missing colour images that transforms.json names, else []."""
    pairs = zip(files, frames, strict=True)
    missing = [f["file_path"] for file, (_, f) in pairs if f.get("file_path") and file.color is None]
    if not missing:
        return []
    return [f"{path / FILE}: {len(missing)} of its colour images are not there, such as {quoted(missing[0])}"]


def _with_focal_lengths(frame: Frame, color_px: tuple[int, int], file: Path) -> Frame:
    """Return a frame's values, with focal lengths and principal point if it has angles of view instead.

    As in instant-ngp, fl_x = w / (2 tan(camera_angle_x / 2)), angle in radians. fl_y is found likewise from h
    and camera_angle_y; without this angle, it equals fl_x. The principal point is the middle of the image.
    """
    if frame.get("fl_x") is not None or frame.get("camera_angle_x") is None:
        return frame
    given = {key: value for key, value in frame.items() if value is not None}
    size = [number_of(given.get(key, px), f"{file}: '{key}'") for key, px in zip("wh", color_px, strict=True)]
    focal = dict[str, object]()
    for key, fl, side in (("camera_angle_x", "fl_x", size[0]), ("camera_angle_y", "fl_y", size[1])):
        angle = number_of(given[key], f"{file}: '{key}'") if key in given else None
        if angle is not None and not 0 < angle < math.pi:
            raise IntrinsicsError(f"{file}: '{key}' is {angle:g}, and no angle of view between 0 and pi")
        focal[fl] = focal["fl_x"] if angle is None else side / (2 * math.tan(angle / 2))
    return {**focal, "cx": size[0] / 2, "cy": size[1] / 2} | given


def _intrinsics(
    path: Path, frames: list[Frame], color_px: tuple[int, int], size_px: tuple[int, int]
) -> tuple[Intrinsics, list[str]]:
    """Return the depth images' common intrinsics (without values if a frame lacks any), and warnings."""
    file = path / FILE
    model = next((m for frame in frames if (m := frame.get("camera_model")) not in MODELS), None)
    if model is not None:
        name = printable(model) if isinstance(model, str) else quoted(model)
        raise RecordingError(
            f"{file}: cameras of the model {name} are not read: undistort the images first", what="lens"
        )
    frames = [_with_focal_lengths(frame, color_px, file) for frame in frames]
    if any(frame.get(key) is None for frame in frames for key in PINHOLE_KEYS):
        return Intrinsics(), []
    sizes = {
        tuple(
            int(number_of(frame.get(key, px), f"{file}: '{key}'"))
            for key, px in zip("wh", color_px, strict=True)
        )
        for frame in frames
    }
    if len(sizes) > 1:
        raise RecordingError(
            f"{file}: its frames are of several sizes; a recording must keep one camera", what="two-cameras"
        )
    rows = [[number_of(frame[key], f"{file}: '{key}'") for key in PINHOLE_KEYS] for frame in frames]
    K, warnings = one_camera(np.array(rows), path)
    K[:2, 2] -= 0.5
    width, height = sizes.pop()
    return scaled_to_depth(K, (width, height), size_px, path), warnings


def _distortion(path: Path, frames: list[Frame]) -> tuple[float, ...]:
    """Return Brown's coefficients k1 k2 p1 p2 k3, which must be equal for all frames."""
    file = path / FILE
    rows = {tuple(number_of(f.get(key, 0), f"{file}: '{key}'") for key in BROWN_KEYS) for f in frames}
    if len(rows) > 1 or any(frame.get("k4") for frame in frames):
        what = "k4 is not 0" if len(rows) == 1 else "frames differ in their distortion"
        raise RecordingError(f"{file}: {what}, which is not read: undistort the images first", what="lens")
    return rows.pop()


def _trajectory(
    path: Path, shared: Frame, files: tuple[FrameFiles, ...], frames: list[Frame]
) -> tuple[GivenTrajectory | None, list[str]]:
    """Return the trajectory (camera to world, metres, with `applied_scale` undone), and warnings."""
    scale = number_of(shared.get("applied_scale", 1.0), f"{path / FILE}: 'applied_scale'")
    if scale <= 0:
        raise GivenPosesError(f"{path / FILE}: 'applied_scale' must be above 0")
    matrices = [_matrix(path, frame.get("transform_matrix"), scale) for frame in frames]
    return trajectory_from_matrices([file.stamp_ns for file in files], matrices, str(path))


def _matrix(path: Path, value: object, scale: float) -> Float64 | None:
    if value is None:
        return None
    T = json_numbers(value)
    if T.shape != (4, 4):
        raise GivenPosesError(f"{path / FILE}: 'transform_matrix' must be four rows of four numbers")
    T[:3, 3] /= scale
    with np.errstate(invalid="ignore"):  # values may not be finite
        return np.asarray(T @ OPENGL_FROM_OPTICAL)
