"""Intrinsics from the recording and the settings, and their check against the images."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from kinectbench.core import IntrinsicsError, RecordingError
from kinectbench.core.geometry import Camera
from kinectbench.core.trajectory.text_rows import read_numbers
from kinectbench.core.trajectory.trajectory_file import rigid_or_none
from kinectbench.core.types import Float64
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.depth_units import scale_of_keys
from kinectbench.stages.ingest.json_values import json_numbers, number_of, read_json_object
from kinectbench.stages.ingest.recording import ColorCalibration

NEEDED = ("fx", "fy", "cx", "cy")
# Shape of a matrix by the number of values in its file.
MATRIX_SHAPES = {9: (3, 3), 12: (3, 4), 16: (4, 4)}
# Limits of focal lengths as shares of the image's side.
LEAST_FOCAL, MOST_FOCAL = 0.2, 10.0
# Limits of focal lengths for any image, pixels.
LEAST_FOCAL_PX, MOST_FOCAL_PX = 1.0, 1e6
# Focal lengths of square pixels differ by less than the first share of fx, others by more than the second
# (our own bounds; calibrations of square pixels differ by some 0.5 %).
SAME_FOCAL, NOT_SQUARE = 0.02, 0.1
# A principal point farther from the centre (ratio of width or height) belongs to no full image.
OFF_CENTRE = 0.15
# Images are of the same shape if their aspect ratios, or the ratios by the principal point, differ by less.
SAME_SHAPE, SAME_RATIO = 0.02, 0.08
# Longer sides of the images of common sensors, pixels; one is taken if it is so near to the estimated side.
COMMON_SIDES_PX, NEARLY = (160, 256, 320, 424, 480, 512, 640, 848, 960, 1024, 1280, 1920, 3840), 0.04
# Nearer to the centre it is of another size only if both axes give one ratio, and that is of a common sensor.
# Of 20 recordings at hand, at most one axis is farther off than the first share (our own bounds).
SLIGHTLY_OFF, SAME_SLIGHTLY = 0.06, 0.03
# librealsense's and Record3D's names of keys; and keys of a matrix instead of fx, fy, cx and cy.
SAME_AS = {"ppx": "cx", "ppy": "cy", "w": "width", "h": "height"}
MATRIX_KEYS = ("intrinsic_matrix", "cam_K", "camera_matrix", "K", "k")
HELD = "width, height, fx, fy, cx, cy"
NICE_SLAM = "cam_params.json"


@dataclass(frozen=True)
class Intrinsics:
    """A depth camera's image size and intrinsics, pixels, and native depth units per metre; None = unknown.

    Also whether colour lies on depth's pixels, whether the camera's y axis points up in the given poses, as
    ICL-NUIM's, and warnings (`notes`), such as on a converted unit.
    """

    width: int | None = None
    height: int | None = None
    fx: float | None = None
    fy: float | None = None
    cx: float | None = None
    cy: float | None = None
    depth_scale: float | None = None
    color_registered: bool | None = None
    y_up: bool = False
    notes: tuple[str, ...] = ()

    @classmethod
    def of_matrix(cls, K: Float64, depth_scale: float | None = None) -> "Intrinsics":
        """Make intrinsics from a pinhole matrix, at least (3, 3), in pixels, and a depth scale if given."""
        fx, fy, cx, cy = (float(K[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
        return cls(fx=fx, fy=fy, cx=cx, cy=cy, depth_scale=depth_scale)

    def overridden_by(self, settings: CameraSettings) -> "Intrinsics":
        """Return a copy in which the settings replace values of the recording.

        If the settings give all of fx, fy, cx and cy, the recording's image size is dropped, because it
        belongs to the replaced intrinsics.
        """
        given = settings.model_dump(exclude_none=True, include={field.name for field in fields(self)})
        own = replace(self, width=None, height=None) if given.keys() >= set(NEEDED) else self
        return replace(own, **given)

    def camera(
        self, size_px: tuple[int, int], path: Path, beside: Callable[[Path], str] | None = None
    ) -> Camera:
        """Return the camera after checking that the values are complete and fit the images.

        `size_px` is depth's width and height; `beside` gives a hint on files that may have missing values.

        Raises:
            RecordingError: a value is missing, a focal length is impossible, the principal point is outside
                the images, or the intrinsics are for another image size.
        """
        width, height = size_px
        missing = [name for name in NEEDED if getattr(self, name) is None]
        if missing:
            hint = beside(path) if beside else ""
            raise RecordingError(
                f"{path}: the recording does not say its intrinsics ({', '.join(missing)}): give them in "
                f"benchmark.yaml as `camera: {{fx: ..., fy: ..., cx: ..., cy: ...}}` (pixels){hint}",
                what="no-intrinsics",
            )
        declared = (self.width or width, self.height or height)
        if declared != size_px:
            raise IntrinsicsError(
                f"{path}: the intrinsics are for {declared[0]}x{declared[1]} images, but the depth images "
                f"are {width}x{height}: give those of the depth images under `camera:` in benchmark.yaml"
                f"{self._if_resized(declared, size_px)}"
            )
        fx, fy, cx, cy = (float(getattr(self, name)) for name in NEEDED)
        if not all(math.isfinite(v) for v in (fx, fy, cx, cy)) or fx <= 0 or fy <= 0:
            raise IntrinsicsError(f"{path}: the focal lengths {fx:g}, {fy:g} are not positive numbers")
        if not (min(fx, fy) >= LEAST_FOCAL_PX and max(fx, fy) <= MOST_FOCAL_PX):
            raise IntrinsicsError(
                f"{path}: the focal lengths {fx:g}, {fy:g} are no camera's; correct them (pixels), or give "
                "fx, fy, cx, cy under `camera:`"
            )
        if not (0 <= cx < width and 0 <= cy < height):
            raise IntrinsicsError(
                f"{path}: the principal point ({cx:g}, {cy:g}) lies outside the {width}x{height} depth "
                f"images: these intrinsics belong to another image size{self._if_larger(size_px)}"
            )
        return Camera(width, height, fx, fy, cx, cy)

    def _if_resized(self, declared: tuple[int, int], size_px: tuple[int, int]) -> str:
        """Return the end of an error message: the values scaled to the images; "" if the shapes differ."""
        across, down = (px / said for px, said in zip(size_px, declared, strict=True))
        if 0 in size_px or abs(across / down - 1) > SAME_SHAPE:  # a damaged image may state no height
            return ""
        return f"; if they differ in size only, scaled to these: {self.scaled_line(across)}"

    def _if_larger(self, size_px: tuple[int, int]) -> str:
        """Return the end of an error message: the values scaled from another likely size; "" if none is."""
        assert self.cx is not None and self.cy is not None
        ratio = ratio_by_centre(self.cx, self.cy, size_px)
        if ratio is None:
            return ""
        width, height = (px / ratio for px in size_px)
        return f", as of {width:.0f}x{height:.0f}; if so, scaled to these: {self.scaled_line(ratio)}"

    def scaled_line(self, ratio: float) -> str:
        """Return the pinhole values for images `ratio` times as large, as a line for benchmark.yaml.

        Pixel centres are integers, and the edges of both images coincide. All four values must be known.
        """
        fx, fy, cx, cy = (float(getattr(self, name)) for name in NEEDED)
        scaled = (fx * ratio, fy * ratio, (cx + 0.5) * ratio - 0.5, (cy + 0.5) * ratio - 0.5)
        values = ", ".join(f"{name}: {value:.7g}" for name, value in zip(NEEDED, scaled, strict=True))
        return f"`camera: {{{values}}}`"


def ratio_by_centre(cx: float, cy: float, size_px: tuple[int, int]) -> float | None:
    """Return the ratio of images' sides to those that a principal point (pixels) is the centre of.

    If the longer side of the latter is nearly that of a common sensor, the ratio is exact.

    Args:
        cx: column of the principal point, pixels.
        cy: row of the principal point, pixels.
        size_px: width and height of the images.

    Returns:
        The ratio; None if the point may be of these images, or if both axes give different ratios.
    """
    if min(cx, cy) <= -0.5:
        return None
    width, height = size_px
    across, down = width / (2 * cx + 1), height / (2 * cy + 1)
    off = [abs(cx / width - 0.5), abs(cy / height - 0.5)]
    clearly = max(off) > OFF_CENTRE
    apart = SAME_RATIO if clearly else SAME_SLIGHTLY
    if abs(across / down - 1) >= apart or not (clearly or min(off) > SLIGHTLY_OFF):
        return None
    ratio = min((max(size_px) / side for side in COMMON_SIDES_PX), key=lambda each: abs(each / across - 1))
    if abs(ratio / across - 1) < NEARLY:
        return ratio
    return across if clearly else None


def gives_intrinsics(settings: CameraSettings) -> bool:
    """Whether the settings give a whole pinhole camera."""
    return all(getattr(settings, key) is not None for key in NEEDED)


def said_warnings(path: Path, recorded: Intrinsics, settings: CameraSettings) -> list[str]:
    """Return the recording's warnings on intrinsics, and one if the settings state another depth scale."""
    return [*recorded.notes, *scale_warnings(path, recorded.depth_scale, settings)]


