"""Results that somebody changed and sealed again: releases, tables, and what earlier runs left there."""

import json
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from fuzz.releases import seal

from hostile_cases.case import Case, on
from hostile_cases.releases import SCORE, VERIFY

NAME = "chair_01"
PAIR, OBJECT = f"release/pairs/{NAME}/000.npz", f"release/objects/{NAME}"
TABLE = "scores/a/scores.json"
RECHECK = f"score predictions --benchmark release --jobs 1 --recheck {TABLE}"
JOURNAL = "scored/.counted.jsonl"
Change = Callable[[dict[str, Any]], object]


def cases() -> Iterator[Case]:
    # What stands nowhere else is believed: its identity is another.
    def believed(said: dict[str, Any]) -> None:
        said["packages"].update(numpy="0.1")

    yield from on(VERIFY, _release("packages", _benchmark(believed), 0, "all well"))
    yield from on(VERIFY, *(_release(name, make, 1, says) for name, (make, says) in RELEASES.items()))
    yield from on(RECHECK, *(_table(name, change, says) for name, (change, says) in TABLES.items()))
    for kind, put in JOURNALS.items():
        yield Case("L", f"a journal that is {kind}", SCORE, _beside(put), "release", (1,), "remove it")
    yield Case("L", "a journal that is made up", SCORE, _made_up, "release", (1,), "score again")


def _release(name: str, make: Callable[[Path], object], status: int, says: str) -> Case:
    def sealed(folder: Path) -> None:
        make(folder)
        seal(folder / "release")

    return Case("L", f"forged: {name}", "", sealed, "release", (status,), says, errors=8)


def _benchmark(change: Change) -> Callable[[Path], object]:
    return _json("release/benchmark.json", change)


def _json(file: str, change: Change) -> Callable[[Path], object]:
    def make(folder: Path) -> None:
        said = json.loads((folder / file).read_text(encoding="utf-8"))
        change(said)
        (folder / file).write_text(json.dumps(said), encoding="utf-8")

    return make


def _recording(**values: Any) -> Callable[[Path], object]:
    return _benchmark(lambda said: said["recordings"][NAME].update(values))


def _grown(folder: Path) -> None:
    """The true shape of a pair grown by five cells, with a surface that is its own."""
    from scipy import ndimage

    from kinectbench.core.voxels.pair_file import pack, pair_bytes, read_pair, unpack
    from kinectbench.core.voxels.solid import packed_shell

    pair = read_pair(folder / PAIR)
    full = pack(ndimage.binary_dilation(unpack(pair.full), iterations=5))
    (folder / PAIR).write_bytes(pair_bytes(replace(pair, full=full, shell=packed_shell(full))))


def _less_known(folder: Path) -> None:
    """A part of the true shape is no longer known: what is wrong there is not counted."""
    from kinectbench.core.voxels.pair_file import pair_bytes, read_pair

    pair = read_pair(folder / PAIR)
    (folder / PAIR).write_bytes(pair_bytes(replace(pair, known=pair.known & np.uint8(0xF0))))


def _mesh(times: float) -> Callable[[Path], object]:
    def make(folder: Path) -> None:
        from kinectbench.core.geometry.mesh import read_own_ply, write_ply

        mesh = read_own_ply(folder / OBJECT / "mesh.ply")
        write_ply(replace(mesh, vertices=mesh.vertices * times), folder / OBJECT / "mesh.ply")

    return make


def _fans(folder: Path) -> None:
    """A mesh all of whose million triangles cross all lines through the cube."""
    import numpy as np

    from kinectbench.core.geometry.mesh import read_own_ply, write_ply

    mesh = read_own_ply(folder / OBJECT / "mesh.ply")
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    wide = np.linspace(3 * low - 2 * high, 3 * high - 2 * low, 3)
    faces = np.tile(np.array([[0, 1, 2], [0, 2, 1]], np.int32), (500_000, 1))
    write_ply(replace(mesh, vertices=wide * [1, -1, 1], faces=faces), folder / OBJECT / "mesh.ply")


