"""The intrinsics and lens distortion of a ROS depth topic, from its CameraInfo."""

import re
from pathlib import Path
from typing import Any

from kinectbench.errors import RecordingError
from kinectbench.geometry import Camera
from kinectbench.ingest.intrinsics import Intrinsics
from kinectbench.ingest.rosbag1_chunks import BagTopic
from kinectbench.ingest.rosbag1_topics import CAMERA_INFO, BagMessages, ImageTopic
from kinectbench.ingest.undistortion import Undistortion

BROWN_MODELS = frozenset({"plumb_bob", "rational_polynomial"})
BROWN_LENGTHS = frozenset({4, 5, 8})


def choose_camera_info(
    depth: ImageTopic, size_px: tuple[int, int], topics: tuple[BagTopic, ...], messages: BagMessages
) -> Any | None:
    """The CameraInfo of the depth images: of their frame, or of a folder that is named for depth.

    Of several, one of their size comes first, then one of their frame, then the nearest by name.
    """
    ranked = []
    for topic in topics:
        info = messages.first(topic) if topic.type == CAMERA_INFO else None
        if info is None or not info.K[0] > 0:  # 0: the driver has no calibration
            continue
        shared = _shared_folders(topic.name, depth.name)
        same_frame = bool(depth.frame_id) and info.header.frame_id == depth.frame_id
        if same_frame or any("depth" in folder.lower() for folder in shared):
            rank = ((info.width, info.height) == size_px, same_frame, len(shared))
            ranked.append((*rank, info))
    return max(ranked, key=lambda entry: entry[:3])[3] if ranked else None


def intrinsics_of(info: Any | None, depth: ImageTopic) -> Intrinsics:
    """K of the images; of rectified images the left 3x3 of P, as sensor_msgs/CameraInfo defines them."""
    if info is None:
        return Intrinsics()
    k = [float(value) for value in info.K]
    if _is_rectified(depth) and info.P[0] > 0:
        p = [float(value) for value in info.P]
        k = [*p[0:3], *p[4:7], *p[8:11]]
    return Intrinsics(width=int(info.width), height=int(info.height), fx=k[0], fy=k[4], cx=k[2], cy=k[5])


def undistortion_of(path: Path, info: Any | None, depth: ImageTopic, camera: Camera) -> Undistortion | None:
    """How distorted depth becomes pinhole depth; None if it needs nothing.

    Raises:
        RecordingError: it is distorted by a model that is not Brown's.
    """
    if info is None or _is_rectified(depth) or not any(info.D):
        return None
    if info.distortion_model not in BROWN_MODELS or len(info.D) not in BROWN_LENGTHS:
        raise RecordingError(
            f"{path}: {depth.name} has the distortion model '{info.distortion_model}' with {len(info.D)} "
            f"values; only {' and '.join(sorted(BROWN_MODELS))} can be removed: record rectified images"
        )
    return Undistortion(camera, [float(value) for value in info.D])


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