def scale_warnings(path: Path, said_scale: float | None, settings: CameraSettings) -> list[str]:
    """Return a warning if the settings and the recording state different depth scales, else []."""
    given = settings.depth_scale
    if said_scale is None or given is None or math.isclose(said_scale, given, rel_tol=1e-6):
        return []
    return [
        f"{path}: says that 1 m is {said_scale:g} units of depth, but `depth_scale: {given:g}` in "
        "benchmark.yaml is taken; remove it there if that is not meant"
    ]


def read_intrinsics_json(path: Path) -> Intrinsics:
    """Read camera.json, intrinsics.json, Open3D's camera_intrinsic.json or NICE-SLAM's cam_params.json.

    Keys: width, height, fx, fy, cx, cy (or w, h, ppx, ppy), color_registered, and a unit (`scale_of_keys`).
    Instead of fx, fy, cx and cy there may be a matrix under `intrinsic_matrix`, `cam_K`, `camera_matrix`, `K`
    or `k`: three rows, nine numbers, or an object with either as `data`. The zeros show whether nine numbers
    are column-major (as in Open3D) or row-major. NICE-SLAM's keys are under `camera`; its unit is `scale`.

    Raises:
        RecordingError: not JSON, a value of the wrong type or out of range, no pinhole matrix, or values that
            contradict each other.
    """
    raw = read_json_object(path, HELD)
    inside = raw.get("camera") if path.name == NICE_SLAM else None
    if isinstance(inside, dict):
        raw = {"depth_scale" if key == "scale" else key: value for key, value in inside.items()}
    return intrinsics_of_keys(raw, path)


