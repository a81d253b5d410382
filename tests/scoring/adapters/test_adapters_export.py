"""`export --layout rgbd`, and the files of methods of today: what their loaders make of them is metric."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import todays_loaders as loaders
from analytic_release import (
    BOX_HIGH,
    BOX_LOW,
    CENTER_M,
    RADIUS_M,
    T_floor_camera,
    is_ball,
    surface_distance_m,
)
from made_once import made_once
from raising import raises
from read_pictures import read_picture
from synthetic_release import RECORDINGS, synthetic_settings

from kinectbench.core.artefacts.benchmark import PublishOptions
from kinectbench.core.errors import ReleaseError, SettingsError
from kinectbench.core.geometry import invert_rigid, transform_points
from kinectbench.release.exchange.rgbd import (
    REGISTERED,
    RgbdView,
    export_rgbd,
    framed,
    read_view,
    write_plain,
)
from kinectbench.release.publish.publish import publish
from kinectbench.release.release import Release, open_release
from kinectbench.scoring.adapters import octmae
from kinectbench.scoring.adapters.octmae import in_cube
from kinectbench.scoring.adapters.registry import ADAPTERS, export_for

MM = 1e-3


@pytest.fixture(scope="module")
def published(analytic: Path) -> Release:
    return open_release(analytic / "benchmark")


@pytest.fixture(scope="module")
def exports(published: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of every method."""

    def make(folder: Path) -> None:
        for name in ADAPTERS:
            count, notes = export_for(published, folder / name, name)
            assert count == 7
            # Who does not look at colour need not hear of it.
            assert any("no colour image" in line for line in notes) == ("color" in ADAPTERS[name].inputs)

    return made_once(tmp_path_factory, "exports_for_methods", make)


def views(published: Release, folder: Path) -> list[tuple[RgbdView, Path]]:
    return [(read_view(published, one), folder / one.recording / one.view) for one in published.targets]


def solid_m(category: str, view: int) -> np.ndarray:
    """Points in the true ball or box, in the camera, metres."""
    unit = np.random.default_rng(0).random((1_000_000, 3))
    if is_ball(category):
        ball = (2 * unit - 1)[np.linalg.norm(2 * unit - 1, axis=1) <= 1]
        points = np.array(CENTER_M) + RADIUS_M * ball
    else:
        points = np.array(BOX_LOW) + unit * (np.array(BOX_HIGH) - np.array(BOX_LOW))
    return transform_points(invert_rigid(T_floor_camera(view)), points)


