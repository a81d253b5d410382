"""npz files: the same bytes, open to plain numpy; pair files: every damage gives one line."""

import io
import os
import platform
import subprocess
import sys
import zipfile
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from raising import raises
from references import shell_of

from kinectbench.core.errors import PairError, StorageError
from kinectbench.core.geometry import rigid, rotation_from_quaternion_xyzw
from kinectbench.core.voxels.npz import npz_bytes, packed_npz_bytes, read_npz
from kinectbench.core.voxels.pair_file import (
    Pair,
    keys_there,
    pack,
    packed_count,
    pair_bytes,
    pair_parts,
    read_pair,
    unknown_share,
    unpack,
)


@pytest.fixture(scope="module")
def pair() -> Pair:
    rng = np.random.default_rng(0)
    full = np.zeros((256, 256, 256), bool)
    full[40:200, 60:180, 30:230] = True
    T = rigid(rotation_from_quaternion_xyzw([0.1, -0.2, 0.3, 0.9]), [0.5, -0.2, 1.0])
    return Pair(
        partial=pack(rng.random((64, 64, 64)) < 0.1),
        partial_256=pack(rng.random((256, 256, 256)) < 0.01),
        full=pack(full),
        shell=shell_of(full),
        known=pack(np.ones_like(full)),
        seen=pack(np.arange(256) < np.full((256, 256, 1), 99)),
        T_world_grid=T,
        T_world_camera=rigid(T[:3, :3], [0.1, 0.2, 0.3]),
        K=np.array([[525.0, 0, 319.5], [0, 525.0, 239.5], [0, 0, 1]]),
        voxel_size_m=0.00437,
        surface_sigma_m=0.0021,
        framing="object",
        partial_rule="any",
        interior=pack(full & (np.arange(256) > 60)),
        said=pack(np.zeros_like(full)),
    )


@pytest.fixture(scope="module")
def stored(pair: Pair) -> dict[str, np.ndarray]:
    with np.load(io.BytesIO(pair_bytes(pair)), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def test_packing_is_numpys() -> None:
    values = np.random.default_rng(1).random((4, 6, 16)) < 0.5
    packed = pack(values)
    assert packed.shape == (4, 6, 2) and packed[0, 0, 0] >> 7 == values[0, 0, 0]
    np.testing.assert_array_equal(unpack(packed), values)
    np.testing.assert_array_equal(np.unpackbits(packed, axis=-1), values)


def test_npz_bytes_are_the_same_and_numpys(tmp_path: Path) -> None:
    arrays = {
        "a": np.arange(12.0).reshape(3, 4).T,  # Fortran order
        "text": np.asarray("näh"),
        "none": np.zeros((0, 3), np.float16),
        "scalar": np.asarray(3),
    }
    data = npz_bytes(arrays)
    assert data == npz_bytes(dict(arrays))
    with np.load(io.BytesIO(data)) as archive:
        assert archive.files == list(arrays)
        for name, values in arrays.items():
            np.testing.assert_array_equal(archive[name], values)
            assert archive[name].dtype == values.dtype
    (tmp_path / "a.npz").write_bytes(data)
    assert read_npz(tmp_path / "a.npz")["scalar"] == 3


def test_npz_holds_no_pickles() -> None:
    with pytest.raises(ValueError, match="allow_pickle"):
        npz_bytes({"a": np.array([{}], dtype=object)})


def test_pair_round_trip(pair: Pair, tmp_path: Path) -> None:
    path = tmp_path / "000.npz"
    path.write_bytes(pair_bytes(pair))
    again = read_pair(path)
    for field in fields(Pair):
        value, expected = getattr(again, field.name), getattr(pair, field.name)
        np.testing.assert_array_equal(value, expected)
        assert type(value) is type(expected)
    assert path.read_bytes() == pair_bytes(replace(pair))
    grid = again.grid
    assert grid.shape == (256, 256, 256) and grid.voxel_size_m == pair.voxel_size_m


def test_pair_opens_with_plain_numpy(pair: Pair, stored: dict[str, NDArray[Any]]) -> None:
    assert set(stored) == {field.name for field in fields(Pair)} | {"format_version"}
    assert stored["format_version"] == 1
    np.testing.assert_array_equal(np.unpackbits(stored["full"], axis=-1).astype(bool), unpack(pair.full))
    assert stored["full"].shape == (256, 256, 32) and stored["partial"].shape == (64, 64, 8)


def store(arrays: dict[str, Any], path: Path) -> Path:
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("partial", np.zeros((64, 64, 64), np.uint8), r"'partial' is uint8\(64, 64, 64\), not"),
        ("full", np.zeros((256, 256, 32), bool), "'full' is bool"),
        ("seen", np.zeros((128, 256, 32), np.uint8), "'seen' is uint8"),
        ("T_world_grid", np.eye(3), "'T_world_grid' is not a finite 4x4"),
        ("T_world_camera", np.full((4, 4), np.nan), "'T_world_camera' is not a finite 4x4"),
        ("K", np.full((3, 3), "x"), "'K' is not a finite 3x3"),
        ("K", np.zeros((3, 3)), "'K' is not a finite 3x3"),
        ("T_world_grid", np.zeros((4, 4), np.float16), "'T_world_grid' is not a finite 4x4"),
        ("format_version", np.asarray(2), "another format version"),
        ("format_version", np.asarray("new"), "another format version"),
        ("format_version", np.arange(3), "another format version"),
        ("format_version", np.asarray(True), "another format version"),
        ("voxel_size_m", np.arange(3.0), "'voxel_size_m'"),
        ("voxel_size_m", np.asarray("big"), "'voxel_size_m'"),
        ("voxel_size_m", np.asarray(-1.0), "'voxel_size_m'"),
        ("voxel_size_m", np.asarray(0.0), "'voxel_size_m'"),
        ("voxel_size_m", np.asarray(np.nan), "'voxel_size_m'"),
        ("surface_sigma_m", np.asarray(np.inf), "'surface_sigma_m'"),
        ("framing", np.asarray(["object", "view"]), "'framing'"),
        ("partial_rule", np.asarray(7), "'partial_rule'"),
    ],
)  # fmt: skip
def test_wrong_values(
    stored: dict[str, NDArray[Any]], tmp_path: Path, name: str, value: NDArray[Any], message: str
) -> None:
    path = store({**stored, name: value}, tmp_path / "007.npz")
    with raises(PairError, "pair.malformed", match=rf"007\.npz.*{message}"):
        read_pair(path)