def intrinsics_of_keys(raw: Mapping[str, object], path: Path) -> Intrinsics:
    """Make intrinsics from the keys of a JSON object, as `read_intrinsics_json` does.

    Raises:
        RecordingError: a value of the wrong type or out of range, no pinhole matrix, or values that
            contradict each other.
    """
    names = {SAME_AS.get(key, key): key for key, value in raw.items() if value is not None}
    known = {key: raw[name] for key, name in names.items()}
    keys = [key for key in (*NEEDED, "depth_scale", "depth_factor", "width", "height") if key in known]
    values: dict[str, Any] = {key: number_of(known[key], f"{path}: '{names[key]}'") for key in keys}
    values |= {key: int(values[key]) for key in ("width", "height") if key in values}
    for stated in ("depth_scale", "depth_factor"):
        if values.pop(stated, 1.0) <= 0:
            raise IntrinsicsError(f"{path}: '{stated}' must be above 0 (native units per metre)")
    if "color_registered" in known:
        if not isinstance(known["color_registered"], bool):
            raise RecordingError(f"{path}: 'color_registered' must be true or false")
        values["color_registered"] = known["color_registered"]
    values["depth_scale"], values["notes"] = scale_of_keys(known, path, of_bop="cam_K" in known)
    # Other programs store something else under "k".
    key = next((key for key in MATRIX_KEYS if key in known and (key != "k" or _is_matrix(known[key]))), None)
    if key is not None:
        matrix = pinhole(_open3d_matrix(known[key], path, key), path)
        for name in NEEDED:
            if not math.isclose(values.get(name, getattr(matrix, name)), getattr(matrix, name), rel_tol=1e-3):
                raise IntrinsicsError(
                    f"{path}: '{name}' is {values[name]:g} and that of '{key}' {getattr(matrix, name):g}: "
                    "correct one of them, or give fx, fy, cx, cy under `camera:`"
                )
        return replace(matrix, **values)
    return Intrinsics(**values)


