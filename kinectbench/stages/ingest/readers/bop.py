"""One scene of a BOP data set: depth/, rgb/ or gray/, scene_camera.json, and masks of an object."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import IntrinsicsError, RecordingError, is_too_large, printable
from kinectbench.core.geometry import Camera, rigid
from kinectbench.core.trajectory.stamps import NS_PER_S
from kinectbench.core.trajectory.trajectory_file import trajectory_from_matrices
from kinectbench.core.types import MM_PER_M, Float64
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.images import decode_color_bgr, encode_png
from kinectbench.stages.ingest.intrinsics import MOST_FOCAL_PX, Intrinsics, scale_warnings
from kinectbench.stages.ingest.json_values import json_numbers, read_json_object
from kinectbench.stages.ingest.known_names import first_file
from kinectbench.stages.ingest.recording import (
    FileRecording,
    FrameFiles,
    Pixel,
    first_depth_size,
    without_color,
)

# Names by the BOP format: the image number in six digits.
DEPTH_FILE = "depth/{:06d}.png"
COLOR_FILES = ("rgb/{:06d}.png", "rgb/{:06d}.jpg", "gray/{:06d}.png", "gray/{:06d}.jpg")
# Matrices are of one camera if they differ by no more than the first; principal points of images that were
# cut from one camera's image differ by whole pixels, up to the second.
MATRIX_TOLERANCE, PARTS_PX = 1e-6, 0.05
# Largest number of groups of images in a message.
MOST_GROUPS = 4


@dataclass(frozen=True, kw_only=True)
class BopRecording(FileRecording):
    """A BOP scene; colour is registered to depth, as the format requires; image numbers count as seconds.

    If the images were cut out of larger images of one camera, as T-LESS' training images were, their
    principal points differ by whole pixels. Each image is then shifted on a larger canvas, so that all have
    the same principal point.

    Attributes:
        moved_px: for each image its shift (to the right, down), pixels; empty: no image is shifted.
    """

    format: ClassVar[str] = "bop"
    uses: ClassVar[frozenset[str]] = frozenset({"mask_object"})
    looks_for: ClassVar[str] = "a folder with scene_camera.json and depth/ (rgb/, mask_visib/, scene_gt.json)"

    moved_px: tuple[tuple[int, int], ...] = ()

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder has a scene_camera.json and depth/."""
        return (path / "scene_camera.json").is_file() and (path / "depth").is_dir()

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """Read the cameras, which must agree up to whole-pixel shifts, and choose the object's masks."""
        listed = _read_by_image(path / "scene_camera.json")
        if not listed or not all(isinstance(camera, dict) for camera in listed.values()):
            raise IntrinsicsError(f"{path / 'scene_camera.json'}: must hold an object for each image")
        # Data sets are also given out as single images of a scene, beside the whole scene's cameras.
        cameras = {n: camera for n, camera in listed.items() if (path / DEPTH_FILE.format(n)).is_file()}
        cameras = cameras or listed  # without any image, the first is reported as missing
        masks, warnings = _masks(path, settings.mask_object)
        files = tuple(
            FrameFiles(
                number * NS_PER_S,
                path / DEPTH_FILE.format(number),
                first_file(path / name.format(number) for name in COLOR_FILES),
                masks.get(number),
            )
            for number in sorted(cameras)
        )
        K, scale, moved_px = _shared(path, cameras)
        recorded = Intrinsics.of_matrix(K, MM_PER_M / scale)
        width, height = first_depth_size(files)
        right, down = (max(moved) for moved in zip(*moved_px, strict=True))
        size_px = (width + right, height + down)
        if is_too_large(*size_px):
            raise RecordingError(
                f"{path / 'scene_camera.json'}: principal points are {right}, {down} px apart",
                what="two-cameras",
            )
        absent = f"{path}: {len(listed) - len(cameras)} of its {len(listed)} images have no file in depth/"
        apart = f"its images have principal points up to {right}, {down} px apart: they are moved to one"
        moved = [f"{path}: {apart}"] if right or down else []
        moved += [absent] if len(listed) > len(cameras) else []
        intrinsics = recorded.overridden_by(settings)
        poses = [_pose(cameras[number]) for number in sorted(cameras)]
        stamps_ns = [file.stamp_ns for file in files]
        trajectory, lost = trajectory_from_matrices(stamps_ns, poses, str(path))
        return cls(
            path=path,
            places=files,
            moved_px=moved_px if right or down else (),
            camera=intrinsics.camera(size_px, path),
            depth_scale=intrinsics.depth_scale or MM_PER_M,
            color_registered=any(file.color for file in files),
            given_trajectory=trajectory,
            warnings=(
                *moved,
                *without_color(path, files),
                *warnings,
                *scale_warnings(path, recorded.depth_scale, settings),
                *lost,
            ),
        )

    def placed(self, image: NDArray[Pixel], index: int) -> NDArray[Pixel]:
        """Shift an image of a frame to the common principal point."""
        return _moved(image, self.moved_px[index], self.camera) if self.moved_px else image

    def color(self, index: int) -> tuple[str, bytes] | None:
        """Return the colour of a frame; if it is shifted, it is encoded again."""
        encoded = super().color(index)
        if encoded is None or not self.moved_px:
            return encoded
        bgr = decode_color_bgr(encoded[1], str(self.places[index].color))
        return ".png", encode_png(self.placed(bgr, index))


def _moved(image: NDArray[Pixel], by_px: tuple[int, int], camera: Camera) -> NDArray[Pixel]:
    """Shift an image (height, width, ...) by `by_px` (right, down), onto zeros of the camera's image size."""
    (right, down), (height, width) = by_px, image.shape[:2]
    if height + down > camera.height or width + right > camera.width:
        return image  # another size than the first image's: refused later
    larger = np.zeros((camera.height, camera.width, *image.shape[2:]), image.dtype)
    larger[down : down + height, right : right + width] = image
    return larger


