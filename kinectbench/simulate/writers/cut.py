"""A recording that ends as a crash leaves it."""

import os
from pathlib import Path

from kinectbench.errors import RecordingError


def cut(path: Path, share: float) -> None:
    """Take the end off a finished recording.

    A bag loses its last bytes, and with them its index. In a folder the depth image whose name comes last
    loses them; every other file stays, lists that name it too (own rule).

    Args:
        path: the recording.
        share: of the bytes that go, 0 to below 1.

    Raises:
        RecordingError: a folder without depth images.
    """
    assert 0 <= share < 1
    file = path if path.is_file() else _last_depth_image(path)
    os.truncate(file, round(file.stat().st_size * (1 - share)))


def _last_depth_image(folder: Path) -> Path:
    images = sorted([*folder.glob("depth/*.png"), *folder.glob("frame-*.depth.png")])
    if not images:
        raise RecordingError(f"{folder}: has no depth image to cut off; record more frames, or cut nothing")
    return images[-1]
