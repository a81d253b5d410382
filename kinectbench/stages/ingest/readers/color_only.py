"""Messages on unsupported paths: colour without depth, or depth of an unsupported layout or kind."""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from kinectbench.core.untrusted import listed_paths, printable
from kinectbench.stages.ingest.readers.folder_images import DEPTH_WORD, is_16_bit

VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".avi", ".m4v", ".webm"})
IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg"})
# Enough images to be a recording, or a folder of depth, and not a stray picture.
LEAST_IMAGES = 5
LOOKED_AT = 20_000
KINDS = "16-bit PNG, .npy, .npz, TIFF"
RAW = "export the raw 16-bit depth (of rs-convert: option -r), or copy the .bag itself"
RECORD = "record with a camera that measures depth, such as a Kinect, a RealSense, or a phone with LiDAR"


def without_depth(path: Path) -> str | None:
    """Why no depth can be read from a video or a folder of images, as an error message; None for other paths.

    The images may be colour only, or depth in a layout or format that is not read: 16-bit PNG in unknown
    folders, 8-bit pictures, EXR. A folder with fewer than five images and no such depth gives None.

    Raises:
        OSError: a file cannot be read.
    """
    if path.is_file():
        video = path.suffix.lower() in VIDEO_SUFFIXES
        return f"{path}: is a video, which holds colour only: {RECORD}" if video else None
    unread = _unread_kind(path)
    if unread is not None:
        return unread
    images, folders = 0, []
    for folder, files in _image_folders(path):
        images += len(files)
        folders.append((folder, files))
    deep = next((folder for folder, files in folders if is_16_bit(files[0])), None)
    if deep is not None:
        return (
            f"{path}: {deep.name}/ holds 16-bit PNG images that look like depth, but in no layout that is "
            "known: name their folder depth/ and that of colour color/, and put intrinsics.json beside them"
        )
    pictures = [file for _, files in folders for file in files if DEPTH_WORD.fullmatch(file.stem)]
    if len(pictures) >= LEAST_IMAGES:
        return (
            f"{path}: its {len(pictures)} images named depth, such as {printable(pictures[0].name)}, are "
            f"pictures in 8 bits (false colours?): {RAW}"
        )
    if images < LEAST_IMAGES:
        return None
    return f"{path}: holds {images} colour images, but no depth that is read ({KINDS}): {RECORD}"


def _unread_kind(path: Path) -> str | None:
    """An error message on EXR depth images, which are not supported; None without such images."""
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
