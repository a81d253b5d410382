"""Name files that look like depth, but are of a kind or in a layout that is not read, and say what to do."""

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path

from kinectbench.core import listed as names_of
from kinectbench.core import printable, read_head, scanned
from kinectbench.stages.ingest.depth_files import ARRAYS, READ_EXR, SUFFIXES, depth_size_px, shapes_of_arrays
from kinectbench.stages.ingest.images import DamagedImageError, image_header
from kinectbench.stages.ingest.readers.folder_images import LEAST_IMAGES, LEAST_SIDE_PX, is_named_depth
from kinectbench.stages.ingest.recording import read_image_file

# Limits of the search: entries of a folder, entries in all (two such folders), folders of a level, and levels
# below the recording's folder.
LOOKED_AT, MOST_ENTRIES, MOST_FOLDERS, LEVELS = 20_000, 40_000, 200, 3
PICTURES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".ppm", ".webp"})
# Files of depth that is read in a folder depth/, and kinds that hold nothing but depth.
READ, ONLY_DEPTH = SUFFIXES - {".png"}, frozenset({".pfm", ".dpt"})
# Files of a folder named depth that are not its images.
BESIDE = frozenset(
    {"", ".json", ".yaml", ".yml", ".xml", ".md", ".py", ".log", ".ini", ".db", ".mp4", ".avi"}
)
MOVE = (
    "put depth alone into a folder depth/ and colour into color/, with the same number in the names of one "
    "frame, and intrinsics.json beside them"
)
AS_READ = "as 16-bit PNG in mm, or as .npy in metres"
CONVERT = f"write it {AS_READ}"
# How to read the array `depth` of an HDF5 file, or else its first.
HDF5 = '(lambda f: f[max(f, key="depth".__eq__)][:])(h5py.File({f}))'
OPENCV_YAML = "cv2.FileStorage({f}, 0).getFirstTopLevelNode().mat()"
# In Hypersim's names; its depth is the distance along the ray (github.com/apple/ml-hypersim).
HYPERSIM = ".depth_meters."
# Kind -> how to read a file {f} as an array in Python.
READ_BY = {
    ".jp2": "cv2.imread({f}, -1)",
    ".exr": READ_EXR,
    ".mat": 'scipy.io.loadmat({f})["depth"]',
    ".h5": HDF5,
    ".hdf5": HDF5,
    ".csv": 'numpy.loadtxt({f}, delimiter=",")',
    ".txt": "numpy.loadtxt({f})",
    ".yml": OPENCV_YAML,
    ".yaml": OPENCV_YAML,
}
# OpenCV's matrices as text; a camera's file is much shorter than an image.
MATRIX_TEXTS = frozenset({".yml", ".yaml"})
# File or folder -> Python that writes it from the ARRAY of a .npz, with a row or an image for each frame.
WRITTEN_BY = {
    "color/": (
        "import cv2; os.makedirs('color', exist_ok=True); "
        "[cv2.imwrite(f'color/{i:06d}.png', a[..., ::-1]) for i, a in enumerate(ARRAY)]"
    ),
    "poses.txt": "(lambda T: numpy.savetxt('poses.txt', T.reshape(len(T), -1)))(ARRAY)",
    "intrinsics.txt": "numpy.savetxt('intrinsics.txt', ARRAY.reshape(-1, 3)[:3])",
}
# Characters of the longest name of an array that a message quotes (chosen by hand).
LONGEST_KEY = 60
# Kinds that hold depth or other things.
POSSIBLY = frozenset({".jp2", ".mat", ".h5", ".hdf5", ".csv", ".npz"})
# Texts that may hold an image, and bytes of the longest line that is read.
TABLES, MOST_LINE = frozenset({".csv", ".txt"}), 64 << 10
BARE, CLOUDS, ZIPPED = frozenset({".raw", ".bin", ".dat"}), frozenset({".ply", ".pcd", ".xyz", ".las"}), ".gz"
# Image sizes (width, height) of depth that Kinect, Xtion, RealSense, Azure Kinect, iPhones and simulators
# write, by their data sheets and defaults; bytes and types of a value of theirs.
SIZES_PX = (
    (640, 480), (848, 480), (1280, 720), (640, 576), (512, 424), (320, 240), (640, 360), (256, 192),
    (480, 270), (424, 240), (1024, 768), (1024, 1024), (640, 400), (320, 288), (512, 512), (160, 120),
    (1280, 800),
)  # fmt: skip
VALUES = ((2, "uint16"), (4, "float32"))


