"""The pipeline: what is made again and what is not, and the same bytes however it is run."""

import html
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from bounds import children_within
from read_pictures import read_picture
from slow import slow
from small_benchmark import STAGE_FOLDERS, Run, copied, finish, hashes, leftovers, run, start

pytestmark = pytest.mark.xdist_group("resume")

Command = Callable[..., Run]
ALL = tuple(STAGE_FOLDERS)
FROM_TRACK, FROM_FUSE, FROM_SEGMENT, FROM_VIEWS = ALL[1:], ALL[2:], ALL[3:], ALL[4:]


@pytest.fixture
def one(small: Path, tmp_path: Path) -> Path:
    """A copy of the benchmark with the chair only."""
    root = copied(small, tmp_path / "one", "recordings/chair", "build/chair")
    lines = (small / "benchmark.yaml").read_text().splitlines()
    (root / "benchmark.yaml").write_text("\n".join(line for line in lines if "id: table" not in line))
    return root


def made(result: Run) -> tuple[str, ...]:
    """Names of the stages that were made, of the only recording."""
    assert result.status == 0, result
    return tuple(json.loads(result.out)[0]["made"])


# Every setting there is, another value for it, and the stages that depend on it.
SETTINGS = {
    "name=other": (),
    "license=CC0-1.0": (),
    "source=simulated": (),
    # Links that are followed are among the files that are hashed; here there are none.
    "recordings.chair.follow_links=true": (),
    "recordings.chair.category=seat": (),
    "recordings.chair.object=red_chair": (),
    "recordings.chair.split=train": (),
    "recordings.chair.trajectory=trust": FROM_TRACK,
    "recordings.chair.trajectory=refine": FROM_TRACK,
    "recordings.chair.trajectory=ignore": ALL,  # a broken one ends ingest no more
    "recordings.chair.camera={fx: 131.0}": ALL,
    "recordings.chair.reference=scan.ply": FROM_SEGMENT,
    "recordings.chair.box={center_m: [0, 0, 0.5], size_m: [1, 1, 0.99]}": FROM_SEGMENT,
    "recordings.chair.pick={frame: 3, pixel: [80, 60]}": FROM_SEGMENT,
    "recordings.chair.floor={plane_world: [0, 0, 1, 0]}": FROM_SEGMENT,
    "recordings.chair.underside=closed": (),  # it is
    "recordings.chair.underside=unseen": FROM_SEGMENT,
    "recordings.chair.segment_by=masks": ALL,  # which ignores the trajectory
    "recordings.chair.segment_by=turntable": ALL,
    "recordings.chair.masks=masks": FROM_VIEWS,
    "recordings.chair.license=CC0-1.0": (),
    "recordings.chair.review={decision: accept, reason: looked at}": (),
    "recordings.chair.source=simulated": (),
    "categories={chair: {underside: open}}": (),  # its own word wins
    "tracking.check_stride_px=3": FROM_TRACK,
    "tracking.check_neighbours=5": FROM_TRACK,
    "tracking.max_disagreement_m=0.03": FROM_TRACK,
    "tracking.max_stamp_gap_s=0.2": FROM_TRACK,
    "fusion.voxel_size_m=0.012": FROM_SEGMENT,
    "fusion.scene_voxel_size_m=0.025": FROM_FUSE,
    "fusion.truncation_voxels=5.0": FROM_FUSE,
    "fusion.min_depth_m=0.2": FROM_FUSE,
    "fusion.max_depth_m=2.9": FROM_FUSE,
    "segmentation.seed=1": FROM_SEGMENT,
    "segmentation.floor_cut_m=0.025": FROM_SEGMENT,
    "segmentation.low_cut_m=0.012": FROM_SEGMENT,
    "segmentation.line_width_m=0.02": FROM_SEGMENT,
    "segmentation.near_m=0.5": FROM_SEGMENT,
    "segmentation.camera_size_m=0.1": FROM_SEGMENT,
    "segmentation.camera_height_m=0.1": FROM_SEGMENT,
    "segmentation.mask_tolerance_m=0.04": FROM_VIEWS,
    "views.count=2": FROM_VIEWS,
    "views.seed=1": FROM_VIEWS,
    "views.strategy=random": (),
    "views.min_pixels=90": FROM_VIEWS,
    "views.recorded_masks=false": FROM_VIEWS,
    "pairs.framing=view": ("pairs",),
    "pairs.partial_rule=majority": ("pairs",),
    "pairs.min_containment=0.8": FROM_VIEWS,
    "pairs.max_residual_m=0.02": FROM_VIEWS,
    "pairs.min_visible_share=0.3": FROM_VIEWS,
    "publish.gate={min_estimated_iou: 0.4}": (),
    "publish.color=true": (),
    "publish.citation={title: Chairs, authors: ['Doe, Jo'], version: 1.0.0}": (),
    "publish.datasheet={motivation: to try it}": (),
    "publish.changelog=[{version: 1.0.0, changes: [first]}]": (),
}


