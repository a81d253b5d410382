"""The health of hand-made trajectories with known figures: circles of cameras, wrong constraints."""

import json
from dataclasses import replace
from types import MappingProxyType

import cv2
import numpy as np
import pytest
from analytic_scenes import displaced, ring, sequence_of
from health_scenes import (
    DISTANCE_M,
    ROUNDED_MM,
    SMALL,
    check_of,
    closed,
    constraint,
    figures_of,
    sequence_at,
    tracked_of,
)

from kinectbench.core.artefacts.trajectory import TrajectoryHealth
from kinectbench.core.geometry import invert_rigid, rigid
from kinectbench.core.images import image_sharpness, relative_blur
from kinectbench.core.sequence import Sequence
from kinectbench.core.storage import pretty_json
from kinectbench.stages.track.health_figures import constraint_correction, median_depths_m, sharpness
from kinectbench.stages.track.tracked import Constraint


@pytest.fixture(scope="module")
def circle() -> np.ndarray:
    return ring(24, DISTANCE_M)


@pytest.fixture(scope="module")
def orbit(circle: np.ndarray) -> Sequence:
    return sequence_at(circle)


# --- constraints


def test_correction_of_a_shift_and_of_a_turn(circle: np.ndarray) -> None:
    shifted = constraint(circle, 0, 2, off=rigid(np.eye(3), [0.003, 0, 0.004]))
    found = constraint_correction(shifted, circle, SMALL, 1.2)
    assert found.shift_m == pytest.approx(0.005, rel=1e-9) and found.turn_rad == pytest.approx(0, abs=1e-9)
    # About the optical axis the centre of the image stands still, but not the rest of it.
    turn = cv2.Rodrigues(np.array([0, 0, 0.01]))[0]
    found = constraint_correction(constraint(circle, 0, 2, off=rigid(turn, [0, 0, 0])), circle, SMALL, 1.2)
    u, v = np.meshgrid(np.linspace(0, 79, 5) - 39.5, np.linspace(0, 59, 5) - 29.5)
    expected = 2 * np.sin(0.005) * 1.2 * np.sqrt(np.mean((u**2 + v**2) / 65.625**2))
    assert found.turn_rad == pytest.approx(0.01, rel=1e-9)
    assert found.shift_m == pytest.approx(expected, rel=1e-9)


def test_a_tie_of_a_lost_frame_has_no_correction(circle: np.ndarray) -> None:
    lost = circle.copy()
    lost[2] = np.nan
    assert np.isnan(constraint_correction(constraint(circle, 0, 2), lost, SMALL, 1.0).shift_m)


def test_median_depth_counts_measurements_only() -> None:
    depth = np.zeros((60, 80), np.float32)
    depth[:, 40:] = 2.0
    assert median_depths_m(sequence_of([depth, 0 * depth], SMALL), [1, 0, 0]) == pytest.approx(
        {0: 2.0, 1: 1.5}
    )


def test_pose_uncertainty_is_that_of_the_ties(circle: np.ndarray, orbit: Sequence) -> None:
    """Keyframes 0, 2, 4, ...; the constraints of 10 are off by 6 and 8 mm, others by nothing."""
    tracked = tracked_of(circle)
    kept = [each for each in tracked.constraints if 10 not in (each.a, each.b)]
    for a, b, off_m in ((8, 10, 0.006), (10, 12, 0.008)):
        kept.append(constraint(circle, a, b, off=rigid(np.eye(3), [off_m, 0, 0])))
    kept.append(constraint(circle, 4, 16, "loop", off=rigid(np.eye(3), [9, 0, 0]), weight=0.0))
    figures = figures_of(orbit, "tracked", replace(tracked, constraints=tuple(kept)), [])
    shifts = {row["frame"]: row["shift_mm"] for row in figures["per_frame"]}
    rms_mm = np.sqrt((6**2 + 8**2) / 2 / 2)
    assert shifts[10] == pytest.approx(rms_mm, abs=ROUNDED_MM)
    assert shifts[8] == pytest.approx(np.sqrt(6**2 / 2 / 2), abs=ROUNDED_MM)
    assert shifts[4] == 0 and shifts[16] == 0  # a constraint without weight says nothing
    # A frame has the uncertainty of the keyframe nearest in time, the earlier of two.
    assert shifts[11] == shifts[10] and shifts[9] == shifts[8]
    stored = TrajectoryHealth.parse(pretty_json(figures), "here")
    assert stored.json_value() == figures and stored.pose_sigma_m()[10] * 1000 == shifts[10]