def _read_by_image(file: Path) -> dict[int, Any]:
    """Read a JSON object whose keys are image numbers."""
    content = read_json_object(file, "image numbers")
    try:
        return {int(key): value for key, value in content.items() if 0 <= int(key) < 10**9}
    except ValueError as error:
        raise RecordingError(f"{file}: is not a JSON object of image numbers ({error})") from error


def _shared(
    path: Path, cameras: dict[int, dict[str, Any]]
) -> tuple[Float64, float, tuple[tuple[int, int], ...]]:
    """Return the matrix and depth scale (mm per unit) of all images, and the shift of each image, pixels."""
    file = path / "scene_camera.json"
    of_images = [_matrix_and_scale(file, number, camera) for number, camera in sorted(cameras.items())]
    K, scales = np.stack([matrix for matrix, _ in of_images]), np.array([scale for _, scale in of_images])
    groups = _groups(K, scales)
    if len(groups) > 1:
        numbers = np.array(sorted(cameras))
        first, other = (numbers[group[0]] for group in groups[:2])
        runs = ", ".join(_runs(numbers, group) for group in groups[:MOST_GROUPS])
        raise RecordingError(
            f"{file}: image {other} has another camera than image {first}: {printable(runs, 200)} have "
            "different cameras: give one group (of one focal length and depth scale, and of principal points "
            "that differ by whole pixels)",
            what="two-cameras",
        )
    shared = K[0].copy()
    shared[:2, 2] = K[:, :2, 2].max(axis=0)
    away_px = shared[:2, 2] - K[:, :2, 2]
    return shared, float(scales[0]), tuple((int(x), int(y)) for x, y in np.rint(away_px).tolist())


def _groups(K: Float64, scales: Float64) -> list[NDArray[np.intp]]:
    """Return the indices of images with one camera, a group for each; at most one more than are printed.

    Args:
        K: (n, 3, 3) pinhole matrices, pixels.
        scales: (n,) millimetres per unit of depth.
    """
    left, groups = np.arange(len(K)), list[NDArray[np.intp]]()
    while len(left) and len(groups) <= MOST_GROUPS:
        others = K[left] - K[left[0]]
        apart_px = others[:, :2, 2].copy()
        others[:, :2, 2] = 0
        cut = (np.abs(apart_px - np.rint(apart_px)) <= PARTS_PX).all(axis=1)
        same = cut & (np.abs(others) <= MATRIX_TOLERANCE).all(axis=(1, 2)) & (scales[left] == scales[left[0]])
        groups.append(left[same])
        left = left[~same]
    return groups


def _runs(numbers: NDArray[np.int64], group: NDArray[np.intp]) -> str:
    """Return a group of images as text, such as "0-29 and 40": runs in the list of image `numbers`."""
    runs = np.split(group, np.flatnonzero(np.diff(group) > 1) + 1)
    ends = [(numbers[run[0]], numbers[run[-1]]) for run in runs]
    return " and ".join(f"{first}" if first == last else f"{first}-{last}" for first, last in ends)


def _matrix_and_scale(file: Path, number: int, camera: dict[str, Any]) -> tuple[Float64, float]:
    """Read the matrix (3, 3) and depth scale (mm per unit) of image `number` from its entry `camera`."""
    try:
        K, scale = np.array(camera["cam_K"], np.float64).reshape(3, 3), float(camera["depth_scale"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise IntrinsicsError(f"{file}: image {number} needs cam_K (9 numbers) and depth_scale") from error
    usable = np.isfinite(K).all() and np.abs(K).max() < MOST_FOCAL_PX and np.isfinite(scale) and scale > 0
    if not usable:
        raise IntrinsicsError(f"{file}: cam_K or depth_scale of image {number} is not usable")
    return K, scale


def _pose(camera: dict[str, object]) -> Float64 | None:
    """Read camera to world (4, 4), metres, from `cam_R_w2c` and `cam_t_w2c` (mm); None if one is missing."""
    R, t_mm = json_numbers(camera.get("cam_R_w2c")), json_numbers(camera.get("cam_t_w2c"))
    if R.size != 9 or t_mm.size != 3:
        return None
    R_world_camera = R.reshape(3, 3).T
    return rigid(R_world_camera, -R_world_camera @ (t_mm.reshape(3) / MM_PER_M))


def _masks(path: Path, object_id: int | None) -> tuple[dict[int, Path], list[str]]:
    """Return {image number: file with the object's visible mask}, and warnings.

    Without `object_id`, the scene's only object is used; a scene of several gives no masks, but a warning. If
    the object occurs twice in an image, the first mask is used.
    """
    file = path / "scene_gt.json"
    if not file.is_file() or not (path / "mask_visib").is_dir():
        return {}, []
    rows = _read_by_image(file)
    try:
        ids = {number: [int(row["obj_id"]) for row in found] for number, found in rows.items()}
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise RecordingError(f"{file}: every row needs an obj_id") from error
    known = sorted({found for row in ids.values() for found in row})
    names = printable(", ".join(map(str, known)))
    if object_id is None and len(known) != 1:
        return {}, [f"{path}: has the objects {names}; no masks are read: name one as `mask_object`"]
    if object_id is not None and object_id not in known:
        raise RecordingError(
            f"{path}: `mask_object: {object_id}` is not in the scene; its objects are {names}",
            what="no-object",
        )
    chosen = known[0] if object_id is None else object_id
    masks = {
        number: path / "mask_visib" / f"{number:06d}_{row.index(chosen):06d}.png"
        for number, row in ids.items()
        if chosen in row
    }
    return {number: mask for number, mask in masks.items() if mask.is_file()}, []