def every_setting() -> set[str]:
    """Dotted names of all settings; those of a section that is None by default count as one."""
    from kinectbench.settings.base import Settings
    from kinectbench.settings.models import BenchmarkSettings, RecordingSettings

    names = {f"recordings.chair.{key}" for key in RecordingSettings.model_fields} - {
        "recordings.chair.id",
        "recordings.chair.path",
    }
    for key, field in BenchmarkSettings.model_fields.items():
        model = field.annotation
        if isinstance(model, type) and issubclass(model, Settings):
            names |= {f"{key}.{name}" for name in model.model_fields}
        elif key != "recordings":
            names.add(key)
    return names


def test_the_table_of_settings_is_complete() -> None:
    # What is included is read before --set, which refuses it.
    assert {setting.split("=")[0] for setting in SETTINGS} == every_setting() - {"include"}


def planned(root: Path, *overrides: str) -> tuple[str, ...]:
    """The stages that are not current under these settings, by fingerprints alone."""
    from kinectbench.engine.pipeline import artefacts_upto
    from kinectbench.engine.stages import Job
    from kinectbench.settings.file import load_benchmark

    settings = load_benchmark(root / "benchmark.yaml", overrides)
    artefacts = artefacts_upto(Job(settings, settings.recordings[0], root), "pairs")
    return tuple(name for name, artefact in artefacts.items() if not artefact.is_current())


