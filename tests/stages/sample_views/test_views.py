"""Sampling views of a simulated chair: how many, which, and with which masks."""

import io
import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from chair_model import Chair
from chair_model import chair as make_chair
from PIL import Image
from raising import raises
from read_pictures import decoded_picture, read_picture
from same_fields import assert_same_fields
from typed import present

from kinectbench.core.errors import SegmentationError, StorageError
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.settings.models import PairSettings, SegmentationSettings, ViewSettings
from kinectbench.stages.sample_views.masks import GivenMasks
from kinectbench.stages.sample_views.view_fit import ViewFit
from kinectbench.stages.sample_views.views import (
    Views,
    _jpeg,
    _warnings,
    read_masks,
    read_views,
    sample_views,
    write_views,
)

pytestmark = pytest.mark.xdist_group("chair_model")


@pytest.fixture(scope="module")
def chair() -> Chair:
    return make_chair()


def sample(
    chair: Chair,
    trajectory: Trajectory | None = None,
    masks: GivenMasks | None = None,
    pairs: PairSettings | None = None,
    **settings: Any,
) -> Views:
    return sample_views(
        chair.recorded.sequence,
        trajectory or chair.trajectory,
        chair.model,
        ViewSettings(**settings),
        SegmentationSettings(),
        pairs or PairSettings(),
        masks,
    )


@pytest.fixture(scope="module")
def views(chair: Chair) -> Views:
    return sample(chair, count=8, seed=3)


def test_as_many_as_asked_for(views: Views) -> None:
    assert len(views.views) == 8 and not views.warnings
    assert [view.name for view in views.views] == [f"{k:03d}" for k in range(8)]
    frames = [view.frame for view in views.views] + [frame for frame, _ in views.refused]
    assert len(set(frames)) == len(frames)


def test_the_draw_is_a_seeded_permutation(chair: Chair, views: Views) -> None:
    order = np.random.default_rng(3).permutation(chair.trajectory.good_frames).tolist()
    taken = {view.frame for view in views.views}
    refused = {frame for frame, _ in views.refused}
    assert [view.frame for view in views.views] == [f for f in order if f in taken]
    assert set(order[: len(taken) + len(refused)]) == taken | refused


def test_the_same_seed_the_same_views(chair: Chair, views: Views) -> None:
    again = sample(chair, count=8, seed=3)
    for one, other in zip(views.views, again.views, strict=True):
        assert (one.frame, one.fit, one.stamp_ns) == (other.frame, other.fit, other.stamp_ns)
        np.testing.assert_array_equal(one.mask, other.mask)
        np.testing.assert_array_equal(one.alignment.T_world_camera, other.alignment.T_world_camera)
    # More views begin with the same ones; another seed gives others.
    assert [v.frame for v in sample(chair, count=10, seed=3).views][:8] == [v.frame for v in views.views]
    assert [v.frame for v in sample(chair, count=8, seed=4).views] != [v.frame for v in views.views]


def test_masks_are_the_object(chair: Chair, views: Views) -> None:
    for view in views.views:
        truth = chair.recorded.masks[view.frame] & (chair.recorded.sequence.depth_m(view.frame) > 0)
        iou = (view.mask & truth).sum() / (view.mask | truth).sum()
        assert iou > 0.85
        assert view.fit.pixels == view.mask.sum()
        assert view.fit.containment > 0.9 and view.fit.residual_m < 0.006
        assert view.fit.dropped_share < 0.05 and 0.6 < view.fit.visible_share <= 1
        assert view.stamp_ns == chair.recorded.sequence.stamps_ns[view.frame]


def test_poses_stay_near_the_truth(chair: Chair, views: Views) -> None:
    """The trajectory is exact: aligning to the fused object, coarse as it is here, must not move much."""
    moved_m = []
    for view in views.views:
        truth = chair.recorded.simulation.T_world_camera[view.frame]
        assert np.linalg.norm(view.alignment.T_world_camera[:3, 3] - truth[:3, 3]) < 0.04
        moved_m.append(view.alignment.moved_m)
    assert np.median(moved_m) < 0.004 and max(moved_m) < 0.015


