"""Damage a release in many ways and see that `verify` names each.

    python benchmarks/damaged_releases.py [RELEASE] [PUBLIC_PART]

Without a release it makes a small one of two pairs, which takes a minute. Each damage is done to a copy.
Some are what disks and downloads do; those that are `sealed` are mistakes of whoever published: all checksums
agree. Archives are damaged as such.
"""

import argparse
import csv
import hashlib
import io
import json
import os
import shutil
import tarfile
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fuzz.releases import RELEASE, make_release

from kinectbench.core.artefacts.targets import benchmark_sha256
from kinectbench.core.errors import KinectBenchError
from kinectbench.release.check.verify import verify

CHANGED = "{}: changed since it was published"


@dataclass(frozen=True)
class Damage:
    """A way to damage a release.

    Attributes:
        name: in words.
        do: takes the copy's folder; returns what is to be verified, if not the folder itself.
        named: what the lines of verify must hold, one each at least; and no line may hold none of them.
        sealed: the checksums are made right again afterwards.
        also: what lines may hold besides, where the release says more of itself.
    """

    name: str
    do: Callable[[Path], Path | None]
    named: tuple[str, ...]
    sealed: bool = False
    also: tuple[str, ...] = ()


def damages(release: Path) -> Iterator[Damage]:
    """Every damage, for a release's own names; those of a public part only if it is one."""
    rows = targets(release)
    pair, last = rows[0]["file"], rows[-1]["file"]
    recording, view = pair.split("/")[1], Path(pair).stem
    mesh, depth = f"objects/{recording}/mesh.ply", f"views/{recording}/{view}.depth.png"
    held_back = json.loads((release / "benchmark.json").read_text()).get("held_back", [])
    if held_back:
        hidden = next(row for row in rows if row["split"] in held_back)
        yield from _of_public_parts(hidden["recording"], hidden["file"])
    else:
        yield from _of_bytes(pair, last, mesh, depth)
        yield from _of_targets(len(rows))
        yield from _of_archives(pair)
        yield from _of_pairs(pair)
        yield from _of_metadata(rows[0])


def _of_bytes(pair: str, last: str, mesh: str, depth: str) -> Iterator[Damage]:
    yield Damage("a bit of a pair flipped", lambda f: flip(f / pair), (CHANGED.format(pair),))
    yield Damage("a bit of a mesh flipped", lambda f: flip(f / mesh), (CHANGED.format(mesh),))
    yield Damage("a bit of a depth image flipped", lambda f: flip(f / depth), (CHANGED.format(depth),))
    yield Damage("a pair cut off", lambda f: void(cut(f / pair)), (CHANGED.format(pair),))
    yield Damage("a file emptied", lambda f: put(f / depth, b""), (CHANGED.format(depth),))
    yield Damage(
        "two pairs exchanged",
        lambda f: exchange(f / pair, f / last),
        (CHANGED.format(pair), CHANGED.format(last)),
    )
    yield Damage("a pair missing", lambda f: (f / pair).unlink(), (f"{pair}: missing",))
    yield Damage("a depth image missing", lambda f: (f / depth).unlink(), (f"{depth}: missing",))
    yield Damage("the checksums missing", lambda f: (f / "SHA256SUMS").unlink(), ("SHA256SUMS: missing",))
    yield Damage(
        "a line of the checksums broken", lambda f: put(f / "SHA256SUMS", b"x\n"), ("SHA256SUMS, line 1",)
    )
    yield Damage(
        "benchmark.json missing", lambda f: (f / "benchmark.json").unlink(), ("benchmark.json: missing",)
    )
    yield Damage("a file more", lambda f: put(f / "views" / "note.txt", b"hi"), ("views/note.txt: not part",))
    yield Damage("a link to another file", lambda f: link(f / pair, f / last), (CHANGED.format(pair),))
    yield Damage(
        "a link to nowhere", lambda f: link(f / pair, f / "no"), (f"{pair}: a link that leads nowhere",)
    )
    yield Damage(
        "a link to a device", lambda f: link(f / pair, Path("/dev/zero")), (f"{pair}: not a plain file",)
    )
    yield Damage("a pipe instead of a file", lambda f: pipe(f / pair), (f"{pair}: not a plain file",))
    yield Damage(
        "a pair and its checksum forged",
        lambda f: void(flip(f / pair), resum(f, pair)),
        (
            "benchmark.json: its benchmark_sha256 is not of SHA256SUMS",
            "targets.csv, line 2: another SHA-256",
            pair,
        ),
    )


