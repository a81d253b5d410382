"""Find the images of a plain folder: in depth/ and color/, or side by side with a word in their names."""

import re
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from kinectbench.core import listed_paths, printable, read_head
from kinectbench.stages.ingest.color_pictures import is_in_color
from kinectbench.stages.ingest.depth_files import SUFFIXES as DEPTH_SUFFIXES
from kinectbench.stages.ingest.depth_files import depth_size_px
from kinectbench.stages.ingest.image_names import counting_key
from kinectbench.stages.ingest.images import DamagedImageError, is_depth_png
from kinectbench.stages.ingest.known_names import REPLICA_FOLDER, in_any_case, in_order
from kinectbench.stages.ingest.recording import read_image_file

COLOR_FOLDERS = ("color", "rgb", "image", "JPEGImages", "images")
# Other names of folders that may contain colour.
LIKE_COLOR = re.compile(
    r"(?!\.|.*(?:depth|mask)).*(?:colou?r|rgb|image|img|photo|picture|jpe?g).*", re.IGNORECASE
)
# Enough images to be a recording, or a folder of depth, and not a stray picture (chosen here).
LEAST_IMAGES = 5
# Names of folders with depth on the pixels of colour, by OpenLORIS, librealsense and ROS.
OTHER_DEPTH = (
    "aligned_depth",
    "depth_aligned",
    "aligned_depth_to_color",
    "depth_registered",
    "depth_to_color",
)
JPEG_SUFFIXES = frozenset({".jpg", ".jpeg"})
COLOR_SUFFIXES = JPEG_SUFFIXES | {".png", ".bmp", ".ppm"}
VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".avi", ".m4v", ".webm"})
# YCB-Video has 000001-depth.png beside 000001-color.png; other data sets have the word first, or in between.
DEPTH_WORD = re.compile(r"(.*?)[-_. ]?depth(?![a-z])[-_. ]?(.*)", re.IGNORECASE | re.DOTALL)
COLOR_WORD = re.compile(r"(.*?)[-_. ]?(?:colou?r|rgb)(?![a-z])[-_. ]?(.*)", re.IGNORECASE | re.DOTALL)
LIKE_DEPTH = re.compile(r"depth|distance|disparity", re.IGNORECASE)
# Words before the number of colour without a word of its own: Replica has depth000000.png beside
# frame000000.jpg; the RGB-D Object Dataset names colour by its number.
FRAME_WORD = re.compile(r"(?:frame|image)?[-_. ]?(.+)", re.IGNORECASE | re.DOTALL)
# What librealsense's tools and DexYCB add to the name of an image that lies on the other camera's pixels.
TO_OTHER = re.compile(r"(?:aligned[-_. ])?(depth|colou?r)[-_. ]to[-_. ](?:depth|colou?r)", re.IGNORECASE)
# Arrays with a shorter side are no images of a room (our own bound); larger files are not opened for it.
LEAST_SIDE_PX, MOST_BYTES = 32, 4096
# Bytes of a PNG that contain its number of bits, and of a picture that usually contain its channels.
HEAD_BYTES, COLOR_HEAD_BYTES = 26, 4096


@dataclass(frozen=True)
class NamedImages:
    """The images of one stream, in numeric order.

    Attributes:
        files: paths of the images.
        stems: names of the frames: file names without suffix, and without the word for the stream.
    """

    files: tuple[Path, ...]
    stems: tuple[str, ...]


def is_named_depth(name: str) -> bool:
    """Whether the name of a file (without suffix) or folder says depth, and not colour."""
    return bool(LIKE_DEPTH.search(name)) and not COLOR_WORD.fullmatch(name)


def depth_images(path: Path) -> NamedImages:
    """Find the depth images in a recording's folder, of the most frequent type; empty if there are none."""
    every = _every_depth(path)
    kinds = [file.suffix.lower() for file in every.files]
    raw = [kind for kind in kinds if kind != ".png"]
    pngs = [file for file, kind in zip(every.files, kinds, strict=True) if kind == ".png"]
    # Pictures of depth may be beside the depth itself. The first, .png, is chosen of equally many.
    among = raw if raw and not any(map(is_16_bit, pngs)) else [".png"] * len(pngs) + raw
    chosen = next((kind for kind, _ in Counter(among).most_common(1)), "")
    kept = [at for at, kind in enumerate(kinds) if kind == chosen]
    return NamedImages(tuple(every.files[at] for at in kept), tuple(every.stems[at] for at in kept))


