"""Messages on unsupported paths: colour without depth, or depth of an unsupported layout or kind."""

import re
from pathlib import Path

from kinectbench.core import listed as names_of
from kinectbench.core import printable, read_head
from kinectbench.core.encoded_images import PNG_MAGIC
from kinectbench.stages.ingest.color_pictures import is_in_color
from kinectbench.stages.ingest.depth_files import SUFFIXES
from kinectbench.stages.ingest.readers.folder_images import (
    DEPTH_WORD,
    HEAD_BYTES,
    LEAST_IMAGES,
    VIDEO_SUFFIXES,
    is_16_bit,
    is_named_depth,
)
from kinectbench.stages.ingest.readers.foreign_depth import (
    AS_READ,
    CONVERT,
    MOVE,
    PICTURES,
    Listed,
    conversion,
    if_depth,
    stacked,
    unread_files,
)

# Names of disparity images and their folders, as Middlebury's disp0.pfm and KITTI's disp_occ_0/.
DISPARITY = re.compile(r"(?:.*[-_. ])?disp(?:arity|arities|s)?(?:[-_. \d].*)?", re.IGNORECASE | re.DOTALL)
KINDS = "16-bit PNG, .npy, .npz, TIFF"
RAW = "export the raw 16-bit depth (of rs-convert: option -r), or copy the .bag itself"
# One file is read of all names that differ only in numbers, for at most this many kinds (chosen by hand).
NUMBER, MOST_KINDS = re.compile(r"\d+"), 50
# So many images that are named depth are no stray pictures (chosen by hand).
LEAST_PICTURES = 3
PACKED = (
    "or, if its channels are bytes of depth, as those of RLBench and TartanAir, join them by the data set's "
    f"own tool, and {CONVERT}"
)
RECORD = "record with a camera that measures depth, such as a Kinect, a RealSense, or a phone with LiDAR"


def without_depth(path: Path, readable: tuple[str, ...]) -> str | None:
    """Return an error message that states why no depth can be read from a video or a folder of images.

    The images may be colour only, or depth in a layout or format that is not read: 16-bit PNG in unknown
    folders, 8-bit pictures, EXR. The result is None for another file, and for a folder with fewer than five
    images and no such depth.

    Args:
        path: the file or folder.
        readable: suffixes, with their dots, of recordings that are read: such files are damaged, and not of
            an unread kind.

    Raises:
        OSError: a file cannot be read.
    """
    if path.is_file():
        video = path.suffix.lower() in VIDEO_SUFFIXES
        return f"{path}: is a video, which holds colour only: {RECORD}" if video else None
    if not path.is_dir():
        return None
    listed = Listed.of(path, readable)
    if (unread := _unread_kind(listed)) is not None:
        return unread
    images, samples, pictures = 0, list[Path](), list[Path]()
    for folder, inside in listed.files.items():
        files = [file for file in inside if file.suffix.lower() in PICTURES]
        images += len(files)
        samples += _one_of_each_kind(files)
        of_depth = is_named_depth(folder.name) and folder != path
        pictures += [file for file in files if of_depth or DEPTH_WORD.fullmatch(file.stem)]
    deep = {file.parent: file for file in reversed(samples) if is_16_bit(file)}
    if deep:
        folder, first = min(deep.items())
        place = folder.relative_to(path).as_posix() if folder != path else path.name
        where = f"{printable(place)}/ holds 16-bit PNG images that look like depth ({printable(first.name)})"
        others = names_of(printable(each.relative_to(path).as_posix()) for each in sorted(deep)[1:])
        apart = f" (also {others}). Give each camera its own folder, and there " if others else ": "
        return f"{path}: {where}, but in no layout that is known{apart}{MOVE}"
    return (
        unread_files(listed)
        or stacked(listed)
        or (_of_pictures(path, pictures) if len(pictures) >= LEAST_PICTURES else None)
        or (
            f"{path}: holds {images} colour images, but no depth that is read ({KINDS}): "
            f"{if_depth(listed)}{RECORD}"
            if images >= LEAST_IMAGES
            else None
        )
    )


def _one_of_each_kind(files: list[Path]) -> list[Path]:
    """Return one file for each pattern of names that differ in numbers only; at most `MOST_KINDS` files."""
    by_kind = {NUMBER.sub("#", file.name): file for file in reversed(files)}
    return sorted(by_kind.values())[:MOST_KINDS]


def _of_pictures(path: Path, pictures: list[Path]) -> str:
    """Return an error message on images that are named depth, and have 8 bits per channel."""
    first = pictures[0]
    line = (
        f"{path}: its {len(pictures)} images named depth, such as {printable(str(first.relative_to(path)))}, "
        f"are pictures in 8 bits (false colours?): {RAW}"
    )
    head = read_head(first, HEAD_BYTES)
    packed = head.startswith(PNG_MAGIC) and is_in_color(head)
    return f"{line}; {PACKED}" if packed else line


def _unread_kind(listed: Listed) -> str | None:
    """Return an error message on EXR images, or on disparity, by their names; None if there are none."""
    for folder, inside in listed.files.items():
        of_folder = folder != listed.path and DISPARITY.fullmatch(folder.name)
        for file in inside:
            kind, name = file.suffix.lower(), printable(file.relative_to(listed.path).as_posix())
            if kind == ".exr":
                what = f"{listed.path}: {name}: EXR images are not read; of Record3D export the .r3d file"
                return f"{what}, else {conversion(listed, file)}; then {MOVE}"
            named = kind in SUFFIXES and (of_folder or DISPARITY.fullmatch(file.stem))
            if named and (kind != ".png" or is_16_bit(file)):
                what = f"{listed.path}: {name} is disparity by its name, not depth"
                return f"{what}: write depth = fx * baseline / disparity, {AS_READ}; then {MOVE}"
    return None
