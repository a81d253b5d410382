"""Messages on unsupported paths: colour without depth, or depth of an unsupported layout or kind."""

import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from kinectbench.core import listed_paths, printable, read_head
from kinectbench.core.encoded_images import PNG_MAGIC
from kinectbench.stages.ingest.depth_files import ARRAYS
from kinectbench.stages.ingest.readers.folder_images import COLOR_WORD, DEPTH_WORD, HEAD_BYTES, is_16_bit

VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".avi", ".m4v", ".webm"})
IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg"})
# Enough images to be a recording, or a folder of depth, and not a stray picture.
LEAST_IMAGES = 5
LOOKED_AT = 20_000
KINDS = "16-bit PNG, .npy, .npz, TIFF"
RAW = "export the raw 16-bit depth (of rs-convert: option -r), or copy the .bag itself"
# Files of depth of a kind that is read in a folder depth/, that is not read, and that holds nothing else.
READ, CONVERTED = ARRAYS | {".tif", ".tiff"}, frozenset({".pgm", ".pfm", ".dpt", ".raw", ".bin", ".mat"})
ONLY_DEPTH = frozenset({".pfm", ".dpt"})
LIKE_DEPTH = re.compile(r"depth|distance|disparity", re.IGNORECASE)
# One file is read of all names that differ only in numbers, for at most this many kinds (chosen by hand).
NUMBER, MOST_KINDS = re.compile(r"\d+"), 50
# Types of colour in the head of a PNG with more than one channel: colour, and colour with alpha.
SEVERAL_CHANNELS = (2, 6)
MOVE = (
    "put depth alone into a folder depth/ and colour into color/, with the same number in the names of one "
    "frame, and intrinsics.json beside them"
)
AS_READ = "as 16-bit PNG in mm, or as .npy in metres"
CONVERT = f"write it {AS_READ}"
PACKED = (
    "or, if its channels are bytes of depth, as those of RLBench and TartanAir, join them by the data set's "
    f"own tool, and {CONVERT}"
)
RECORD = "record with a camera that measures depth, such as a Kinect, a RealSense, or a phone with LiDAR"


def without_depth(path: Path) -> str | None:
    """Return an error message that states why no depth can be read from a video or a folder of images.

    The images may be colour only, or depth in a layout or format that is not read: 16-bit PNG in unknown
    folders, 8-bit pictures, EXR. The result is None for another file, and for a folder with fewer than five
    images and no such depth.

    Raises:
        OSError: a file cannot be read.
    """
    if path.is_file():
        video = path.suffix.lower() in VIDEO_SUFFIXES
        return f"{path}: is a video, which holds colour only: {RECORD}" if video else None
    unread = _unread_kind(path)
    if unread is not None:
        return unread
    images, samples, pictures = 0, list[Path](), list[Path]()
    for folder, files in _image_folders(path):
        images += len(files)
        samples += _one_of_each_kind(files)
        of_depth = _is_named_depth(folder.name) and folder != path
        pictures += [file for file in files if of_depth or DEPTH_WORD.fullmatch(file.stem)]
    deep = next((file for file in samples if is_16_bit(file)), None)
    if deep is not None:
        where = f"{deep.parent.name}/ holds 16-bit PNG images that look like depth ({printable(deep.name)})"
        return f"{path}: {where}, but in no layout that is known: {MOVE}"
    return (
        _other_files(path)
        or (_of_pictures(path, pictures) if len(pictures) >= LEAST_IMAGES else None)
        or (
            f"{path}: holds {images} colour images, but no depth that is read ({KINDS}): {RECORD}"
            if images >= LEAST_IMAGES
            else None
        )
    )


def _one_of_each_kind(files: list[Path]) -> list[Path]:
    """Return one file for each pattern of names that differ in numbers only; at most `MOST_KINDS` files."""
    by_kind = {NUMBER.sub("#", file.name): file for file in reversed(files)}
    return sorted(by_kind.values())[:MOST_KINDS]


def _is_named_depth(name: str) -> bool:
    return bool(LIKE_DEPTH.search(name)) and not COLOR_WORD.fullmatch(name)


def _of_pictures(path: Path, pictures: list[Path]) -> str:
    """Return an error message on images that are named depth, and have 8 bits per channel."""
    first = pictures[0]
    line = (
        f"{path}: its {len(pictures)} images named depth, such as {printable(str(first.relative_to(path)))}, "
        f"are pictures in 8 bits (false colours?): {RAW}"
    )
    head = read_head(first, HEAD_BYTES)
    packed = len(head) == HEAD_BYTES and head.startswith(PNG_MAGIC) and head[-1] in SEVERAL_CHANNELS
    return f"{line}; {PACKED}" if packed else line


def _other_files(path: Path) -> str | None:
    """Return an error message on files that look like depth in no known layout or kind; None if none do."""
    if not path.is_dir():
        return None
    children = sorted(child for child in islice(listed_paths(path), LOOKED_AT) if child.is_dir())
    for folder in [path, *children]:
        by_kind = dict[str, list[Path]]()
        for file in islice(listed_paths(folder), LOOKED_AT):
            kind = file.suffix.lower()
            named = _is_named_depth(file.stem) or (folder != path and _is_named_depth(folder.name))
            if kind in ONLY_DEPTH or (named and kind in (*READ, *CONVERTED)):
                by_kind.setdefault(kind, []).append(file)
        for kind, files in by_kind.items():
            if len(files) >= LEAST_IMAGES:
                name = printable(str(min(files).relative_to(path)))
                looks = f"{len(files)} {kind} files, such as {name}, look like depth"
                if kind in READ:
                    return f"{path}: {looks}, but in no layout that is known: {MOVE}"
                return f"{path}: {looks}, but {kind} is not read: {CONVERT}; then {MOVE}"
    return None


def _unread_kind(path: Path) -> str | None:
    """Return an error message on EXR depth images, which are not supported; None if there are none."""
    if not path.is_dir():
        return None
    children = [child for child in islice(listed_paths(path), LOOKED_AT) if child.is_dir()]
    below = [each for child in children for each in islice(listed_paths(child), LOOKED_AT) if each.is_dir()]
    for folder in (path, *children, *below):
        exr = next(listed_paths(folder, wanted=lambda name: name.lower().endswith(".exr")), None)
        if exr is not None:
            return (
                f"{path}: {printable(str(exr.relative_to(path)))}: EXR images are not read; of Record3D "
                "export the .r3d file, else write depth into depth/ as 16-bit PNG in mm, or as .npy in metres"
            )
    return None


def _image_folders(path: Path) -> Iterator[tuple[Path, list[Path]]]:
    """Yield (folder, its images) for the folder and its subfolders; folders without images are skipped."""
    children = sorted(child for child in islice(listed_paths(path), LOOKED_AT) if child.is_dir())
    for folder in [path, *children]:
        files = (file for file in islice(listed_paths(folder), LOOKED_AT) if file.is_file())
        images = sorted(file for file in files if file.suffix.lower() in IMAGE_SUFFIXES)
        if images:
            yield folder, images
