"""Pack many small files into one object: an uncompressed tar, with equal bytes for equal files."""

import tarfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO

from kinectbench.core.errors import StorageError
from kinectbench.core.storage import storage_errors
from kinectbench.core.untrusted import below, copy_bounded, open_plain, printable


def pack_files(folder: Path, names: list[str], archive: Path) -> None:
    """Write files of a folder into a tar, in the given order, without times, owners and permissions."""
    with storage_errors(archive), tarfile.open(archive, "w", format=tarfile.PAX_FORMAT) as tar:
        for name in names:
            entry = tarfile.TarInfo(name)
            entry.size = (folder / name).stat().st_size
            with open_plain(folder / name) as file:
                tar.addfile(entry, file)


def unpack_files(archive: Path, folder: Path, sizes: Mapping[str, int]) -> None:
    """Extract a tar that must hold exactly these files with these sizes.

    Args:
        archive: tar from a store, untrusted.
        folder: target; created if missing.
        sizes: name -> bytes of each file.

    Raises:
        StorageError: the tar holds something else, is damaged, or the disk cannot be written.
    """
    left = dict(sizes)
    try:
        with (
            storage_errors(folder),
            open_plain(archive) as file,
            tarfile.open(fileobj=file, mode="r:") as tar,
        ):
            while (entry := tar.next()) is not None:
                if not entry.isreg() or left.pop(entry.name, None) != entry.size:
                    name = printable(entry.name)
                    raise StorageError(f"{archive.name}: '{name}' is not what manifest.json lists")
                _write(tar.extractfile(entry), below(folder, entry.name), entry.size)
                tar.members.clear()  # type: ignore[attr-defined] # it keeps all
    except (tarfile.TarError, ValueError, EOFError) as error:
        raise StorageError(f"{archive.name}: damaged ({printable(str(error))})") from error
    if left:
        raise StorageError(f"{archive.name}: lacks '{printable(next(iter(left)))}' and is damaged")


def _write(source: IO[bytes] | None, path: Path, size: int) -> None:
    assert source is not None, "a regular member has bytes"
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as target:
        copy_bounded(source, target, size)
