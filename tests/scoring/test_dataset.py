"""What a dataset reads of a pair: the keys that are asked for, in a folder or in an archive in place."""

import hashlib
import multiprocessing
import pickle
import shutil
import tarfile
import zipfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from fuzz.releases import seal
from raising import raises
from read_pictures import read_picture
from small_benchmark import hashes
from synthetic_release import synthetic_settings, write_build

import kinectbench
from kinectbench.core.artefacts.benchmark import PublishOptions
from kinectbench.core.errors import KinectBenchError, PairError, ReleaseError, SettingsError
from kinectbench.core.voxels import npz
from kinectbench.core.voxels.pair_file import OPTIONAL, PACKED_SHAPES, pair_bytes, read_pair, unpack
from kinectbench.release.publish.archive import write_archive
from kinectbench.release.publish.publish import publish
from kinectbench.release.published import _opened
from kinectbench.release.release import Release, open_release
from kinectbench.scoring.baselines.predict import write_baselines
from kinectbench.scoring.dataset import IMAGES, KEYS, META, OF_PAIR
from kinectbench.scoring.score import score


def test_each_key_alone_is_that_of_the_pair_file(release: Release) -> None:
    pair = read_pair(release.pair_path(release.targets[0]))
    assert set(kinectbench.load(release.folder, keys=OPTIONAL)[0]) == {"pair_id"}  # these have none
    for key in [key for key in OF_PAIR if key not in OPTIONAL]:
        (name, found), *more = list(kinectbench.load(release.folder, keys=[key])[0].items())[1:]
        assert name == key and not more
        stored = getattr(pair, key)
        np.testing.assert_array_equal(found, unpack(stored) if key in PACKED_SHAPES else stored)
        assert type(found) is type(stored)
        packed = kinectbench.load(release.folder, keys=key, packed=True)[0][key]
        np.testing.assert_array_equal(packed, stored)


def test_one_pair_at_a_time(release: Release) -> None:
    with pytest.raises(TypeError, match="one pair at a time"):
        kinectbench.load(release.folder)[0:2]  # type: ignore[index]
    with pytest.raises(IndexError):
        kinectbench.load(release.folder)[len(release.targets)]


def test_images_of_the_view(release: Release) -> None:
    item = kinectbench.load(release.folder, keys=("depth", "mask"))[0]
    png = release.folder / "views/chair_01/000.depth.png"
    depth_mm = read_picture(png, cv2.IMREAD_UNCHANGED)
    assert item["depth"].dtype == np.float32 and item["mask"].dtype == np.bool_
    np.testing.assert_allclose(item["depth"], depth_mm / 1000, rtol=1e-6)
    mask = read_picture(png.with_name("000.mask.png"), cv2.IMREAD_UNCHANGED) > 0
    assert mask.any() and np.array_equal(item["mask"], mask)
    with raises(ReleaseError, "release.missing-file", match=r"000\.color\.jpg"):
        kinectbench.load(release.folder, keys=("color",))[0]


def encoded(image: np.ndarray, ending: str) -> bytes:
    return cv2.imencode(ending, image)[1].tobytes()


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (encoded(np.zeros((6, 8), np.uint8), ".png"), "another kind of image"),
        (encoded(np.zeros((6, 8, 3), np.uint16), ".png"), "another kind of image"),
        (encoded(np.zeros((6, 8), np.uint8), ".jpg"), "another kind of image"),
        (encoded(np.zeros((1, 8200), np.uint16), ".png"), "8200x1 pixels; more than 8192 a side"),
        (encoded(np.zeros((6, 8), np.uint16), ".png")[:-9], "cut off"),
        (b"", "the file is empty"),
    ],
)
def test_an_image_that_is_no_depth_is_told(
    release: Release, tmp_path: Path, content: bytes, told: str
) -> None:
    folder = Path(shutil.copytree(release.folder, tmp_path / "b"))
    (folder / "views/chair_01/000.depth.png").write_bytes(content)
    seal(folder)
    dataset = kinectbench.load(folder, keys="depth")
    with raises(ReleaseError, "release.damaged", match=rf"000\.depth\.png.*16-bit.*\(.*{told}"):
        dataset[0]


def test_colour_where_it_is_published(tmp_path: Path) -> None:
    write_build(tmp_path / "build")
    folder = publish(
        synthetic_settings(publish={"color": True}), tmp_path / "build", tmp_path / "b", ["chair_01"]
    ).folder
    color = kinectbench.load(folder, keys=("color",))[0]["color"]
    assert color.shape == (240, 320, 3) and abs(color.astype(int) - 128).max() < 5


