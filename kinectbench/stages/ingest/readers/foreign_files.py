"""Messages on files that are no recording: what a file is, by its first bytes or its name, and what to do."""

from pathlib import Path
from typing import NamedTuple

from kinectbench.core import open_plain
from kinectbench.stages.ingest.readers.color_only import RECORD
from kinectbench.stages.ingest.readers.foreign_depth import AS_READ, MOVE, stacked_in

# A tar's first header block, and where its magic lies (POSIX ustar, pax(1)).
HEAD_BYTES, TAR_AT, TAR_MAGIC = 512, 257, b"ustar"


class ForeignKind(NamedTuple):
    """A kind of file that is not read.

    Attributes:
        is_a: what it is.
        advice: what to do instead.
        magics: first bytes, one of which a file of the kind has; empty: it is known by its name alone.
        suffixes: endings of names, in lower case, one of which a file of the kind has; empty: any name.
    """

    is_a: str
    advice: str
    magics: tuple[bytes, ...] = ()
    suffixes: tuple[str, ...] = ()


ONE_A_FRAME = f"write the depth of each frame {AS_READ}; then {MOVE}"
UNPACK = "unpack it and give the folder"
# The first that fits is meant. First bytes: the formats' own descriptions, and file(1) of Debian 12.
KINDS = (
    ForeignKind(
        "an OpenNI recording (.oni)",
        "record with `kinectbench record`, or play it by OpenNI 2 (in Python `openni2.Device.open_file`) and "
        f"{ONE_A_FRAME}",
        (b"NI10",),
    ),
    ForeignKind("an HDF5 file", ONE_A_FRAME, (b"\x89HDF\r\n\x1a\n",)),
    ForeignKind("a file of a NumPy array", ONE_A_FRAME, (b"\x93NUMPY",)),
    ForeignKind("a file of NumPy arrays (.npz)", ONE_A_FRAME, (b"PK\x03\x04",), (".npz",)),
    ForeignKind("a zip without a recording of a known format", UNPACK, (b"PK\x03\x04", b"PK\x05\x06")),
    ForeignKind(
        "an archive",
        UNPACK,
        (b"\x1f\x8b", b"BZh", b"\xfd7zXZ\0", b"7z\xbc\xaf\x27\x1c", b"Rar!", b"\x28\xb5\x2f\xfd"),
    ),
    ForeignKind("a file of MATLAB arrays", ONE_A_FRAME, (b"MATLAB",)),
    ForeignKind("a ZED recording", "export its depth by the ZED SDK's SVO export", (), (".svo", ".svo2")),
    ForeignKind("a recording of Kinect Studio", f"play it in Kinect Studio and {ONE_A_FRAME}", (), (".xef",)),
    ForeignKind(
        "a mesh or a cloud of points, without depth images",
        RECORD,
        (b"ply\n", b"ply\r\n", b"glTF", b"# .PCD"),
    ),
    ForeignKind(
        "a mesh or a cloud of points, without depth images", RECORD, (), (".obj", ".stl", ".off", ".pcd")
    ),
    ForeignKind(
        "one image",
        "give the folder of the whole recording",
        (b"\x89PNG", b"\xff\xd8\xff", b"II*\0", b"MM\0*"),
    ),
)
# Names of files that may hold the whole recording of a folder, archives first.
FOREIGN = (
    *("*.zip", "*.tar", "*.tar.*", "*.tgz", "*.7z", "*.rar", "*.gz"),
    *("*.oni", "*.xef", "*.svo", "*.svo2", "*.npz", "*.npy", "*.h5", "*.hdf5", "*.mat"),
)


def foreign_file(path: Path) -> str | None:
    """Return an error message for a file that no reader recognises: what kind of file it is, and what to do.

    The result is None if the kind is unknown. An empty file is reported as empty.

    Raises:
        OSError: the file cannot be read.
    """
    with open_plain(path) as file:
        head = file.read(HEAD_BYTES)
    if not head:
        return f"{path}: the file is empty; copy it again"
    if (said := stacked_in(path)) is not None:
        return f"{path.parent}: {said}"
    suffix = path.suffix.lower()
    for kind in KINDS:
        by_bytes = not kind.magics or head.startswith(kind.magics)
        if by_bytes and (not kind.suffixes or suffix in kind.suffixes):
            return f"{path}: is {kind.is_a}; {kind.advice}"
    if head[TAR_AT:].startswith(TAR_MAGIC):
        return f"{path}: is an archive; {UNPACK}"
    return None
