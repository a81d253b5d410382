"""Pairs of a release and other arrays of one: they swell, claim, are encrypted, or are no pairs."""

import io
import os
import struct
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from fuzz.members import BOMB_MB, add_bomb
from fuzz.releases import seal

from hostile_cases.case import Case, in_turn, on

PAIR, VOLUME = "pairs/chair_01/000.npz", "objects/chair_01/volume.npz"
READERS = """verify release
score predictions --benchmark release --jobs 1 --no-surface --no-baselines --no-gallery --out scored
load release
baseline partial hull --benchmark release --jobs 1 --out made
export exported --layout recgan --benchmark release
export exported --layout bop --benchmark release
export exported --layout webdataset --benchmark release
report --benchmark release --out page.html"""
OF_OBJECTS = "verify release\nexport exported --layout bop --benchmark release"
GALLERY = "report --benchmark release --scores scores --out page.html"
IMPORT = "import authors imported"


def cases() -> Iterator[Case]:
    damaged = [_damaged("M1", f"a pair: {name}", PAIR, damage) for name, damage in DAMAGES.items()]
    yield from in_turn(READERS, *damaged, others=3)
    volumes = [
        _damaged("M1", f"the object's volume: {n}", VOLUME, damage, (0, 1)) for n, damage in DAMAGES.items()
    ]
    yield from in_turn(OF_OBJECTS, *volumes)
    for name, damage in DAMAGES.items():
        yield Case("M1", f"a gallery: {name}", GALLERY, _gallery(damage), "release", (0, 1), errors=2)
        yield Case("M1", f"the authors' file: {name}", IMPORT, _authors(damage), "release", (1,))
    yield from on(
        READERS, Case("M1", "a pair that grows to 8 GB afterwards", "", _grown, "release", (0, 1), errors=2)
    )
    yield Case(
        "L", "a pair that was changed afterwards", "load release", _changed, "release", (1,), "changed"
    )
    yield Case(
        "H5",
        "an export that names files elsewhere",
        "import exported imported",
        _names_out,
        "release",
        (1,),
        "leads out",
    )
    yield Case(
        "H4", "an export whose file is a pipe", "import exported imported", _export_pipe, "release", (1,)
    )
    yield Case(
        "M3", "an export whose list is brackets", "import exported imported", _export_deep, "release", (1, 2)
    )
    yield Case(
        "M5",
        "an export of names with control characters",
        "import exported imported",
        _export_names,
        "release",
        (1,),
    )
    yield Case(
        "M6",
        "an export of 100,000 pairs that are not there",
        "import exported imported",
        _export_many,
        "release",
        (1,),
    )


def _damaged(
    group: str, name: str, file: str, damage: Callable[[Path], object], statuses: tuple[int, ...] = (0, 1, 3)
) -> Case:
    def make(folder: Path) -> None:
        damage(folder / "release" / file)
        seal(folder / "release")

    return Case(group, name, "", make, "release", statuses, errors=4)


def _npy(shape: tuple[int, ...], descr: str = "|u1") -> bytes:
    header = f"{{'descr': {descr!r}, 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header


def _with_member(
    path: Path, name: str, data: bytes, method: int = zipfile.ZIP_DEFLATED, flags: int = 0
) -> None:
    """The npz with other bytes for one of its arrays, whichever comes first with that name."""
    with zipfile.ZipFile(path) as archive:
        members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    name = name if any(one == name for one, _ in members) else members[0][0]
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for one, content in members:
            if one != name:
                archive.writestr(one, content)
    with zipfile.ZipFile(buffer, "a", method) as archive:
        archive.writestr(name, data)
    whole = bytearray(buffer.getvalue())
    whole[whole.rindex(b"PK\1\2") + 8] |= flags
    path.write_bytes(whole)


