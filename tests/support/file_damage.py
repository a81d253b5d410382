"""Changes to the files of a release: bits, entries, rows, archives; and its checksums made right again."""

import csv
import hashlib
import io
import json
import os
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np

from kinectbench.core.artefacts.targets import benchmark_sha256


def targets(release: Path) -> list[dict[str, str]]:
    """The rows of targets.csv."""
    with (release / "targets.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def void(_: object) -> None:
    """For damages that are several steps."""


def forge(release: Path, file: str) -> None:
    """One bit flips, and the checksums are made anew."""
    flip(release / file)
    resum(release, file)


def put(path: Path, content: bytes) -> None:
    path.write_bytes(content)


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)


def cut(path: Path) -> Path:
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    return path


def exchange(one: Path, two: Path) -> None:
    first, second = one.read_bytes(), two.read_bytes()
    one.write_bytes(second)
    two.write_bytes(first)


def link(path: Path, to: Path) -> None:
    path.unlink()
    path.symlink_to(to)


def pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def edit_pair(path: Path, values: dict[str, object]) -> None:
    """Replace, add or (None) take out keys of a pair file."""
    with np.load(path) as pair:
        arrays = {key: pair[key] for key in pair.files} | values
    np.savez_compressed(path, **{key: value for key, value in arrays.items() if value is not None})


def shear(path: Path) -> None:
    with np.load(path) as pair:
        T = pair["T_world_camera"].copy()
    T[0, :3] += 0.1 * T[1, :3]
    edit_pair(path, {"T_world_camera": T})


def turn_bits(path: Path) -> None:
    """Pack `partial_256` least significant bit first, the likeliest mistake of another writer."""
    with np.load(path) as pair:
        bits = np.unpackbits(pair["partial_256"], axis=-1)
    edit_pair(path, {"partial_256": np.packbits(bits, axis=-1, bitorder="little")})


def set_corner(path: Path, key: str) -> None:
    with np.load(path) as pair:
        grid = pair[key].copy()
    grid[0, 0, 0] ^= 128
    edit_pair(path, {key: grid})


def empty_full(path: Path) -> None:
    empty = np.zeros((256, 256, 32), np.uint8)
    edit_pair(path, {"full": empty, "shell": empty})


def add_poses(path: Path) -> None:
    content = json.loads(path.read_text(encoding="utf-8"))
    content["views"][0]["T_world_camera"] = np.eye(4).tolist()
    path.write_text(json.dumps(content), encoding="utf-8")


def edit_lines(release: Path, change: Callable[[list[str]], list[str]]) -> None:
    path = release / "targets.csv"
    path.write_text("".join(change(path.read_text().splitlines(keepends=True))))


def edit_targets(
    release: Path, index: int, more: dict[int, dict[str, str]] | None = None, **values: str
) -> None:
    rows = targets(release)
    for at, changes in {index: values, **(more or {})}.items():
        rows[at] |= changes
    with (release / "targets.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def resum(release: Path, *names: str) -> None:
    """Put the hashes that files have now into SHA256SUMS."""
    path = release / "SHA256SUMS"
    lines = [line.split("  ", 1) for line in path.read_text().splitlines()]
    path.write_text(
        "".join(f"{sha256(release / name) if name in names else old}  {name}\n" for old, name in lines)
    )


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def seal(release: Path) -> None:
    """Make every checksum right again, as a publisher's own mistake would have them."""
    rows = {row["file"]: row["sha256"] for row in targets(release)}
    for table in (
        release / "targets.csv",
        *release.glob("targets/*.csv"),
        *release.glob("previews/*/*.jsonl"),
    ):
        text = table.read_text()
        for file, old in rows.items():
            if (release / file).is_file():
                text = text.replace(old, sha256(release / file))
        table.write_text(text)
    croissant = release / "croissant.json"
    content = json.loads(croissant.read_text())
    for file in content["distribution"]:
        if "sha256" in file:
            file["sha256"] = sha256(release / file["contentUrl"])
    croissant.write_text(json.dumps(content))
    names = sorted(p.relative_to(release).as_posix() for p in release.rglob("*") if p.is_file())
    lines = {n: f"{sha256(release / n)}  {n}\n" for n in names if n not in ("SHA256SUMS", "benchmark.json")}
    metadata = json.loads((release / "benchmark.json").read_text())
    metadata["benchmark_sha256"] = benchmark_sha256("".join(lines.values()), json.dumps(metadata))
    (release / "benchmark.json").write_text(json.dumps(metadata))
    lines["benchmark.json"] = f"{sha256(release / 'benchmark.json')}  benchmark.json\n"
    (release / "SHA256SUMS").write_text("".join(lines[name] for name in sorted(lines)))


def zipped(
    release: Path, without: str = "", more: dict[str, bytes] | None = None, claimed: int | None = None
) -> Path:
    """The release as a zip, without a file or with some more, the last of which claims another size."""
    path = release.parent / "release.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(release.rglob("*")):
            name = file.relative_to(release).as_posix()
            if file.is_file() and name != without:
                archive.write(file, name)
        for name, content in (more or {}).items():
            archive.writestr(name, content)
        archive.filelist[-1].file_size = claimed or archive.filelist[-1].file_size
    return path


def tarred(
    release: Path, packing: Literal["w", "w:gz"] = "w", more: str = "", kind: bytes = tarfile.REGTYPE
) -> Path:
    path = release.parent / "release.tar"
    with tarfile.open(path, packing) as archive:
        archive.add(release, "furniture-1.0")
        if more:
            entry = tarfile.TarInfo(more if more.startswith("/") else f"furniture-1.0/{more}")
            entry.type, entry.linkname = kind, "/etc/passwd"
            archive.addfile(entry, io.BytesIO())
    return path


def flip_in_zip(path: Path, name: str) -> Path:
    with zipfile.ZipFile(path) as archive:
        info = archive.getinfo(name)
    at = info.header_offset + 30 + len(name) + info.compress_size // 2
    return flip_at(path, at)


def flip_in_tar(path: Path, name: str) -> Path:
    with tarfile.open(path) as archive:
        info = archive.getmember(f"furniture-1.0/{name}")
    return flip_at(path, info.offset_data + info.size // 2)


def flip_at(path: Path, at: int) -> Path:
    content = bytearray(path.read_bytes())
    content[at] ^= 4
    path.write_bytes(content)
    return path