# --- sharpness


def striped(wave_px: float, gain: float = 1.0) -> np.ndarray:
    rng = np.random.default_rng(0)
    image = cv2.GaussianBlur(rng.normal(size=(120, 160)).astype(np.float32), (0, 0), wave_px)
    striped: np.ndarray = np.clip(128 + gain * 40 * image / image.std(), 0, 255).astype(np.uint8)
    return striped


def test_a_smoothed_image_is_less_sharp_and_exposure_changes_nothing() -> None:
    sharp, soft, softer = (image_sharpness(striped(s)) for s in (0.8, 1.5, 3.0))
    assert sharp > 1.5 * soft > 1.5**2 * softer
    assert image_sharpness(striped(1.5, gain=0.5)) == pytest.approx(soft, rel=0.05)
    assert np.isnan(image_sharpness(np.full((60, 80), 90, np.uint8)))


def test_blur_is_relative_to_the_median() -> None:
    np.testing.assert_allclose(relative_blur(np.array([2.0, 4.0, 1.0, np.nan])), [1, 0.5, 2, np.nan])
    assert np.isnan(relative_blur(np.full(3, np.nan))).all()


class Colored:
    """Depthless frames with the colour images given; None where there is none."""

    def __init__(self, images: list[np.ndarray | None]):
        self.images = images

    def depth_native(self, index: int) -> np.ndarray:
        return np.zeros((SMALL.height, SMALL.width), np.uint16)

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        image = self.images[index]
        if image is None:
            return None
        return ".png", b"no image" if not image.size else cv2.imencode(".png", image)[1].tobytes()


def test_sharpness_of_colour_that_is_missing_or_damaged(circle: np.ndarray) -> None:
    images = [striped(0.8), striped(3.0), striped(0.8), None, np.zeros((0, 0))]
    sequence = replace(sequence_at(circle[:5]), frames=Colored(images))
    measured = sharpness(sequence, {})
    np.testing.assert_array_equal(np.isfinite(measured), [True, True, True, False, False])
    assert measured[0] == measured[2] > 1.5 * measured[1]
    rows = figures_of(sequence, "tracked", tracked_of(circle[:5]), [])["per_frame"]
    assert [row["blur"] for row in rows][::2] == [1, 1, None] and rows[1]["blur"] > 1.5
    known = replace(tracked_of(circle[:5]), sharpness=dict.fromkeys(range(5), 7.0))
    assert [row["blur"] for row in figures_of(sequence, "tracked", known, [])["per_frame"]] == [1.0] * 5


# --- the figures


def test_a_gap_is_open_where_no_loop_spans_it(circle: np.ndarray, orbit: Sequence) -> None:
    lost = circle.copy()
    lost[7:10] = lost[15] = lost[:2] = lost[22:] = np.nan
    elapsed_s = np.diff(orbit.stamps_ns[[6, 10, 14, 16]]) / 1e9
    for loops, open_s in (((), elapsed_s[0]), (((4, 12),), elapsed_s[2]), (((4, 18),), None)):
        tracked = tracked_of(lost)
        kept = [each for each in tracked.constraints if not {each.a, each.b} & {0, 8, 22}]
        spans = [constraint(circle, a, b, "loop") for a, b in loops]
        found = figures_of(orbit, "tracked", replace(tracked, constraints=(*kept, *spans)), [])
        assert found["open_gap_s"] == (open_s and pytest.approx(open_s, abs=1e-3))


