"""The whole of `synthesize`: releases that verify and score, the authors' folders, resuming, bad meshes."""

import hashlib
import json
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from raising import raises
from synthesis_shapes import write_shapenet

from kinectbench.core.artefacts.views import ViewsFile
from kinectbench.core.errors import KinectBenchError, SettingsError, StorageError
from kinectbench.core.voxels.pair_file import read_pair, unpack
from kinectbench.lab.synthesize import make
from kinectbench.lab.synthesize.mesh_check import CheckedMesh, load_model
from kinectbench.lab.synthesize.models import Model, SynthesisSettings
from kinectbench.lab.synthesize.synthesize import Report, synthesize
from kinectbench.release.check.verify import verify
from kinectbench.release.release import Release, open_release
from kinectbench.scoring.baselines.predict import write_baselines
from kinectbench.scoring.score import score_methods


def settings(models: Path, **other: object) -> SynthesisSettings:
    """Two steps a turn, small images; four models a category asked for, of three good ones."""
    values = {"train": 2, "validation": 1, "test": 1, "sv_steps": 2, "cv_steps": 1, "image_px": 96}
    return SynthesisSettings.model_validate({"models": str(models), **values, **other})


def hashes(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_shapenet(tmp_path_factory.mktemp("shapenet"))
    for name, text in {"broken": "v 1 2\nf 9 9 9\n", "void": ""}.items():
        (folder / "03001627" / name).mkdir()
        (folder / "03001627" / name / "model.obj").write_text(text)
    return folder


@pytest.fixture(scope="module")
def report(models: Path, tmp_path_factory: pytest.TempPathFactory) -> Report:
    steps: list[tuple[str, int, int]] = []
    found = synthesize(
        settings(models),
        tmp_path_factory.mktemp("synthetic") / "out",
        progress=lambda *step: steps.append(step),
    )
    assert steps[-1] == ("making", 6, 6) and steps[0][0] == "checking"
    return found


@pytest.fixture(scope="module")
def release(report: Report) -> Release:
    return open_release(report.folder)


def test_the_release_verifies(report: Report, release: Release) -> None:
    assert verify(report.folder) == []
    assert release.benchmark_sha256 == report.benchmark_sha256
    assert (report.models, report.pairs) == (6, len(release.targets)) == (6, 2 * (8 + 9 + 9))
    per_split = Counter((target.category, target.split) for target in release.targets)
    assert per_split["chair", "train"] == 8 and per_split["table", "test"] == 9
    groups = Counter((target.split, target.recording.rpartition("-")[2]) for target in release.targets)
    assert groups["validation", "cv"] == groups["test", "cv"] == 2 and groups["train", "cv"] == 0
    assert not (report.folder.parent / "out.work").exists()


def test_framing_view_and_few_views(models: Path, tmp_path: Path) -> None:
    """The views are drawn by the model alone, so that other framings have the same."""
    found = {}
    for framing in ("view", "object"):
        given = settings(models, framing=framing, most_views=3)
        report = synthesize(given, tmp_path / framing)
        assert verify(report.folder) == []
        release = open_release(report.folder)
        assert release.metadata.framing == framing
        rows = [ViewsFile.read(folder) for folder in sorted((report.folder / "views").iterdir())]
        for file in rows:
            assert isinstance(file.steps_per_turn, int)
            assert len(file.views) + len(file.refused) == min(3, file.steps_per_turn**3)
        found[framing] = [
            {row.steps for row in file.views} | {row.steps for row in file.refused} for file in rows
        ]
    assert found["view"] == found["object"]
    assert len({frozenset(steps) for steps in found["view"] if len(steps) == 3}) > 1


def test_noise_is_in_the_settings_and_in_the_card(models: Path, tmp_path: Path) -> None:
    report = synthesize(settings(models, noise="kinect", most_views=1), tmp_path / "noisy")
    assert verify(report.folder) == [] and report.pairs > 0
    stored = json.loads((report.folder / "benchmark.json").read_text())["settings"]["synthesis"]
    assert stored["noise"] == "kinect"
    line = "depth with the errors of a Kinect v1; the full shapes are exact"
    assert line in report.lines and line in (report.folder / "README.md").read_text()


def test_a_collection_may_hold_a_model_thrice(models: Path, tmp_path: Path) -> None:
    """Its author cannot mend that: the release verifies."""
    for name in ("a", "b", "c"):
        path = tmp_path / "cad/chair" / f"{name}.obj"
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(models / "03001627/c0/models/model_normalized.obj", path)
    report = synthesize(settings(tmp_path / "cad", train=1, most_views=1), tmp_path / "out")
    assert {target.split for target in open_release(report.folder).targets} == {"train", "validation", "test"}
    assert verify(report.folder) == []


def test_the_files_say_which_rule_filled_them(release: Release) -> None:
    for target in release.targets:
        expected = "six-rays" if target.object == "t0" else "winding"
        assert read_pair(release.pair_path(target)).occupancy_rule == expected
        assert release.metadata.recordings[target.recording].quality.method == expected


def test_views_json_has_the_angles(report: Report, release: Release) -> None:
    target = release.targets[-1]
    content = json.loads((report.folder / "views" / target.recording / "views.json").read_text())
    row = next(row for row in content["views"] if row["view"] == target.view)
    pair = read_pair(release.pair_path(target))
    np.testing.assert_array_equal(row["T_world_camera"], pair.T_world_camera)
    assert content["steps_per_turn"] == 2 and row["steps"] == [1, 1, 1]
    np.testing.assert_allclose(row["angles_rad"], [np.pi] * 3)
    assert content["camera"]["fx"] == pair.K[0, 0]


def test_nothing_is_left_out_silently(report: Report, models: Path) -> None:
    assert [bad.model for bad in report.left_out] == ["chair/broken", "chair/void"]
    assert (
        "chair: 3 models for the 2 train, 1 validation, 1 test asked for: dealt in proportion" in report.lines
    )
    text = (report.folder / "README.md").read_text()
    for line in report.lines:
        assert f"- {line}" in text
    assert any(line.startswith("left out: chair/void: ") for line in report.lines)
    assert "table/t0: not watertight: filled by the rule six-rays" in report.lines
    chairs = "3 models (1 train, 1 validation, 1 test), 26 pairs (8 train, 9 validation, 9 test)"
    assert f"chair: {chairs}, 3 by winding" in report.lines
    assert str(models) not in (report.folder / "benchmark.json").read_text() + text


def test_it_can_be_scored_and_gives_thresholds(release: Release, tmp_path: Path) -> None:
    write_baselines(release, tmp_path / "baselines", ("empty",))
    for target in release.targets:
        if target.split != "train":
            path = tmp_path / "methods" / "perfect" / target.recording / f"{target.view}.npy"
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, unpack(read_pair(release.pair_path(target)).full))
    (table,) = score_methods(release, tmp_path / "methods" / "perfect", tmp_path / "scores", surface=False)
    assert table.complete and table.threshold_source == "validation"
    assert {row.iou for row in table.rows} == {1.0}