def read_color_calibration(path: Path) -> ColorCalibration | None:
    """Read the calibration of colour relative to depth from camera.json: `color_camera`, `T_color_depth`.

    `color_camera` has width, height, fx, fy, cx, cy and optionally `distortion` (Brown's coefficients);
    `T_color_depth` has four rows, metres, depth camera to colour camera.

    Returns:
        The calibration; None if the file does not contain both.

    Raises:
        RecordingError: a value is invalid.
    """
    raw = read_json_object(path, HELD)
    if raw.get("color_camera") is None or raw.get("T_color_depth") is None:
        return None
    where = f"{path}: 'color_camera'"
    color_camera = raw["color_camera"]
    if not isinstance(color_camera, dict):
        raise RecordingError(f"{where} must hold an object with {HELD}")
    values: dict[str, Any] = {
        key: number_of(color_camera.get(key), f"{where}: '{key}'") for key in ("width", "height", *NEEDED)
    }
    size_px = (int(values["width"]), int(values["height"]))
    camera = Intrinsics(**{key: values[key] for key in NEEDED}).camera(size_px, path)
    distortion = color_camera.get("distortion") or []
    if not isinstance(distortion, list) or len(distortion) not in (0, 4, 5, 8):
        raise RecordingError(f"{where}: 'distortion' must hold 4, 5 or 8 numbers (Brown's model)")
    matrix = json_numbers(raw["T_color_depth"])
    T = rigid_or_none(matrix) if matrix.shape == (4, 4) else None
    if T is None:
        raise RecordingError(f"{path}: 'T_color_depth' must be four rows of a rigid transform")
    return ColorCalibration(camera, tuple(number_of(d, f"{where}: 'distortion'") for d in distortion), T)


def read_intrinsics_matrix(path: Path) -> Intrinsics:
    """Read a text file with a row-major pinhole matrix (3x3, 3x4 or 4x4), or with fx, fy, cx, cy.

    Raises:
        RecordingError: another number of values, or no pinhole matrix.
    """
    numbers = read_numbers(path)
    if len(numbers) == len(NEEDED):
        return of_four_numbers(numbers, path)
    matrix = of_matrix_numbers(numbers, path)
    if matrix is None:
        raise IntrinsicsError(
            f"{path}: holds {len(numbers)} numbers, not the 3x3 of a pinhole matrix (nor 3x4, 4x4, or fx fy "
            "cx cy)"
        )
    return matrix


def of_matrix_numbers(numbers: Sequence[float], path: Path) -> Intrinsics | None:
    """Make intrinsics from the numbers of a pinhole matrix, row by row; None if they are not 9, 12 or 16."""
    shape = MATRIX_SHAPES.get(len(numbers))
    return None if shape is None else pinhole(np.array(numbers).reshape(shape)[:3, :3], path)


