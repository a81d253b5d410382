"""A BOP scene of two crates that touch: the masks that came with it decide which pixels are the object's."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from analytic_scenes import CAMERA, box, depth_of, plane, ring

from kinectbench.core.geometry import OrientedBox, transform_points
from kinectbench.core.sequence import Sequence
from kinectbench.settings.models import (
    CameraSettings,
    FusionSettings,
    PairSettings,
    SegmentationSettings,
    TrackingSettings,
    ViewSettings,
)
from kinectbench.stages.fuse import fuse
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence
from kinectbench.stages.sample_views.views import Views, sample_views
from kinectbench.stages.segment.find.given import GivenObject
from kinectbench.stages.segment.object_model import ObjectModel
from kinectbench.stages.segment.segment import segment
from kinectbench.stages.track import Trajectory, track

FRAMES = 12
# They touch at x = 0.
CRATE = ((-0.30, -0.20, 0.0), (0.0, 0.20, 0.40))
OTHER = ((0.0, -0.15, 0.0), (0.25, 0.15, 0.30))
CRATE_ID, OTHER_ID = 3, 8
FUSION = FusionSettings(voxel_size_m=0.01, scene_voxel_size_m=0.02)


def write_scene(folder: Path) -> Path:
    """Depth without noise, poses, and for each crate its visible pixels, two pixels too wide."""
    for name in ("depth", "mask_visib"):
        (folder / name).mkdir(parents=True)
    cameras, objects = {}, {}
    for i, T in enumerate(ring(FRAMES, 1.3, (0, 0, 0.15), (0.5, 0.7))):
        crate, other = (depth_of([box(*each)], CAMERA, T) for each in (CRATE, OTHER))
        depth = depth_of([box(*CRATE), box(*OTHER), plane((0, 0, 1), 0.0)], CAMERA, T)
        cv2.imwrite(str(folder / f"depth/{i:06d}.png"), np.rint(depth * 10_000).astype(np.uint16))
        for place, own in enumerate((crate, other)):
            mask = ((own > 0) & (own <= depth)).astype(np.uint8) * 255
            wide = cv2.dilate(mask, np.ones((5, 5), np.uint8))
            cv2.imwrite(str(folder / f"mask_visib/{i:06d}_{place:06d}.png"), wide)
        R = T[:3, :3].T
        cameras[str(i)] = {
            "cam_K": CAMERA.K.ravel().tolist(),
            "depth_scale": 0.1,
            "cam_R_w2c": R.ravel().tolist(),
            "cam_t_w2c": (-1000 * R @ T[:3, 3]).tolist(),
        }
        objects[str(i)] = [{"obj_id": CRATE_ID}, {"obj_id": OTHER_ID}]
    (folder / "scene_camera.json").write_text(json.dumps(cameras))
    (folder / "scene_gt.json").write_text(json.dumps(objects))
    return folder


@dataclass(frozen=True)
class Scene:
    folder: Path
    trajectory: Trajectory
    both: ObjectModel
    crate: ObjectModel


def ingested(folder: Path, object_id: int, to: Path) -> Sequence:
    write_sequence(open_recording(folder, CameraSettings(mask_object=object_id)), to)
    return read_sequence(to)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    root = tmp_path_factory.mktemp("bop")
    sequence = ingested(write_scene(root / "scene"), CRATE_ID, root / "first")
    trajectory = track(sequence, "trust", TrackingSettings())
    surface = fuse(sequence, trajectory, FUSION).mesh
    both = segment(sequence, trajectory, surface, SegmentationSettings(), FUSION)
    # In the frame `floor`, as it was found; a person's box around one crate is a little too large.
    middle = transform_points(both.floor.T_floor_world, np.array([[-0.15, 0.0, 0.2]]))[0]
    along = both.floor.T_floor_world[:3, :3] @ [1.0, 0.0, 0.0]
    around = OrientedBox(tuple(middle), (0.36, 0.46, 0.46), float(np.arctan2(along[1], along[0])))
    crate = segment(sequence, trajectory, surface, SegmentationSettings(), FUSION, GivenObject(around))
    return Scene(root / "scene", trajectory, both, crate)


def views_of(sequence: Sequence, scene: Scene, model: ObjectModel, **settings: Any) -> Views:
    limits = PairSettings(min_visible_share=0.05)
    chosen = ViewSettings(count=6, min_pixels=100, **settings)
    return sample_views(sequence, scene.trajectory, model, chosen, SegmentationSettings(), limits)


def shares(views: Views) -> list[tuple[float, float, float]]:
    """Of each view's mask the shares on the crate and the other; and of the crate's pixels those in it."""
    found = []
    for view in views.views:
        T = ring(FRAMES, 1.3, (0, 0, 0.15), (0.5, 0.7))[view.frame]
        crate, other = (depth_of([box(*each)], CAMERA, T) for each in (CRATE, OTHER))
        depth = depth_of([box(*CRATE), box(*OTHER), plane((0, 0, 1), 0.0)], CAMERA, T)
        on = [(own > 0) & (own <= depth) for own in (crate, other)]
        size = view.mask.sum()
        inside = (view.mask & on[0]).sum()
        found.append((inside / size, (view.mask & on[1]).sum() / size, inside / on[0].sum()))
    return found


def test_the_recorded_mask_decides_between_things_that_touch(scene: Scene, tmp_path: Path) -> None:
    crate = ingested(scene.folder, CRATE_ID, tmp_path / "crate")
    other = ingested(scene.folder, OTHER_ID, tmp_path / "other")
    # Without masks they are one thing; from some sides one hides the other.
    blind = np.array(shares(views_of(crate, scene, scene.both, recorded_masks=False)))
    assert blind[:, 1].mean() > 0.2 and blind[:, 1].max() > 0.5 and blind[:, 2].min() > 0.9
    for of_crate, of_other, complete in shares(views_of(crate, scene, scene.both)):
        # What is left of the other are the two pixels by which the mask is too wide.
        assert of_crate > 0.85 and of_other < 0.1 and complete > 0.97
    for of_crate, of_other, _ in shares(views_of(other, scene, scene.both)):
        assert of_other > 2 * of_crate


def test_with_a_box_the_pixels_beyond_the_outline_are_left_out(scene: Scene, tmp_path: Path) -> None:
    sequence = ingested(scene.folder, CRATE_ID, tmp_path / "crate")
    views = views_of(sequence, scene, scene.crate)
    assert len(views.views) == 6
    recorded = sequence.masks
    assert recorded is not None
    for view, (of_crate, _, complete) in zip(views.views, shares(views), strict=True):
        given = recorded(view.frame)
        assert given is not None and not (view.mask & ~given).any()
        # Floor that lies beyond the crate's box is not the crate's.
        assert view.mask.sum() < 0.97 * given.sum()
        assert of_crate > 0.9 and complete > 0.97
        assert view.fit.containment > 0.9 and view.fit.residual_m < 0.005


def test_frames_without_a_mask_are_masked_by_depth(scene: Scene, tmp_path: Path) -> None:
    sequence = ingested(scene.folder, CRATE_ID, tmp_path / "crate")
    full = views_of(sequence, scene, scene.both)
    first = full.views[0].frame
    (scene.folder / f"mask_visib/{first:06d}_000000.png").rename(tmp_path / "away.png")
    try:
        partly = ingested(scene.folder, CRATE_ID, tmp_path / "partly")
    finally:
        (tmp_path / "away.png").rename(scene.folder / f"mask_visib/{first:06d}_000000.png")
    blind = views_of(sequence, scene, scene.both, recorded_masks=False)
    mixed = views_of(partly, scene, scene.both)
    assert mixed.views[0].frame == first
    np.testing.assert_array_equal(mixed.views[0].mask, blind.views[0].mask)
    np.testing.assert_array_equal(mixed.views[1].mask, full.views[1].mask)
