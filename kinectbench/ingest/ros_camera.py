"""Intrinsics, lens distortion and place of ROS cameras, from CameraInfo."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinectbench.errors import RecordingError
from kinectbench.geometry import Camera
from kinectbench.ingest.intrinsics import Intrinsics
from kinectbench.ingest.ros_topics import ImageTopic
from kinectbench.ingest.undistortion import Undistortion

# realsense's names of Brown's model, and of none, stand beside those of ROS.
BROWN_MODELS = frozenset({"plumb_bob", "rational_polynomial", "Brown Conrady", "brown_conrady"})
NO_MODELS = frozenset({"", "None", "none"})
BROWN_LENGTHS = frozenset({4, 5, 8})


@dataclass(frozen=True)
class CameraInfo:
    """What a CameraInfo message says; the fields of sensor_msgs/CameraInfo under ROS 1's names."""

    width: int
    height: int
    distortion_model: str
    D: tuple[float, ...]
    K: tuple[float, ...]
    P: tuple[float, ...]
    frame_id: str


def camera_info(message: Any) -> CameraInfo:
    """The values of a message of ROS 1 (K, D, P) or ROS 2 (k, d, p)."""

    def numbers(name: str) -> tuple[float, ...]:
        values = getattr(message, name, None)
        return tuple(float(v) for v in (getattr(message, name.lower()) if values is None else values))

    return CameraInfo(
        width=int(message.width),
        height=int(message.height),
        distortion_model=message.distortion_model,
        D=numbers("D"),
        K=numbers("K"),
        P=numbers("P"),
        frame_id=message.header.frame_id,
    )


def choose_camera_info(
    image: ImageTopic, kind: Sequence[str], size_px: tuple[int, int], infos: Sequence[tuple[str, CameraInfo]]
) -> CameraInfo | None:
    """The CameraInfo of images: of their frame, or of a folder that is named for their kind.

    Of several, one of their size comes first, then one of their frame, then the nearest by name.

    Args:
        image: the topic of the images.
        kind: words that such a folder's name holds, such as "depth".
        size_px: width and height of the images.
        infos: every CameraInfo of the bag with its topic's name.
    """
    ranked = []
    for name, info in infos:
        if not info.K[0] > 0:  # 0: the driver has no calibration
            continue
        shared = _shared_folders(name, image.name)
        same_frame = bool(image.frame_id) and info.frame_id == image.frame_id
        if same_frame or any(word in folder.lower() for folder in shared for word in kind):
            rank = ((info.width, info.height) == size_px, same_frame, len(shared))
            ranked.append((*rank, info))
    return max(ranked, key=lambda entry: entry[:3])[3] if ranked else None


def intrinsics_of(info: CameraInfo | None, image: ImageTopic) -> Intrinsics:
    """K of the images; of rectified images the left 3x3 of P, as sensor_msgs/CameraInfo defines them."""
    if info is None:
        return Intrinsics()
    k = info.K
    if _is_rectified(image) and info.P[0] > 0:
        k = (*info.P[0:3], *info.P[4:7], *info.P[8:11])
    return Intrinsics(width=info.width, height=info.height, fx=k[0], fy=k[4], cx=k[2], cy=k[5])


def distortion_of(path: Path, info: CameraInfo | None, image: ImageTopic) -> tuple[float, ...]:
    """Brown's coefficients of images, as OpenCV orders them; empty if they have no distortion.

    Raises:
        RecordingError: they are distorted by a model that is not Brown's.
    """
    if info is None or _is_rectified(image) or not any(info.D) or info.distortion_model in NO_MODELS:
        return ()
    if info.distortion_model not in BROWN_MODELS or len(info.D) not in BROWN_LENGTHS:
        raise RecordingError(
            f"{path}: {image.name} has the distortion model '{info.distortion_model}' with {len(info.D)} "
            "values; only plumb_bob and rational_polynomial can be removed: record rectified images"
        )
    return info.D


def undistortion_of(camera: Camera, distortion: tuple[float, ...]) -> Undistortion | None:
    """How distorted images become pinhole images; None if they are."""
    return Undistortion(camera, distortion) if distortion else None


def _is_rectified(image: ImageTopic) -> bool:
    """Whether a topic's name says that its images are free of distortion, as image_proc names them."""
    return any("rect" in re.split(r"[_/]", part) for part in image.name.lower().split("/"))


def _shared_folders(first: str, second: str) -> list[str]:
    shared = []
    for a, b in zip(first.split("/")[:-1], second.split("/"), strict=False):
        if a != b:
            break
        shared.append(a)
    return shared
