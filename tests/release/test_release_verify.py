"""verify names every kind of damage, one line each."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from raising import raises
from synthetic_release import resum, synthetic_pair

from kinectbench.core.artefacts.targets import benchmark_sha256
from kinectbench.core.artefacts.views import ViewsFile
from kinectbench.core.errors import ReleaseError
from kinectbench.core.voxels.pair_file import Pair, pack
from kinectbench.release.check.verify import CHANGED, EXTRA, MISSING, verify
from kinectbench.release.check.view_check import pair_problems
from kinectbench.release.release import Release


@pytest.fixture
def copy(release: Release, tmp_path: Path) -> Path:
    return Path(shutil.copytree(release.folder, tmp_path / "benchmark"))


def test_sound(release: Release) -> None:
    progress: list[tuple[int, int]] = []
    assert verify(release.folder, lambda *done: progress.append(done)) == []
    assert progress[-1][0] == progress[-1][1] == len(progress)


def flip(path: Path, position: int = 1000) -> None:
    content = bytearray(path.read_bytes())
    content[position % len(content)] ^= 4
    path.write_bytes(content)


def change_target(folder: Path) -> None:
    path = folder / "targets.csv"
    path.write_text(
        path.read_text().replace("chair_02,blue_chair,000,chair,test", "chair_02,blue_chair,000,sofa,test")
    )


def card_lost_and_a_link_more(folder: Path) -> None:
    (folder / "README.md").unlink()
    (folder / "out").symlink_to("/")


def link(folder: Path) -> None:
    (folder / "README.md").unlink()
    (folder / "README.md").symlink_to("targets.csv")


DAMAGE: dict[str, tuple[Callable[[Path], object], list[str]]] = {
    "flipped bit in a pair": (
        lambda folder: flip(folder / "pairs/chair_01/001.npz"),
        [CHANGED.format("pairs/chair_01/001.npz")],
    ),
    "flipped bit in a mesh": (
        lambda folder: flip(folder / "objects/chair_01/mesh.ply"),
        [CHANGED.format("objects/chair_01/mesh.ply")],
    ),
    "missing pair": (
        lambda folder: (folder / "pairs/table_01/000.npz").unlink(),
        [MISSING.format("pairs/table_01/000.npz")],
    ),
    "extra file": (
        lambda folder: (folder / "views/notes.txt").write_text("hello"),
        [EXTRA.format("views/notes.txt")],
    ),
    "changed target": (
        change_target,
        [
            CHANGED.format("targets.csv"),
            "targets.csv, line 4: category 'sofa' where benchmark.json has 'chair'",
        ],
    ),
    "line taken out of targets.csv": (
        lambda folder: (folder / "targets.csv").write_text(
            "".join((folder / "targets.csv").read_text().splitlines(keepends=True)[:-1])
        ),
        [
            CHANGED.format("targets.csv"),
            "targets.csv: no line for pairs/table_02/000.npz",
            "targets.csv: 0 pairs of table_02 where benchmark.json has 1",
        ],
    ),
    "link": (link, [CHANGED.format("README.md")]),
    "missing card and a link more": (
        card_lost_and_a_link_more,
        [MISSING.format("README.md"), EXTRA.format("out")],
    ),
    "benchmark.json": (
        lambda folder: (folder / "benchmark.json").write_text("{"),
        [CHANGED.format("benchmark.json")],
    ),
    "no targets": (lambda folder: (folder / "targets.csv").unlink(), [MISSING.format("targets.csv")]),
}


@pytest.mark.parametrize("name", list(DAMAGE))
def test_damage(name: str, copy: Path) -> None:
    damage, expected = DAMAGE[name]
    damage(copy)
    assert verify(copy) == expected


def test_a_forged_list_of_sums(copy: Path) -> None:
    flip(copy / "objects/chair_01/mesh.ply")
    resum(copy, "objects/chair_01/mesh.ply")
    assert verify(copy) == ["benchmark.json: its benchmark_sha256 is not of SHA256SUMS and of what it says"]


def test_a_share_of_unknown_that_the_grids_do_not_have(copy: Path) -> None:
    path = copy / "views/chair_02/views.json"
    text = path.read_text()
    (row,) = ViewsFile.parse(text, "views.json").views
    path.write_text(text.replace(f'"unknown_share": {row.unknown_share}', '"unknown_share": 0.5'))
    resum(copy, "views/chair_02/views.json")
    line = f"{row.unknown_share} of the true shape is unknown where views.json has 0.5"
    assert f"pairs/chair_02/000.npz: {line}" in verify(copy)
    content = json.loads(text)
    del content["views"][0]["unknown_share"]  # as in a release published before
    path.write_text(json.dumps(content))
    resum(copy, "views/chair_02/views.json")
    assert verify(copy) == ["benchmark.json: its benchmark_sha256 is not of SHA256SUMS and of what it says"]
    tables = [copy / "targets.csv", *(copy / "targets").iterdir()]
    for path in tables:
        path.write_text(path.read_text().replace(f",{row.unknown_share}\n", ",0.5\n"))
    names = [str(path.relative_to(copy)) for path in tables]
    resum(copy, *names)
    line = f"{row.unknown_share} of the true shape is unknown where targets.csv has 0.5"
    assert f"pairs/chair_02/000.npz: {line}" in verify(copy)
    for path in tables:  # as in a release published before
        path.write_text("".join(f"{text.rpartition(',')[0]}\n" for text in path.read_text().splitlines()))
    resum(copy, *names)
    other = "not the lines of targets.csv whose split is"
    assert verify(copy) == [
        "benchmark.json: its benchmark_sha256 is not of SHA256SUMS and of what it says",
        "croissant.json: another SHA-256 for targets.csv than in SHA256SUMS",
        *(f"previews/{split}/metadata.jsonl: {other} {split}" for split in ("validation", "test")),
    ]


def test_agreement_of_the_small_files(copy: Path) -> None:
    path = copy / "targets.csv"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join([lines[0], *lines[2:]]))
    (copy / "splits.json").write_text("{}")
    resum(copy, "targets.csv", "splits.json")
    text = (copy / "SHA256SUMS").read_text()
    old = (copy / "benchmark.json").read_text()
    identity = benchmark_sha256(text, old)
    at = old.index('"benchmark_sha256": "') + len('"benchmark_sha256": "')
    (copy / "benchmark.json").write_text(old[:at] + identity + old[at + 64 :])
    resum(copy, "benchmark.json")
    assert verify(copy) == [
        "targets.csv: no line for pairs/chair_01/000.npz",
        "targets.csv: 1 pairs of chair_01 where benchmark.json has 2",
        "splits.json: does not agree with targets.csv",
        "README.md: does not have the row '| chair | 3 | 0 | 2 | 2 |', which targets.csv counts",
        "croissant.json: another SHA-256 for splits.json than in SHA256SUMS",
        "croissant.json: another SHA-256 for targets.csv than in SHA256SUMS",
        "lineage.json: other views of chair_01 than in targets.csv",
        "targets/test.csv: not the lines of targets.csv whose split is test",
        "previews/test/metadata.jsonl: not the lines of targets.csv whose split is test",
        "previews/test/metadata.jsonl: chair_01/000.jpg and the pairs of targets.csv do not agree",
        "views/chair_01/views.json: other views with a pair than in targets.csv",
    ]


def test_damaged_sums(copy: Path) -> None:
    (copy / "SHA256SUMS").write_text("nonsense\n")
    assert verify(copy) == ["SHA256SUMS, line 1: malformed, repeated or unsafe; download it again"]
    for name in ("x" * 256, "/".join(["x" * 200] * 6)):
        (copy / "SHA256SUMS").write_text(f"{'0' * 64}  {name}\n")
        assert verify(copy) == ["SHA256SUMS, line 1: longer than a file's name can be"]
    (copy / "SHA256SUMS").unlink()
    assert verify(copy) == ["SHA256SUMS: missing; make or download it again"]
    with raises(ReleaseError, "release.not-one"):
        verify(copy / "pairs")


GOOD = synthetic_pair(0, "chair")
SKEW, MIRROR = np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0])
SKEW[0, 1] = 0.1
# A camera in the middle of the cube.
BEHIND = GOOD.T_world_camera.copy()
BEHIND[:3, 3] = (GOOD.T_world_grid @ np.array([*[128 * GOOD.voxel_size_m] * 3, 1.0]))[:3]
ONE_CELL = np.zeros((64, 64, 64), bool)
ONE_CELL[0, 0, 0] = True
CORNER = np.zeros((256, 256, 256), bool)
CORNER[0, 0, 0] = True

WRONG: dict[str, tuple[Pair, list[str]]] = {
    "sound": (GOOD, []),
    "skewed": (
        replace(GOOD, T_world_grid=SKEW, T_world_camera=SKEW),
        ["T_world_grid is not a rotation and a shift", "T_world_camera is not a rotation and a shift"],
    ),
    "mirrored": (
        replace(GOOD, T_world_grid=MIRROR, T_world_camera=MIRROR),
        ["T_world_grid", "T_world_camera"],
    ),
    "turned": (replace(GOOD, T_world_grid=np.eye(4)), ["the grid's axes are not the view's"]),
    "no focal length": (replace(GOOD, K=np.zeros((3, 3))), ["the focal lengths"]),
    "sigma": (replace(GOOD, surface_sigma_m=float("nan")), ["surface_sigma_m is nan"]),
    "framing": (replace(GOOD, framing="view"), ["framing is 'view' where the benchmark has 'object'"]),
    "rule": (
        replace(GOOD, partial_rule="majority"),
        ["partial_rule is 'majority'", "cells of 'partial' are not 'partial_256' reduced by 'majority'"],
    ),
    "empty": (
        replace(GOOD, full=np.zeros_like(GOOD.full), shell=np.zeros_like(GOOD.full)),
        ["'full' is empty", "containment is 0.000, below 0.85"],
    ),
    "reduction": (
        replace(GOOD, partial=GOOD.partial | pack(ONE_CELL)),
        ["1 cells of 'partial' are not 'partial_256' reduced by 'any'"],
    ),
    "shell": (
        replace(GOOD, shell=GOOD.shell | pack(CORNER)),
        ["1 cells of 'shell' are not as the surface of 'full'"],
    ),
    "thin shell": (
        replace(GOOD, shell=np.zeros_like(GOOD.shell)),
        [f"{int(np.unpackbits(GOOD.shell).sum())} cells of 'shell' are not as the surface of 'full'"],
    ),
    "nothing known": (
        replace(GOOD, known=np.zeros_like(GOOD.known)),
        [f"only 0 of the {int(np.unpackbits(GOOD.partial_256).sum())} cells of 'partial_256' are 'known'"],
    ),
    "told by what, beyond what is known": (
        replace(GOOD, known=GOOD.known & ~pack(CORNER), interior=pack(CORNER), said=pack(CORNER)),
        ["1 cells of 'interior' are not 'known'", "1 cells of 'said' are not 'known'"],
    ),
    "nothing seen": (
        replace(GOOD, seen=np.zeros_like(GOOD.seen)),
        [f"only 0 of the {int(np.unpackbits(GOOD.partial_256).sum())} cells of 'partial_256' are 'seen'"],
    ),
    "seen behind the camera": (
        replace(GOOD, T_world_camera=BEHIND),
        ["'seen' holds cells behind the camera"],
    ),
    "containment": (
        replace(GOOD, partial=pack(ONE_CELL), partial_256=pack(CORNER)),
        ["containment is 0.000, below 0.85"],
    ),
}


@pytest.mark.parametrize("name", list(WRONG))
def test_pair_problems(name: str) -> None:
    pair, expected = WRONG[name]
    found = list(pair_problems(pair, min_containment=0.85, framing="object", partial_rule="any"))
    assert len(found) == len(expected)
    assert all(part in line for part, line in zip(expected, found, strict=True))


@pytest.mark.parametrize("name", DAMAGE)
def test_checksums_alone_find_every_changed_missing_or_new_file(name: str, copy: Path) -> None:
    damage, expected = DAMAGE[name]
    damage(copy)
    of_bytes = tuple(words.format("") for words in (CHANGED, MISSING, EXTRA))
    assert verify(copy, checksums_only=True) == [line for line in expected if line.endswith(of_bytes)]


def test_checksums_alone_look_into_no_file(copy: Path) -> None:
    progress: list[tuple[int, int]] = []
    path = copy / "pairs/chair_01/001.npz"
    path.write_bytes(b"no pair")
    resum(copy, "pairs/chair_01/001.npz")
    found = verify(copy, lambda *done: progress.append(done), checksums_only=True)
    assert found == ["benchmark.json: its benchmark_sha256 is not of SHA256SUMS and of what it says"]
    assert (
        progress[-1][0]
        == progress[-1][1]
        == len(progress)
        == len((copy / "SHA256SUMS").read_text().splitlines())
    )