def test_figures_of_a_closed_circle(circle: np.ndarray, orbit: Sequence) -> None:
    figures = figures_of(orbit, "tracked", closed(circle), ["careful"])
    chord_m = 2 * DISTANCE_M * np.cos(0.4) * np.sin(np.pi / 24)
    assert figures["path_length_m"] == pytest.approx(23 * chord_m, abs=6e-4)
    assert figures["open_path_m"] == pytest.approx(chord_m, abs=6e-4)  # from frame 22, the last loop, to 23
    assert figures["arc_deg"] == pytest.approx(345, abs=0.01) and figures["open_gap_s"] is None
    assert (figures["frames"], figures["tracked"], figures["lost"], figures["rejected"]) == (24, 24, [], [])
    assert figures["keyframes"] == list(range(0, 24, 2))
    assert figures["ties"] == {"odometry": 11, "covisible": 0, "loop": 1, "refused": 0}
    assert figures["loop_correction_mm"] == 0 and figures["median_shift_mm"] == 0
    assert figures["held_out_residual_mm"] == 3 and figures["median_residual_mm"] == 3
    assert figures["sensor_noise_mm"] == 4
    assert figures["warnings"] == ["careful"] and figures["recommended"] is None and figures["given"] is None
    assert figures["grade"] == "good"
    assert figures["verdict"].startswith("good for ground truth: 100 % of the frames have a pose")
    assert "loops close within 0.0 mm" in figures["verdict"]


def test_speed_and_turn_rate(circle: np.ndarray, orbit: Sequence) -> None:
    poses = circle.copy()
    poses[5] = np.nan
    rows = figures_of(orbit, "tracked", tracked_of(poses), [])["per_frame"]
    chord_m = 2 * DISTANCE_M * np.cos(0.4) * np.sin(np.pi / 24)
    assert rows[1]["speed_m_per_s"] == pytest.approx(chord_m / 0.1, abs=1e-4)
    relative = invert_rigid(circle[0]) @ circle[1]
    angle_rad = np.arccos((np.trace(relative[:3, :3]) - 1) / 2)
    assert rows[1]["turn_rad_per_s"] == pytest.approx(angle_rad / 0.1, abs=1e-4)
    for index in (0, 5, 6):  # the first, a lost one and the one behind it
        assert rows[index]["speed_m_per_s"] is None and rows[index]["turn_rad_per_s"] is None
    assert [row["blur"] for row in rows] == [None] * 24
    assert [row["state"] for row in rows] == ["lost" if i == 5 else "tracked" for i in range(24)]
    assert rows[5]["residual_mm"] is None and rows[5]["shift_mm"] is None


def test_lost_stretches_and_frames_found_again(circle: np.ndarray, orbit: Sequence) -> None:
    poses = circle.copy()
    lost = [0, 7, 8, 9, 23]
    poses[lost] = np.nan
    states = ["lost" if i in lost else "tracked" for i in range(24)]
    states[10] = "relocalised"
    reasons = {7: "too fast", 8: "no depth", 9: "no depth", 23: "cut off"}
    tracked = tracked_of(poses, states=tuple(states), reasons=reasons)
    figures = figures_of(orbit, "tracked", tracked, [])
    assert figures["lost"] == lost and figures["relocalised"] == [10] and figures["tracked"] == 19
    assert figures["lost_stretches"] == [
        {"first_frame": 0, "last_frame": 0, "from_s": 0.0, "to_s": 0.0, "reason": "no pose"},
        {"first_frame": 7, "last_frame": 9, "from_s": 0.7, "to_s": 0.9, "reason": "no depth"},
        {"first_frame": 23, "last_frame": 23, "from_s": 2.3, "to_s": 2.3, "reason": "cut off"},
    ]
    looped = replace(tracked, constraints=(*tracked.constraints, constraint(circle, 1, 22, "loop")))
    figures = figures_of(orbit, "tracked", looped, [])
    assert figures["verdict"] == "fair for ground truth: 79.2 % of the frames have a pose"


def test_held_out_frames_are_no_keyframes(circle: np.ndarray, orbit: Sequence) -> None:
    residual_m = np.where(np.arange(24) % 2 == 0, 0.001, 0.004)
    residual_m[1] = np.nan
    tracked = closed(circle)
    figures = figures_of(orbit, "tracked", replace(tracked, residual_m=residual_m), [])
    assert figures["held_out_residual_mm"] == 4 and figures["unchecked"] == 1
    every = replace(tracked, residual_m=residual_m, keyframes=np.arange(24))
    assert figures_of(orbit, "tracked", every, [])["held_out_residual_mm"] == 1


