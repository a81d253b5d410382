"""What a release shows of a view, forged and sealed again: `verify` compares each pair's input with it."""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from analytic_release import write_analytic_build
from file_damage import seal
from numpy.typing import NDArray
from small_benchmark import Run
from synthetic_release import RECORDINGS, synthetic_settings

from kinectbench.core.geometry import Camera
from kinectbench.core.geometry.depth import depth_in_mm
from kinectbench.core.images import read_gray
from kinectbench.core.sequence import depth_in_metres
from kinectbench.core.voxels.pair_file import Pair, pair_bytes, read_pair
from kinectbench.core.voxels.seen_cells import seen_cells
from kinectbench.core.voxels.view_grids import partial_grids
from kinectbench.release.check.reservations import reservations
from kinectbench.release.check.verify import verify
from kinectbench.release.check.view_check import view_problems
from kinectbench.release.publish.publish import NO_OPTIONS, publish

Image = NDArray[np.generic]
Change = Callable[[Path], None]
PAIR, VIEW = "pairs/chair_02/000.npz", "views/chair_02/000"


@pytest.fixture
def copy(analytic: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(analytic / "benchmark", tmp_path / "benchmark"))


def image(suffix: str, change: Callable[[Image], Image]) -> Change:
    def make(folder: Path) -> None:
        path = f"{folder / VIEW}.{suffix}.png"
        assert cv2.imwrite(path, change(cv2.imread(path, cv2.IMREAD_UNCHANGED)))  # type: ignore[arg-type]

    return make


def images(change: Callable[[Image], Image]) -> Change:
    def make(folder: Path) -> None:
        image("depth", change)(folder)
        image("mask", change)(folder)

    return make


def pair(change: Callable[[Pair], Pair]) -> Change:
    def make(folder: Path) -> None:
        (folder / PAIR).write_bytes(pair_bytes(change(read_pair(folder / PAIR))))

    return make


def moved_camera(of: Pair) -> Pair:
    T = of.T_world_camera.copy()
    T[:3, 3] += 0.004 * T[:3, 0]
    return replace(of, T_world_camera=T)


def cut(image: Image) -> Image:
    image = image.copy()
    rows = np.nonzero(image.any(axis=1))[0]
    image[: rows[0] + 10] = 0
    return image


NO_DEPTH = f"{PAIR}: [0-9]+ cells of 'partial_256' hold no depth of its view's mask"
NO_CELL = f"{PAIR}: [0-9]+ pixels of depth in its view's mask lie in no cell of 'partial_256'"
SEEN = f"{PAIR}: [0-9]+ cells of 'seen' are not as its view's depth has them"
FORGED: dict[str, tuple[Change, tuple[str, ...]]] = {
    "depth is farther by 5 mm": (
        image("depth", lambda depth: np.where(depth != 0, depth + 5, 0).astype(np.uint16)),
        (NO_DEPTH, NO_CELL),
    ),
    "depth is without rows": (image("depth", cut), (NO_DEPTH, SEEN)),
    "the mask is without rows": (image("mask", cut), (NO_DEPTH,)),
    "the images are mirrored": (
        images(lambda was: was[:, ::-1]),
        (NO_DEPTH, NO_CELL, SEEN),
    ),
    "the camera is moved by 4 mm": (pair(moved_camera), (NO_DEPTH, NO_CELL)),
    "the focal length is another": (
        pair(lambda of: replace(of, K=of.K * [[1.02], [1.02], [1]])),
        (NO_DEPTH, NO_CELL),
    ),
    "all is seen": (
        pair(lambda of: replace(of, seen=np.full_like(of.seen, 255))),
        (SEEN, "benchmark.json: its recordings.chair_02.visible_share is 0.[0-9]+ where its pairs have 1.0"),
    ),
    "the mask has another size": (
        image("mask", lambda mask: mask[:-1]),
        (f"{PAIR}: its depth image has 320 x 240 pixels, its mask 320 x 239",),
    ),
    "both have another size": (
        images(lambda was: was[:-1]),
        (f"{VIEW}.depth.png: 320 x 239 pixels where views.json has 320 x 240",),
    ),
    "depth of 8 bits": (
        image("depth", lambda depth: depth.astype(np.uint8)),
        (f"{VIEW}.depth.png: not a PNG of 16-bit depth",),
    ),
}


@pytest.mark.parametrize("name", FORGED)
def test_an_input_that_is_not_of_its_view_is_found(copy: Path, name: str) -> None:
    make, expected = FORGED[name]
    make(copy)
    seal(copy)
    lines = verify(copy)
    for pattern in expected:
        assert any(re.match(pattern, line) for line in lines), lines
    others = [line for line in lines if not line.startswith((PAIR, VIEW))]
    assert [line for line in others if not any(re.match(pattern, line) for pattern in expected)] == []