def test_the_result_depends_on_neither_jobs_nor_interruptions(
    models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original, made = load_model, []
    tables = settings(models, categories=["table"], sv_steps=1)

    def stop_at_the_third(model: Model, max_faces: int) -> CheckedMesh | None:
        made.append(model)
        if len(made) == 3:
            raise KeyboardInterrupt
        return original(model, max_faces)

    out = tmp_path / "out"
    monkeypatch.setattr(make, "load_model", stop_at_the_third)
    with pytest.raises(KeyboardInterrupt):
        synthesize(tables, out)
    assert not out.exists() and len(list((tmp_path / "out.work").glob("*/made.json"))) == 2
    (tmp_path / "out.work" / ".t9.abc.part").mkdir()  # a leftover of a killed process
    kept = next((tmp_path / "out.work").glob("*/made.json"))
    whole = kept.read_bytes()
    kept.write_bytes(b" " * len(whole))
    with raises(StorageError, "storage.damaged", match=r"made\.json"):
        synthesize(tables, out)
    kept.write_bytes(whole)
    synthesize(tables, out)
    assert len(made) == 4  # only the third again
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    monkeypatch.undo()
    synthesize(tables, tmp_path / "again", jobs=2)
    assert hashes(tmp_path / "again") == hashes(out)


def test_a_finished_model_is_used_again_by_another_seed_only_without_noise(
    tmp_path: Path,
) -> None:
    def made_with(seed: int, noise: str, work: Path) -> dict[str, str]:
        chosen = SynthesisSettings.model_validate(
            {"seed": seed, "noise": noise, "sv_steps": 1, "image_px": 96, "min_containment": 0}
        )
        task = make.Task(Model("chair", "chair-00003", seed=3), "train", chosen, work)
        make.make_model(task)
        return hashes(task.folder / make.FILES)

    for noise in ("none", "kinect"):
        first = made_with(0, noise, tmp_path / noise)
        assert len(first) > 3  # a pair, its views, its object
        (task_folder,) = (tmp_path / noise).iterdir()
        stamp_ns = (task_folder / "made.json").stat().st_mtime_ns
        other = made_with(1, noise, tmp_path / noise)
        assert other == made_with(1, noise, tmp_path / f"{noise}-alone")
        assert (other == first) == (noise == "none")
        assert ((task_folder / "made.json").stat().st_mtime_ns == stamp_ns) == (noise == "none")


def test_layout_recgan(models: Path, tmp_path: Path) -> None:
    report = synthesize(settings(models, layout="recgan", categories=["chair"]), tmp_path / "out")
    names = {path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*.npz")}
    folders = Counter(name.rpartition("/")[0] for name in names)
    assert folders == {
        f"P1_03001627_chair/{split}_{kind}_vox256": count
        for split, count in (("train_8", 8), ("val_8", 8), ("val_1", 1), ("test_8", 8), ("test_1", 1))
        for kind in ("25d", "3d")
    }
    assert report.pairs == len(names) / 2 == 26
    content = json.loads((tmp_path / "out" / "synthesis.json").read_text())
    assert content["report"] == list(report.lines)
    assert {row["quality"]["method"] for row in content["models"].values()} == {"winding"}


def test_only_what_it_wrote_is_replaced(models: Path, tmp_path: Path) -> None:
    """A person's own files may be in a folder that is named as the authors name theirs."""
    chosen, out = settings(models, layout="recgan", categories=["chair"]), tmp_path / "out"
    synthesize(chosen, out)
    before = {path.name for path in out.iterdir()}
    synthesize(chosen, out)
    assert {path.name for path in out.iterdir()} == before
    mine = out / "P1_03001627_chair" / "of the thesis.npz"
    mine.write_bytes(b"years of work")
    with raises(SettingsError, "settings.other-content"):
        synthesize(chosen, out)
    assert mine.read_bytes() == b"years of work"
    mine.unlink()
    (out / "synthesis.json").write_text("damaged")
    with raises(SettingsError, "settings.other-content"):
        synthesize(chosen, out)


def test_what_else_lies_there_is_not_replaced(models: Path, tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    with raises(SettingsError, "settings.other-content"):
        synthesize(settings(models), tmp_path)
    assert (tmp_path / "thesis.txt").read_text() == "years of work"


def test_not_one_good_model(models: Path, tmp_path: Path) -> None:
    folder = tmp_path / "models"
    shutil.copytree(models / "03001627" / "void", folder / "chair" / "void")
    with raises(KinectBenchError, "run.no-model"):
        synthesize(settings(folder), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_parametric_furniture(tmp_path: Path) -> None:
    chosen = SynthesisSettings(
        categories=("table",), train=1, validation=0, test=1, sv_steps=1, cv_steps=1, image_px=96
    )
    report = synthesize(chosen, tmp_path / "out")
    assert verify(report.folder) == [] and report.models == 2
    info = open_release(report.folder).metadata.recordings
    assert {row.quality.source for row in info.values()} == {"table:seed=0", "table:seed=1"}
    assert {row.quality.method for row in info.values()} == {"winding"}