def _of_targets(count: int) -> Iterator[Damage]:
    changed = CHANGED.format("targets.csv")
    yield Damage(
        "a category changed in targets.csv",
        lambda f: edit_targets(f, 0, category="sofa"),
        (changed, "targets.csv, line 2: category 'sofa'"),
    )
    yield Damage(
        "a line taken out of targets.csv",
        lambda f: edit_lines(f, lambda lines: lines[:-1]),
        (changed, "targets.csv: no line for pairs/", "pairs of "),
    )
    yield Damage(
        "a line of targets.csv doubled",
        lambda f: edit_lines(f, lambda lines: [*lines, lines[-1]]),
        (changed, f"targets.csv, line {count + 2}: "),
    )
    yield Damage(
        "a way out of the release in targets.csv",
        lambda f: edit_targets(f, 0, file="../../etc/passwd"),
        (changed, "targets.csv, line 2: file '../../etc/passwd'"),
    )


def _of_archives(pair: str) -> Iterator[Damage]:
    yield Damage("a zip cut off", lambda f: cut(zipped(f)), ("release.zip: cut off or damaged",))
    yield Damage("a tar.gz cut off", lambda f: cut(tarred(f, "gz")), ("release.tar: cut off or damaged",))
    yield Damage("a tar cut off", lambda f: cut(tarred(f)), ("release.tar: cut off or damaged",))
    yield Damage("a bit flipped in a zip", lambda f: flip_in_zip(zipped(f), pair), (f"{pair}: ",))
    yield Damage("a bit flipped in a tar", lambda f: flip_in_tar(tarred(f), pair), (CHANGED.format(pair),))
    yield Damage("a file missing in a zip", lambda f: zipped(f, without=pair), (f"{pair}: missing",))
    yield Damage("a file twice in a zip", lambda f: zipped(f, more={pair: b"x"}), (f"{pair}: twice",))
    yield Damage(
        "a way out of a zip",
        lambda f: zipped(f, more={"../evil": b"x"}),
        ("'../evil': a name that leads out",),
    )
    yield Damage(
        "an absolute path in a tar", lambda f: tarred(f, more="/evil"), ("'/evil': a name that leads out",)
    )
    yield Damage(
        "a link in a tar",
        lambda f: tarred(f, more="evil", kind=tarfile.SYMTYPE),
        ("evil: not part of the release",),
    )
    yield Damage(
        "a zip that swells",
        lambda f: zipped(f, more={"zeros": b"0"}, claimed=10**12),
        ("release.zip: claims to hold more than 100 times its size",),
    )


def _of_pairs(pair: str) -> Iterator[Damage]:
    def pair_with(**values: object) -> Callable[[Path], None]:
        return lambda f: edit_pair(f / pair, values)

    yield Damage(
        "a key of a pair missing", pair_with(known=None), (f"{pair}: not a pair file: the keys known",), True
    )
    yield Damage(
        "a grid of another shape",
        pair_with(full=np.zeros((4, 4), np.uint8)),
        (f"{pair}: 'full' is uint8(4, 4)",),
        True,
    )
    yield Damage(
        "numbers that are none", pair_with(K=np.full((3, 3), np.nan)), (f"{pair}: 'K' is not a finite",), True
    )
    yield Damage(
        "a camera that shears",
        lambda f: shear(f / pair),
        (f"{pair}: T_world_camera is not", f"{pair}: the grid's axes"),
        True,
    )
    yield Damage("bits in the other order", lambda f: turn_bits(f / pair), (f"{pair}: ",), True)
    yield Damage(
        "an input that is not the reduction",
        lambda f: set_corner(f / pair, "partial"),
        (f"{pair}: 1 cells of 'partial' are not",),
        True,
    )
    yield Damage(
        "a shell that is not the surface",
        lambda f: set_corner(f / pair, "shell"),
        (f"{pair}: 1 cells of 'shell'",),
        True,
    )
    yield Damage(
        "another object's truth",
        lambda f: empty_full(f / pair),
        (f"{pair}: 'full' is empty", f"{pair}: containment is 0.000"),
        True,
        (f"{pair}: 0.0 of the true shape is unknown", "cells of 'full' are not as its mesh.ply"),
    )
    yield Damage(
        "nothing known",
        pair_with(known=np.zeros((256, 256, 32), np.uint8)),
        (f"{pair}: only 0 of the", f"{pair}: 1.0 of the true shape is unknown"),
        True,
        ("cells of 'known' are not as its volume.npz",),
    )
    yield Damage(
        "nothing seen", pair_with(seen=np.zeros((256, 256, 32), np.uint8)), (f"{pair}: only 0 of the",), True
    )
    yield Damage(
        "another framing", pair_with(framing=np.asarray("view")), (f"{pair}: framing is 'view'",), True
    )
    yield Damage(
        "a pair that swells",
        pair_with(more=np.zeros(8 << 20, np.uint8)),
        (f"{pair}: cannot be read as a pair file (claims to unpack to",),
        True,
    )


