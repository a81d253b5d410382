"""`publish --isolate`: one view of each object whose truth is held back, and nothing that the others told."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from analytic_release import CAMERA, write_analytic_build
from held_back_attack import measured
from raising import raises
from read_pictures import read_picture
from small_benchmark import Run, hashes
from synthetic_release import Recordings, synthetic_settings
from test_release_forged import sealed

from kinectbench.cli.publish import publish_options
from kinectbench.core.artefacts.benchmark import PublishOptions, ReleaseInfo
from kinectbench.core.errors import ReleaseError, SettingsError
from kinectbench.core.sequence import depth_in_metres
from kinectbench.core.voxels.pair_file import pair_bytes, read_input, read_pair, unpack
from kinectbench.core.voxels.seen_cells import seen_cells
from kinectbench.release.check.rebuild import LocalRecording, rebuild_plan
from kinectbench.release.check.verify import verify
from kinectbench.release.opening import open_contents
from kinectbench.release.publish.held_back import isolate
from kinectbench.release.publish.publish import PublishSummary, publish
from kinectbench.release.release import open_release
from kinectbench.scoring.baselines.predict import write_baselines
from kinectbench.scoring.score import score
from kinectbench.settings.models import BenchmarkSettings

Command = Callable[..., Run]
# The red chair is recorded twice.
WANTED: Recordings = (
    ("chair_01", "chair", "red_chair", "test", 2),
    ("chair_04", "chair", "red_chair", "test", 3),
    ("table_01", "table", "old_table", "test", 2),
    ("table_02", "table", "val_table", "validation", 1),
)
NAMES = [name for name, *_ in WANTED]
TEST = NAMES[:3]
ISOLATE = PublishOptions(hold_back=("test",), thresholds=None, isolate=True)


def settings_of(seed: int = 0) -> BenchmarkSettings:
    return synthetic_settings(
        WANTED, pairs={"framing": "view"}, publish={"color": True}, views={"seed": seed}
    )


def write_build(build: Path) -> None:
    """As exact as can be, before a wall at 3 m; in the mask is a row without depth, as where it is black."""
    write_analytic_build(build, WANTED, "view")
    for folder in build.glob("*/views"):
        for path in folder.glob("*.depth.png"):
            depth_mm = read_picture(path, cv2.IMREAD_UNCHANGED)
            mask = np.where(depth_mm > 0, np.uint8(255), np.uint8(0))
            depth_mm[depth_mm == 0] = 3000
            depth_mm[:5], mask[2] = 0, 255
            color = np.full((*mask.shape, 3), 200, np.uint8)
            for suffix, image in (("depth.png", depth_mm), ("mask.png", mask), ("color.jpg", color)):
                cv2.imwrite(str(path.with_name(path.name.replace("depth.png", suffix))), image)
            of_pair = folder.parent / "pairs" / path.name.replace("depth.png", "npz")
            pair, depth_m = read_pair(of_pair), depth_in_metres(depth_mm.astype(np.uint16), 1000)
            seen = seen_cells(depth_m, CAMERA, pair.T_world_camera, pair.grid)
            of_pair.write_bytes(pair_bytes(replace(pair, seen=seen)))
        change(folder / "views.json", color_registered=True)


def change(path: Path, **values: Any) -> None:
    text = json.dumps(json.loads(path.read_text(encoding="utf-8")) | values)
    path.write_text(text, encoding="utf-8")


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("isolated")
    write_build(folder / "build")
    return folder


@pytest.fixture(scope="module")
def parts(root: Path) -> PublishSummary:
    return publish(settings_of(), root / "build", root / "benchmark", NAMES, ISOLATE)


def test_one_view_of_each_object(parts: PublishSummary) -> None:
    assert parts.private is not None
    assert verify(parts.folder) == [] and verify(parts.private) == []
    for folder in (parts.folder, parts.private):
        test = open_release(folder).split("test")
        assert sorted(target.object for target in test) == ["old_table", "red_chair"]
        assert all(target.view == "000" for target in test)
    assert any(line.startswith("--isolate: chair_0") and "left out" in line for line in parts.warnings)
    truth = read_pair(parts.private / "pairs" / "table_01" / "000.npz")
    assert unpack(truth.full).any() and truth.framing == "view"
    for text in ("README.md", "datasheet.md"):
        assert "Of each object whose truth is held back one view is published" in (
            (parts.folder / text).read_text()
        )


def test_the_view_is_drawn_by_the_seed(root: Path) -> None:
    found = {
        tuple(sorted(isolate(settings_of(seed), root / "build", TEST).views.items())) for seed in range(20)
    }
    assert len(found) > 4
    one, again = (isolate(settings_of(3), root / "build", names) for names in (TEST, TEST[:2]))
    # Other objects do not change what is drawn of one.
    assert {name: one.views[name] for name in again.views} == again.views


def isolated_ids(folder: Path) -> tuple[str, ...]:
    return ReleaseInfo.read(folder).isolated


def test_nothing_but_the_view(parts: PublishSummary) -> None:
    ids = isolated_ids(parts.folder)
    files = [path.relative_to(parts.folder) for path in parts.folder.rglob("*") if path.is_file()]
    info = json.loads((parts.folder / "benchmark.json").read_text())
    lineage = json.loads((parts.folder / "lineage.json").read_text())["recordings"]
    for name in ids:
        here = sorted(str(file) for file in files if name in str(file))
        images = [f"views/{name}/000.{end}" for end in ("color.jpg", "depth.png", "mask.png")]
        assert here == [f"pairs/{name}/000.npz", *images, f"views/{name}/views.json"]
        assert lineage[name] == {"source": "made up", "license": "CC0-1.0", "files": {}, "stages": {}}
        assert info["recordings"][name]["quality"] == {} and info["recordings"][name]["refused"] == 0
        (row,) = json.loads((parts.folder / "views" / name / "views.json").read_text())["views"]
        assert set(row) == {"view", "K", "width", "height", "pair"}
    for row in info["settings"]["recordings"]:
        if row["split"] == "test":
            assert set(row) <= {"id", "object", "category", "split", "license", "source"}
    assert not any(name in (parts.folder / "index.html").read_text().split("<main>")[1] for name in ids)
    # A reader of tables finds pictures of the other splits, and no folder that is not there.
    assert "previews/test" not in (parts.folder / "README.md").read_text()


def test_the_background_is_masked(parts: PublishSummary) -> None:
    for name in isolated_ids(parts.folder):
        views = parts.folder / "views" / name
        depth_mm = read_picture(views / "000.depth.png", cv2.IMREAD_UNCHANGED)
        mask = read_picture(views / "000.mask.png", cv2.IMREAD_UNCHANGED) > 0
        # The mask has no row without depth: that was the outline of the shape rebuilt of all views.
        np.testing.assert_array_equal(mask, depth_mm > 0)
        assert mask.any() and depth_mm.max() < 3000 and not mask[2].any()
        color = read_picture(views / "000.color.jpg")
        far = cv2.dilate(mask.astype(np.uint8), np.ones((33, 33))) == 0  # JPEG blocks are 16 pixels
        assert color[far].max() <= 2 and color[mask].mean() > 150
        # No chunk of the PNG files tells of anything but the pixels.
        for path in views.glob("*.png"):
            content = path.read_bytes()
            assert not any(chunk in content for chunk in (b"tEXt", b"iTXt", b"zTXt", b"tIME", b"eXIf"))
        pair = read_input(parts.folder / "pairs" / name / "000.npz")
        np.testing.assert_array_equal(pair.T_world_camera, np.eye(4))
        seen = unpack(pair.seen)
        # Of cells on the outline the centre may lie beside the object.
        assert (seen & unpack(pair.partial_256)).sum() > 0.98 * unpack(pair.partial_256).sum()
        # Rays beside the object have seen nothing: the corners of the cube's front.
        assert not seen[0, 0].any() and not seen[-1, -1].any() and seen.any()


def test_the_rest_of_the_build_does_not_matter(parts: PublishSummary, root: Path, tmp_path: Path) -> None:
    build = Path(shutil.copytree(root / "build", tmp_path / "build"))
    for name in TEST:
        for path in (build / name / "pairs").glob("*.npz"):
            pair = read_pair(path)
            other = pair.full.copy()
            other[:128] = 0
            path.write_bytes(pair_bytes(replace(pair, full=other, known=other, surface_sigma_m=0.02)))
        for path in build.glob(f"{name}/*/manifest.json"):
            change(path, fingerprint="1" * 64, settings={"box": None, "floor": 7})
        change(build / name / "sources.json", more=[1, 2, "cd" * 32])
        change(build / name / "object" / "floor.json", plane_world=[0.0, 0.6, 0.8, 0.1], tilt_rad=0.3)
        change(build / name / "object" / "quality.json", repeatability_iou=0.5, volume_m3=7.0)
    again = publish(settings_of(), build, tmp_path / "benchmark", NAMES, ISOLATE)
    ours, theirs = hashes(parts.folder), hashes(again.folder)
    # `rebuilt_iou` and the name of the private part, and what quotes or hashes them.
    changed = {name for name in ours.keys() | theirs.keys() if ours.get(name) != theirs.get(name)}
    assert changed == {"benchmark.json", "SHA256SUMS"}
    one, two = (ReleaseInfo.read(folder) for folder in (parts.folder, again.folder))
    told = {"rebuilt_iou": None, "rebuilt_single_iou": None}
    for info in (one, two):
        for name in info.isolated:
            info.recordings[name] = info.recordings[name].model_copy(update=told)
    assert one.recordings == two.recordings and one.settings == two.settings


def test_it_is_scored_with_the_truth(parts: PublishSummary, tmp_path: Path) -> None:
    assert parts.private is not None
    write_baselines(open_release(parts.folder), tmp_path, ["hull"])
    table = score(open_release(parts.private), tmp_path / "hull", method="hull", surface=False)
    assert table.complete and len(table.rows) >= 2
    with raises(ReleaseError, "release.truth-held-back"):
        score(open_release(parts.folder), tmp_path / "hull", method="hull", surface=False)


def test_a_view_alone_rebuilds_no_more_than_a_view(parts: PublishSummary, root: Path, tmp_path: Path) -> None:
    shown = publish(
        settings_of(),
        root / "build",
        tmp_path / "all",
        NAMES,
        PublishOptions(hold_back=("test",), thresholds=None),
    )
    alone, together = (ReleaseInfo.read(folder).recordings for folder in (parts.folder, shown.folder))
    for name in isolated_ids(parts.folder):
        assert alone[name].rebuilt_iou == alone[name].rebuilt_single_iou
    for info in (together[name] for name in TEST):
        assert info.rebuilt_iou is not None and info.rebuilt_single_iou is not None
        assert info.rebuilt_iou > info.rebuilt_single_iou + 0.02
    assert all(info.rebuilt_iou is None for info in (alone["table_02"], together["table_02"]))
    line = next(line for line in shown.warnings if line.startswith("the public views of a held-back object"))
    assert "--isolate" in line and line in (shown.folder / "README.md").read_text()
    assert not any("registered with each other" in line for line in parts.warnings)


def test_the_attack_gains_nothing_on_isolated_views(parts: PublishSummary) -> None:
    assert parts.private is not None
    figures = list(measured(parts.folder, parts.private, 2))
    bars = [figure for figure in figures if figure.bar is not None]
    assert len(bars) == 2 and all(figure.met for figure in bars)


def test_verify_names_what_is_too_much(parts: PublishSummary, tmp_path: Path) -> None:
    public = Path(shutil.copytree(parts.folder, tmp_path / "public"))
    name = isolated_ids(public)[0]
    for file in (f"objects/{name}/floor.json", f"previews/test/{name}/000.jpg"):
        (public / file).parent.mkdir(parents=True)
        (public / file).write_text("{}")
        assert f"{file}: of a recording of which one view alone is published" in verify(public)


def lower(held: list[str], key: str, stated: dict[str, Any]) -> None:
    for name in held:
        stated["recordings"][name].update({key: 0.01})


def test_verify_compares_what_the_card_says_of_held_back_truth(
    parts: PublishSummary, root: Path, tmp_path: Path
) -> None:
    public = Path(shutil.copytree(parts.folder, tmp_path / "isolated"))
    sealed(public, lambda stated: stated.update(isolated=stated["isolated"][:-1]))
    assert any("`isolated` of benchmark.json" in line for line in verify(public))
    options = publish_options(settings_of(), ["test"], None)
    shown = publish(settings_of(), root / "build", tmp_path / "benchmark", NAMES, options).folder
    assert verify(shown) == []
    held = [name for name, info in ReleaseInfo.read(shown).recordings.items() if info.rebuilt_iou is not None]
    for key in ("rebuilt_iou", "rebuilt_single_iou"):
        forged = Path(shutil.copytree(shown, tmp_path / key))
        sealed(forged, partial(lower, held, key))
        assert any("`rebuilt_iou` of benchmark.json" in line for line in verify(forged))


def test_what_cannot_be_isolated() -> None:
    with raises(SettingsError, "settings.wrong-value", match="`--hold-back"):
        publish_options(settings_of(), (), None, isolate=True)
    with raises(SettingsError, "settings.wrong-value", match=r"--isolate: with pairs\.framing 'object'"):
        publish_options(synthetic_settings(WANTED), ["test"], None, isolate=True)
    assert publish_options(settings_of(), ["test"], None, isolate=True) == ISOLATE


def test_a_rebuild_leaves_them_out(parts: PublishSummary, root: Path) -> None:
    assert parts.private is not None
    with open_contents(parts.private) as contents:
        plan = rebuild_plan(contents, {name: LocalRecording(root) for name in NAMES})
    assert [target.recording for target in plan.targets] == ["table_02"]
    assert any("its pair is not compared" in note for note in plan.notes)