def _every_depth(path: Path) -> NamedImages:
    """List the depth images of all types; arrays that are too small are left out if there are others."""
    folder = in_any_case(path, "depth")
    if folder.is_dir():
        every = in_folder(folder, DEPTH_SUFFIXES)
    else:
        every = beside_each_other(folder_of_both(path) or path, DEPTH_WORD)
    large = [at for at, file in enumerate(every.files) if not _is_small_array(file)]
    if not large:
        return every
    return NamedImages(tuple(every.files[at] for at in large), tuple(every.stems[at] for at in large))


def _is_small_array(file: Path) -> bool:
    """Whether an intact array is too small for an image, such as a matrix of a calibration."""
    if file.suffix.lower() != ".npy" or not file.is_file() or file.stat().st_size > MOST_BYTES:
        return False
    with suppress(DamagedImageError):
        return min(depth_size_px(read_image_file(file), str(file))) < LEAST_SIDE_PX
    return False


def unread_depth(path: Path, read: NamedImages) -> tuple[str, ...]:
    """Return a warning on depth images of other file types than the one that is read; () if none exists."""
    read_kinds = {file.suffix.lower() for file in read.files}
    others: dict[str, list[str]] = {}
    for file in sorted(_every_depth(path).files):
        if file.suffix.lower() not in read_kinds:
            others.setdefault(file.suffix.lower(), []).append(file.name)
    if not others or not read.files:
        return ()
    counted = " and ".join(f"{len(n)} {kind} (such as {printable(n[0])})" for kind, n in others.items())
    kinds = f"{', '.join(sorted(read_kinds))} (such as {printable(read.files[0].name)})"
    line = f"{counted} images beside the {len(read.files)} {kinds} are not read: keep one kind"
    return (f"{read.files[0].parent}: {line}",)


def other_depth(path: Path) -> tuple[str, ...]:
    """Return a warning on each folder of depth beside depth/, such as aligned_depth/; () if none exists."""
    folders = [in_any_case(path, name) for name in OTHER_DEPTH] if in_any_case(path, "depth").is_dir() else []
    others = [folder for folder in folders if folder.is_dir() and _first_is_depth(folder)]
    return tuple(
        f"{path}: depth is read from depth/, and not from {f.name}/ beside it: if colour lies on "
        "the pixels of the latter, rename it to depth/"
        for f in others
    )


def _first_is_depth(folder: Path) -> bool:
    first = next(iter(in_folder(folder, DEPTH_SUFFIXES).files), None)
    return first is not None and (first.suffix.lower() != ".png" or is_16_bit(first))


def color_images(path: Path) -> NamedImages:
    """Find the colour images: in the first of `COLOR_FOLDERS` that has any, or beside depth; may be empty."""
    folders = [folder for folder in in_order(path, COLOR_FOLDERS) if folder.is_dir()]
    if not (folders or in_any_case(path, "depth").is_dir()):
        return _color_beside(folder_of_both(path) or path)
    every = (in_folder(folder, COLOR_SUFFIXES) for folder in folders)
    return next((images for images in every if images.files), NamedImages((), ()))


def unread_color(path: Path) -> tuple[str, ...]:
    """Return a warning on folders of images that look like colour, and on videos, if no colour is read."""
    videos = [
        file.name
        for file in sorted(listed_paths(path, wanted=lambda name: not name.startswith(".")))
        if file.suffix.lower() in VIDEO_SUFFIXES and not is_named_depth(file.stem)
    ]
    lines = []
    if videos:
        are = "is a video: write its" if len(videos) == 1 else "are videos: write that of colour's"
        named = f"{printable(', '.join(videos))} {are} frames to color/, with the names of depth"
        lines.append(f"{path}: no colour is read; {named}")
    for folder in sorted(listed_paths(path, wanted=LIKE_COLOR.fullmatch)):
        files = in_folder(folder, COLOR_SUFFIXES).files if folder.is_dir() and not folder.is_symlink() else ()
        if len(files) >= LEAST_IMAGES and not is_16_bit(files[0]):
            name = printable(f"{folder.name}/{files[0].name}")
            lines.append(
                f"{path}: no colour is read; {name} and {len(files) - 1} more: rename the folder to color/"
            )
    return tuple(lines)


