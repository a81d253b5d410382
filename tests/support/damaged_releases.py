"""Some fifty ways to damage a release, each of which `verify` has to name.

Each damage is done to a copy. Some are what disks and downloads do; those that are `sealed` are mistakes of
whoever published: all checksums agree. Archives are damaged as such.
"""

import json
import shutil
import tarfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from file_damage import (
    add_poses,
    cut,
    edit_lines,
    edit_pair,
    edit_targets,
    empty_full,
    exchange,
    flip,
    flip_in_tar,
    flip_in_zip,
    forge,
    link,
    pipe,
    put,
    seal,
    set_corner,
    shear,
    targets,
    tarred,
    turn_bits,
    void,
    zipped,
)

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
        lambda f: forge(f, pair),
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
    yield Damage("a tar.gz cut off", lambda f: cut(tarred(f, "w:gz")), ("release.tar: cut off or damaged",))
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
        (
            f"{pair}: 0.0 of the true shape is unknown",
            "cells of 'full' are not as its mesh.ply",
            "visible_share is",
        ),
    )
    yield Damage(
        "nothing known",
        pair_with(known=np.zeros((256, 256, 32), np.uint8)),
        (f"{pair}: only 0 of the", f"{pair}: 1.0 of the true shape is unknown"),
        True,
        ("cells of 'known' are not as its volume.npz",),
    )
    yield Damage(
        "nothing seen",
        pair_with(seen=np.zeros((256, 256, 32), np.uint8)),
        (f"{pair}: only 0 of the", "cells of 'seen' are not as its view's depth has them"),
        True,
        ("visible_share is",),
    )
    yield Damage(
        "another framing",
        pair_with(framing=np.asarray("view")),
        (f"{pair}: framing is 'view'", f"{pair}: its cube is not that of its view's depth"),
        True,
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
