"""A release as the authors' files and back: an asymmetric shape, so that a mirrored axis shows."""

import json
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from raising import raises
from small_benchmark import Run
from synthetic_release import publish_synthetic
from typer.testing import CliRunner

from kinectbench.cli.main import app
from kinectbench.core.errors import PairError, ReleaseError, SettingsError
from kinectbench.core.voxels.npz import npz_bytes
from kinectbench.core.voxels.pair_file import Pair, read_pair, unpack
from kinectbench.core.voxels.recgan_file import read_recgan_file, recgan_file_bytes
from kinectbench.release.check.verify import verify
from kinectbench.release.exchange.recgan import export_recgan, import_recgan
from kinectbench.release.release import open_release
from kinectbench.scoring.published import REAL, SYNTHETIC, published_beside

Command = Callable[..., Run]
KEPT = {"partial", "partial_256", "full", "shell", "T_world_grid", "T_world_camera", "K", "voxel_size_m"}


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return publish_synthetic(tmp_path_factory.mktemp("published")).folder


@pytest.fixture(scope="module")
def exported(release: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("exported") / "theirs"
    assert export_recgan(open_release(release), out) == 7
    return out


def corner() -> np.ndarray:
    """Arms of different lengths along x, y and z, so that no mirror image or order of axes is the same."""
    cells = np.zeros((256, 256, 256), bool)
    cells[30:200, 40:60, 50:70] = cells[30:50, 40:150, 50:70] = cells[30:50, 40:60, 50:110] = True
    return cells


def test_axes_of_one_file(tmp_path: Path) -> None:
    """A cell at our (i, j, k) lies at their (255 - i, 255 - j, k): x to the left, y up, z forward."""
    path = tmp_path / "m_0_0_0.npz"
    path.write_bytes(recgan_file_bytes(corner()))
    with np.load(path, allow_pickle=False) as archive:
        theirs = archive["arr_0"]
    assert theirs.shape == (256, 256, 256, 1) and theirs.dtype == np.int8
    i, j, k = np.argwhere(corner()).T
    assert theirs.sum() == len(i) and theirs[255 - i, 255 - j, k, 0].all()
    np.testing.assert_array_equal(read_recgan_file(path), corner())


@pytest.mark.parametrize("size", [(170, 110, 60), (171, 111, 61), (258, 256, 258)])
def test_other_sizes_are_centred_as_their_readers_do(tmp_path: Path, size: tuple[int, int, int]) -> None:
    cells = np.random.default_rng(0).random(size) < 0.01
    path = tmp_path / "m_0_0_0.npz"
    path.write_bytes(npz_bytes({"arr_0": cells[..., None].astype(np.int8)}))
    expected = np.zeros((256, 256, 256), bool)
    for x, y, z in np.argwhere(cells):
        at = [
            c - (d - 256) // 2 if d > 256 else c + (256 - d) // 2
            for c, d in zip((x, y, z), size, strict=True)
        ]
        if all(0 <= a < 256 for a in at):
            expected[255 - at[0], 255 - at[1], at[2]] = True
    np.testing.assert_array_equal(read_recgan_file(path), expected)


def test_round_trip_is_exact(release: Path, exported: Path, tmp_path: Path) -> None:
    assert import_recgan(exported, tmp_path / "back") == 7
    assert verify(tmp_path / "back") == []
    old, new = open_release(release), open_release(tmp_path / "back")
    assert [t.name for t in new.targets] == [t.name for t in old.targets]
    for target, other in zip(old.targets, new.targets, strict=True):
        assert (target.object, target.category, target.split) == (other.object, other.category, other.split)
        one, two = read_pair(old.pair_path(target)), read_pair(new.pair_path(other))
        for name in KEPT & {field.name for field in fields(Pair)}:
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
        assert unpack(two.known).all() and other.unknown_share is None
    rows = json.loads((exported / "export.json").read_text())["pairs"]
    assert [row["unknown_share"] for row in rows] == [target.unknown_share for target in old.targets]


def test_names_of_the_files(exported: Path) -> None:
    assert (exported / "P1_03001627_chair/test_2_25d_vox256/chair_01_1_0_0.npz").is_file()
    assert (exported / "P1_03001627_chair/val_2_3d_vox256/chair_03_0_0_0.npz").is_file()
    assert (
        len(list(exported.glob("P1_*/*_25d_*/*.npz"))) == len(list(exported.glob("P1_*/*_3d_*/*.npz"))) == 7
    )


def test_their_own_files_become_a_release(tmp_path: Path) -> None:
    for kind, cells in (("25d", corner() & (np.arange(256) < 60)), ("3d", corner())):
        for name in ("m_0_10_0", "m_0_2_0"):
            path = tmp_path / f"in/P1_02828884_bench/test_125_{kind}_vox256/{name}.npz"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(recgan_file_bytes(cells))
    assert import_recgan(tmp_path / "in", tmp_path / "out") == 2
    assert verify(tmp_path / "out") == []
    target = open_release(tmp_path / "out").targets[1]
    assert (target.recording, target.view, target.category, target.split) == ("m-125", "001", "bench", "test")
    pair = read_pair(tmp_path / "out" / target.file)
    np.testing.assert_array_equal(unpack(pair.full), corner())
    card = " ".join((tmp_path / "out/README.md").read_text().split())
    assert "`surface_sigma_m`, which is not known, is 0: do not use the surface Dice" in card
    assert pair.surface_sigma_m == 0
    (tmp_path / "in/P1_02828884_bench/test_125_3d_vox256/m_0_2_0.npz").unlink()
    with raises(PairError, "pair.malformed", match=r"m_0_2_0\.npz"):
        import_recgan(tmp_path / "in", tmp_path / "out2")
    assert not (tmp_path / "out2").exists()


def test_wrong_folders_and_files(release: Path, exported: Path, tmp_path: Path) -> None:
    with raises(SettingsError, "settings.no-file"):
        import_recgan(tmp_path, tmp_path / "new" / "out")
    assert not (tmp_path / "new").exists()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("precious")
    with raises(SettingsError, "settings.other-content"):
        export_recgan(open_release(release), tmp_path / "mine")
    with raises(ReleaseError, "release.other-content"):
        import_recgan(exported, tmp_path / "mine")
    path = tmp_path / "bad.npz"
    for content in (
        b"no",
        npz_bytes({"arr_0": np.zeros((4, 4, 4))}),
        npz_bytes({"other": np.zeros((4, 4, 4, 1))}),
        npz_bytes({"arr_0": np.full((4, 4, 4, 1), 7)}),
        npz_bytes({"arr_0": np.zeros((600, 1, 1, 1), np.int8)}),
    ):
        path.write_bytes(content)
        with raises(PairError, "pair.malformed", match=r"bad\.npz"):
            read_recgan_file(path)


def test_own_files_beside_an_export_or_an_import_stay(release: Path, exported: Path, tmp_path: Path) -> None:
    mine, imported = tmp_path / "mine", tmp_path / "imported"
    for _ in range(2):  # its own output is replaced
        export_recgan(open_release(release), mine)
        import_recgan(exported, imported)
    for folder in (mine, imported):
        (folder / "notes.txt").write_text("precious")
    with raises(SettingsError, "settings.other-content", match="holds something else"):
        export_recgan(open_release(release), mine)
    with raises(ReleaseError, "release.other-content", match=r"notes\.txt"):
        import_recgan(exported, imported)
    assert all((folder / "notes.txt").read_text() == "precious" for folder in (mine, imported))


def test_a_damaged_list_is_refused(exported: Path, tmp_path: Path) -> None:
    content = json.loads((exported / "export.json").read_text())
    content["pairs"][0]["recording"] = "../../up"
    (tmp_path / "export.json").write_text(json.dumps(content))
    with raises(PairError, "pair.malformed", match="not safe"):
        import_recgan(tmp_path, tmp_path / "out")


def test_commands(release: Path, tmp_path: Path) -> None:
    runner = CliRunner()
    there = runner.invoke(app, ["export", str(tmp_path / "theirs"), "--benchmark", str(release)])
    assert there.exit_code == 0 and "exported 7 pairs" in there.output
    back = runner.invoke(app, ["import", str(tmp_path / "theirs"), str(tmp_path / "back"), "--json"])
    assert back.exit_code == 0 and json.loads(back.output)["pairs"] == 7


def test_same_and_cross_viewing_angles_stay_apart(tmp_path: Path) -> None:
    for group in ("train_125", "val_125", "val_216", "test_125", "test_216"):
        for kind, cells in (("25d", corner() & (np.arange(256) < 60)), ("3d", corner())):
            model = {"train": "t", "val": "v", "test": "m"}[group.partition("_")[0]]
            path = tmp_path / f"in/P1_02828884_bench/{group}_{kind}_vox256/{model}_0_2_0.npz"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(recgan_file_bytes(cells))
    with raises(SettingsError, "settings.wrong-value", match="125 and 216"):
        import_recgan(tmp_path / "in", tmp_path / "both")
    with raises(SettingsError, "settings.wrong-value", match="of 50 views"):
        import_recgan(tmp_path / "in", tmp_path / "both", views=50)
    assert not (tmp_path / "both").exists()
    for views in (125, 216):
        assert import_recgan(tmp_path / "in", tmp_path / f"{views}", views=views) == 3
        release = open_release(tmp_path / f"{views}")
        assert release.metadata.name == f"in-{views}"
        assert {t.recording for t in release.targets} == {"t-125", f"v-{views}", f"m-{views}"}
        beside = published_beside(t.recording for t in release.split("test"))
        assert [table.views for table in beside] == [views] * (3 if views == 125 else 2)
    assert published_beside(["m-125", "m-216"]) == published_beside(["chair_01"]) == (REAL,)


def test_the_papers_synthetic_tables() -> None:
    assert [table.rows[0].iou[0] for table in SYNTHETIC[:4]] == [0.580, 0.531, 0.581, 0.540]
    for table in SYNTHETIC[:4]:
        assert [row.method for row in table.rows] == [row.method for row in REAL.rows]
        assert all(table.rows[0].iou[n] == max(row.iou[n] for row in table.rows) for n in range(4))
        assert all(table.rows[0].ce[n] == min(row.ce[n] for row in table.rows) for n in range(4))


LEAD_OUT = {
    "recording": "../../up",
    "object": "/etc/passwd",
    "view": "../000",
    "category": "..",
    "file_25d": "../../secret.npz",
    "file_3d": "/etc/hostname",
}


def refused(command: Command, where: Path, status: int = 1) -> str:
    """Import `where/in`; the one line that refuses it, with which nothing is written."""
    before = sorted(where.rglob("*"))
    done = command(where, "import", "in", "out")
    assert done.status == status and done.out == "", done
    (line,) = done.err.splitlines()
    assert line.startswith("error: ") and sorted(where.rglob("*")) == before
    return line


@pytest.mark.parametrize("key", LEAD_OUT)
def test_the_command_follows_no_name_out_of_its_folders(
    exported: Path, tmp_path: Path, command: Command, key: str
) -> None:
    inside = tmp_path / "deep" / "in"
    inside.mkdir(parents=True)
    (tmp_path / "secret.npz").write_bytes(recgan_file_bytes(corner()))
    content = json.loads((exported / "export.json").read_text())
    content["pairs"][0][key] = LEAD_OUT[key]
    (inside / "export.json").write_text(json.dumps(content))
    line = refused(command, tmp_path / "deep")
    assert key in line or "leads out of the folder" in line


def test_the_command_takes_no_archive_and_no_odd_folder(tmp_path: Path, command: Command) -> None:
    for name in ("archive", "folder"):
        (tmp_path / name).mkdir()
    (tmp_path / "archive" / "in").write_bytes(npz_bytes({"../../up": np.zeros(1)}))
    (tmp_path / "folder" / "in" / "P1_.._up").mkdir(parents=True)
    for name in ("archive", "folder"):
        assert "no P1_<synset>_<category>" in refused(command, tmp_path / name, status=2)


SEEN = "P1_02828884_bench/test_125_25d_vox256/m_0_2_0.npz"
FULL = SEEN.replace("25d", "3d")


def theirs(folder: Path) -> Path:
    """A folder of one pair in the authors' layout."""
    for name, cells in ((SEEN, corner() & (np.arange(256) < 60)), (FULL, corner())):
        (folder / name).parent.mkdir(parents=True)
        (folder / name).write_bytes(recgan_file_bytes(cells))
    return folder


@pytest.mark.parametrize("name", [SEEN, FULL, str(Path(FULL).parent), str(Path(SEEN).parents[1]), "loop"])
def test_the_command_follows_no_link_out_of_the_folder(tmp_path: Path, command: Command, name: str) -> None:
    """What a link leads to would be published."""
    folder = theirs(tmp_path / "here" / "in")
    if name == "loop":
        (folder / FULL).unlink()
        (folder / FULL).symlink_to(folder / FULL)
    else:
        (folder / name).rename(tmp_path / "elsewhere")
        (folder / name).symlink_to(tmp_path / "elsewhere")
    assert "a link out of the folder; put the file itself there" in refused(command, tmp_path / "here")


def test_the_command_follows_no_link_to_a_list_elsewhere(
    exported: Path, tmp_path: Path, command: Command
) -> None:
    folder = theirs(tmp_path / "in")
    (folder / "export.json").symlink_to(exported / "export.json")
    assert "export.json: a link out of the folder" in refused(command, tmp_path)


def test_links_within_the_folder_and_to_it_are_followed(tmp_path: Path, command: Command) -> None:
    folder = theirs(tmp_path / "data")
    (folder / FULL).rename(folder / "full.npz")
    (folder / FULL).symlink_to(folder / "full.npz")
    (tmp_path / "in").symlink_to(folder)
    done = command(tmp_path, "import", "in", "out")
    assert done.status == 0, done.err
    np.testing.assert_array_equal(unpack(read_pair(tmp_path / "out/pairs/m-125/000.npz").full), corner())


def test_a_folder_that_is_a_link_to_itself_is_a_line(tmp_path: Path, command: Command) -> None:
    (tmp_path / "loop").symlink_to("loop")
    result = command(tmp_path, "import", "loop", "out")
    assert result.status in (1, 2) and "internal error" not in result.err and result.err.count("\n") == 1


def test_a_release_without_pairs_is_exported(release: Path, tmp_path: Path) -> None:
    assert export_recgan(replace(open_release(release), targets=()), tmp_path / "out") == 0