@pytest.fixture(scope="module")
def shared(small: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the benchmark for tests that make nothing."""
    root = copied(small, tmp_path_factory.mktemp("shared") / "b")
    (root / "masks").mkdir()
    (root / "scan.ply").write_bytes(b"a mesh")
    return root


@pytest.mark.parametrize("setting", SETTINGS)
def test_a_setting_invalidates_what_depends_on_it(shared: Path, setting: str) -> None:
    assert planned(shared) == ()
    assert planned(shared, setting) == SETTINGS[setting]


@pytest.mark.parametrize("setting", ["license=CC0-1.0", "pairs.partial_rule=majority", "views.seed=1"])
def test_and_nothing_else_is_made(command: Command, one: Path, setting: str) -> None:
    kept = [folder for stage, folder in STAGE_FOLDERS.items() if stage not in SETTINGS[setting]]
    before = {folder: (one / "build" / "chair" / folder).stat().st_ino for folder in kept}
    assert made(command(one, "build", "--json", "--set", setting)) == SETTINGS[setting]
    assert {folder: (one / "build" / "chair" / folder).stat().st_ino for folder in kept} == before


def test_back_and_forth_gives_the_first_bytes(command: Command, one: Path) -> None:
    before = hashes(one / "build")
    assert made(command(one, "build", "--json", "--set", "views.seed=1")) == FROM_VIEWS
    assert hashes(one / "build") != before
    assert made(command(one, "build", "--json")) == FROM_VIEWS
    assert hashes(one / "build") == before


@pytest.mark.parametrize("name", [slow("build"), "segment", "pairs"])
def test_force(command: Command, one: Path, name: str) -> None:
    before = hashes(one / "build")
    assert made(command(one, name, "--force", "--json")) == (ALL if name == "build" else (name,))
    assert hashes(one / "build") == before


def test_a_stage_brings_up_to_date_what_it_stands_on(command: Command, one: Path) -> None:
    shutil.rmtree(one / "build")
    assert made(command(one, "fuse", "--json")) == ALL[:3]
    assert made(command(one, "segment", "--json")) == ("segment",)
    assert not (one / "build" / "chair" / "views").exists()


def test_the_second_run_is_fast(small: Path) -> None:
    with children_within(12):  # idle 7.9: three processes, each with the whole package
        result = run(small, "build")
    assert result.status == 0 and result.out.count("up to date") == 2


# --- recordings ---------------------------------------------------------------------------------------


def test_moving_everything_keeps_it_current(command: Command, one: Path, tmp_path: Path) -> None:
    moved = tmp_path / "elsewhere" / "deep"
    moved.parent.mkdir()
    one.rename(moved)
    assert made(command(moved, "build", "--json")) == ()
    copy = tmp_path / "copy"
    shutil.copytree(moved, copy, copy_function=shutil.copy)  # other times
    assert made(command(copy, "build", "--json")) == ()


def test_other_times_change_nothing(command: Command, one: Path) -> None:
    for path in (one / "recordings").rglob("*"):
        os.utime(path, (1, 1))
    assert made(command(one, "build", "--json")) == ()


def test_a_click_is_no_frame(command: Command, one: Path) -> None:
    """What lies beside the frames as pick.json is asked for in benchmark.yaml: no stage is made for it."""
    (one / "recordings/chair/pick.json").write_text('{"frame": 3, "pixel": [80, 60]}')
    assert made(command(one, "build", "--json")) == ()


def test_one_byte_of_a_depth_image_changes_everything(command: Command, one: Path) -> None:
    path = sorted((one / "recordings" / "chair" / "depth").iterdir())[2]
    image = read_picture(path, cv2.IMREAD_UNCHANGED)
    assert image is not None
    image[60, 80] += 1
    assert cv2.imwrite(str(path), image)
    assert made(command(one, "build", "--json")) == ALL


@pytest.mark.parametrize("text", ["", "[]", '{"depth.txt": 5}', '{"depth.txt": [1, 2]}', "{"])
def test_a_damaged_cache_of_hashes_is_no_harm(command: Command, one: Path, text: str) -> None:
    (one / "build" / "chair" / "sources.json").write_text(text)
    assert made(command(one, "build", "--json")) == ()


def test_why_a_stage_failed_is_kept_for_the_page_until_it_succeeds(command: Command, one: Path) -> None:
    elsewhere = "recordings.chair.box={center_m: [9, 9, 0.5], size_m: [0.2, 0.2, 0.2]}"
    result = command(one, "report", "--set", elsewhere)
    assert result.status == 1
    note, error, *_ = result.err.splitlines()
    assert note.startswith("note: chair: built with other settings (box was None, now ")
    told = error.removeprefix("chair: error: ")
    file = one / "build" / "chair" / "failed.json"
    kept = {"format_version": 1, "stage": "segment", "error": told, "code": "segmentation.empty-box"}
    assert json.loads(file.read_text()).items() >= kept.items()
    page = one / "scores" / "index.html"
    assert f"The last build failed: segment: {told}" in html.unescape(page.read_text())
    # What comes before it is well and says nothing of it; not even a damaged file stops the next run.
    assert command(one, "fuse").status == 0 and file.exists()
    assert command(one, "report").status == 0 and not file.exists()
    assert "The last build failed" not in page.read_text()
    file.write_text("[")
    assert command(one, "fuse").status == 0 and not file.exists()
    assert leftovers(one) == []


def test_masks_count_by_their_contents(command: Command, one: Path) -> None:
    masks = one / "masks"
    masks.mkdir()
    setting = ["--set", "recordings.chair.masks=masks", "--json"]
    assert cv2.imwrite(str(masks / "000.exclude.png"), np.zeros((120, 160), np.uint8))
    assert made(command(one, "build", *setting)) == FROM_VIEWS
    assert made(command(one, "build", *setting)) == ()
    assert cv2.imwrite(str(masks / "000.exclude.png"), np.eye(120, 160, dtype=np.uint8))
    assert made(command(one, "build", *setting)) == FROM_VIEWS


# --- same bytes ---------------------------------------------------------------------------------------


def test_masks_that_benchmark_yaml_does_not_name_are_told(command: Command, one: Path) -> None:
    assert "masks" not in command(one, "build").err
    (one / "masks" / "chair").mkdir(parents=True)
    result = command(one, "build", "--json")
    (row,) = json.loads(result.out)
    assert row["made"] == []
    told = "masks/chair: not used; add `masks: masks/chair` to chair in benchmark.yaml to use it"
    assert row["warnings"][-1] == told and result.err == f"chair: warning: {told}\n"
    assert command(one, "segment").err == ""
    named = command(one, "build", "--set", "recordings.chair.masks=masks/chair")
    assert named.status == 0 and "not used" not in named.err


def test_two_runs_at_once(one: Path, small: Path) -> None:
    shutil.rmtree(one / "build")
    runs = [start(one, "publish", "--jobs", "1") for _ in range(2)]
    results = [finish(process) for process in runs]
    assert [result.status for result in results] == [0, 0], results
    assert any("waiting for process" in line for result in results for line in result.progress)
    assert hashes(one / "build" / "chair") == hashes(small / "build" / "chair")
    assert run(one, "verify").status == 0
    assert leftovers(one) == []