@pytest.fixture(scope="module")
def framed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A release of framing `view`, with a public part that holds the test split back."""
    root = tmp_path_factory.mktemp("framed")
    write_analytic_build(root / "build", framing="view")
    settings = synthetic_settings(pairs={"framing": "view"})
    names = [recording[0] for recording in RECORDINGS]
    options = NO_OPTIONS.model_copy(update={"hold_back": ("test",)})
    publish(settings, root / "build", root / "benchmark", names, options)
    return root


def test_sound_ones_of_framing_view_are_well(framed: Path) -> None:
    assert verify(framed / "benchmark") == [] and verify(framed / "benchmark-private") == []


def test_a_cube_of_framing_view_that_is_not_of_its_view_is_found(framed: Path, tmp_path: Path) -> None:
    """By 2 % larger; the cells are filled for it, so that nothing else is wrong."""
    folder = Path(shutil.copytree(framed / "benchmark-private", tmp_path / "benchmark"))
    of = read_pair(folder / PAIR)
    (folder / PAIR).write_bytes(pair_bytes(replace(of, voxel_size_m=of.voxel_size_m * 1.02)))
    seal(folder)
    assert f"{PAIR}: its cube is not that of its view's depth in its mask" in verify(folder)


@pytest.mark.parametrize("scale", [256.0, 1000.0, 5000.0, 12345.6])
def test_depth_of_any_unit_agrees_with_its_millimetres(copy: Path, scale: float) -> None:
    """The pair is made of depth as recorded; its view holds whole millimetres."""
    of = read_pair(copy / PAIR)
    rng = np.random.default_rng(0)
    camera = Camera(320, 240, *(float(of.K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))))
    stored = read_gray(Path(f"{copy / VIEW}.depth.png"))
    exact_m = (stored / 1000 + rng.uniform(-0.0005, 0.0005, stored.shape)) * (stored > 0)
    depth_m = depth_in_metres(np.rint(exact_m * scale).astype(np.uint16), scale)
    fine, coarse = partial_grids(depth_m, camera, of.T_world_camera, of.grid)
    seen = seen_cells(depth_m, camera, of.T_world_camera, of.grid)
    made = replace(of, partial=coarse, partial_256=fine, seen=seen)
    mm, mask = depth_in_mm(depth_m), depth_m > 0
    assert list(view_problems(made, mm, mask, has_too_far=False)) == []


def test_depth_beyond_what_an_image_holds_is_not_missed(copy: Path) -> None:
    """What lies along a pixel of 0 is seen if its depth was too far for the image, as a warning says."""
    of = read_pair(copy / PAIR)
    depth = read_gray(Path(f"{copy / VIEW}.depth.png"))
    camera = Camera(320, 240, *(float(of.K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))))
    far_m = np.where(depth > 0, depth / 1000, 80).astype(np.float32)
    before = replace(of, seen=seen_cells(far_m, camera, of.T_world_camera, of.grid))
    (found,) = view_problems(before, depth, depth > 0, has_too_far=False)
    assert "cells of 'seen'" in found
    assert list(view_problems(before, depth, depth > 0, has_too_far=True)) == []


@pytest.mark.parametrize("voxel_m", [1e-300, 1e-9, 1e300])
def test_cubes_of_any_size_take_bounded_time(copy: Path, voxel_m: float) -> None:
    of = replace(read_pair(copy / PAIR), voxel_size_m=voxel_m)
    stored = np.full((480, 640), 1500, np.uint16)
    assert list(view_problems(of, stored, stored > 0, has_too_far=False)) != []


def test_what_no_depth_is_published_of_is_said(
    copy: Path, analytic: Path, tmp_path: Path, command: Callable[..., Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only other versions may have published none."""
    said = command(tmp_path, "verify", str(analytic / "benchmark"))
    assert said.status == 0 and "no depth" not in said.out
    for path in (copy / "views").glob("*/*.png"):
        path.unlink()
    seal(copy)
    said = command(tmp_path, "verify", str(copy))
    assert said.status == 1 and said.err.count(".depth.png: missing, targets.csv has its pair") == 7
    monkeypatch.setattr("kinectbench.core.artefacts.benchmark.__version__", "99")
    said = command(tmp_path, "verify", str(copy))
    assert "; 7 of 7 partials could not be compared with depth: the release has none" in said.out
    assert said.status == 0 and "with a mesh" not in said.out
    for path in (copy / "objects").glob("*/mesh.ply"):  # pairs imported from elsewhere have no mesh
        path.unlink()
    seal(copy)
    assert "7 of 7 shapes could not be compared with a mesh: the release has none" in reservations(copy)


def json_of(name: str, change: Callable[[dict[str, Any]], object]) -> Change:
    def make(folder: Path) -> None:
        content = json.loads((folder / name).read_text())
        change(content)
        (folder / name).write_text(json.dumps(content))

    return make


TWICE: dict[str, tuple[Change, str]] = {
    "noise of the surface": (
        pair(lambda of: replace(of, surface_sigma_m=0.02)),
        f"{PAIR}: surface_sigma_m is 0.02 where benchmark.json has 0.001",
    ),
    "visible share": (
        json_of("benchmark.json", lambda all_: all_["recordings"]["chair_02"].update(visible_share=0.9)),
        r"benchmark.json: its recordings.chair_02.visible_share is 0.9 where its pairs have 0\.\d+$",
    ),
    "frame": (
        json_of("views/chair_02/views.json", lambda views: views["views"][0].update(frame=99)),
        "views/chair_02/views.json: another frame or stamp of 000 than in lineage.json",
    ),
    "floor": (
        json_of("objects/chair_02/floor.json", lambda floor: floor.update(plane_world=[0, 1, 0, 0.2])),
        "objects/chair_02/floor.json: plane_world is not z = 0 of T_floor_world",
    ),
}


def test_a_damaged_views_json_hides_no_later_contradiction(copy: Path) -> None:
    TWICE["frame"][0](copy)
    (copy / "views/chair_01/views.json").write_text("{}")
    seal(copy)
    assert TWICE["frame"][1] in verify(copy)


@pytest.mark.parametrize("name", TWICE)
def test_what_a_recording_states_twice_is_compared(copy: Path, name: str) -> None:
    with_sigma = json_of(
        "benchmark.json", lambda all_: all_["recordings"]["chair_02"]["quality"].update(surface_sigma_m=0.001)
    )
    with_sigma(copy)
    seal(copy)
    before = verify(copy)
    assert not any(re.match(TWICE[name][1], line) for line in before)
    TWICE[name][0](copy)
    seal(copy)
    assert any(re.match(TWICE[name][1], line) for line in verify(copy))