def of_four_numbers(numbers: Sequence[float], path: Path) -> Intrinsics:
    """Make intrinsics from [fx, fy, cx, cy]; or, with a warning, from [fx, cx, fy, cy], as in OpenLORIS.

    The second order is recognised if the first and third numbers are nearly equal, and the second differs.
    Read in the usual order, such numbers would mean pixels that are not square, and a cx as large as fx.
    """
    first, second, third, fourth = numbers
    near, far = SAME_FOCAL * abs(first), NOT_SQUARE * abs(first)
    if not (abs(third - first) <= near and abs(second - first) > far):
        return Intrinsics(fx=first, fy=second, cx=third, cy=fourth)
    read = f"fx {first:g}, cx {second:g}, fy {third:g}, cy {fourth:g}"
    note = f"{path}: its four numbers are read as {read}; if not so, give them under `camera:`"
    return Intrinsics(fx=first, fy=third, cx=second, cy=fourth, notes=(note,))


def check_focal_lengths(intrinsics: Intrinsics, size_px: tuple[int, int], file: Path) -> None:
    """Refuse an implausible field of view: wider than 136 or narrower than 6 degrees (our own bounds).

    Raises:
        RecordingError: the field of view is too wide or too narrow.
    """
    for focal, side in ((intrinsics.fx, size_px[0]), (intrinsics.fy, size_px[1])):
        if focal is None or focal <= 0 or LEAST_FOCAL * side <= focal <= MOST_FOCAL * side:
            continue
        view_deg = math.degrees(2 * math.atan(side / (2 * focal)))
        raise IntrinsicsError(
            f"{file}: a focal length of {focal:g} pixels gives {size_px[0]}x{size_px[1]} images a field of "
            f"view of {view_deg:.0f} degrees: it is of another camera or unit; correct it, or give fx, fy, "
            "cx, cy under `camera:`"
        )


def rig_calibration(
    color: Intrinsics, color_px: tuple[int, int], color_to_rig: Float64, depth_to_rig: Float64, path: Path
) -> ColorCalibration | None:
    """Calibrate colour relative to depth, from the poses that ScanNet gives for both cameras in their rig.

    The poses `color_to_rig` and `depth_to_rig` are (4, 4), metres. Return None if one of them is not rigid,
    if there is no colour (its size is 0), or if colour's intrinsics do not fit the size of its images.
    """
    T_rig_color, T_rig_depth = rigid_or_none(color_to_rig), rigid_or_none(depth_to_rig)
    if T_rig_color is None or T_rig_depth is None or not all(color_px):
        return None
    try:
        camera = color.camera(color_px, path)
    except RecordingError:
        return None
    return ColorCalibration(camera, (), np.linalg.inv(T_rig_color) @ T_rig_depth)


def _open3d_matrix(value: object, path: Path, key: str) -> Float64:
    """Read a JSON matrix (3, 3): three rows, or nine numbers, column-major (row-major if 7th, 8th are 0)."""
    numbers = json_numbers(value.get("data") if isinstance(value, dict) else value)
    if numbers.shape == (3, 3):
        return numbers
    if numbers.shape != (9,):
        raise IntrinsicsError(f"{path}: '{key}' must hold nine numbers")
    by_row = not numbers[6:8].any()
    return numbers.reshape(3, 3) if by_row else numbers.reshape(3, 3).T


def _is_matrix(value: object) -> bool:
    return json_numbers(value).shape in ((9,), (3, 3))


def pinhole(K: Float64, path: Path) -> Intrinsics:
    """Make intrinsics from a pinhole matrix (3, 3), pixels.

    Raises:
        RecordingError: the matrix is no pinhole matrix.
    """
    if not np.isfinite(K).all() or K[0, 1] or K[1, 0] or K[2].tolist() != [0, 0, 1]:
        raise IntrinsicsError(
            f"{path}: {K.tolist()} is not a pinhole matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
        )
    return Intrinsics.of_matrix(K)
