"""Name files that look like depth, but are of a kind or in a layout that is not read, and say what to do."""

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path

from kinectbench.core import listed_paths, printable, read_head
from kinectbench.stages.ingest.depth_files import ARRAYS, depth_size_px
from kinectbench.stages.ingest.images import DamagedImageError, image_header
from kinectbench.stages.ingest.readers.folder_images import COLOR_WORD, LEAST_SIDE_PX
from kinectbench.stages.ingest.recording import read_image_file

# Enough images to be a recording, or a folder of depth, and not a stray picture.
LEAST_IMAGES = 5
# Limits of the search: entries of a folder, folders of a level, and levels below the recording's folder.
LOOKED_AT, MOST_FOLDERS, LEVELS = 20_000, 200, 3
PICTURES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".webp"})
# Files of depth that is read in a folder depth/, and kinds that hold nothing but depth.
READ, ONLY_DEPTH = ARRAYS | {".tif", ".tiff"}, frozenset({".pfm", ".dpt"})
# Files of a folder named depth that are not its images.
BESIDE = frozenset(
    {"", ".json", ".yaml", ".yml", ".xml", ".md", ".py", ".log", ".ini", ".db", ".mp4", ".avi"}
)
LIKE_DEPTH = re.compile(r"depth|distance|disparity", re.IGNORECASE)
MOVE = (
    "put depth alone into a folder depth/ and colour into color/, with the same number in the names of one "
    "frame, and intrinsics.json beside them"
)
AS_READ = "as 16-bit PNG in mm, or as .npy in metres"
CONVERT = f"write it {AS_READ}"
# Kind -> how to read a file {f} as an array in Python.
READ_BY = {
    ".pfm": "cv2.imread({f}, -1)",
    ".pgm": "cv2.imread({f}, -1)",
    ".jp2": "cv2.imread({f}, -1)",
    ".exr": "cv2.imread({f}, -1)",
    ".mat": 'scipy.io.loadmat({f})["depth"]',
    ".h5": 'h5py.File({f})["depth"][:]',
    ".hdf5": 'h5py.File({f})["depth"][:]',
    ".csv": 'numpy.loadtxt({f}, delimiter=",")',
    ".txt": "numpy.loadtxt({f})",
}
# Kinds that hold depth or other things.
POSSIBLY = frozenset({".pgm", ".jp2", ".mat", ".h5", ".hdf5", ".csv", ".npz"})
# Texts that may hold an image, and bytes of the longest line that is read.
TABLES, MOST_LINE = frozenset({".csv", ".txt"}), 64 << 10
BARE, CLOUDS, ZIPPED = frozenset({".raw", ".bin", ".dat"}), frozenset({".ply", ".pcd", ".xyz", ".las"}), ".gz"
# Image sizes of common depth cameras, and bytes and types of a value of theirs.
SIZES_PX = (
    (640, 480), (848, 480), (1280, 720), (640, 576), (512, 424), (320, 240), (640, 360), (256, 192),
    (480, 270), (424, 240), (1024, 768), (1024, 1024), (640, 400), (320, 288), (512, 512), (160, 120),
    (1280, 800),
)  # fmt: skip
VALUES = ((2, "uint16"), (4, "float32"))


def folders_below(path: Path) -> Iterator[Path]:
    """Yield a folder and those below it down to three levels, each level by name; not the hidden ones."""
    level = [path]
    for _ in range(LEVELS):
        yield from level
        below = (child for folder in level for child in sorted(islice(listed_paths(folder), LOOKED_AT)))
        folders = (child for child in below if not child.name.startswith(".") and child.is_dir())
        level = list(islice(folders, MOST_FOLDERS))
    yield from level


def is_named_depth(name: str) -> bool:
    """Whether the name of a file (without suffix) or folder says depth, and not colour."""
    return bool(LIKE_DEPTH.search(name)) and not COLOR_WORD.fullmatch(name)


def unread_files(path: Path) -> str | None:
    """Return an error message on files that look like depth in no known layout or kind; None if none do.

    Files look like depth if they, or their folder, are so named. Arrays of other names may be depth if they
    have the size of an image.

    Raises:
        OSError: a folder cannot be read.
    """
    if not path.is_dir():
        return None
    folders = list(folders_below(path))
    for named in (True, False):
        for folder in folders:
            of_depth = folder != path and is_named_depth(folder.name)
            for kind, files in _by_kind(folder, of_depth=of_depth, named=named).items():
                if len(files) >= LEAST_IMAGES and (named or _is_an_image(path, files[0])):
                    return _message(path, kind, files, "look like depth" if named else "may be depth")
    return None