@dataclass(frozen=True)
class Listed:
    """The files of a folder and of those below it.

    Attributes:
        path: the folder.
        files: each folder's files by name, without hidden ones; a level of folders comes after that above it.
    """

    path: Path
    files: dict[Path, list[Path]]

    @classmethod
    def of(cls, path: Path, left_out: tuple[str, ...]) -> "Listed":
        """List a folder once, and those below it down to three levels, each level by name.

        Hidden folders, links to folders, and folders below `path` that cannot be read are skipped.

        Args:
            path: the folder.
            left_out: suffixes in lower case, with their dots, of files to leave out.

        Raises:
            OSError: the folder itself cannot be read.
        """
        files, level, left = dict[Path, list[Path]](), [path], MOST_ENTRIES
        for _ in range(LEVELS + 1):
            below = list[Path]()
            for folder in level:
                try:
                    entries = list(islice(scanned(folder), min(left, LOOKED_AT)))
                except OSError:
                    if folder == path:
                        raise
                    continue
                left -= len(entries)
                shown = sorted((e for e in entries if not e.name.startswith(".")), key=lambda e: e.name)
                below += [folder / e.name for e in shown if e.is_dir(follow_symlinks=False)]
                kept = (e.name for e in shown if not e.name.lower().endswith(left_out) and e.is_file())
                files[folder] = [folder / name for name in kept]
            level = below[:MOST_FOLDERS]
        return cls(path, files)

    @cached_property
    def color_px(self) -> list[tuple[int, int]]:
        """Width and height of the first intact picture, of the first five in each folder; [] without one."""
        for files in self.files.values():
            for file in [file for file in files if file.suffix.lower() in PICTURES][:LEAST_IMAGES]:
                with suppress(DamagedImageError):
                    return [image_header(read_image_file(file), str(file))[1:]]
        return []


def unread_files(listed: Listed) -> str | None:
    """Return an error message on files that look like depth in no known layout or kind; None if none do.

    Files look like depth if they, or their folder, are so named. Arrays of other names may be depth if they
    have the size of an image.

    Raises:
        OSError: a file cannot be read.
    """
    for named in (True, False):
        for folder, inside in listed.files.items():
            of_depth = folder != listed.path and is_named_depth(folder.name)
            for kind, files in _by_kind(inside, of_depth=of_depth, named=named).items():
                if len(files) >= LEAST_IMAGES and (named or _is_an_image(listed, files[0])):
                    return _message(listed, kind, files, "look like depth" if named else "may be depth")
    return None


def stacked(listed: Listed) -> str | None:
    """Return an error message on a file with the depth images of all frames; None if there is none."""
    for file in listed.files[listed.path]:
        named = is_named_depth(file.stem) or file.suffix.lower() == ".npz"
        if named and file.suffix.lower() in ARRAYS and (said := stacked_in(file, listed.color_px)):
            return f"{listed.path}: {said}"
    return None


def stacked_in(file: Path, color_px: Sequence[tuple[int, int]] = ()) -> str | None:
    """Return a message on an .npy or .npz file with the depth of all frames, with a line that divides it.

    The line also writes colour, poses and intrinsics that an .npz holds, each if exactly one array has the
    shape; else the message names those that do. The result is None if no array can be the depth of all
    frames, if several may be, or if a name is too long or holds a backtick.

    Args:
        file: the file.
        color_px: width and height of colour images, if known.
    """
    known = {tuple(sorted(size)) for size in (*color_px, *SIZES_PX)}
    shapes = {
        key: tuple(side for side in shape if side != 1) for key, shape in shapes_of_arrays(file).items()
    }
    stacks = {key: stack for key, shape in shapes.items() if (stack := _frames_of(shape, known)) is not None}
    depth = [key for key in stacks if is_named_depth(key)] or [*stacks]
    if len(depth) != 1 or "`" in f"{file.name}{''.join(shapes)}" or max(map(len, shapes)) > LONGEST_KEY:
        return None
    (key,), (count, last) = depth, stacks[depth[0]]
    loaded = f"numpy.load({file.name!r})"
    array = f"{loaded}[{key!r}].squeeze()" if key else f"{loaded}.squeeze()"
    array = f"numpy.moveaxis({array}, -1, 0)" if last else array
    line = (
        "import numpy, os; os.makedirs('depth', exist_ok=True); "
        f"[numpy.save(f'depth/{{i:06d}}.npy', a) for i, a in enumerate({array})]"
    )
    unsure = list[str]()
    for target, write in WRITTEN_BY.items():
        fitting = [other for other, shape in shapes.items() if _file_of(shape, count) == target]
        if len(fitting) == 1:
            line += f"; {write.replace('ARRAY', f'{loaded}[{fitting[0]!r}].squeeze()')}"
        elif fitting:
            unsure.append(f"of {printable(names_of(fitting))} to {target}")
    held = f"{printable(file.name)} holds {count} images in one array, which is not read"
    which = f"; write the right one {', '.join(unsure)}" if unsure else ""
    then = "" if "intrinsics.txt" in line else f"; then {MOVE}"
    return f"{held}: write each to a file, such as by `{line}`{which}{then}"


def _frames_of(shape: Sequence[int], known: Collection[tuple[int, ...]]) -> tuple[int, bool] | None:
    """Return how many images an array of this shape holds, and whether along its last axis; None if none."""
    if len(shape) != 3:
        return None
    # The frames are along the first axis, or along the last if that is the shortest.
    last = shape[2] < min(shape[:2]) and tuple(sorted(shape[1:])) not in known
    count, *sides = shape[::-1] if last else shape
    return (count, last) if count >= LEAST_IMAGES and min(sides) >= LEAST_SIDE_PX else None


