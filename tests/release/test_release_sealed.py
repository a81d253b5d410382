"""Releases that somebody changed and sealed again: checksums agree, and `verify` names what is wrong."""

import json
import re
import shutil
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from file_damage import seal
from raising import raises
from synthetic_release import publish_synthetic

import kinectbench
from kinectbench.core.artefacts.targets import benchmark_sha256, parse_sums
from kinectbench.core.errors import PairError
from kinectbench.core.voxels.npz import load_arrays, npz_bytes
from kinectbench.core.voxels.pair_file import MATRIX_SIDES, read_pair
from kinectbench.release.check.verify import verify
from kinectbench.release.release import Release, copy_problems

PAIR, VOLUME, GLB = "pairs/chair_01/000.npz", "objects/chair_01/volume.npz", "objects/chair_01.glb"
GRID = ("voxel_size_m", "T_world_grid")


@pytest.fixture
def copy(analytic: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(analytic / "benchmark", tmp_path / "release"))


def retyped(path: Path, names: tuple[str, ...], kind: str) -> None:
    arrays = load_arrays(path)
    path.write_bytes(
        npz_bytes(arrays | {name: arrays[name].astype(kind) for name in names if name in arrays})
    )


@pytest.mark.parametrize("kind", [">f8", np.dtype(np.longdouble).str])
@pytest.mark.parametrize("file", [PAIR, VOLUME])
def test_numbers_of_any_kind_are_read(copy: Path, file: str, kind: str) -> None:
    """Turned bytes and long doubles ended in an internal error of linear algebra."""
    retyped(copy / file, (*MATRIX_SIDES, *GRID), kind)
    seal(copy)
    assert verify(copy) == []
    if file == PAIR:
        matrices = vars(read_pair(copy / PAIR))
        assert {matrices[name].dtype.str for name in MATRIX_SIDES} == {np.dtype(np.float64).str}
        assert kinectbench.load(copy)[0]["meta"]["recording"] == "chair_01"


def test_half_floats_are_too_coarse_for_a_camera(copy: Path) -> None:
    retyped(copy / PAIR, tuple(MATRIX_SIDES), "<f2")
    retyped(copy / VOLUME, ("T_world_grid",), "<f2")
    seal(copy)
    lines = verify(copy)
    assert any(line.startswith(f"{PAIR}: T_world_grid is not a rotation") for line in lines), lines
    assert all(line.split(":")[0] in (PAIR, VOLUME) for line in lines), lines


@pytest.mark.skipif(np.finfo(np.longdouble).maxexp == 1024, reason="a long double is a double here")
def test_numbers_beyond_float64_are_infinite(copy: Path) -> None:
    arrays = load_arrays(copy / PAIR)
    large = arrays["K"].astype(np.longdouble)
    large[0, 0] = np.longdouble("1e4000")
    (copy / PAIR).write_bytes(npz_bytes(arrays | {"K": large}))
    with raises(PairError, "pair.malformed", match="'K' is not a finite 3x3 matrix"):
        read_pair(copy / PAIR)


def as_another(folder: Path) -> None:
    """The object of the test split once more, under the name of an object of another split."""
    for place in ("views", "objects"):
        for path in (folder / place / "chair_01").iterdir():
            shutil.copy(path, folder / place / "chair_03" / path.name)


def test_a_copy_under_another_name_is_named(copy: Path) -> None:
    as_another(copy)
    seal(copy)
    (line,) = [found for found in verify(copy) if "is a copy of" in found]
    assert re.match(
        r"targets\.csv: chair_0. \(\w+\) is a copy of chair_0. \(\w+\), though its object is", line
    )


def test_without_meshes_all_pairs_are_compared(release: Release) -> None:
    first, *others = release.targets
    other = next(target for target in others if target.object != first.object)
    twin = type(first)(**vars(other) | {"sha256": first.sha256, "split": "train"})
    here, there = replace(first, split="test"), replace(twin, split="test")
    images = {f"views/{each.recording}/{each.view}.depth.png": "" for each in (first, twin)}
    assert [*copy_problems([here, twin], {})] == []  # of no recording
    assert [*copy_problems([here, twin], images)] == [
        f"targets.csv: {twin.recording} (train) is a copy of {first.recording} (test), though its object is "
        f"'{twin.object}' and not '{first.object}'; name one object, in one split"
    ]
    assert [*copy_problems([here, there], images)] == []
    assert [*copy_problems([first, other], images)] == []
    assert [*copy_problems(release.targets, release.sums)] == []


def benchmark(folder: Path) -> str:
    return (folder / "benchmark.json").read_text(encoding="utf-8")