def _bomb(path: Path) -> None:
    """An array that unpacks to more than 1 GB."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(path) as archive:
        members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    last = "full.npy" if any(name == "full.npy" for name, _ in members) else members[-1][0]
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members:
            if name != last:
                archive.writestr(name, content)
        add_bomb(archive, buffer, zipfile.ZipInfo(last), _npy((BOMB_MB << 10, 1 << 10)))
    path.write_bytes(buffer.getvalue())


def _two_bombs(path: Path) -> None:
    """Two arrays more than a pair has, of a gigabyte each."""
    buffer = io.BytesIO(path.read_bytes())
    with zipfile.ZipFile(buffer, "a", zipfile.ZIP_DEFLATED) as archive:
        for name in ("more.npy", "yet_more.npy"):
            archive.fp.seek(archive.start_dir)  # type: ignore[union-attr]
            add_bomb(archive, buffer, zipfile.ZipInfo(name), _npy((BOMB_MB << 10, 1 << 10)))
    path.write_bytes(buffer.getvalue())


def _lies(path: Path) -> None:
    """An array that unpacks to 1 GB and says 100 bytes."""
    _bomb(path)
    content = bytearray(path.read_bytes())
    struct.pack_into("<I", content, content.rindex(b"PK\1\2") + 24, 100)
    path.write_bytes(content)


DAMAGES: dict[str, Callable[[Path], object]] = {
    "an array of 1 GB": _bomb,
    "arrays more": _two_bombs,
    "an array that lies": _lies,
    "10^15 cells": lambda path: _with_member(path, "full.npy", _npy((10**5,) * 3)),
    "a shape of 10^30": lambda path: _with_member(path, "full.npy", _npy((10**30,))),
    "encrypted": lambda path: _with_member(path, "full.npy", b"", flags=1),
    "lzma": lambda path: _with_member(path, "full.npy", b"", zipfile.ZIP_LZMA),
    "bzip2": lambda path: _with_member(path, "full.npy", b"x" * 99, zipfile.ZIP_BZIP2),
    "objects": lambda path: _with_member(path, "full.npy", _npy((1,), "|O") + b"cos\nsystem\n(S'id'\ntR."),
    "complex numbers": lambda path: _with_member(path, "K.npy", _npy((3, 3), "<c16") + bytes(144)),
    "a single array": lambda path: path.write_bytes(_npy((1,)) + b"1"),
    "no bytes": lambda path: path.write_bytes(b""),
    "a name with a way out": lambda path: _renamed(path, "../../out.npy"),
}


def _renamed(path: Path, name: str) -> None:
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(name, _npy((1,)) + b"1")


def _gallery(damage: Callable[[Path], object]) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        damage(next((folder / "scores").rglob("gallery.npz")))

    return make


def _grown(folder: Path) -> None:
    os.truncate(folder / "release" / PAIR, 8 << 30)


def _changed(folder: Path) -> None:
    from kinectbench.core.voxels.npz import load_arrays, npz_bytes

    path = folder / "release" / PAIR
    arrays = load_arrays(path)
    arrays["partial"] = np.zeros_like(arrays["partial"])
    path.write_bytes(npz_bytes(arrays))


def _exported(folder: Path) -> Path:
    from kinectbench.release.exchange.recgan import export_recgan
    from kinectbench.release.release import open_release

    export_recgan(open_release(folder / "release"), folder / "exported")
    return folder / "exported"


def _authors(damage: Callable[[Path], object]) -> Callable[[Path], None]:
    """Files of the authors' layout without a list, one of them damaged."""

    def make(folder: Path) -> None:
        _exported(folder).rename(folder / "authors")
        (folder / "authors/export.json").unlink()
        damage(next((folder / "authors").rglob("*_25d_vox256/*.npz")))

    return make


def _edit(folder: Path, before: str, after: str) -> None:
    import re

    path = _exported(folder) / "export.json"
    text = path.read_text(encoding="utf-8")
    changed = re.sub(before, lambda _: after, text, count=1)
    assert changed != text
    path.write_text(changed, encoding="utf-8")


def _names_out(folder: Path) -> None:
    _edit(folder, r'"file_25d": "[^"]+"', '"file_25d": "../secret.npz"')


def _export_pipe(folder: Path) -> None:
    path = next(_exported(folder).rglob("*.npz"))
    path.unlink()
    os.mkfifo(path)


def _export_deep(folder: Path) -> None:
    (_exported(folder) / "export.json").write_text("[" * 100_000, encoding="utf-8")


def _export_names(folder: Path) -> None:
    _edit(folder, r'"recording": "[^"]+"', '"recording": "../\\u001b[2J\\nerror: x"')


def _export_many(folder: Path) -> None:
    import json

    path = _exported(folder) / "export.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    content["pairs"] = content["pairs"][:1] * 100_000
    for number, row in enumerate(content["pairs"][:1]):
        row["file_3d"] = f"nowhere/{number}.npz"
    path.write_text(json.dumps(content), encoding="utf-8")
