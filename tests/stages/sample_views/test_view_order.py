"""The order in which frames are tried as views: sides take turns, and the rules behind it."""

from typing import Any

import numpy as np
import pytest
from chair_model import Chair
from chair_model import chair as make_chair

from kinectbench.core.geometry import invert_rigid, rigid, transform_points
from kinectbench.core.geometry.camera import DepthRenderer
from kinectbench.settings.models import PairSettings, SegmentationSettings, ViewSettings
from kinectbench.stages.sample_views.view_order import direction, share_class, taking_turns, visible_share
from kinectbench.stages.sample_views.views import Views, sample_views

pytestmark = pytest.mark.xdist_group("chair_model")


@pytest.fixture(scope="module")
def chair() -> Chair:
    return make_chair()


def sampled(chair: Chair, **settings: Any) -> Views:
    return sample_views(
        chair.recorded.sequence,
        chair.trajectory,
        chair.model,
        ViewSettings(**settings),
        SegmentationSettings(),
        PairSettings(),
    )


def test_sides_take_turns_by_hand() -> None:
    strata = {0: (0, 1, 2), 1: (0, 1, 2), 2: (0, 0, 2), 3: (5, 1, 0), 4: (0, 1, 1), 5: (0, 0, 2)}
    # Sector 0: height 0 is [2, 5], height 1 is [4 (share 1), 0, 1]: 2 4 5 0 1; sector 5 has one frame.
    assert taking_turns([0, 1, 2, 3, 4, 5], strata) == [2, 3, 4, 5, 0, 1]
    assert taking_turns([5, 4, 3, 2, 1, 0], strata) == [5, 3, 4, 2, 1, 0]


def test_a_hundred_frames_of_one_side_do_not_crowd_out_the_others() -> None:
    strata = {frame: (0 if frame < 100 else frame % 4 + 1, 0, 0) for frame in range(112)}
    first = taking_turns(list(range(112)), strata)[:15]
    assert np.bincount([strata[frame][0] for frame in first]).tolist() == [3, 3, 3, 3, 3]


@pytest.mark.parametrize(
    ("azimuth_deg", "height_deg", "stratum"),
    [(0.5, 1, (0, 0)), (29.5, 14, (0, 0)), (30.5, 16, (1, 1)), (359.5, 89.9, (11, 5)), (181, -1, (6, -1))],
)
def test_sector_and_height_of_a_camera(
    chair: Chair, azimuth_deg: float, height_deg: float, stratum: tuple[int, int]
) -> None:
    a, h = np.radians(azimuth_deg), np.radians(height_deg)
    at_floor = np.array(chair.model.box.center_m) + 1.7 * np.array(
        [np.cos(h) * np.cos(a), np.cos(h) * np.sin(a), np.sin(h)]
    )
    at_world = transform_points(invert_rigid(chair.model.floor.T_floor_world), at_floor)
    assert direction(rigid(np.eye(3), at_world), chair.model) == stratum


def test_thirds_of_the_visible_share() -> None:
    assert [share_class(share) for share in (0.0, 0.49, 0.5, 0.79, 0.8, 1.0)] == [0, 0, 1, 1, 2, 2]


def test_the_estimated_visible_share_is_near_the_measured_one(chair: Chair) -> None:
    renderer = DepthRenderer(chair.model.shape.mesh)
    for view in sampled(chair, count=4).views:
        pose = chair.trajectory.T_world_camera[view.frame]
        share = visible_share(chair.recorded.sequence, view.frame, pose, renderer, SegmentationSettings())
        assert share == pytest.approx(view.fit.visible_share, abs=0.1)


def test_coverage_draws_every_side_alike_and_the_same_again(chair: Chair) -> None:
    one, two = sampled(chair, count=8, strategy="coverage"), sampled(chair, count=8, strategy="coverage")
    assert [view.frame for view in one.views] == [view.frame for view in two.views]
    poses = chair.trajectory.T_world_camera
    everywhere = {direction(poses[f], chair.model)[0] for f in chair.trajectory.good_frames}
    covered = {direction(poses[view.frame], chair.model)[0] for view in one.views}
    assert len(covered) >= min(8, len(everywhere)) - len(one.refused)
    for view in one.views:
        sector = direction(poses[view.frame], chair.model)[0]
        assert view.reason.startswith(f"coverage: azimuth {30 * sector} to {30 * sector + 30} deg, height ")