def test_only_what_is_asked_for_is_unpacked(release: Release, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[str] = []
    array_of = npz._read

    def noted(file: Any, archive: Any, entry: zipfile.ZipInfo) -> Any:
        read.append(entry.filename.removesuffix(".npy"))
        return array_of(file, archive, entry)

    monkeypatch.setattr(npz, "_read", noted)
    kinectbench.load(release.folder, keys=("full", "K"))[0]
    assert read == ["format_version", "full", "K"]
    read.clear()
    kinectbench.load(release.folder, keys=("mask",))[0]
    assert read == []


def test_keys_that_there_are_not(release: Release) -> None:
    with raises(SettingsError, "settings.wrong-value", match="'sigma'"):
        kinectbench.load(release.folder, keys=("partial", "sigma"))
    assert {*IMAGES, META, *OF_PAIR} == set(KEYS)


def count_cells(item: dict[str, Any]) -> tuple[str, int]:
    return item["pair_id"], int(item["partial"].sum())


def test_a_transform_makes_the_item_also_of_a_split(release: Release) -> None:
    dataset = kinectbench.load(release.folder, keys=("partial",), transform=count_cells)
    test = pickle.loads(pickle.dumps(dataset.split("test")))
    cells = unpack(read_pair(release.pair_path(test.targets[1])).partial).sum()
    assert test[1] == ("chair_01/001", cells)
    assert list(dataset.split("test").split("test"))[1] == test[1]


def test_truth_that_is_held_back_is_not_there(tmp_path: Path) -> None:
    write_build(tmp_path / "build")
    options = PublishOptions(hold_back=("test",), thresholds=None)
    settings = synthetic_settings()
    folder = publish(settings, tmp_path / "build", tmp_path / "b", ["chair_01", "chair_03"], options).folder
    told = {
        split: set(kinectbench.load(folder, keys=[key for key in KEYS if key != "color"]).split(split)[0])
        for split in ("validation", "test")
    }
    hidden = {"full", "shell", "known", "surface_sigma_m", "occupancy_rule"}
    assert told["validation"] - told["test"] == hidden
    assert "unknown_share" not in kinectbench.load(folder, keys="meta").split("test")[0]["meta"]


def test_a_pair_file_of_another_version_is_told(release: Release, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(release.folder, tmp_path / "b"))
    dataset = kinectbench.load(folder)
    target = dataset.targets[0]
    content = pair_bytes(read_pair(folder / target.file))
    (folder / target.file).write_bytes(content[:-1] + b"\1")
    with raises(ReleaseError, "release.changed", match="changed since it was published"):
        dataset[0]
    other = npz.packed_npz_bytes(
        {"format_version": np.asarray(2), "partial": np.zeros((64, 64, 8), np.uint8)}
    )
    for made, told in ((other, "another format version"), (b"PK", "cannot be read as a pair file")):
        (folder / target.file).write_bytes(made)
        object.__setattr__(dataset.targets[0], "sha256", hashlib.sha256(made).hexdigest())
        dataset.keys = ("partial",)
        with raises(PairError, "pair.malformed", match=told):
            dataset[0]


@pytest.fixture(scope="module", params=["zip", "tar", "tar.gz"])
def archive(
    request: pytest.FixtureRequest, release: Release, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    root: Path = tmp_path_factory.mktemp("archive")
    if request.param == "zip":
        return write_archive(release.folder, root)
    path = root / f"chairs.{request.param}"
    with tarfile.open(path, "w:gz" if request.param.endswith("gz") else "w") as packed:
        packed.add(release.folder, "chairs")
    return path


def first_full(dataset: kinectbench.Dataset) -> int:
    return int(dataset[0]["full"].sum())


def test_an_archive_is_read_in_place(release: Release, archive: Path) -> None:
    before = set(archive.parent.iterdir())
    dataset, plain = kinectbench.load(archive), kinectbench.load(release.folder)
    assert len(dataset) == 7 and dataset.targets == plain.targets
    for index in (0, 6, 3):
        for key in ("partial", "full", "known"):
            np.testing.assert_array_equal(dataset[index][key], plain[index][key])
    images = kinectbench.load(archive, keys=("depth",))[2]["depth"]
    np.testing.assert_array_equal(images, kinectbench.load(release.folder, keys=("depth",))[2]["depth"])
    assert set(archive.parent.iterdir()) == before
    # A forked process shares the place in what its parent has open.
    with multiprocessing.get_context("fork").Pool(2) as pool:
        assert pool.map(first_full, [dataset] * 4) == [first_full(plain)] * 4


def test_a_url_is_read_in_place(release: Release, tmp_path: Path) -> None:
    pytest.importorskip("obstore")
    keys = ("partial", "full", "depth")
    dataset = pickle.loads(pickle.dumps(kinectbench.load(f"file://{release.folder}", keys=keys)))
    for found, item in zip(dataset, kinectbench.load(release.folder, keys=keys), strict=True):
        for key in keys:
            np.testing.assert_array_equal(found[key], item[key])
    with raises(ReleaseError, "release.not-one"):
        kinectbench.load(f"file://{tmp_path}")


def test_what_scores_a_folder_scores_an_archive(release: Release, tmp_path: Path) -> None:
    archive = write_archive(release.folder, tmp_path)
    names = ("hull", "base-rate")
    write_baselines(open_release(archive), tmp_path / "b", names)
    write_baselines(release, tmp_path / "a", names)
    assert hashes(tmp_path / "a") == hashes(tmp_path / "b") != {}
    hull = tmp_path / "a" / "hull"
    tables = [score(open_release(path), hull, method="hull") for path in (release.folder, archive)]
    assert tables[0].json_value() == tables[1].json_value()
    scorer = kinectbench.Scorer(archive, surface=False)
    for split in ("validation", "test"):
        for item in kinectbench.load(archive).split(split):
            scorer.update(item["pair_id"], item["full"])
    overall = scorer.result().overall
    assert overall is not None and overall["known"]["iou"] == 1


def test_an_archive_that_changes_is_noticed(release: Release, tmp_path: Path) -> None:
    path = tmp_path / "chairs.zip"
    for other in (False, True):
        with zipfile.ZipFile(path, "w") as packed:
            for file in sorted(release.folder.rglob("*.*")):
                content = file.read_bytes() if file.is_file() else b""
                other_bytes = content[:-1] + b"\1" if other and file.name == "001.npz" else content
                packed.writestr(file.relative_to(release.folder).as_posix(), other_bytes)
            packed.write(release.folder / "SHA256SUMS", "SHA256SUMS")
        if not other:
            dataset = kinectbench.load(path)
            assert dataset[1]["pair_id"] == "chair_01/001"
    with raises(ReleaseError, "release.changed", match=r"001\.npz"):
        dataset[1]
    path.unlink()
    with raises(KinectBenchError, "release.damaged", match=r"chairs\.zip"):
        dataset[1]
    assert _opened.cache_info().currsize <= 2
