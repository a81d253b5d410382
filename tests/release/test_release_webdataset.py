"""WebDataset shards, read back by the package itself and by tarfile and numpy."""

import gc
import io
import json
import tarfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from kinectbench.cli.main import app
from kinectbench.core.errors import SettingsError
from kinectbench.core.voxels.pair_file import read_pair
from kinectbench.release.exchange.webdataset import export_webdataset
from kinectbench.release.release import Release, open_release


@pytest.fixture(scope="module")
def shards(release: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out: Path = tmp_path_factory.mktemp("webdataset") / "shards"
    assert export_webdataset(release, out, pairs_per_shard=3) == 7
    return out


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
            for name in ("partial", "full", "known", "seen"):
                np.testing.assert_array_equal(sample[f"{name}.npy"], getattr(pair, name))
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
        assert list(members) == [
            "table_01_000.partial.npy", "table_01_000.full.npy", "table_01_000.known.npy",
            "table_01_000.seen.npy", "table_01_000.json",
        ]  # fmt: skip
        assert all(member.mtime == member.uid == 0 for member in members.values())
        file = shard.extractfile("table_01_000.full.npy")
        assert file is not None
        full = np.unpackbits(np.load(io.BytesIO(file.read()), allow_pickle=False), axis=-1)
    pair = read_pair(release.folder / "pairs/table_01/000.npz")
    np.testing.assert_array_equal(full, np.unpackbits(pair.full, axis=-1))


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
    with pytest.raises(SettingsError, match=r"'a\.b' and 'a-b' would have the same keys"):
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