def test_frames_whose_depth_leaves_a_motion_open(circle: np.ndarray, orbit: Sequence) -> None:
    poses = circle.copy()
    poses[5] = np.nan
    degenerate = np.isin(np.arange(24), [4, 5, 6])
    figures = figures_of(
        orbit, "tracked", replace(closed(circle), T_world_camera=poses, degenerate=degenerate), []
    )
    assert figures["degenerate"] == [4, 5, 6]
    # Of the 23 with a pose; the lost one can do no harm.
    assert "8.7 % of the frames show too plain a shape" in figures["verdict"]
    assert figures["grade"] == "fair"


def test_loops_refused_and_in_doubt(circle: np.ndarray, orbit: Sequence) -> None:
    tracked = closed(circle, off=rigid(np.eye(3), [0, 0.007, 0]))
    doubted = constraint(circle, 4, 20, "loop", off=rigid(np.eye(3), [0.3, 0, 0]), weight=0.01)
    wrong = constraint(circle, 2, 14, "loop", off=rigid(np.eye(3), [0, 0, 1.0]), weight=0.0, inlier_share=0.2)
    other = constraint(circle, 2, 8, "covisible", weight=0.0)
    tracked = replace(tracked, constraints=(*tracked.constraints, doubted), refused=(wrong, other))
    figures = figures_of(orbit, "tracked", tracked, [])
    assert [(row["a"], row["b"], row["correction_mm"], row["believed"]) for row in figures["loops"]] == [
        (0, 22, 7.0, True),
        (4, 20, 300.0, False),
    ]
    (refused,) = figures["refused_loops"]
    assert (refused["a"], refused["b"], refused["correction_mm"], refused["inlier_share"]) == (
        2,
        14,
        1e3,
        0.2,
    )
    assert figures["ties"]["refused"] == 2 and figures["loop_correction_mm"] == 7
    assert figures["grade"] == "fair"
    assert "loops close within 7.0 mm" in figures["verdict"]
    assert "1 of 2 loops contradict the rest" in figures["verdict"]


def test_a_loop_of_little_overlap_may_be_off_itself(circle: np.ndarray, orbit: Sequence) -> None:
    """One of twenty that slid by 107 mm, of .31 overlap, is left out; a second, or a strong one, counts."""
    slid, off = (rigid(np.eye(3), [shift_m, 0, 0]) for shift_m in (0.107, 0.001))
    weak = constraint(circle, 4, 18, "loop", slid, weight=0.71, overlap=0.31, inlier_share=0.956)
    strong = constraint(circle, 4, 18, "loop", slid, overlap=0.7, inlier_share=0.99)
    right = constraint(circle, 0, 22, "loop", off, inlier_share=0.99)

    def correction_mm(*loops: Constraint) -> float:
        tracked = tracked_of(circle)
        tracked = replace(tracked, constraints=(*tracked.constraints, *loops))
        return float(figures_of(orbit, "tracked", tracked, [])["loop_correction_mm"])

    assert correction_mm(*[right] * 19, weak) == 1
    for count, others in ((18, (weak, weak)), (19, (strong,)), (18, (weak,))):
        all_of = np.array([1.0] * count + [107.0] * len(others))
        left_out = 1 if len(others) == 2 else 0
        wanted = np.sqrt(np.mean(np.square(all_of[: len(all_of) - left_out])))
        assert correction_mm(*[right] * count, *others) == pytest.approx(wanted, abs=0.01)


def test_covisibility_is_over_some_keyframes(circle: np.ndarray, orbit: Sequence) -> None:
    many = ring(150, DISTANCE_M)
    tracked = tracked_of(many, keyframes=np.arange(0, 150), constraints=())
    table = figures_of(sequence_at(many), "tracked", tracked, [])["covisibility"]
    assert len(table["keyframes"]) == 60 and table["keyframes"][0] == 0 and table["keyframes"][-1] == 149
    assert max(np.diff(table["keyframes"])) <= 3 and np.shape(table["share"]) == (60, 60)
    share = np.array(table["share"])
    np.testing.assert_array_equal(np.diag(share), 1)
    assert (share[0, 1] > 0.8) and share[0, 30] < share[0, 1]


