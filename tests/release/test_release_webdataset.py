"""WebDataset shards, read back by the package itself and by tarfile and numpy."""

import gc
import io
import json
import tarfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raising import raises
from typer.testing import CliRunner

import kinectbench
from kinectbench.cli.main import app
from kinectbench.core.errors import PairError, SettingsError
from kinectbench.core.voxels.pair_file import read_pair
from kinectbench.release.exchange.webdataset import export_webdataset
from kinectbench.release.release import Release, open_release


@pytest.fixture(scope="module")
def shards(release: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out: Path = tmp_path_factory.mktemp("webdataset") / "shards"
    assert export_webdataset(release, out, pairs_per_shard=3) == 7
    return out


def test_an_earlier_export_of_more_files_is_replaced(release: Release, tmp_path: Path) -> None:
    export_webdataset(release, tmp_path / "out", pairs_per_shard=1)
    (tmp_path / "out/.DS_Store").touch()  # of a file manager
    assert export_webdataset(release, tmp_path / "out", pairs_per_shard=7) == 7
    assert len(list((tmp_path / "out").glob("*.tar"))) == 2


def test_shards(shards: Path) -> None:
    assert json.loads((shards / "export.json").read_text())["shards"] == {
        "validation-000000.tar": 3, "test-000000.tar": 3, "test-000001.tar": 1
    }  # fmt: skip


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # the package leaves its files to the collector
def test_samples_by_webdataset(release: Release, shards: Path) -> None:
    webdataset = pytest.importorskip("webdataset")
    for split, count in (("validation", 3), ("test", 4)):
        urls = sorted(str(path) for path in shards.glob(f"{split}-*.tar"))
        samples = list(webdataset.WebDataset(urls, shardshuffle=False).decode())
        assert len(samples) == count
        for sample, target in zip(samples, release.split(split), strict=True):
            pair = read_pair(release.pair_path(target))
            assert sample["__key__"] == f"{target.recording}_{target.view}"
            for name in ("partial", "partial_256", "full", "shell", "known", "seen"):
                np.testing.assert_array_equal(sample["npz"][name], getattr(pair, name))
            row = sample["json"]
            for name in ("recording", "object", "view", "category", "split"):
                assert row[name] == getattr(target, name)
            for name in ("T_world_grid", "T_world_camera", "K"):
                np.testing.assert_array_equal(np.array(row[name]), getattr(pair, name))
            assert row["unknown_share"] == round(pair.unknown_share, 4) > 0
            assert row["voxel_size_m"] == pair.voxel_size_m and row["framing"] == "object"
    gc.collect()


def test_samples_by_tarfile_and_numpy(release: Release, shards: Path) -> None:
    with tarfile.open(shards / "test-000001.tar") as shard:
        members = {member.name: member for member in shard}
        assert list(members) == ["table_01_000.npz", "table_01_000.json"]
        assert all(member.mtime == member.uid == 0 for member in members.values())
        file = shard.extractfile("table_01_000.npz")
        assert file is not None
        full = np.unpackbits(np.load(io.BytesIO(file.read()), allow_pickle=False)["full"], axis=-1)
    pair = read_pair(release.folder / "pairs/table_01/000.npz")
    np.testing.assert_array_equal(full, np.unpackbits(pair.full, axis=-1))


def samples(path: Path) -> list[dict[str, Any]]:
    """The samples of a shard as webdataset hands them to a decoder: bytes by ending."""
    found: dict[str, dict[str, Any]] = {}
    with tarfile.open(path) as shard:
        for member in shard:
            key, _, ending = member.name.partition(".")
            file = shard.extractfile(member)
            assert file is not None
            found.setdefault(key, {"__key__": key})[ending] = file.read()
    return list(found.values())


def assert_same_items(found: dict[str, Any], item: dict[str, Any]) -> None:
    assert list(found) == list(item)
    for key in item:
        if key == "meta":
            assert_same_items(found[key], item[key])
        else:
            np.testing.assert_array_equal(found[key], item[key])
            assert type(found[key]) is type(item[key])
            assert getattr(found[key], "dtype", None) == getattr(item[key], "dtype", None)


GRIDS = ("partial", "full", "known", "seen")


def test_a_decoded_sample_is_the_item_of_the_dataset(release: Release, shards: Path) -> None:
    found = [sample for name in ("test-000000", "test-000001") for sample in samples(shards / f"{name}.tar")]
    for keys in (None, ("K", "shell", "framing", "surface_sigma_m")):
        dataset = kinectbench.load(release.folder, keys=keys, packed=keys is None).split("test")
        for sample, item in zip(found, dataset, strict=True):
            assert_same_items(kinectbench.decode_sample(sample, keys=keys, packed=keys is None), item)


def earlier(sample: dict[str, Any]) -> dict[str, Any]:
    """The sample as earlier versions wrote it: a .npy file for each grid, all else in `json`."""
    pair = np.load(io.BytesIO(sample["npz"]))
    files = {}
    for name in GRIDS:
        buffer = io.BytesIO()
        np.save(buffer, pair[name])
        files[f"{name}.npy"] = buffer.getvalue()
    return {"__key__": sample["__key__"], **files, "json": sample["json"]}


def test_samples_of_earlier_versions_are_read(release: Release, shards: Path) -> None:
    (sample,) = samples(shards / "test-000001.tar")
    keys = (*GRIDS, "T_world_grid", "K", "voxel_size_m", "partial_rule", "meta")
    item = kinectbench.load(release.folder, keys=keys).split("test")[3]
    assert_same_items(kinectbench.decode_sample(earlier(sample), keys=keys), item)
    with raises(PairError, "pair.malformed", match=r"table_01_000: cannot be read as a pair \('shell.npy'\)"):
        kinectbench.decode_sample(earlier(sample), keys="shell")


@pytest.mark.parametrize("old", [False, True])
def test_a_sample_that_is_damaged_or_lacks_something_is_told(shards: Path, old: bool) -> None:
    (sample,) = samples(shards / "test-000001.tar")
    sample = earlier(sample) if old else sample
    grid = "full.npy" if old else "npz"
    for name, content in ((grid, sample[grid][:-9]), (grid, b"\0"), ("json", b"{}"), ("json", b"[")):
        with raises(PairError, "pair.malformed", match="table_01_000: cannot be read as a pair"):
            kinectbench.decode_sample(sample | {name: content}, keys=("full",))
    with raises(PairError, "pair.malformed", match="'depth'"):
        kinectbench.decode_sample(sample, keys=("depth",))
    with raises(SettingsError, "settings.wrong-value", match="'fill'"):
        kinectbench.decode_sample(sample, keys=("fill",))
    without = {name: value for name, value in sample.items() if name != "json"}
    with raises(PairError, "pair.malformed", match=r"\('json'\)"):
        kinectbench.decode_sample(without)


def test_shards_are_no_larger_than_the_release(release: Release, shards: Path) -> None:
    """Of these small releases as of large ones: a sample is its pair file, a line of JSON and two heads."""
    pairs = sum(release.pair_path(target).stat().st_size for target in release.targets)
    assert (
        sum(path.stat().st_size for path in shards.glob("*.tar"))
        < pairs + len(release.targets) * 6000 + 30720
    )


def test_same_release_same_bytes(release: Release, shards: Path, tmp_path: Path) -> None:
    export_webdataset(release, tmp_path / "again", pairs_per_shard=3)
    for path in shards.iterdir():
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes()


def test_dots_in_names(release: Release, tmp_path: Path) -> None:
    first, second, *_ = release.targets
    dotted = replace(release, targets=(replace(first, recording="a.b"), replace(second, recording="a.c")))
    export_webdataset(dotted, tmp_path / "out")
    with tarfile.open(tmp_path / "out" / "test-000000.tar") as shard:
        assert {name.partition(".")[0] for name in shard.getnames()} == {"a-b_000", "a-c_001"}
    same = replace(
        release, targets=(replace(first, recording="a.b"), replace(second, recording="a-b", view="000"))
    )
    with raises(SettingsError, "settings.wrong-value"):
        export_webdataset(same, tmp_path / "out2")


def test_command(release: Release, tmp_path: Path) -> None:
    arguments = [
        "export",
        str(tmp_path / "out"),
        "--layout",
        "webdataset",
        "--benchmark",
        str(release.folder),
    ]
    result = CliRunner().invoke(app, [*arguments, "--json"])
    assert result.exit_code == 0 and json.loads(result.output)["pairs"] == 7
    assert CliRunner().invoke(app, [*arguments[:3], "hdf5"]).exit_code == 2
    assert open_release(release.folder).benchmark_sha256 == release.benchmark_sha256