def test_fewer_frames_than_asked_for(chair: Chair) -> None:
    poses = chair.trajectory.T_world_camera.copy()
    poses[6:] = np.nan
    few = sample(chair, replace(chair.trajectory, T_world_camera=poses), count=50)
    assert len(few.views) + len(few.refused) == 6
    assert any("instead of 50" in warning and "6 good frames" in warning for warning in few.warnings)


def test_refusals_are_recorded_and_do_not_shrink_the_set(chair: Chair) -> None:
    """Frames 0 to 5 get a pose half a metre off: they are refused, and others are taken."""
    poses = chair.trajectory.T_world_camera.copy()
    poses[:6, :3, 3] += 0.5
    wrong = replace(chair.trajectory, T_world_camera=poses)
    drawn = sample(chair, wrong, count=18)
    assert len(drawn.views) == 18 or drawn.warnings
    assert {view.frame for view in drawn.views}.isdisjoint(range(6))
    for frame, reason in drawn.refused:
        assert frame in chair.trajectory.good_frames
        assert any(word in reason for word in ("pixels on the object", "off the object", "of the partial"))


def test_limits_are_obeyed(chair: Chair) -> None:
    with raises(SegmentationError, "segmentation.no-view", match=r"fits.*24"):
        sample(chair, count=3, min_pixels=70_000)
    with raises(SegmentationError, "segmentation.no-view", match=r"fits.*mm \(median\)"):
        sample(chair, count=3, pairs=PairSettings(max_residual_m=1e-6))
    strict = PairSettings(min_containment=0.9999)
    try:
        drawn = sample(chair, count=24, pairs=strict)
        assert all(view.fit.containment >= 0.9999 for view in drawn.views)
        assert any("of the partial lies in the object" in reason for _, reason in drawn.refused)
    except SegmentationError as error:
        assert "of the partial lies in the object" in str(error)


def test_a_persons_masks_win(chair: Chair, views: Views, tmp_path: Path) -> None:
    mask = np.zeros_like(views.views[0].mask)
    mask[50:60, 70:90] = True
    cv2.imwrite(str(tmp_path / "001.png"), mask.astype(np.uint8) * 255)
    drawn = sample(chair, masks=read_masks(tmp_path), count=3, seed=3)
    np.testing.assert_array_equal(drawn.views[1].mask, mask)
    np.testing.assert_array_equal(drawn.views[0].mask, views.views[0].mask)
    assert drawn.views[1].fit == views.views[1].fit  # the figures judge the automatic mask
    cv2.imwrite(str(tmp_path / "002.png"), np.zeros((10, 10), np.uint8))
    with raises(SegmentationError, "segmentation.mask-size", match=r"002\.png.*10x10"):
        sample(chair, masks=read_masks(tmp_path), count=3, seed=3)


STORED_ROUNDED = {
    f"{of}.{name}": 5e-7
    for of, names in (
        ("alignment", ("moved_m", "turned_rad")),
        ("fit", tuple(field.name for field in fields(ViewFit) if field.name != "pixels")),
    )
    for name in names
}