def _file_of(shape: Sequence[int], count: int) -> str:
    """Return the key of `WRITTEN_BY` that an array of this shape fits, of `count` frames; "" if none."""
    if len(shape) == 4 and shape[0] == count and shape[3] == 3:
        return "color/"
    if shape in ((count, 4, 4), (count, 3, 4)):
        return "poses.txt"
    return "intrinsics.txt" if shape in ((3, 3), (count, 3, 3)) else ""


def if_depth(listed: Listed) -> str:
    """Return "if its 8 .h5 files are depth, ..., else " for files that may hold depth; "" without such files.

    Raises:
        OSError: a file cannot be read.
    """
    for inside in listed.files.values():
        for kind, files in _by_kind(inside, of_depth=False, named=False).items():
            if kind in POSSIBLY and len(files) >= LEAST_IMAGES:
                name = printable(files[0].relative_to(listed.path).as_posix())
                are = f"if its {len(files)} {kind} files, such as {name}, are depth"
                return f"{are}, {conversion(listed, files[0])}, and {MOVE}; else "
    return ""


def conversion(listed: Listed, file: Path) -> str:
    """Return the words "write it as ...", with a line of Python that does it, if the kind of file has one.

    There is no line if the name holds a backtick, which would end it.
    """
    kind, name = file.suffix.lower(), file.relative_to(listed.path).as_posix()
    template = _raw(listed, file) if kind in BARE else READ_BY.get(kind, "")
    if not template or "`" in name:
        return CONVERT
    read = template.format(f=repr(name))
    imported = "h5py" if template == HDF5 else read.split(".")[0]
    modules = "numpy" if imported == "numpy" else f"{imported.replace('scipy', 'scipy.io')}, numpy"
    line = f"import {modules}; numpy.save({f'depth/{file.stem}.npy'!r}, {read})"
    return f"{CONVERT}, such as by `{line}`"


def _by_kind(inside: Sequence[Path], *, of_depth: bool, named: bool) -> dict[str, list[Path]]:
    """Return a folder's files that may be depth by their suffix, in the given order.

    Args:
        inside: the folder's files.
        of_depth: whether the folder is named depth.
        named: whether to list files that are so named, or all arrays.
    """
    by_kind = dict[str, list[Path]]()
    for file in inside:
        kind = file.suffix.lower()
        if kind in PICTURES:
            continue
        if named:
            wanted = kind in ONLY_DEPTH or ((of_depth or is_named_depth(file.stem)) and kind not in BESIDE)
        else:
            wanted = kind in READ | BARE | POSSIBLY
        of_matrices = kind in MATRIX_TEXTS and of_depth and file.stat().st_size >= LEAST_SIDE_PX**2
        if of_matrices or (wanted and (kind not in TABLES or _is_table(file))):
            by_kind.setdefault(kind, []).append(file)
    return by_kind


def _is_table(file: Path) -> bool:
    """Whether the first line of a text has as many numbers as an image is wide."""
    line = read_head(file, MOST_LINE).partition(b"\n")[0].replace(b",", b" ").replace(b";", b" ")
    return len(line.split()) >= LEAST_SIDE_PX


def _is_an_image(listed: Listed, file: Path) -> bool:
    """Whether an array, a TIFF or a file of bare values has the size of an image of a room."""
    if file.suffix.lower() in BARE:
        return bool(_raw(listed, file))
    if file.suffix.lower() not in READ:
        return False
    with suppress(DamagedImageError):
        return min(depth_size_px(read_image_file(file), str(file))) >= LEAST_SIDE_PX
    return False


def _message(listed: Listed, kind: str, files: Sequence[Path], looks: str) -> str:
    name = printable(files[0].relative_to(listed.path).as_posix())
    found = f"{listed.path}: {len(files)} {kind} files, such as {name}, {looks}"
    if kind in READ:
        return f"{found}, but in no layout that is known: {MOVE}"
    if kind in CLOUDS:
        return f"{found}, but are clouds of points: export the depth images, and {CONVERT}; then {MOVE}"
    if kind == ZIPPED:
        return f"{found}, but {kind} is not read: unpack them; then {MOVE}"
    along = "; of Hypersim, give `depth_code: ray_distance`" if HYPERSIM in files[0].name else ""
    return f"{found}, but {kind} is not read: {conversion(listed, files[0])}; then {MOVE}{along}"


def _raw(listed: Listed, file: Path) -> str:
    """Return how to read a file {f} of bare values in Python, by its length; "" if it is of no known size."""
    count = file.stat().st_size
    for width, height in (*listed.color_px, *SIZES_PX):
        for each, kind in VALUES:
            if count == width * height * each:
                return f'numpy.fromfile({{f}}, "{kind}").reshape({height}, {width})'
    return ""
