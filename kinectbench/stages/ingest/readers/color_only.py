"""What is said of a path that no reader knows: colour without depth, or depth under another name."""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from kinectbench.core.untrusted import listed, read_head
from kinectbench.stages.ingest.images import is_depth_png

VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".avi", ".m4v", ".webm"})
IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg"})
# Enough to tell a recording from a stray picture, and to find a folder of depth (own choices).
LEAST_IMAGES = 5
LOOKED_AT = 20_000
# The head of a PNG, which tells its bits.
HEAD_BYTES = 26
RECORD = "record with a camera that measures depth, such as a Kinect, a RealSense, or a phone with LiDAR"


def without_depth(path: Path) -> str | None:
    """What is missing in a video, or in a folder of images that no reader knows; None if it is neither.

    Raises:
        OSError: a file in it cannot be read.
    """
    if path.is_file():
        video = path.suffix.lower() in VIDEO_SUFFIXES
        return f"{path}: is a video, which holds colour only: {RECORD}" if video else None
    images, folders = 0, []
    for folder, files in _image_folders(path):
        images += len(files)
        folders.append((folder, files[0]))
    deep = next((folder for folder, file in folders if _is_depth(file)), None)
    if deep is not None:
        return (
            f"{path}: {deep.name}/ holds 16-bit PNG images that look like depth, but in no layout that is "
            "known: name their folder depth/ and that of colour color/, and put intrinsics.json beside them"
        )
    if images < LEAST_IMAGES:
        return None
    return f"{path}: holds {images} colour images, but no depth that is read (16-bit PNG): {RECORD}"


def _image_folders(path: Path) -> Iterator[tuple[Path, list[Path]]]:
    """The folder itself and those in it, with their images; those without any are left out."""
    children = sorted(child for child in islice(listed(path), LOOKED_AT) if child.is_dir())
    for folder in [path, *children]:
        files = (file for file in islice(listed(folder), LOOKED_AT) if file.is_file())
        images = sorted(file for file in files if file.suffix.lower() in IMAGE_SUFFIXES)
        if images:
            yield folder, images


def _is_depth(file: Path) -> bool:
    return is_depth_png(read_head(file, HEAD_BYTES))