def folder_of_both(path: Path) -> Path | None:
    """Return the folder, `path` or its results/, with 16-bit depth beside colour; None if there is none."""
    for folder in (path, path / REPLICA_FOLDER):
        named = listed_paths(folder, wanted=_is_depth_png) if folder.is_dir() else ()
        if any(map(is_16_bit, named)):
            return folder if _color_beside(folder).files else None
    return None


def _is_depth_png(name: str) -> bool:
    return _word(name, DEPTH_WORD, frozenset({".png"}))


def _color_beside(folder: Path) -> NamedImages:
    """List the colour images beside depth: those with a word for colour, or else those named as depth is.

    The latter may be masks, so only images in colour count: of each number a JPEG, or else the first.
    """
    named = beside_each_other(folder, COLOR_WORD)
    if named.files:
        return named
    frames, every = set(beside_each_other(folder, DEPTH_WORD).stems), in_folder(folder, COLOR_SUFFIXES)
    chosen = dict[str, Path]()
    for file in every.files:
        stem, is_jpeg = FRAME_WORD.sub(r"\1", file.stem), file.suffix.lower() in JPEG_SUFFIXES
        wanted = stem in frames and (is_jpeg or stem not in chosen) and file.is_file()
        if wanted and is_in_color(read_head(file, COLOR_HEAD_BYTES)):
            chosen[stem] = file
    return NamedImages(tuple(chosen.values()), tuple(chosen))


def in_folder(folder: Path, suffixes: frozenset[str]) -> NamedImages:
    """List the images of a folder in numeric order: 2 before 10."""
    files = (f for f in listed_paths(folder) if f.suffix.lower() in suffixes and not f.name.startswith("."))
    ordered = sorted(files, key=lambda file: (counting_key(file.stem), file.name))
    return NamedImages(tuple(ordered), tuple(file.stem for file in ordered))


def beside_each_other(path: Path, word: re.Pattern[str]) -> NamedImages:
    """List the images of a folder whose names contain `word`, in numeric order."""
    suffixes = DEPTH_SUFFIXES if word is DEPTH_WORD else COLOR_SUFFIXES
    files = listed_paths(path, wanted=lambda name: _word(name, word, suffixes))
    named = sorted(
        ((_without(word, file.stem), file) for file in files if _is_of(word, file)),
        key=lambda each: (counting_key(each[0]), each[1].name),
    )
    return NamedImages(tuple(file for _, file in named), tuple(stem for stem, _ in named))


def is_16_bit(file: Path) -> bool:
    """Whether a file starts like depth: a grey PNG with 16 bits per pixel."""
    return file.is_file() and is_depth_png(read_head(file, HEAD_BYTES))


def _word(name: str, word: re.Pattern[str], suffixes: frozenset[str]) -> bool:
    stem, dot, suffix = name.rpartition(".")
    return f"{dot}{suffix.lower()}" in suffixes and not name.startswith(".") and bool(word.fullmatch(stem))


def _is_of(word: re.Pattern[str], file: Path) -> bool:
    """Whether an image belongs to the stream of this word; its name may contain the other stream's word, too.

    If the name has both words, as aligned_depth_to_color_000000.png, 16 bits per pixel mean depth.
    """
    if file.suffix.lower() not in COLOR_SUFFIXES:
        return True
    both = DEPTH_WORD.fullmatch(file.stem) and COLOR_WORD.fullmatch(file.stem)
    return not both or is_16_bit(file) == (word is DEPTH_WORD)


def _without(word: re.Pattern[str], stem: str) -> str:
    """Return a name without the word in it; the parts before and after are joined by an underscore."""
    stem = TO_OTHER.sub(r"\1", stem)
    match = word.fullmatch(stem)
    return "_".join(part for part in match.groups() if part) if match else stem