@pytest.mark.parametrize("sign", ["\v", "\f", "\x1c", "\x85", "\u2028", "\r\n", "\r"])
def test_lines_of_the_list_end_as_for_sha256sum(copy: Path, sign: str) -> None:
    """At other signs `sha256sum` goes on reading a name, and `verify` did not: each checked other files."""
    text = (copy / "SHA256SUMS").read_text(encoding="utf-8").replace("\n", sign, 1)
    (copy / "SHA256SUMS").write_bytes(text.encode())
    whole = benchmark_sha256(text, benchmark(copy))
    stated = re.sub(r'("benchmark_sha256": *")[0-9a-f]{64}', rf"\g<1>{whole}", benchmark(copy))
    (copy / "benchmark.json").write_text(stated, encoding="utf-8")
    assert verify(copy, checksums_only=True) == [
        "SHA256SUMS, line 1: malformed, repeated or unsafe; download it again"
    ]


def test_the_last_line_may_lack_its_end() -> None:
    line = f"{'0' * 64}  a"
    assert parse_sums(line, "") == parse_sums(f"{line}\n", "") == {"a": "0" * 64}
    assert parse_sums("", "") == {}


def with_entry(folder: Path, part: str, key: str, value: str) -> None:
    """A GLB with another entry in the first of its buffers or meshes."""
    content = (folder / GLB).read_bytes()
    (length,) = struct.unpack_from("<I", content, 12)
    header = json.loads(content[20 : 20 + length])
    header[part][0][key] = value
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    parts = (content[:8], struct.pack("<2I", len(content) - length + len(text), len(text)), content[16:20])
    (folder / GLB).write_bytes(b"".join((*parts, text, content[20 + length :])))


def with_uri(folder: Path) -> None:
    """A GLB whose buffer lies elsewhere: whoever shows it would fetch it."""
    with_entry(folder, "buffers", "uri", "https://example.org/shape.bin")


def test_a_mesh_may_be_named_uri(copy: Path) -> None:
    with_entry(copy, "meshes", "name", "uri")
    seal(copy)
    assert verify(copy) == []


def more_of(place: str) -> Callable[[Path], object]:
    return lambda folder: shutil.copytree(folder / place / "chair_01", folder / place / "nobody")


def surface_of_nobody(folder: Path) -> None:
    (folder / "surfaces").mkdir()
    shutil.copy(folder / "objects/chair_01/mesh.ply", folder / "surfaces/nobody.ply")


def in_card(spaced: str, name: str = "chair_01", more: int = 0) -> Callable[[Path], object]:
    """A second row of figures of one recording, with so many more cells than the right one."""

    def change(folder: Path) -> None:
        path = folder / "README.md"
        text = path.read_text(encoding="utf-8")
        right = next(line for line in text.splitlines() if line.startswith("| chair_01 |") and "0.9" in line)
        cells = [name, *["0.999"] * (right.count(" | ") + more)]
        path.write_text(f"{text}\n{spaced.join(('', *cells, '')).strip()}\n", encoding="utf-8")

    return change


def test_a_recording_may_be_named_as_its_category(tmp_path: Path) -> None:
    """The card's tables of categories have a row of that name, too."""
    folder = publish_synthetic(tmp_path, (("chair", "chair", "chair", "test", 2),)).folder
    rows = [line for line in (folder / "README.md").read_text().splitlines() if line.startswith("| chair |")]
    assert len({row.count("|") for row in rows}) > 1
    assert verify(folder) == []


CHANGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "a GLB that names other files": (with_uri, f"{GLB}: names other files by a URI"),
    "an object of nobody": (
        more_of("objects"),
        "objects/nobody/floor.json: of a recording that benchmark.json",
    ),
    "views of nobody": (more_of("views"), "views/nobody/000.depth.png: of a recording that benchmark.json"),
    "an open mesh of nobody": (surface_of_nobody, "surfaces/nobody.ply: of a recording that benchmark.json"),
    "other figures in the card": (in_card(" | "), "README.md: has the row '| chair_01 | 0.999"),
    "other figures without spaces": (in_card("|"), "README.md: has the row '|chair_01|0.999"),
    "other figures in bold": (in_card("|", "**chair_01**"), "README.md: has the row '|**chair_01**|"),
    "other figures of code": (in_card("|", "`chair_01`"), "README.md: has the row '|`chair_01`|"),
    "one figure more": (in_card("|", more=1), "README.md: has the row '|chair_01|0.999"),
    "one figure less": (in_card("|", more=-1), "README.md: has the row '|chair_01|0.999"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_sealed_change_is_named(copy: Path, name: str) -> None:
    change, line = CHANGES[name]
    change(copy)
    seal(copy)
    lines = verify(copy)
    assert len(lines) == 1 and lines[0].startswith(line), lines