def if_depth(path: Path) -> str:
    """Return "if its 8 .h5 files are depth, ..., else " for files that may hold depth; "" without such files.

    Raises:
        OSError: a folder cannot be read.
    """
    for folder in folders_below(path):
        for kind, files in _by_kind(folder, of_depth=False, named=False).items():
            if kind in POSSIBLY and len(files) >= LEAST_IMAGES:
                name = printable(files[0].relative_to(path).as_posix())
                are = f"if its {len(files)} {kind} files, such as {name}, are depth"
                return f"{are}, {conversion(path, files[0])}, and {MOVE}; else "
    return ""


def conversion(path: Path, file: Path) -> str:
    """Return the words "write it as ...", with a line of Python that does it, if the kind of file has one.

    Args:
        path: the recording's folder.
        file: one of its files of depth.
    """
    kind, name = file.suffix.lower(), printable(file.relative_to(path).as_posix())
    read = READ_BY.get(kind, "").format(f=f'"{name}"')
    if kind in BARE:
        read = _raw(path, file, name)
    if not read:
        return CONVERT
    imported = read.split(".")[0]
    modules = "numpy" if imported == "numpy" else f"{imported.replace('scipy', 'scipy.io')}, numpy"
    before = 'import os; os.environ["OPENCV_IO_ENABLE_OPENEXR"] = "1"; ' if kind == ".exr" else ""
    line = f'{before}import {modules}; numpy.save("depth/{printable(file.stem)}.npy", {read})'
    return f"{CONVERT}, such as by `{line}`"


def _by_kind(folder: Path, *, of_depth: bool, named: bool) -> dict[str, list[Path]]:
    """Return a folder's files that may be depth by their suffix, sorted.

    Args:
        folder: the folder.
        of_depth: whether it is named depth.
        named: whether to list files that are so named, or all arrays.
    """
    by_kind = dict[str, list[Path]]()
    for file in islice(listed_paths(folder), LOOKED_AT):
        kind = file.suffix.lower()
        if file.name.startswith(".") or kind in PICTURES:
            continue
        if named:
            wanted = kind in ONLY_DEPTH or ((of_depth or is_named_depth(file.stem)) and kind not in BESIDE)
        else:
            wanted = kind in READ | BARE | POSSIBLY
        if wanted and file.is_file() and (kind not in TABLES or _is_table(file)):
            by_kind.setdefault(kind, []).append(file)
    return {kind: sorted(files) for kind, files in by_kind.items()}


def _is_table(file: Path) -> bool:
    """Whether the first line of a text has as many numbers as an image is wide."""
    line = read_head(file, MOST_LINE).partition(b"\n")[0].replace(b",", b" ").replace(b";", b" ")
    return len(line.split()) >= LEAST_SIDE_PX


def _is_an_image(path: Path, file: Path) -> bool:
    """Whether an array, a TIFF or a file of bare values has the size of an image of a room."""
    if file.suffix.lower() in BARE:
        return bool(_raw(path, file, ""))
    if file.suffix.lower() not in READ:
        return False
    with suppress(DamagedImageError):
        return min(depth_size_px(read_image_file(file), str(file))) >= LEAST_SIDE_PX
    return False


def _message(path: Path, kind: str, files: Sequence[Path], looks: str) -> str:
    name = printable(files[0].relative_to(path).as_posix())
    found = f"{path}: {len(files)} {kind} files, such as {name}, {looks}"
    if kind in READ:
        return f"{found}, but in no layout that is known: {MOVE}"
    if kind in CLOUDS:
        return f"{found}, but are clouds of points: export the depth images, and {CONVERT}; then {MOVE}"
    if kind == ZIPPED:
        return f"{found}, but {kind} is not read: unpack them; then {MOVE}"
    return f"{found}, but {kind} is not read: {conversion(path, files[0])}; then {MOVE}"


def _raw(path: Path, file: Path, name: str) -> str:
    """Return how to read a file of bare values in Python, by its length; "" if it is of no known size."""
    count = file.stat().st_size
    for width, height in (*_color_sizes(path), *SIZES_PX):
        for each, kind in VALUES:
            if count == width * height * each:
                return f'numpy.fromfile("{name}", "{kind}").reshape({height}, {width})'
    return ""


def _color_sizes(path: Path) -> list[tuple[int, int]]:
    """Return width and height of the first intact PNG or JPEG in a folder or below it; [] without one."""
    for folder in folders_below(path):
        for file in sorted(islice(listed_paths(folder), LOOKED_AT))[:LEAST_IMAGES]:
            if file.suffix.lower() in PICTURES and file.is_file():
                with suppress(DamagedImageError):
                    return [image_header(read_image_file(file), str(file))[1:]]
    return []
