"""Archives of scans that are damaged or hold nothing: a line, and no folder."""

import gzip
import io
import tarfile
from pathlib import Path

import pytest
from raising import raises

from kinectbench.core.errors import StorageError
from kinectbench.release.unpack import unpack_archive


def tar_of(*names: str) -> bytes:
    """A tar of small files; each takes two blocks of 512 bytes."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        for name in names:
            info = tarfile.TarInfo(name)
            info.size = 5
            archive.addfile(info, io.BytesIO(b"12345"))
    return packed.getvalue()


WHOLE = tar_of("a/1", "a/2", "a/3")
PACKED = gzip.compress(WHOLE)
DAMAGED = {
    "a damaged second header": WHOLE[:1024] + b"?" * 512 + WHOLE[1536:],
    "cut at a header": WHOLE[:2048],
    "cut within a header": WHOLE[:2148],
    "another checksum": PACKED[:-8] + bytes(4) + PACKED[-4:],
    "no end of the gzip": PACKED[:-8],
    "zeros without end": gzip.compress(WHOLE + bytes(80 << 20)),
    "only hidden files": tar_of(".a", "b/.c"),
}


def test_a_whole_archive_is_unpacked(tmp_path: Path) -> None:
    for name, content in (("a.tar", WHOLE), ("a.tgz", PACKED)):
        (tmp_path / name).write_bytes(content)
        unpack_archive(tmp_path / name, tmp_path / f"{name}-files")
        assert sorted(path.name for path in (tmp_path / f"{name}-files").iterdir()) == ["1", "2", "3"]


@pytest.mark.parametrize("damage", DAMAGED)
def test_a_damaged_archive_is_a_line(tmp_path: Path, damage: str) -> None:
    (tmp_path / "a.tgz").write_bytes(DAMAGED[damage])
    with raises(StorageError, "storage.damaged", match="cannot be unpacked"):
        unpack_archive(tmp_path / "a.tgz", tmp_path / "a")
    assert not (tmp_path / "a").exists()
