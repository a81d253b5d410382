"""A recording that ends as a crash leaves it."""

import os
from pathlib import Path

from kinectbench.errors import RecordingError

DEPTH_IMAGES = ("depth/*.png", "frame-*.depth.png", "depth_*.png")


def cut(path: Path, share: float) -> None:
    """Take the end off a finished recording.

    A file loses its last bytes, a bag its index with them. In a folder the bag, or else the depth image whose
    name comes last, loses them; every other file stays, lists that name it too (own rule).

    Args:
        path: the recording.
        share: of the bytes that go, 0 to below 1.

    Raises:
        RecordingError: a folder without depth images.
    """
    assert 0 <= share < 1
    file = path if path.is_file() else _last_file(path)
    os.truncate(file, round(file.stat().st_size * (1 - share)))


def _last_file(folder: Path) -> Path:
    bags = sorted([*folder.glob("*.db3"), *folder.glob("*.mcap")])
    if bags:
        return bags[-1]
    images = sorted(image for pattern in DEPTH_IMAGES for image in folder.glob(pattern))
    if not images:
        raise RecordingError(f"{folder}: has no depth image to cut off; record more frames, or cut nothing")
    return images[-1]