def test_poses_that_were_lost_after_being_keyframes(circle: np.ndarray, orbit: Sequence) -> None:
    poses = circle.copy()
    tracked = closed(circle)
    poses[[4, 22]] = np.nan
    figures = figures_of(orbit, "tracked", replace(tracked, T_world_camera=poses), [])
    assert figures["covisibility"]["keyframes"] == [k for k in range(0, 24, 2) if k not in (4, 22)]
    assert figures["loops"][0]["correction_mm"] is None and figures["loop_correction_mm"] is None
    json.loads(pretty_json(figures))


# --- edges


@pytest.mark.parametrize("n", [1, 2])
def test_very_short_recordings(n: int) -> None:
    poses = ring(8, DISTANCE_M)[:n]
    figures = figures_of(sequence_at(poses), "tracked", tracked_of(poses), [])
    assert figures["tracked"] == n and figures["grade"] == "not good"
    assert figures["verdict"] == f"not good for ground truth: {n} of {n} frames have a pose"
    assert figures["path_length_m"] == pytest.approx(
        (n - 1) * np.linalg.norm(np.ptp(poses[:, :3, 3], 0)), abs=6e-4
    )
    json.loads(pretty_json(figures))


def test_everything_lost() -> None:
    poses = np.full((5, 4, 4), np.nan)
    tracked = tracked_of(poses, reasons=MappingProxyType(dict.fromkeys(range(5), "no depth")))
    figures = figures_of(sequence_at(poses), "tracked", tracked, [])
    assert figures["lost"] == list(range(5)) and figures["arc_deg"] is None
    assert figures["lost_stretches"][0]["reason"] == "no depth"
    assert figures["covisibility"] == {"keyframes": [], "share": []}
    assert figures["median_shift_mm"] is figures["held_out_residual_mm"] is figures["sensor_noise_mm"] is None
    assert figures["verdict"] == "not good for ground truth: 0 of 5 frames have a pose"
    json.loads(pretty_json(figures))


def test_a_pause_and_figures_that_are_not_known() -> None:
    poses = np.repeat(ring(8, DISTANCE_M)[:1], 6, axis=0)
    unknown = np.full(6, np.nan)
    tracked = tracked_of(poses, residual_m=unknown, inlier_share=unknown, constraints=())
    figures = figures_of(sequence_at(poses), "tracked", tracked, [])
    assert figures["path_length_m"] == 0 and figures["arc_deg"] == 0 and figures["unchecked"] == 6
    assert figures["grade"] == "not good" and "no frame could be predicted" in figures["verdict"]
    assert all(row["inlier_share"] is None and row["shift_mm"] is None for row in figures["per_frame"])


def test_what_is_given_is_left_alone(circle: np.ndarray, orbit: Sequence) -> None:
    tracked, given = closed(circle), check_of(24)
    for value in (tracked.T_world_camera, tracked.residual_m, tracked.keyframes, given.frames.shift_m):
        value.setflags(write=False)
    first = pretty_json(figures_of(orbit, "refine", tracked, [], given))
    assert pretty_json(figures_of(orbit, "refine", tracked, [], given)) == first


def test_drift_is_seen_in_the_loop(circle: np.ndarray, orbit: Sequence) -> None:
    """A chain that drifts by a millimetre a frame; the loop measured right: off by what has come together."""
    drifting = np.stack([displaced(T, (0.001 * i, 0, 0), 0.0) for i, T in enumerate(circle)])
    tracked = tracked_of(drifting)
    loop = constraint(circle, 0, 22, "loop")
    figures = figures_of(orbit, "tracked", replace(tracked, constraints=(*tracked.constraints, loop)), [])
    assert figures["loop_correction_mm"] == pytest.approx(22, abs=ROUNDED_MM)
    assert figures["grade"] == "not good" and "loops close within 22.0 mm" in figures["verdict"]