def _of_metadata(row: dict[str, str]) -> Iterator[Damage]:
    recording = row["recording"]
    split = "train" if row["split"] != "train" else "test"
    quality, views = f"objects/{recording}/quality.json", f"views/{recording}/views.json"
    shared = {"object": "other", "category": row["category"]}
    yield Damage(
        "an object in two splits",
        lambda f: edit_targets(f, 0, object="other", more={-1: {**shared, "split": split}}),
        (
            "targets.csv: object 'other' is in two splits",
            "targets.csv, line",
            "splits.json",
            "README.md",
            "targets/",
            "previews/",
        ),
        True,
    )
    yield Damage(
        "a split that benchmark.json does not have",
        lambda f: edit_targets(f, 0, split=split),
        ("targets.csv, line 2: split", "targets.csv", "splits.json", "README.md", "targets/", "previews/"),
        True,
    )
    yield Damage(
        "a number that JSON does not know",
        lambda f: put(f / quality, b'{"volume_m3": NaN}'),
        (f"{quality}: not valid JSON",),
        True,
    )
    yield Damage(
        "a value of another type",
        lambda f: put(f / quality, b'{"volume_m3": "big"}'),
        (f"{quality}: 'volume_m3'",),
        True,
    )
    yield Damage(
        "views.json without its views",
        lambda f: put(f / views, b'{"format_version": 1, "views": [], "refused": []}'),
        (f"{views}: ",),
        True,
    )
    yield Damage(
        "the card of another benchmark",
        lambda f: put(f / "README.md", b"# Chairs\n"),
        ("README.md: does not",),
        True,
    )
    yield Damage(
        "a licence that leaves one out",
        lambda f: put(f / "LICENSE", b"MIT\n"),
        ("LICENSE: does not state licence and source of",),
        True,
    )
    yield Damage(
        "a split's table of another release",
        lambda f: put(f / "targets" / f"{row['split']}.csv", b"x\n"),
        (f"targets/{row['split']}.csv: not the lines",),
        True,
    )
    yield Damage(
        "a row of another view",
        lambda f: put(f / "previews" / row["split"] / "metadata.jsonl", b"{}\n"),
        (f"previews/{row['split']}/metadata.jsonl: not the lines",),
        True,
    )
    yield Damage(
        "views without their images",
        lambda f: (f / f"views/{recording}/{Path(row['file']).stem}.mask.png").unlink(),
        (".mask.png: missing, targets.csv has its pair",),
        True,
    )


def _of_public_parts(recording: str, pair: str) -> Iterator[Damage]:
    full = np.zeros((256, 256, 32), np.uint8)
    yield Damage(
        "truth in a pair that is held back",
        lambda f: edit_pair(f / pair, {"full": full}),
        (f"{pair}: holds full, which is held back",),
        True,
    )
    mesh = f"objects/{recording}/mesh.ply"
    yield Damage(
        "a mesh that is held back",
        lambda f: put(f / mesh, b"ply"),
        (f"{mesh}: truth of a split that is held back",),
        True,
    )
    views = f"views/{recording}/views.json"
    yield Damage(
        "poses that are held back",
        lambda f: add_poses(f / views),
        (f"{views}: holds T_world_camera, which is held back", "T_world_camera is not that of views.json"),
        True,
    )


def targets(release: Path) -> list[dict[str, str]]:
    """The rows of targets.csv."""
    with (release / "targets.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def void(*_: object) -> None:
    """For damages that are several steps."""


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


def tarred(release: Path, packing: str = "", more: str = "", kind: bytes = tarfile.REGTYPE) -> Path:
    path = release.parent / "release.tar"
    with tarfile.open(path, f"w:{packing}") as archive:
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


def lines_of(path: Path) -> list[str]:
    """What verify says, its refusals too, without the folder of the copy."""
    try:
        lines = verify(path)
    except KinectBenchError as error:
        lines = [str(error)]
    return [line.replace(f"{path.parent}/", "") for line in lines]


def try_damage(damage: Damage, release: Path, work: Path) -> tuple[list[str], bool]:
    """Damage a copy and verify it: what it says, and whether the damage is named and nothing else."""
    copy = Path(shutil.copytree(release, work / "copy" / "release"))
    subject = damage.do(copy) or copy
    if damage.sealed:
        seal(copy)
    lines = lines_of(subject)
    named = all(any(part in line for line in lines) for part in damage.named)
    shutil.rmtree(work / "copy")
    return lines, named and all(any(part in line for part in (*damage.named, *damage.also)) for line in lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("release", type=Path, nargs="*", help="a complete release, or the public part of one")
    done = right = 0
    made = tempfile.TemporaryDirectory()
    releases = parser.parse_args().release
    if not releases:
        make_release(Path(made.name))
        releases = [Path(made.name) / RELEASE]
    for release in releases:
        assert verify(release) == [], f"{release} is damaged already"
        with tempfile.TemporaryDirectory() as work:
            for damage in damages(release):
                started = time.perf_counter()
                lines, well = try_damage(damage, release, Path(work))
                done, right = done + 1, right + well
                seconds = time.perf_counter() - started
                verdict = "named" if well else "WRONG"
                print(f"{verdict}  {damage.name:44} {seconds:5.1f} s  {lines[0] if lines else '-'}")
    print(f"{right} of {done} damages named rightly")


if __name__ == "__main__":
    main()
