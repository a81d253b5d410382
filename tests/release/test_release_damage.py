"""Damaged releases are named, in folders and archives; sound archives verify."""

import io
import shutil
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from damaged_releases import damages, try_damage
from fuzz.releases import seal
from raising import raises
from synthetic_release import synthetic_settings
from typer.testing import CliRunner

import kinectbench
from kinectbench.cli.main import app
from kinectbench.core.artefacts.benchmark import PublishOptions
from kinectbench.core.errors import ReleaseError
from kinectbench.core.voxels.pair_file import TRUTH_KEYS
from kinectbench.release.check.verify import EXTRA, verify
from kinectbench.release.exchange.bop import export_bop
from kinectbench.release.exchange.recgan import export_recgan
from kinectbench.release.exchange.webdataset import export_webdataset
from kinectbench.release.publish.publish import publish
from kinectbench.release.release import Release, open_release

RECORDINGS = ["chair_02", "table_02"]


@pytest.fixture(scope="module")
def parts(analytic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`whole/`, of two pairs, and `public/`, whose test split is held back."""
    root: Path = tmp_path_factory.mktemp("parts")
    publish(synthetic_settings(), analytic / "build", root / "whole", RECORDINGS)
    publish(
        synthetic_settings(),
        analytic / "build",
        root / "public",
        RECORDINGS,
        PublishOptions(hold_back=("test",), thresholds=None),
    )
    return root


@pytest.mark.filterwarnings("ignore:Duplicate name")  # a file twice in a zip
def test_every_damage_is_named(parts: Path, tmp_path: Path) -> None:
    wrong, done = [], 0
    for release in (parts / "whole", parts / "public"):
        assert verify(release) == []
        for damage in damages(release):
            lines, well = try_damage(damage, release, tmp_path)
            done += 1
            if not well:
                wrong.append((damage.name, lines))
    assert wrong == [] and done >= 50


@pytest.mark.parametrize("form", ["zip", "top.zip", "tar", "tar.gz"])
def test_sound_archives(parts: Path, tmp_path: Path, form: str) -> None:
    path = tmp_path / f"release.{form}"
    if form.endswith("zip"):
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in sorted((parts / "whole").rglob("*")):
                top = "" if form == "zip" else "chairs-1.0/"
                archive.write(file, top + file.relative_to(parts / "whole").as_posix())
    else:
        with tarfile.open(path, "w:gz" if form == "tar.gz" else "w") as archive:
            archive.add(parts / "whole", ".")
    before = sorted(tmp_path.iterdir())
    progress: list[tuple[int, int]] = []
    assert verify(path, lambda *done: progress.append(done)) == []
    assert progress[-1][0] == progress[-1][1] == len(progress) and sorted(tmp_path.iterdir()) == before
    result = CliRunner().invoke(app, ["verify", str(path)])
    assert result.exit_code == 0 and "all well" in result.output


def test_all_problems_at_once(parts: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(parts / "whole", tmp_path / "benchmark"))
    (folder / "more.txt").write_text("hi")
    (folder / "pairs" / "chair_02" / "000.npz").unlink()
    (folder / "LICENSE").write_text("mine")
    result = CliRunner().invoke(app, ["verify", str(folder)])
    assert result.exit_code == 1
    for name in ("more.txt: not part", "pairs/chair_02/000.npz: missing", "LICENSE: changed"):
        assert name in result.output


def test_a_file_that_is_damaged_itself_is_told_alike_in_a_folder_and_an_archive(
    parts: Path, tmp_path: Path
) -> None:
    """It was published so, as its checksum holds: no archive is to blame."""
    name = "objects/chair_02/volume.npz"
    folder = Path(shutil.copytree(parts / "whole", tmp_path / "benchmark"))
    content = (folder / name).read_bytes()
    (folder / name).write_bytes(content[: len(content) // 2])
    seal(folder)
    packed = Path(shutil.make_archive(str(tmp_path / "benchmark"), "zip", folder))
    (line,) = verify(folder)
    assert line.startswith(f"{name}: damaged (") and "archive" not in line
    assert verify(packed) == [line]


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"", "cut off or damaged"), (b"PK nothing", "cut off or damaged"), (b"\x1f\x8bnothing", "cut off")],
)
def test_no_archive(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "release.zip"
    path.write_bytes(content)
    with raises(ReleaseError, "release.damaged", match=message):
        verify(path)
    with raises(ReleaseError, "release.not-one", match="elsewhere.zip"):
        verify(tmp_path / "elsewhere.zip")


def test_an_archive_of_something_else(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("one/SHA256SUMS", "")
        archive.writestr("two/SHA256SUMS", "")
    with raises(ReleaseError, "release.not-one", match="several"):
        verify(tmp_path / "a.zip")
    with zipfile.ZipFile(tmp_path / "b.zip", "w") as archive:
        archive.writestr("photo.jpg", "")
    with raises(ReleaseError, "release.not-one", match="it holds none"):
        verify(tmp_path / "b.zip")
    assert verify(_with_neighbour(tmp_path / "c.zip")) == [
        "__MACOSX/x: beside the release's folder", "SHA256SUMS: missing; make or download it again"
    ]  # fmt: skip


def _with_neighbour(path: Path) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("one/benchmark.json", "{}")
        archive.writestr("__MACOSX/x", "")
    return path


def test_exports_of_a_public_part(parts: Path, tmp_path: Path) -> None:
    """chair_02 is held back: its scene has no ground truth, its sample only the input."""
    public = open_release(parts / "public")
    assert export_bop(public, tmp_path / "bop") == 2
    hidden, known = tmp_path / "bop/test/000001", tmp_path / "bop/val/000002"
    assert sorted(path.name for path in hidden.iterdir()) == ["depth", "scene_camera.json"]
    assert "cam_R_w2c" not in (hidden / "scene_camera.json").read_text()
    assert (known / "scene_gt.json").is_file() and (known / "mask_visib").is_dir()
    assert [path.name for path in (tmp_path / "bop/models").glob("*.ply")] == ["obj_000002.ply"]
    assert export_webdataset(public, tmp_path / "shards") == 2
    with tarfile.open(tmp_path / "shards" / "test-000000.tar") as shard:
        assert shard.getnames() == ["chair_02_000.npz", "chair_02_000.json"]
        npz = shard.extractfile("chair_02_000.npz")
        assert npz is not None
        sample = {"npz": npz.read(), "json": b"".join(shard.extractfile("chair_02_000.json") or ())}
    assert not {*TRUTH_KEYS, "occupancy_rule"} & set(np.load(io.BytesIO(sample["npz"])))
    (item,) = kinectbench.load(public.folder).split("test")
    assert set(kinectbench.decode_sample(sample)) == set(item) == {"pair_id", "partial", "meta"}
    with raises(ReleaseError, "release.truth-held-back"):
        export_recgan(public, tmp_path / "theirs")


@pytest.mark.parametrize("packed", ["", ".zip", ".tar"])
def test_an_empty_folder_is_reported_like_a_file_that_was_added(
    release: Release, tmp_path: Path, packed: str
) -> None:
    folder = Path(shutil.copytree(release.folder, tmp_path / "benchmark"))
    (folder / "pairs" / "extra" / "inner").mkdir(parents=True)
    path = folder
    if packed:
        kind = packed.removeprefix(".")
        path = Path(shutil.make_archive(str(tmp_path / "packed"), kind, tmp_path, "benchmark"))
    assert verify(path) == verify(path, checksums_only=True) == [EXTRA.format("pairs/extra/inner/")]


def test_another_floor_is_not_read(analytic: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(analytic / "benchmark", tmp_path / "copy"))
    first = open_release(copy).targets[0].recording
    assert open_release(copy).floor(first) is not None
    path = copy / "objects" / first / "floor.json"
    path.write_text(path.read_text() + " ")
    with raises(ReleaseError, "release.changed", match=r"floor\.json"):
        open_release(copy).floor(first)
