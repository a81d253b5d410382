"""The estimated IoU and its interval, against values computed by hand."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from evidence_by_hand import shape_of

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.trajectory.trajectory import UNCHECKED_POSE_SIGMA_M
from kinectbench.stages.segment.judge.estimate import (
    COIN_SIGMAS,
    DECIDED,
    MAX_SHIFTED_SHARE,
    MAX_VOLUME_SHARE_PER_MM,
    MISSED_LEAST,
    MISSED_LESS,
    MISSED_MORE,
    MOST_BIAS_M,
    OFF_M,
    OFF_M_IF_THIN,
    OFF_PER_POSE,
    OFF_PER_SIGMA,
    UNKNOWN_BIAS_M,
    IouEstimate,
    PoseError,
    estimate_iou,
    volume_share_per_mm,
)
from kinectbench.stages.segment.judge.frontiers import Frontier
from kinectbench.stages.segment.solid.solid import SolidShape

CERTAIN = PoseError(0.0)
VOXEL_M = 0.01


def block_mesh(*size_m: float) -> TriangleMesh:
    box = trimesh.creation.box(size_m)
    return TriangleMesh(np.asarray(box.vertices), np.asarray(box.faces, np.int32))


# A cube of 0.3 m: of its volume 2 % lie within 1 mm of the surface.
CUBE, CUBE_PER_MM = block_mesh(0.3, 0.3, 0.3), 0.001 * 6 / 0.3


def known_solid(mesh: TriangleMesh = CUBE) -> SolidShape:
    """Eight voxels, all of them measured, beside eight that were seen to be empty."""
    solid = np.zeros((4, 2, 2), bool)
    solid[:2] = True
    labels = np.where(solid, Label.SURFACE, Label.FREE).astype(np.uint8)
    return shape_of(solid, labels=labels, mesh=mesh, voxel_m=VOXEL_M)


def partly_known(inside: float, outside: float) -> SolidShape:
    """The same; of two of its voxels, and of two beside it, the probability is all that is known."""
    shape = known_solid()
    labels, probability = shape.labels.copy(), shape.probability.copy()
    labels[1, 0], labels[2, 0] = Label.UNKNOWN, Label.UNKNOWN
    probability[1, 0], probability[2, 0] = inside, outside
    return replace(shape, labels=labels, probability=probability)


def frontier(voxels: float, inside: float, solid: float) -> Frontier:
    """So many voxels lie behind it, of which so much is expected inside, and called solid."""
    volume_m3 = voxels * VOXEL_M**3
    return Frontier("up", 0.01, (0.1, 0.1), (0.0, 0.0, 0.1), (0.0, 0.0, 1.0), volume_m3, inside, solid)


def half_of(missing: float) -> float:
    """What a solid lacks of its volume, and has too much, if it misses so much of an IoU of 1."""
    return missing / (2 - missing)


def iou_of_known(missing: float) -> float:
    assert (1 - half_of(missing)) / (1 + half_of(missing)) == pytest.approx(1 - missing)
    return 1 - missing


def check(estimate: IouEstimate) -> None:
    assert 0 <= estimate.low <= estimate.value <= estimate.high <= 1


def test_of_a_thin_board_a_millimetre_is_much() -> None:
    area_m2, volume_m3 = 2 * (0.6 + 0.02 + 0.012), 0.012
    board = block_mesh(1.0, 0.6, 0.02)
    assert volume_share_per_mm(board) == pytest.approx(0.001 * area_m2 / volume_m3)
    assert volume_share_per_mm(CUBE) == pytest.approx(CUBE_PER_MM)


def expected_iou(shape: SolidShape) -> float:
    """Expected intersection over expected union, by the probabilities of all voxels."""
    inside = float(shape.probability[shape.solid].sum())
    return inside / (int(shape.solid.sum()) + float(shape.probability[~shape.solid].sum()))


def test_expected_iou_by_hand() -> None:
    solid = np.array([[[True, True, False, False]]])
    # 0.9 + 0.7 of two voxels are inside; outside, 0.4 more are expected.
    shape = shape_of(solid, np.array([[[0.9, 0.7, 0.4, 0.0]]]), mesh=CUBE)
    assert estimate_iou(shape, 0.0, CERTAIN, ()).value == pytest.approx(1.6 / 2.4)


def test_expected_iou_of_calibrated_voxels_is_the_actual_one() -> None:
    rng = np.random.default_rng(0)
    probability = rng.uniform(size=(60, 60, 60)) ** 3
    true, solid = rng.uniform(size=probability.shape) < probability, probability > 0.5
    actual = (true & solid).sum() / (true | solid).sum()
    shape = shape_of(solid, probability, mesh=CUBE)
    assert expected_iou(shape) == pytest.approx(actual, abs=0.01)
    # Where nothing was measured, that is the estimate.
    assert estimate_iou(shape, 0.0, CERTAIN, ()).value == pytest.approx(expected_iou(shape))


def missing_of(sigma_m: float = 0.0, median_m: float = 0.0) -> float:
    """What the cube misses of an IoU of 1 if all of it was measured."""
    off_m = OFF_M + OFF_M_IF_THIN * CUBE_PER_MM + OFF_PER_SIGMA * sigma_m + OFF_PER_POSE * median_m
    return CUBE_PER_MM * 1000 * off_m


def most_of(missing: float) -> float:
    return missing * (1 + MISSED_MORE) + MISSED_LEAST


def least_of(missing: float) -> float:
    return max(0, missing * (1 - MISSED_LESS) - MISSED_LEAST)


@pytest.mark.parametrize(("sigma_m", "median_m"), [(0.0, 0.0), (0.002, 0.0), (0.0, 0.002), (0.001, 0.001)])
def test_of_a_solid_that_is_known(sigma_m: float, median_m: float) -> None:
    found = estimate_iou(known_solid(), sigma_m, PoseError(median_m), ())
    missing = missing_of(sigma_m, median_m)
    assert found.value == pytest.approx(iou_of_known(missing))
    assert found.low == pytest.approx(iou_of_known(most_of(missing)))
    assert found.high == pytest.approx(iou_of_known(least_of(missing)))
    check(found)
    known = (found.known_low, found.known, found.known_high)
    assert known == pytest.approx((found.low, found.value, found.high))


def test_an_unknown_bias_is_expected_but_not_at_best() -> None:
    without = estimate_iou(known_solid(), 0.001, CERTAIN, ())
    found = estimate_iou(known_solid(), 0.001, CERTAIN, (), bias_known=False)
    missing = missing_of(0.001) + 1000 * UNKNOWN_BIAS_M * CUBE_PER_MM
    most = most_of(missing_of(0.001)) + 1000 * MOST_BIAS_M * CUBE_PER_MM
    assert found.value == pytest.approx(iou_of_known(missing))
    assert found.low == pytest.approx(iou_of_known(most))
    assert (found.high, found.known_high) == (without.high, without.known_high)
    check(found)
    assert not any("Kinect" in line for line in without.reasons)
    # Of the cube 1 mm is 2 %: 1.5 mm are as much as is worth a reason.
    thin = known_solid(block_mesh(0.3, 0.3, 0.05))
    (reason,) = estimate_iou(thin, 0.0, CERTAIN, (), bias_known=False).reasons
    assert "Kinect" in reason


def known_skin() -> SolidShape:
    """A block of 6 x 6 x 6 voxels in free space, of which nothing but the outer layer was measured."""
    solid = np.zeros((8, 8, 8), bool)
    solid[1:-1, 1:-1, 1:-1] = True
    labels = np.where(solid, Label.SURFACE, Label.FREE).astype(np.uint8)
    labels[2:-2, 2:-2, 2:-2] = Label.UNKNOWN
    return shape_of(solid, labels=labels, mesh=CUBE, voxel_m=VOXEL_M)


@pytest.mark.parametrize(
    ("shape", "of_known"),
    [
        # Two of four faces have known voxels on both sides, and six of eight voxels are known.
        (partly_known(0.9, 0.3), (2 / 4) / (6 / 8)),
        # A thin skin: all of its faces are known, and 6^3 - 4^3 of 6^3 voxels.
        (known_skin(), 6**3 / (6**3 - 4**3)),
    ],
)
def test_the_error_of_known_voxels_is_that_of_their_faces(shape: SolidShape, of_known: float) -> None:
    found = estimate_iou(shape, 0.001, PoseError(0.001), ())
    missing = of_known * missing_of(0.001, 0.001)
    assert found.known == pytest.approx(1 - missing)
    assert found.known_low == pytest.approx(1 - most_of(missing))
    assert found.known_high == pytest.approx(1 - least_of(missing))


def test_of_a_solid_that_is_unknown_in_part() -> None:
    found = estimate_iou(partly_known(0.9, 0.3), 0.0, CERTAIN, ())
    missing = missing_of()
    # Of eight voxels six are known, 2 * 0.9 are expected of the other two, and 2 * 0.3 beside them.
    inside, union = 6 * (1 - half_of(missing)) + 1.8, 8 + 6 * half_of(missing) + 0.6
    assert found.value == pytest.approx(inside / union)
    # Both of the solid are one coin, and so are those beside it.
    expected = (6 + 1.8) / (8 + 0.6)
    sigma = np.sqrt((2 / 8) ** 2 * 0.9 * 0.1 + expected**2 * (2 / 8) ** 2 * 0.3 * 0.7) / (1 + 0.6 / 8)
    most = half_of(most_of(missing))
    worst = (6 * (1 - most) + 1.8) / (8 + 6 * most + 0.6)
    assert found.low == pytest.approx(max(0, worst - COIN_SIGMAS * sigma))
    # At best every guess is right.
    least = half_of(least_of(missing))
    best = (6 * (1 - least) + 2) / (8 + 6 * least)
    assert found.high == pytest.approx(best)
    check(found)


@pytest.mark.parametrize("p", [0.5 * DECIDED, 1 - 0.5 * DECIDED])
def test_what_is_as_good_as_decided_is_no_coin(p: float) -> None:
    solid = np.zeros((4, 4, 4), bool)
    solid[:2] = True
    labels = np.where(solid, Label.INTERIOR, Label.UNKNOWN)
    shape = shape_of(solid, np.where(solid, 1.0, p), labels.astype(np.uint8), CUBE)
    found = estimate_iou(shape, 0.0, CERTAIN, ())
    most = half_of(most_of(missing_of()))
    assert found.low == pytest.approx((1 - most) / (1 + most + p))


def test_regions_apart_are_coins_of_their_own_and_an_underside_is_one() -> None:
    """Four single voxels apart: as four coins they vary half as much as one."""
    solid = np.zeros((9, 3, 3), bool)
    solid[::2, 1, 1] = True
    probability, labels = np.where(solid, 0.9, 0.0), np.full(solid.shape, Label.UNKNOWN, np.uint8)
    apart = shape_of(solid, probability, labels, CUBE)
    together = replace(apart, underside=solid)
    widths = [0.9 - estimate_iou(shape, 0.0, CERTAIN, ()).low for shape in (apart, together)]
    assert widths[1] == pytest.approx(widths[0] * np.sqrt(5), abs=0.03)


@pytest.mark.parametrize("guessed", [0.6, 0.9])
def test_what_the_surface_alone_may_leave_does_not_depend_on_guesses(guessed: float) -> None:
    known, partly = known_solid(), partly_known(guessed, 0.3)
    whole, part = (estimate_iou(shape, 0.001, CERTAIN, ()) for shape in (known, partly))
    assert whole.measured_low == pytest.approx(whole.low)
    # A known voxel may be wrong; one that is guessed right is not.
    assert part.low < whole.measured_low < part.measured_low
    assert part.measured_low == estimate_iou(partly_known(0.7, 0.1), 0.001, CERTAIN, ()).measured_low


def test_reasons_name_openings_and_undersides() -> None:
    of_an_opening = frontier(2, 0.9, 1.0)
    of_an_underside = replace(of_an_opening, underside=True)
    shape = partly_known(0.9, 0.3)
    told = [
        estimate_iou(shape, 0.0, CERTAIN, found).reasons
        for found in ((), (of_an_opening,), (of_an_underside,), (of_an_opening, of_an_underside))
    ]
    opening = "an opening that nobody looked into: what is behind it is a guess"
    underside = "an underside that nobody saw: what is behind it is a guess"
    assert told == [(), (opening,), (underside,), (opening, underside)]


def test_poses_that_no_frame_could_check_widen_it_downwards_only() -> None:
    """Given poses are taken at their word, but for the worst; of tracked ones 20 mm are expected anyway."""
    checked = estimate_iou(known_solid(), 0.0, CERTAIN, ())
    unchecked = estimate_iou(known_solid(), 0.0, PoseError(0.0, checked=False), ())
    assert (unchecked.value, unchecked.high) == (checked.value, checked.high)
    tracked = [PoseError(UNCHECKED_POSE_SIGMA_M, checked) for checked in (False, True)]
    assert len({estimate_iou(known_solid(), 0.0, each, ()).low for each in tracked}) == 1
    most = most_of(missing_of())
    most += OFF_PER_POSE * 1000 * UNCHECKED_POSE_SIGMA_M * CUBE_PER_MM
    assert unchecked.low == pytest.approx(max(0, iou_of_known(most)))
    assert unchecked.low < checked.low
    check(unchecked)


def test_what_is_better_is_never_estimated_to_be_worse() -> None:
    thin = known_solid(block_mesh(1.0, 0.6, 0.02))
    steps = [
        estimate_iou(thin, 0.002, PoseError(0.002), ()),
        estimate_iou(thin, 0.001, PoseError(0.002), ()),
        estimate_iou(thin, 0.001, PoseError(0.001), ()),
        estimate_iou(known_solid(), 0.001, PoseError(0.001), ()),
        estimate_iou(known_solid(), 0.0, PoseError(0.001), ()),
        estimate_iou(known_solid(), 0.0, CERTAIN, ()),
    ]
    for figures in ([one.low for one in steps], [one.value for one in steps], [one.high for one in steps]):
        assert figures == sorted(figures)
    assert len({round(one.value, 6) for one in steps}) == len(steps)
    for one in steps:
        check(one)


def test_more_frames_of_the_same_path_do_not_raise_it() -> None:
    """The deviation of the halves falls with the root of their number; the surface gets no better."""
    few, many = (
        estimate_iou(known_solid(), 0.002, CERTAIN, (), 180),
        estimate_iou(known_solid(), 0.002 / 2, CERTAIN, (), 720),
    )
    assert many.value == pytest.approx(few.value) and many.low == pytest.approx(few.low)
    assert estimate_iou(known_solid(), 0.002, CERTAIN, (), 20) == few


@pytest.mark.parametrize("sigma_m", [0.005, 0.05])
def test_nothing_is_below_zero(sigma_m: float) -> None:
    paper = known_solid(block_mesh(1.0, 1.0, 0.001))
    worst = estimate_iou(paper, sigma_m, PoseError(0.05, checked=False), (frontier(100, 0.5, 1),))
    check(worst)
    assert worst.low == 0


def test_reasons_are_those_that_hold() -> None:
    thin_m = 0.002 / MAX_VOLUME_SHARE_PER_MM
    for thick_m, told in ((0.9 * thin_m, True), (1.1 * thin_m, False)):
        # Without edges to speak of, 1 mm on both faces.
        found = estimate_iou(known_solid(block_mesh(50.0, 50.0, thick_m)), 0.0, CERTAIN, ())
        assert [line[:34] for line in found.reasons] == ["thin parts: 1 mm of surface is 11%"] * told
    much_m = MAX_SHIFTED_SHARE / CUBE_PER_MM / 1000
    for median_m, told in ((1.1 * much_m, True), (0.9 * much_m, False)):
        found = estimate_iou(known_solid(), 0.0, PoseError(median_m), ())
        assert [line.split(",")[0] for line in found.reasons] == [
            "poses: what they may be off by moves 3% of the volume"
        ] * told
    (line,) = estimate_iou(known_solid(), 0.0, PoseError(0.0, checked=False), ()).reasons
    assert line.endswith(", and other frames could not check them")