RELEASES: dict[str, tuple[Callable[[Path], object], str]] = {
    "quality": (_recording(quality={"repeatability_iou": 0.999}), "quality.json"),
    "settings": (
        _benchmark(lambda said: said["settings"]["pairs"].update(framing="view")),
        "settings.pairs.framing",
    ),
    "refused": (_recording(refused=7), "refused where"),
    "licence": (_benchmark(lambda said: said.update(license="MIT")), "another license"),
    "poor without a reason": (_recording(poor=["publish.gate.max_unknown_share"]), "go together"),
    "left out, and never built": (
        _benchmark(lambda said: said.update(left_out={"nobody": "was bad"})),
        "left_out.nobody",
    ),
    "the true shape is grown": (_grown, "cells of 'full' are not as its mesh.ply"),
    "less is known": (_less_known, "cells of 'known' are not as its volume.npz"),
    "a mesh of another size": (_mesh(1.02), "are not as"),
    "a mesh in millimetres": (_mesh(1000.0), "cannot be compared"),
    "a mesh of a million faces across each other": (_fans, "across each other"),
}


def _unknown(said: dict[str, Any]) -> None:
    """The worst rows are declared to have nothing that is known."""
    for row in said["rows"]:
        if row["protocol"] == "known":
            row.update(dict.fromkeys(("iou", "precision", "recall", "f1", "ce"), None))
            said["all_unknown_pairs"]["known"].append(f"{row['recording']}/{row['view']}")


def _table(name: str, change: Change, says: str) -> Case:
    def make(folder: Path) -> None:
        (folder / "predictions/method.json").write_text('{"name": "a"}', encoding="utf-8")
        _json(TABLE, change)(folder)

    return Case("L", f"recheck: {name}", "", make, "release", (1, 2, 3), says, errors=8)


TABLES: dict[str, tuple[Change, str]] = {
    "rows declared all unknown": (_unknown, "error: "),
    "another name of the method": (lambda said: said.update(method="theirs"), "error: "),
    "a warning is deleted": (lambda said: said.update(warnings=[]), "error: "),
    "a better row": (lambda said: said["rows"][0].update(iou=0.999), "error: "),
}


def _beside(put: Callable[[Path], object]) -> Callable[[Path], object]:
    def make(folder: Path) -> None:
        (folder / JOURNAL).parent.mkdir()
        (folder / "elsewhere").write_text("mine", encoding="utf-8")
        put(folder / JOURNAL)

    return make


JOURNALS: dict[str, Callable[[Path], object]] = {
    "a pipe": os.mkfifo,
    "a link out": lambda path: path.symlink_to("../elsewhere"),
    "a link to zeros": lambda path: path.symlink_to("/dev/zero"),
    "a folder": lambda path: path.mkdir(),
}


def _made_up(folder: Path) -> None:
    """What a stopped run would have left, if its predictions had been the truth."""
    from kinectbench.core.artefacts.counted import CountedPair
    from kinectbench.core.storage import canonical_json
    from kinectbench.release.release import open_release
    from kinectbench.scoring.pair_result import PairJob, count_job, counting_of

    release = open_release(folder / "release")
    counting = counting_of(release, None, "half-pixel", surface=False)
    lines = []
    for target in release.targets:
        file = folder / "predictions" / target.recording / f"{target.view}.npy"
        threshold = None if target.split == "validation" else 0.5
        job = PairJob(target, release.pair_path(target), file, threshold, counting)
        result = count_job(job)
        assert not isinstance(result, str)
        said = CountedPair(pair=target.name, key=job.key(result.digest), result=result).json_value()
        tally = said["result"]["tally"]
        tally["above"] = [[n * (code % 2) for code, n in enumerate(tally["voxels"])]] * len(tally["above"])
        lines.append(canonical_json(said) + "\n")
    (folder / JOURNAL).parent.mkdir()
    (folder / JOURNAL).write_text("".join(lines), encoding="utf-8")