@pytest.mark.parametrize("name", ["partial", "known", "K", "framing", "voxel_size_m"])
def test_missing_keys(stored: dict[str, NDArray[Any]], tmp_path: Path, name: str) -> None:
    path = store({key: value for key, value in stored.items() if key != name}, tmp_path / "000.npz")
    with raises(PairError, "pair.malformed", match=rf"000\.npz.*{name}.*missing"):
        read_pair(path)


def test_several_missing_keys_and_none_at_all(tmp_path: Path) -> None:
    with raises(PairError, "pair.malformed", match="partial_256"):
        read_pair(store({"x": np.zeros(3)}, tmp_path / "000.npz"))
    with raises(PairError, "pair.malformed", match=r"none\.npz"):
        read_pair(tmp_path / "none.npz")
    with raises(PairError, "pair.malformed", match=r"000\.npy"):
        np.save(tmp_path / "000.npy", np.zeros(3))
        read_pair(tmp_path / "000.npy")


@pytest.mark.parametrize("damage", ["empty", "text", "cut", "folder", "pickle", "flipped", "method"])
@pytest.mark.parametrize("reader", [read_pair, read_npz])
def test_damaged_files(
    pair: Pair, tmp_path: Path, damage: str, reader: Callable[..., Pair | dict[str, NDArray[Any]]]
) -> None:
    path = tmp_path / "000.npz"
    data = bytearray(pair_bytes(pair))
    if damage == "folder":
        path.mkdir()
    elif damage == "pickle":
        np.savez(path, partial=np.array([{}], dtype=object))
    else:
        middle = len(data) // 3
        if damage == "flipped":
            for at in range(middle, middle + 64):
                data[at] ^= 0xFF
        if damage == "method":
            with zipfile.ZipFile(io.BytesIO(bytes(data))) as archive:
                offset = archive.infolist()[0].header_offset
                directory = archive.start_dir
            data[directory + 10 : directory + 12] = (99).to_bytes(2, "little")
            data[offset + 8 : offset + 10] = (99).to_bytes(2, "little")
        cut_short: dict[str, bytes | bytearray] = {"empty": b"", "text": b"hello" * 50, "cut": data[:middle]}
        path.write_bytes(cut_short.get(damage, data))
    with pytest.raises((PairError, StorageError), match=r"000\.npz") as caught:
        reader(path)
    assert "\n" not in str(caught.value)