def gaps_m(of: np.ndarray, to: np.ndarray) -> np.ndarray:
    """How far each point of one cloud is from the other's nearest."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(to).query(of)[0])


def test_plain_files_are_metric(published: Release, tmp_path: Path) -> None:
    count, notes = export_rgbd(published, tmp_path / "out")
    assert count == 7 and len(notes) == 1 and notes[0].startswith("7 of 7 views have no colour image")
    for target in published.targets:
        folder = tmp_path / "out" / target.recording / target.view
        names = {"depth.png", "depth_m.npy", "pointmap_cv.npy", "mask.png", "camera.json"}
        assert {path.name for path in folder.iterdir()} == names
        camera = json.loads((folder / "camera.json").read_text())
        assert camera["color"] == "none: the recording's colour is not registered to its depth"
        assert (camera["width"], camera["height"]) == (320, 240) and "method" not in camera
        depth = read_picture(folder / "depth.png", cv2.IMREAD_UNCHANGED)
        depth_m, points = np.load(folder / "depth_m.npy"), np.load(folder / "pointmap_cv.npy")
        assert depth.dtype == np.uint16 and depth_m.dtype == points.dtype == np.float32
        np.testing.assert_allclose(depth_m, depth / 1000, rtol=0, atol=1e-6)
        measured = depth > 0
        assert np.isnan(points[~measured]).all() and np.isfinite(points[measured]).all()
        mask = read_picture(folder / "mask.png", cv2.IMREAD_UNCHANGED) > 0
        on_floor = transform_points(T_floor_camera(int(target.view)), points[mask & measured])
        # Depth is in whole millimetres, along z.
        assert surface_distance_m(target.category, on_floor).max() < 0.6 * MM
        K = np.array(camera["K"])
        np.testing.assert_allclose(
            points[measured] @ K[0] / points[measured][:, 2], np.nonzero(measured)[1], atol=1e-2
        )
    export_rgbd(published, tmp_path / "out")  # an earlier export is replaced


def test_registered_colour_lies_on_depth(published: Release, tmp_path: Path) -> None:
    view = read_view(published, published.targets[0])
    color = np.zeros((*view.mask.shape, 3), np.uint8)
    color[view.mask] = (200, 20, 10)
    colored = replace(view, color=color, color_words=REGISTERED)
    write_plain(published, colored, tmp_path)
    found = read_picture(tmp_path / "rgb.png")[..., ::-1]
    np.testing.assert_array_equal(found, color)
    ADAPTERS["sam3d"].write(published, colored, tmp_path)
    np.testing.assert_array_equal(read_picture(tmp_path / "image.png")[..., ::-1], color)


@pytest.mark.parametrize(
    ("height", "width"), [(240, 320), (480, 640), (720, 1280), (1080, 1920), (424, 512), (2, 900)]
)
def test_an_image_of_another_size_keeps_its_points(published: Release, height: int, width: int) -> None:
    """To a thousandth of a millimetre: pixels are taken, none is made."""
    rng = np.random.default_rng(0)
    view = read_view(published, published.targets[0])
    mask = np.zeros((height, width), bool)
    mask[height // 3 : height - height // 9, width // 5 : width - 3] = True
    depth = rng.integers(800, 2000, (height, width)).astype(np.uint16)
    K = np.array([[500.0, 0, width / 2], [0, 510, height / 3], [0, 0, 1]])
    large = replace(view, depth_mm=depth, mask=mask, K=K)
    shown = framed(large, 640, 480)
    assert shown.depth_mm.shape == shown.mask.shape == (480, 640)
    step = max(1, int(np.ceil(max(np.ptp(np.nonzero(mask), axis=1) + 1) / 640)), 0)
    assert len(shown.object_points_m) > 0.8 * mask.sum() / (step + 1) ** 2
    assert gaps_m(shown.object_points_m, large.object_points_m).max() < 1e-6
    if height <= 480 and width <= 640:
        assert len(shown.object_points_m) == mask.sum()


@pytest.mark.parametrize("name", ["rayst3r", "sam3d"])
def test_loaders_of_images_get_the_metric_points(published: Release, exports: Path, name: str) -> None:
    for view, folder in views(published, exports / name):
        points = getattr(loaders, name)(folder)
        assert len(points) == len(view.object_points_m)
        np.testing.assert_allclose(points, view.object_points_m, rtol=0, atol=MM)


def test_octmae_gets_the_metric_points_and_the_share_that_it_cuts(published: Release, exports: Path) -> None:
    for view, folder in views(published, exports / "octmae"):
        points, held = loaders.octmae(folder)
        np.testing.assert_allclose(points, view.object_points_m, rtol=0, atol=MM)
        seen_mm = view.object_points_m * 1000
        np.testing.assert_array_equal(in_cube(seen_mm, seen_mm), held)
        camera = json.loads((folder / "camera.json").read_text())
        solid_mm = solid_m(view.target.category, int(view.target.view)) * 1000
        z_min = np.floor(seen_mm[:, 2].min() / 40) * 40 - 200
        out = (
            (np.abs(solid_mm[:, :2]) > 640).any(axis=1)
            | (solid_mm[:, 2] < z_min)
            | (solid_mm[:, 2] > z_min + 1280)
        )
        assert camera["cut_of"] == "truth"
        assert camera["cut_share"] == pytest.approx(out.mean(), abs=2e-3)


def test_the_share_of_the_truth_that_a_smaller_cube_would_cut(
    published: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(octmae, "CELLS", 14)  # 560 mm
    count, notes = export_for(published, tmp_path / "out", "octmae")
    assert count == 7 and notes[1].startswith("the method's volume cuts the object of 7 of 7 views: ")
    for view, folder in views(published, tmp_path / "out"):
        share = json.loads((folder / "camera.json").read_text())["cut_share"]
        solid_mm = solid_m(view.target.category, int(view.target.view)) * 1000
        z_min = np.floor(view.object_points_m[:, 2].min() * 1000 / 40) * 40 - 200
        z = solid_mm[:, 2]
        out = (np.abs(solid_mm[:, :2]) > 280).any(axis=1) | (z < z_min) | (z > z_min + 560)
        # A layer of cells has up to 0.5 % of the ball, and the share's standard deviation is 0.2 %.
        assert share == pytest.approx(out.mean(), abs=9e-3)


def test_what_octmaes_cube_cuts_is_stated() -> None:
    """Points of a box that reaches half out of the cube."""
    z = np.full(1000, 1000.0)
    x = np.linspace(0, 1280, 1000)
    points = np.stack([x, np.zeros(1000), z], axis=1)
    assert in_cube(points, points).mean() == pytest.approx(0.5, abs=1e-3)
    deep = np.stack([np.zeros(1000), np.zeros(1000), np.linspace(1000, 3000, 1000)], axis=1)
    # The cube ends 1,280 - 200 mm behind the nearest point's cell, which is 1,000 / 40 * 40.
    assert in_cube(deep, deep).mean() == pytest.approx(0.54, abs=2e-3)


def test_depth_beyond_rayst3rs_10_m_is_missing(published: Release, tmp_path: Path) -> None:
    pytest.importorskip("torch")
    view = read_view(published, published.targets[0])
    far = replace(view, depth_mm=np.where(view.mask, view.depth_mm, 10_001).astype(np.uint16))
    ADAPTERS["rayst3r"].write(published, far, tmp_path)
    depth = read_picture(tmp_path / "depth.png", cv2.IMREAD_UNCHANGED)
    mask = read_picture(tmp_path / "mask.png", cv2.IMREAD_UNCHANGED) > 0
    assert depth[mask].all() and not depth[~mask].any()


def test_a_view_without_a_measured_point_has_no_share_that_is_cut(published: Release, tmp_path: Path) -> None:
    view = read_view(published, published.targets[0])
    _, stated = octmae.write_octmae(published, replace(view, mask=np.zeros_like(view.mask)), tmp_path)
    assert set(stated) == {"T_camera_method"}


def test_pointr_gets_the_metric_points(published: Release, exports: Path) -> None:
    for view, folder in views(published, exports / "pointr"):
        points, center, norm = loaders.pointr(folder)
        # Its own centring and scaling find nothing to do, so that both kinds of configurations agree.
        assert np.abs(center).max() < 1e-6 and norm == pytest.approx(1, abs=1e-6) and len(points) == 2048
        T = np.array(json.loads((folder / "camera.json").read_text())["T_camera_method"])
        back = transform_points(T, points * norm + center)
        assert gaps_m(back, view.object_points_m).max() < MM
        up_floor = (view.T_world_camera @ T)[:3, 1]
        floor = published.floor(view.target.recording)
        assert floor is not None
        up = floor.T_floor_world[:3, :3] @ up_floor
        np.testing.assert_allclose(up / np.linalg.norm(up), [0, 0, 1], atol=1e-6)


def test_patchcomplete_gets_the_metric_surface(published: Release, exports: Path) -> None:
    for view, folder in views(published, exports / "patchcomplete"):
        voxels = loaders.patchcomplete(folder / "input.npz")
        T = np.array(json.loads((folder / "camera.json").read_text())["T_camera_method"])
        edge_m = np.cbrt(np.linalg.det(T[:3, :3]))
        near = np.abs(voxels) < 2.4
        centers = transform_points(T, (np.argwhere(near) + 0.5) / 32)
        depth_m = centers[:, 2] + voxels[near] / 32 * edge_m
        u, v = np.rint(view.camera.project(centers)).astype(int).T
        assert near.sum() > 500 and (voxels > 0).any() and (voxels < 0).any()
        assert view.mask[v, u].all()
        np.testing.assert_allclose(depth_m, view.depth_m[v, u], rtol=0, atol=MM)
        assert (np.abs(voxels) <= 2.5).all()


def test_views_whose_truth_is_held_back(analytic: Path, tmp_path: Path) -> None:
    """Of OctMAE's cube it is stated what it cuts of the points that the view measured."""
    names = [recording[0] for recording in RECORDINGS]
    options = PublishOptions(hold_back=("test",), thresholds=None)
    publish(synthetic_settings(), analytic / "build", tmp_path / "benchmark", names, options)
    public = open_release(tmp_path / "benchmark")
    for name in ADAPTERS:
        assert export_for(public, tmp_path / name, name)[0] == 7
    of = {
        target.name: json.loads((tmp_path / "octmae" / target.name / "camera.json").read_text())["cut_of"]
        for target in public.targets
    }
    splits = {target.name: target.split for target in public.targets}
    assert of == {name: "seen" if splits[name] == "test" else "truth" for name in splits}


def test_without_torch_it_says_what_to_install(
    published: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with raises(SettingsError, "settings.no-package", match="rayst3r"):
        export_for(published, tmp_path / "out", "rayst3r")
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_exported_is_said(published: Release, tmp_path: Path) -> None:
    with raises(SettingsError, "settings.wrong-value", match="rayst3r"):
        export_for(published, tmp_path / "out", "rayster")
    bare = Release(published.folder, published.targets, published.metadata)
    bare.__dict__["sums"] = {name: of for name, of in published.sums.items() if ".depth." not in name}
    with raises(ReleaseError, "release.missing-file"):
        export_rgbd(bare, tmp_path / "out")