def test_folder_round_trip(chair: Chair, views: Views, tmp_path: Path) -> None:
    unknown = replace(views.views[2], fit=replace(views.views[2].fit, residual_m=float("nan")), blur=None)
    some = Views([*views.views[:2], unknown], [(7, "only 3 pixels on the object")], ["näh"])
    for view in views.views[:2]:
        health = present(chair.trajectory.health).per_frame[view.frame]
        assert (view.blur, view.pose_residual_m) == (health.blur, health.residual_m)
    write_views(some, chair.recorded.sequence, tmp_path)
    again = read_views(tmp_path)
    for one, other in zip(some.views, again, strict=True):
        assert one.depth_digest and not other.depth_digest  # views that are read are not chosen again
        assert_same_fields(replace(one, depth_digest=b""), other, STORED_ROUNDED)
        depth_mm = read_picture(tmp_path / f"{one.name}.depth.png", cv2.IMREAD_UNCHANGED)
        assert depth_mm.dtype == np.uint16
        assert np.abs(depth_mm / 1000 - chair.recorded.sequence.depth_m(one.frame)).max() <= 0.00051
        mask = read_picture(tmp_path / f"{one.name}.mask.png", cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(mask, one.mask * np.uint8(255))
        color = read_picture(tmp_path / f"{one.name}.color.jpg")[..., ::-1]
        difference = np.abs(color.astype(int) - chair.recorded.sequence.color_rgb(one.frame))
        assert np.median(difference) <= 4
    stored = json.loads((tmp_path / "views.json").read_text())
    assert stored["refused"] == [{"frame": 7, "reason": "only 3 pixels on the object"}]
    assert stored["warnings"] == ["näh"]
    (tmp_path / "001.mask.png").write_bytes(b"no")
    with raises(StorageError, "storage.damaged", match=r"001\.mask\.png"):
        read_views(tmp_path)
    stored["views"][0].pop("pixels")
    (tmp_path / "views.json").write_text(json.dumps(stored))
    with raises(StorageError, "storage.damaged", match="'pixels' of view 000"):
        read_views(tmp_path)
    (tmp_path / "views.json").write_text("{}")
    with raises(StorageError, "storage.damaged", match="--force"):
        read_views(tmp_path)


def test_depth_too_far_for_an_image_is_none_and_said(chair: Chair, views: Views, tmp_path: Path) -> None:
    sequence = chair.recorded.sequence
    far = replace(sequence, depth_scale=sequence.depth_scale / 30)  # 2.2 m becomes 66 m
    write_views(Views(views.views[:1], [], []), far, tmp_path)
    depth_mm = read_picture(tmp_path / "000.depth.png", cv2.IMREAD_UNCHANGED).astype(float)
    depth_m = far.depth_m(views.views[0].frame)
    fits = depth_m * 1000 < 65_535.5
    assert (depth_m > 0)[~fits].any() and (depth_m > 0)[fits].any()
    assert not depth_mm[~fits].any()
    assert np.abs(depth_mm / 1000 - depth_m)[fits].max() <= 0.00051
    said = _warnings([views.views[0], replace(views.views[1], too_far_share=0.031)], ViewSettings(count=2), 9)
    assert said == [
        "1 of 2 views have depth beyond 65.535 m (3.1% of the pixels with depth at most), which their 16-bit "
        "depth images hold as 0, no measurement: is `depth_scale` right?"
    ]


@pytest.mark.parametrize(
    ("suffix", "damaged"),
    [(".png", b""), (".png", b"\x89PNG nothing"), (".jpg", b""), (".jpg", b"\xff\xd8\xff\xe0 nothing")],
)
def test_damaged_colour_is_refused(suffix: str, damaged: bytes) -> None:
    with raises(StorageError, "storage.damaged", match="colour image is damaged"):
        _jpeg(suffix, damaged)


def photo(**segments: Any) -> bytes:
    buffer = io.BytesIO()
    pixels = np.random.default_rng(0).integers(0, 256, (32, 48, 3), np.uint8)
    Image.fromarray(pixels).save(buffer, "JPEG", quality=90, **segments)
    return buffer.getvalue()


def test_a_view_has_the_recorded_pixels_without_their_metadata() -> None:
    """Orientation 6 would turn the colour against its depth; the position is nobody's business."""
    exif = Image.Exif()
    exif[0x0112] = 6
    exif.get_ifd(0x8825).update({1: "N", 2: (51.0, 45.0, 7.0)})
    assert photo(exif=exif, comment=b"by Jo") != photo()
    assert _jpeg(".jpg", photo(exif=exif, comment=b"by Jo")) == photo()
    profile = photo(icc_profile=b"of colours")
    assert _jpeg(".jpg", profile) == profile
    assert _jpeg(".jpg", photo() + bytes(9)) == photo() + bytes(9)  # some cameras fill up with zeros


def test_a_jpeg_of_odd_structure_keeps_its_pixels_but_no_metadata() -> None:
    odd = photo(comment=b"by Jo")
    at = odd.index(b"\xff\xc4")
    odd = odd[:at] + b"\0Jo\0" + odd[at:]  # libjpeg skips what is between segments
    view = _jpeg(".jpg", odd)
    assert b"Jo" not in view
    assert np.abs(decoded_picture(view).astype(int) - decoded_picture(odd)).mean() < 10