def test_a_file_without_an_occupancy_rule_is_by_winding(
    pair: Pair, stored: dict[str, NDArray[Any]], tmp_path: Path
) -> None:
    """Files of before the key was added."""
    path = tmp_path / "old.npz"
    path.write_bytes(npz_bytes({name: value for name, value in stored.items() if name != "occupancy_rule"}))
    assert read_pair(path).occupancy_rule == "winding"
    path.write_bytes(pair_bytes(replace(pair, occupancy_rule="six-rays")))
    assert read_pair(path).occupancy_rule == "six-rays"
    path.write_bytes(npz_bytes({**stored, "occupancy_rule": np.asarray(3)}))
    with raises(PairError, "pair.malformed", match="'occupancy_rule'"):
        read_pair(path)


def test_a_file_that_does_not_tell_by_what_it_is_known(
    pair: Pair, stored: dict[str, NDArray[Any]], tmp_path: Path
) -> None:
    """Files of before `interior` and `said`, and those of exact shapes; what is there is checked."""
    path = tmp_path / "old.npz"
    path.write_bytes(pair_bytes(replace(pair, interior=None, said=None)))
    with np.load(path) as archive:
        assert {*stored} - {*archive.files} == {"interior", "said"}
    again = read_pair(path)
    assert again.interior is None and again.said is None
    np.testing.assert_array_equal(again.known, pair.known)
    with pytest.raises(ValueError, match="it holds no 'interior'"):
        pair_parts(path.read_bytes(), ("known", "interior"))
    assert keys_there(("known", "interior"), path.read_bytes()) == ["known"]
    assert keys_there(("said", "interior"), pair_bytes(pair)) == ["said", "interior"]
    path.write_bytes(npz_bytes({**stored, "said": np.zeros((256, 256, 16), np.uint8)}))
    with raises(PairError, "pair.malformed", match=r"uint8\(256.*256.*16\)"):
        read_pair(path)


@pytest.mark.parametrize("value", [None, 0, 255])
def test_packed_npz_is_a_sound_zip_that_numpy_opens(value: int | None) -> None:
    grid = np.random.default_rng(0).integers(0, 3, (16, 16, 4)).astype(np.uint8)
    arrays = {
        "grid": grid if value is None else np.full_like(grid, value),
        "fortran": np.arange(12.0).reshape(3, 4).T,
        "text": np.asarray("näh"),
        "none": np.zeros((0, 3), np.uint8),
    }
    data = packed_npz_bytes(arrays)
    assert data == packed_npz_bytes(arrays)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert archive.testzip() is None
        assert archive.namelist() == [f"{name}.npy" for name in arrays]
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        for name, values in arrays.items():
            np.testing.assert_array_equal(archive[name], values)
            assert archive[name].dtype == values.dtype


def test_npz_level_counts() -> None:
    values = {"a": np.random.default_rng(0).integers(0, 3, 40000).astype(np.uint8)}
    assert len(npz_bytes(values, level=9)) < len(npz_bytes(values, level=1))


def test_parts_of_a_pair_are_checked_like_the_whole(pair: Pair) -> None:
    content = pair_bytes(pair)
    K, partial = pair_parts(content, ("K", "partial"))
    np.testing.assert_array_equal(K, pair.K)
    np.testing.assert_array_equal(partial, pair.partial)
    with pytest.raises(ValueError, match="it holds no 'depth'"):
        pair_parts(content, ("depth",))
    with pytest.raises(ValueError, match="'K' is not a finite 3x3 matrix"):
        pair_parts(npz_bytes({"format_version": np.asarray(1), "K": np.full((3, 3), np.nan)}), ("K",))


FAULTS = """
import resource, sys
from pathlib import Path
from kinectbench.core.voxels.pair_file import read_pair
for _ in range(3):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    read_pair(Path(sys.argv[1]))
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library does as it likes")
def test_the_memory_of_a_pair_is_used_for_the_next(pair: Pair, tmp_path: Path) -> None:
    path = tmp_path / "000.npz"
    path.write_bytes(pair_bytes(pair))
    # Dask sets some for the processes that it starts, where they are as good as a command's.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("MALLOC_")}
    command = [sys.executable, "-c", FAULTS, str(path)]
    told = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    # Its grids have 2,570 pages of 4 KB; given back to the system, all of them would be asked for again.
    assert int(told.stdout) < 500


def test_the_share_of_what_is_not_known() -> None:
    full, known = (pack(np.random.default_rng(n).random((16, 16, 64)) < 0.4) for n in range(2))
    assert unknown_share(full, known) == (unpack(full) & ~unpack(known)).sum() / unpack(full).sum()
    assert unknown_share(np.zeros_like(full), known) == 0


def test_the_count_of_packed_cells_is_that_of_their_bits() -> None:
    packed = np.random.default_rng(8).integers(0, 256, (8, 8, 4), dtype=np.uint8)
    assert packed_count(packed) == packed_count(np.asfortranarray(packed)) == unpack(packed).sum()
