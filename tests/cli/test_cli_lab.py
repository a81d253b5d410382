"""The commands around known truth, as a user gives them."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from read_pictures import read_picture
from small_benchmark import Run, copied

from kinectbench.lab.simulate.objects import families
from kinectbench.lab.simulate.presets import PRESETS
from kinectbench.lab.simulate.truth import read_truth
from kinectbench.release.check.verify import verify
from kinectbench.release.release import open_release
from kinectbench.stages.ingest.readers import open_recording

Command = Callable[..., Run]
SMALL = ("--set", "sensor.width=160", "--set", "sensor.height=120", "--frames", "3")


def test_simulate_by_preset_format_and_settings(command: Command, tmp_path: Path) -> None:
    first = command(tmp_path, "simulate", "a.bag", "--object", "table:seed=3", "--preset", "arc-v1", *SMALL)
    assert (first.status, first.out) == (0, "wrote a.bag\n")
    truth = read_truth(tmp_path / "a.truth")
    assert (truth.subject, truth.camera.width, len(truth.stamps_ns)) == ("table:seed=3", 160, 3)
    plain = command(tmp_path, "simulate", "b", "--format", "folder", *SMALL, "--json")
    assert json.loads(plain.out) == ["b"]
    assert open_recording(tmp_path / "b", None).format == "folder"


def test_simulate_a_mesh_file(command: Command, tmp_path: Path) -> None:
    import trimesh

    trimesh.creation.box((0.5, 0.4, 0.8)).export(tmp_path / "crate.obj")
    run = command(tmp_path, "simulate", "crate", "--mesh", "crate.obj", *SMALL)
    assert run.status == 0, run.err
    truth = read_truth(tmp_path / "crate.truth")
    assert truth.mesh_world.volume_m3 == pytest.approx(0.16, rel=1e-6)
    assert "closed" in truth.origin
    record = json.loads((tmp_path / "crate.truth/truth.json").read_text())
    assert record["spec"]["mesh"]["name"] == "crate.obj"
    assert str(tmp_path) not in json.dumps(record)


def test_simulate_lists_presets_and_draws_contact_sheets(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two families; that all are drawn is tested beside the sheets."""
    assert set(json.loads(command(tmp_path, "simulate", "--presets", "--json").out)) == set(PRESETS)
    assert "orbit-v1" in command(tmp_path, "simulate", "--presets").out
    assert json.loads(command(tmp_path, "simulate", "--families", "--json").out) == sorted(families())
    few = {family: families()[family] for family in ("bench", "table")}
    monkeypatch.setattr("kinectbench.lab.simulate.objects.contact_sheets.families", lambda: few)
    sheets = json.loads(command(tmp_path, "simulate", "--contact-sheets", "sheets", "--json").out)
    assert sheets == ["sheets/bench.png", "sheets/table.png"]
    for sheet in sheets:
        image = read_picture(tmp_path / sheet)
        assert image.shape[1] > 1000
        assert image.std() > 20


def test_evaluate_a_recording_of_the_benchmark(command: Command, small: Path, tmp_path: Path) -> None:
    run = command(small, "evaluate", "chair", "--out", str(tmp_path / "seen"), "--json")
    assert run.status == 0, run.err
    figures = json.loads(run.out)
    assert figures == json.loads((tmp_path / "seen/evaluation.json").read_text())
    assert figures["trajectory"]["error"]["ate_m"]["rmse"] < 1e-6  # the given trajectory is the true one
    assert 0.3 < figures["solid"]["fine"]["iou"] < 1
    assert figures["pairs"]["containment"]["mean"] > 0.85


def test_stages_left_over_from_other_settings_do_not_count(
    command: Command, small: Path, tmp_path: Path
) -> None:
    root = copied(small, tmp_path / "copy")
    changed = command(root, "track", "chair", "--set", "tracking.max_disagreement_m=0.02")
    assert changed.status == 0, changed.err
    found = json.loads(command(root, "evaluate", "build/chair", "--json").out)
    assert found["trajectory"] is not None
    assert found["solid"] is None and found["masks"] is None and found["pairs"] is None
    table = command(root, "evaluate", "build/chair")
    assert "ATE, rmse" in table.out and "index.html" in table.out


def test_what_failed_now_is_not_judged_as_it_was_before(
    command: Command, small: Path, tmp_path: Path
) -> None:
    root = copied(small, tmp_path / "copy")
    run = command(root, "evaluate", "chair", "--json")
    assert run.status == 0 and json.loads(run.out)["solid"]
    run = command(root, "evaluate", "chair", "--json", "--set", "fusion.voxel_size_m=0.001")
    assert run.status == 1 and "too large" in run.err, run.err
    found = json.loads(run.out)
    assert found["trajectory"] is not None and found["solid"] is None and found["pairs"] is None


def test_evaluate_says_in_one_line_what_is_wrong(command: Command, small: Path) -> None:
    for arguments, says in (
        (("chiar",), "did you mean 'chair'"),
        (("chair", "recordings/chair"), "no truth there"),
    ):
        run = command(small, "evaluate", *arguments)
        assert run.status in (1, 2)
        assert says in run.err
        assert len(run.err.splitlines()) == 1


def test_synthesize_a_release_and_the_authors_layout(command: Command, tmp_path: Path) -> None:
    few = ("--category", "table", "--train", "1", "--validation", "1", "--test", "1", "--jobs", "1",
           "--set", "sv_steps=1", "--set", "cv_steps=2", "--set", "image_px=128")  # fmt: skip
    run = command(tmp_path, "synthesize", "made", *few, "--json")
    assert run.status == 0, run.err
    report = json.loads(run.out)
    release = open_release(tmp_path / "made")
    assert (report["models"], report["pairs"]) == (3, len(release.targets))
    assert {target.split for target in release.targets} == {"train", "validation", "test"}
    assert verify(tmp_path / "made") == []
    authors = command(tmp_path, "synthesize", "theirs", *few, "--layout", "recgan")
    assert authors.status == 0, authors.err
    folders = {path.name for path in (tmp_path / "theirs/P1_04379243_table").iterdir()}
    assert {"train_1_25d_vox256", "train_1_3d_vox256", "test_8_25d_vox256"} <= folders
    (tmp_path / "made/notes.txt").write_text("mine")
    (tmp_path / "other.work").mkdir()
    (tmp_path / "other.work/notes.txt").write_text("mine")
    for out in ("made", "other"):
        refused = command(tmp_path, "synthesize", out, *few)
        assert (refused.status, len(refused.err.splitlines())) == (2, 1)
    assert (
        (tmp_path / "made/notes.txt").read_text() == (tmp_path / "other.work/notes.txt").read_text() == "mine"
    )
    assert not (tmp_path / "made.work").exists()
    wrong = command(tmp_path, "synthesize", "x", "--layout", "recgn")
    assert (wrong.status, "wanted one of release, recgan" in wrong.err) == (2, True)
