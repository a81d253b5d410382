"""The health of hand-made trajectories, whose figures are known: circles of cameras, ties that are off."""

import json
from dataclasses import replace
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np
import pytest
from analytic_scenes import CAMERA, depth_of, displaced, health_of, plane, ring, sequence_of, sphere
from tracking_scenes import tie_at

from kinectbench.core.artefacts.stored import known
from kinectbench.core.artefacts.trajectory import GivenFigures, LoopClosure, RejectedFrame, TrajectoryHealth
from kinectbench.core.geometry import Camera, invert_rigid, rigid
from kinectbench.core.geometry.depth import NO_CALIBRATION
from kinectbench.core.images import image_sharpness, relative_blur
from kinectbench.core.sequence import Sequence
from kinectbench.core.storage import pretty_json
from kinectbench.core.trajectory.coverage import convergence_point, covered_arc_rad, covisibility, from_above
from kinectbench.stages.track.check_given import GivenCheck
from kinectbench.stages.track.frame_check import FrameCheck
from kinectbench.stages.track.health import health
from kinectbench.stages.track.health_figures import median, median_depths_m, sharpness, tie_correction
from kinectbench.stages.track.tracked import Tie, Tracked
from kinectbench.stages.track.verdict import judge, recommend

SMALL = Camera(80, 60, 65.625, 65.625, 39.5, 29.5)
FLOOR = plane((0, 0, 1), -0.3)
SCENE = [sphere((0, 0, 0), 0.3), FLOOR]
DISTANCE_M = 1.5
# Figures are rounded to a hundredth of a millimetre.
ROUNDED_MM = 0.006


def sequence_at(poses: np.ndarray, camera: Camera = SMALL) -> Sequence:
    """Depth seen from the poses; of frames without one, none."""
    blank = np.zeros((camera.height, camera.width), np.float32)
    return sequence_of([depth_of(SCENE, camera, T) if np.isfinite(T).all() else blank for T in poses], camera)


def tie(poses: np.ndarray, a: int, b: int, kind: str = "odometry", **changes: object) -> Tie:
    """A tie that agrees with the poses; `off` (4, 4) is put behind it."""
    off = changes.pop("off", np.eye(4))
    measured = invert_rigid(poses[a]) @ poses[b] @ off
    values = {"overlap": 0.7, "inlier_share": 0.9, "residual_m": 0.004, **changes}
    return tie_at(a, b, measured, np.eye(6), kind, **values)


def tracked_of(poses: np.ndarray, **changes: object) -> Tracked:
    """Everything tracked, every second frame a keyframe tied to the next one, residual 3 mm."""
    n = len(poses)
    posed = np.isfinite(poses).all(axis=(1, 2))
    keyframes = np.flatnonzero(posed & (np.arange(n) % 2 == 0))
    values = {
        "T_world_camera": poses,
        "states": tuple("tracked" if p else "lost" for p in posed),
        "reasons": {},
        "keyframes": keyframes,
        "ties": tuple(tie(poses, int(a), int(b)) for a, b in pairwise(keyframes)),
        "refused": (),
        "residual_m": np.where(posed, 0.003, np.nan),
        "noise_m": np.where(posed, 0.004, np.nan),
        "inlier_share": np.where(posed, 0.9, np.nan),
        "degenerate": np.zeros(n, dtype=bool),
        **changes,
    }
    return Tracked(**values)


def check_of(
    n: int, shift_m: float = 0.002, rejected: np.ndarray | None = None, **changes: Any
) -> GivenCheck:
    """Frames that move by 2 mm, with a residual of 2.5 mm; distant ones by 5 mm."""
    nothing = np.zeros(n, dtype=bool)
    frames = FrameCheck(
        compared=np.arange(n),
        shift_m=np.broadcast_to(shift_m, n),
        turn_rad=np.full(n, 0.01),
        residual_m=np.full(n, 0.0025),
        noise_m=np.full(n, np.nan),
        inlier_share=np.full(n, np.nan),
        degenerate=nothing,
        disagrees=nothing if rejected is None else rejected,
        blind=nothing,
        jumps=(),
    )
    values = {
        "disagreeing": np.flatnonzero(frames.disagrees).tolist(),
        "median_shift_m": known(median(frames.shift_m)),
        "distant_shift_m": 0.005,
        "distant_unmatched": None,
        "refined_apart_m": None,
        "largest_jump_m": 0.0,
        "distant_residual_m": 0.004,
        "refined_distant_residual_m": 0.004,
        **changes,
    }
    T_given = np.tile(np.eye(4), (n, 1, 1))
    return GivenCheck(T_given, frames, (), GivenFigures(**values), {}, NO_CALIBRATION)


def figures_of(*args: object) -> dict[str, Any]:
    """The health as the file holds it."""
    return health(*args).json_value()


@pytest.fixture(scope="module")
def circle() -> np.ndarray:
    return ring(24, DISTANCE_M)


@pytest.fixture(scope="module")
def orbit(circle: np.ndarray) -> Sequence:
    return sequence_at(circle)


def closed(poses: np.ndarray, **changes: object) -> Tracked:
    """The tracked circle with a loop from its first to its last frames."""
    tracked = tracked_of(poses)
    last = int(tracked.keyframes[-1])
    loop = tie(poses, 0, last, "loop", **changes)
    return replace(tracked, ties=(*tracked.ties, loop))


# --- what is looked at


def test_axes_meet_where_the_cameras_look() -> None:
    poses = ring(9, 2.0, target=(0.4, -0.2, 0.7), elevations_rad=(0.2, 0.6))
    np.testing.assert_allclose(convergence_point(poses), [0.4, -0.2, 0.7], atol=2e-3)
    # One camera leaves the distance open: 1.5 m ahead.
    np.testing.assert_allclose(
        convergence_point(poses[:1]), poses[0, :3, 3] + 1.5 * poses[0, :3, 2], atol=1e-9
    )


@pytest.mark.parametrize("degrees", [60.0, 120.0, 200.0, 300.0])
def test_arc_of_a_part_of_a_circle(degrees: float) -> None:
    poses = ring(361, DISTANCE_M)[: round(degrees) + 1]
    assert np.degrees(covered_arc_rad(poses)) == pytest.approx(degrees * 360 / 361, rel=0.015)


def test_arc_of_a_full_circle_and_of_few_cameras() -> None:
    assert np.degrees(covered_arc_rad(ring(360, DISTANCE_M))) == pytest.approx(359, abs=0.01)
    assert covered_arc_rad(ring(5, 1.0)[:1]) == 0
    assert covered_arc_rad(np.zeros((0, 4, 4))) is None


def test_someone_who_turns_about_walks_around_nothing() -> None:
    outward = ring(36, 0.3)
    outward[:, :3, :3] = outward[:, :3, :3] @ np.diag([-1.0, 1, -1])  # away from the middle
    assert covered_arc_rad(outward) is None


def test_from_above_the_first_camera_looks_up_the_page() -> None:
    for poses in (ring(7, 2.0), ring(1, 2.0), ring(5, 1.0, elevations_rad=(np.pi / 2 - 1e-3,))):
        R = from_above(poses)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1)
        first_ahead = R @ poses[0, :3, 2]
        assert abs(first_ahead[0]) < 1e-9 and first_ahead[1] > 0
    # Level cameras say where the vertical is, though all of them look down.
    np.testing.assert_allclose(from_above(ring(8, 2.0))[2], [0, 0, 1], atol=1e-9)
    assert from_above(ring(36, 2.0)[:12])[2, 2] > np.cos(np.radians(1))


def test_covisibility_of_a_plane() -> None:
    """Cameras look straight down at a floor 1 m below; the second stands a quarter of the image aside."""
    down = rigid(np.diag([1.0, -1, -1]), [0, 0, 1])
    width_m = CAMERA.width / CAMERA.fx
    aside, away, blind = (rigid(down[:3, :3], [x * width_m, 0, 1]) for x in (0.25, 1.5, 0.0))
    poses = np.stack([down, aside, away, blind])
    depths = [depth_of([plane((0, 0, 1), 0)], CAMERA, T) for T in poses]
    depths[3] = 0 * depths[3]
    shares = covisibility(sequence_of(depths, CAMERA), poses, np.arange(4))
    expected = np.array([[1, 0.75, 0, 0], [0.75, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 0]])
    np.testing.assert_allclose(shares, expected, atol=0.04)


def test_what_is_hidden_is_not_seen() -> None:
    """Two cameras see opposite sides of a ball."""
    poses = ring(2, DISTANCE_M)
    ball = [sphere((0, 0, 0), 0.45)]
    alone = sequence_of([depth_of(ball, CAMERA, T) for T in poses], CAMERA)
    shares = covisibility(alone, poses, np.arange(2))
    np.testing.assert_allclose(np.diag(shares), 1)
    assert shares[0, 1] < 0.02 and shares[1, 0] < 0.02


# --- ties


def test_correction_of_a_shift_and_of_a_turn(circle: np.ndarray) -> None:
    shifted = tie(circle, 0, 2, off=rigid(np.eye(3), [0.003, 0, 0.004]))
    found = tie_correction(shifted, circle, SMALL, 1.2)
    assert found.shift_m == pytest.approx(0.005, rel=1e-9) and found.turn_rad == pytest.approx(0, abs=1e-9)
    # About the optical axis the centre of the image stands still, but not the rest of it.
    turn = cv2.Rodrigues(np.array([0, 0, 0.01]))[0]
    found = tie_correction(tie(circle, 0, 2, off=rigid(turn, [0, 0, 0])), circle, SMALL, 1.2)
    u, v = np.meshgrid(np.linspace(0, 79, 5) - 39.5, np.linspace(0, 59, 5) - 29.5)
    expected = 2 * np.sin(0.005) * 1.2 * np.sqrt(np.mean((u**2 + v**2) / 65.625**2))
    assert found.turn_rad == pytest.approx(0.01, rel=1e-9)
    assert found.shift_m == pytest.approx(expected, rel=1e-9)


def test_a_tie_of_a_lost_frame_has_no_correction(circle: np.ndarray) -> None:
    lost = circle.copy()
    lost[2] = np.nan
    assert np.isnan(tie_correction(tie(circle, 0, 2), lost, SMALL, 1.0).shift_m)


def test_median_depth_counts_measurements_only() -> None:
    depth = np.zeros((60, 80), np.float32)
    depth[:, 40:] = 2.0
    assert median_depths_m(sequence_of([depth, 0 * depth], SMALL), [1, 0, 0]) == pytest.approx(
        {0: 2.0, 1: 1.5}
    )


def test_pose_uncertainty_is_that_of_the_ties(circle: np.ndarray, orbit: Sequence) -> None:
    """Keyframes 0, 2, 4, ...; the ties of 10 are off by 6 and 8 mm, others by nothing."""
    tracked = tracked_of(circle)
    kept = [each for each in tracked.ties if 10 not in (each.a, each.b)]
    for a, b, off_m in ((8, 10, 0.006), (10, 12, 0.008)):
        kept.append(tie(circle, a, b, off=rigid(np.eye(3), [off_m, 0, 0])))
    kept.append(tie(circle, 4, 16, "loop", off=rigid(np.eye(3), [9, 0, 0]), weight=0.0))
    figures = figures_of(orbit, "tracked", replace(tracked, ties=tuple(kept)), [])
    shifts = {row["frame"]: row["shift_mm"] for row in figures["per_frame"]}
    rms_mm = np.sqrt((6**2 + 8**2) / 2 / 2)
    assert shifts[10] == pytest.approx(rms_mm, abs=ROUNDED_MM)
    assert shifts[8] == pytest.approx(np.sqrt(6**2 / 2 / 2), abs=ROUNDED_MM)
    assert shifts[4] == 0 and shifts[16] == 0  # a tie without weight says nothing
    # A frame has the uncertainty of the keyframe nearest in time, the earlier of two.
    assert shifts[11] == shifts[10] and shifts[9] == shifts[8]
    stored = TrajectoryHealth.parse(pretty_json(figures), "here")
    assert stored.json_value() == figures and stored.pose_sigma_m()[10] * 1000 == shifts[10]


# --- sharpness


def striped(wave_px: float, gain: float = 1.0) -> np.ndarray:
    rng = np.random.default_rng(0)
    image = cv2.GaussianBlur(rng.normal(size=(120, 160)).astype(np.float32), (0, 0), wave_px)
    return np.clip(128 + gain * 40 * image / image.std(), 0, 255).astype(np.uint8)


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


def test_figures_of_a_closed_circle(circle: np.ndarray, orbit: Sequence) -> None:
    figures = figures_of(orbit, "tracked", closed(circle), ["careful"])
    chord_m = 2 * DISTANCE_M * np.cos(0.4) * np.sin(np.pi / 24)
    assert figures["path_length_m"] == pytest.approx(23 * chord_m, abs=6e-4)
    assert figures["open_path_m"] == pytest.approx(chord_m, abs=6e-4)  # from frame 22, the last loop, to 23
    assert figures["arc_deg"] == pytest.approx(345, abs=0.01)
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
    looped = replace(tracked, ties=(*tracked.ties, tie(circle, 1, 22, "loop")))
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
    doubted = tie(circle, 4, 20, "loop", off=rigid(np.eye(3), [0.3, 0, 0]), weight=0.01)
    wrong = tie(circle, 2, 14, "loop", off=rigid(np.eye(3), [0, 0, 1.0]), weight=0.0, inlier_share=0.2)
    other = tie(circle, 2, 8, "covisible", weight=0.0)
    tracked = replace(tracked, ties=(*tracked.ties, doubted), refused=(wrong, other))
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


def test_covisibility_is_over_some_keyframes(circle: np.ndarray, orbit: Sequence) -> None:
    many = ring(150, DISTANCE_M)
    tracked = tracked_of(many, keyframes=np.arange(0, 150), ties=())
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


# --- given trajectories


def test_a_trusted_trajectory_is_judged_by_its_check(circle: np.ndarray, orbit: Sequence) -> None:
    poses = circle.copy()
    poses[11] = np.nan
    rejected = np.arange(24) == 11
    shift_m = np.where(rejected, 0.06, 0.0021)
    shift_m[3] = np.nan
    given = check_of(24, shift_m=shift_m, rejected=rejected)
    fits = np.where(rejected, 0.95, 0.9)
    figures = figures_of(orbit, "trust", tracked_of(poses, inlier_share=fits), [], given)
    assert figures["rejected"] == [
        {
            "frame": 11,
            "stamp_ns": 1_100_000_000,
            "residual_mm": 2.5,
            "shift_mm": 60.0,
            "turn_deg": 0.57,
            "reason": "its depth disagrees with its pose by 60.0 mm, where 95 % of it fits",
        }
    ]
    assert figures["lost"] == [] and figures["lost_stretches"] == [] and figures["tracked"] == 23
    assert figures["per_frame"][11]["state"] == "rejected"
    assert (figures["median_shift_mm"], figures["max_shift_mm"], figures["unchecked"]) == (2.1, 2.1, 1)
    assert figures["median_residual_mm"] == 2.5
    assert figures["recommended"] == "trust"
    assert figures["verdict"].startswith("good for ground truth:")
    assert "frames agree within 2.1 mm (median)" in figures["verdict"]


def test_what_is_refined_is_not_left_out(circle: np.ndarray, orbit: Sequence) -> None:
    given = check_of(
        24,
        0.012,
        rejected=np.arange(24) == 11,
        distant_shift_m=0.04,
        refined_distant_residual_m=0.003,
    )
    figures = figures_of(orbit, "refine", closed(circle), [], given)
    assert figures["rejected"] == [] and figures["tracked"] == 24
    assert figures["given"] == {
        "disagreeing": [11],
        "median_shift_mm": 12.0,
        "distant_shift_mm": 40.0,
        "distant_unmatched": None,
        "largest_jump_mm": 0.0,
        "refined_apart_mm": None,
        "distant_residual_mm": 4.0,
        "refined_distant_residual_mm": 3.0,
    }
    assert figures["recommended"] == "refine" and figures["grade"] == "good"
    assert figures["median_shift_mm"] == 0  # of the refined poses


def test_a_trusted_trajectory_that_drifts(circle: np.ndarray, orbit: Sequence) -> None:
    given = check_of(24, distant_shift_m=0.013)
    figures = figures_of(orbit, "trust", tracked_of(circle), [], given)
    assert figures["grade"] == "fair" and figures["recommended"] == "refine"
    assert (
        "distant frames agree within 13.0 mm (median), the given trajectory is worth refining"
        in (figures["verdict"])
    )


SOUND = GivenFigures(median_shift_m=0.002, distant_shift_m=0.004, distant_unmatched=0.1, largest_jump_m=0.0)


@pytest.mark.parametrize(
    ("rejected_share", "distant_m", "near_m", "expected"),
    [
        (0.0, 0.004, 0.002, "trust"),
        (0.0, 0.0085, 0.002, "trust"),
        (0.0, 0.0095, 0.002, "refine"),
        # A motion capture's noise is as large between near frames as between distant ones.
        (0.0, 0.020, 0.010, "trust"),
        (0.0, 0.080, 0.010, "refine"),
        (0.2, 0.004, 0.002, "refine"),
        (0.6, 0.004, 0.002, "ignore"),
        (0.4, 1.0, 0.002, "refine"),  # drift alone is no reason to ignore it
        (0.0, None, 0.002, "trust"),
        (0.0, None, 0.006, "refine"),
        (0.0, 0.004, None, "trust"),
        (0.0, 0.006, None, "refine"),
        (0.0, None, None, "trust"),
    ],
)
def test_recommendation(
    rejected_share: float, distant_m: float | None, near_m: float | None, expected: str
) -> None:
    given = SOUND.model_copy(update={"distant_shift_m": distant_m, "median_shift_m": near_m})
    assert recommend(given, 1.0, rejected_share) == expected


@pytest.mark.parametrize(
    ("changes", "checked_share", "expected"),
    [
        ({}, 1.0, "trust"),
        ({"largest_jump_m": 0.03}, 1.0, "refine"),
        ({"distant_unmatched": 0.35}, 1.0, "trust"),
        ({"distant_unmatched": 0.45}, 1.0, "refine"),
        ({"distant_unmatched": 1.0, "distant_shift_m": None}, 1.0, "refine"),
        ({"refined_apart_m": 0.013}, 1.0, "trust"),
        ({"refined_apart_m": 0.056}, 1.0, "refine"),
        ({}, 0.6, "trust"),
        ({"median_shift_m": None, "distant_shift_m": None}, 0.0, "ignore"),
    ],
)
def test_what_else_speaks_against_a_given_trajectory(
    changes: dict[str, float | None], checked_share: float, expected: str
) -> None:
    assert recommend(SOUND.model_copy(update=changes), checked_share, 0.0) == expected


# --- the verdict

GOOD = {
    "frames": 1000,
    "tracked": 1000,
    "median_shift_m": 0.001,
    "loop_correction_m": 0.002,
    "open_path_m": 0.3,
    "arc_rad": np.radians(359.0),
    "held_out_residual_m": 0.004,
    "sensor_noise_m": 0.004,
}


def judged(loops: int = 20, believed_loops: int = 20, degenerate: int = 0, rejected: int = 0, **changes: Any):
    """The verdict on good poses, but for the changes."""
    closures = [LoopClosure(a=0, b=1, believed=k < believed_loops) for k in range(loops)]
    left_out = [RejectedFrame(frame=k) for k in range(rejected)]
    rows = {"loops": closures, "degenerate": range(degenerate), "rejected": left_out}
    return judge(health_of(**{**GOOD, **rows, **changes}))


@pytest.mark.parametrize(
    ("changes", "grade", "reason"),
    [
        ({}, "good", "held-out depth is off by 4.0 mm, 1.0 times the sensor's noise"),
        ({}, "good", "only 0.3 m of path lie outside any loop"),
        ({"tracked": 999}, "good", "99.9 % of the frames have a pose"),
        ({"tracked": 850}, "fair", "85.0 % of the frames have a pose"),
        ({"tracked": 500}, "not good", "50.0 % of the frames have a pose"),
        ({"tracked": 2}, "not good", "2 of 1000 frames have a pose"),
        ({"loop_correction_m": 0.008}, "fair", "loops close within 8.0 mm"),
        ({"loop_correction_m": 0.012}, "not good", "loops close within 12.0 mm"),
        ({"believed_loops": 12}, "fair", "8 of 20 loops contradict"),
        ({"believed_loops": 8}, "not good", "12 of 20 loops contradict"),
        ({"held_out_residual_m": 0.01}, "fair", "2.5 times the sensor's noise"),
        ({"held_out_residual_m": 0.014}, "not good", "3.5 times the sensor's noise"),
        ({"held_out_residual_m": None}, "not good", "no frame could be predicted"),
        ({"sensor_noise_m": None}, "not good", "no frame could be predicted"),
        ({"degenerate": 100}, "fair", "10.0 % of the frames show too plain a shape"),
        ({"degenerate": 400}, "not good", "40.0 % of the frames show too plain a shape"),
        ({"median_shift_m": 0.007}, "fair", "keyframes agree within 7.0 mm"),
        ({"open_path_m": 3.0}, "fair", "3.0 m of path lie outside any loop, their drift is not known"),
        (
            {
                "loops": 0,
                "believed_loops": 0,
                "loop_correction_m": None,
                "open_path_m": 3.1,
                "arc_rad": np.radians(118.0),
            },
            "fair",
            "3.1 m of path lie outside any loop (arc of 118 degrees), their drift is not known",
        ),
        (
            {
                "loops": 0,
                "believed_loops": 0,
                "loop_correction_m": None,
                "open_path_m": 8.0,
                "arc_rad": None,
            },
            "not good",
            "8.0 m of path lie outside any loop, their drift is not known",
        ),
        ({"source": "refine", "open_path_m": 8.0}, "good", "loops close"),
        ({"source": "trust", "median_shift_m": 0.004}, "good", "frames agree within 4.0 mm (median)"),
        ({"source": "trust", "median_shift_m": 0.009}, "fair", "frames agree within 9.0 mm (median)"),
        ({"source": "trust", "median_shift_m": 0.011}, "not good", "frames agree within 11.0 mm (median)"),
        ({"source": "trust", "median_shift_m": None}, "not good", "could not be checked"),
        ({"source": "trust", "unchecked": 600}, "fair", "60.0 % of the poses could not be checked"),
        ({"source": "trust", "rejected": 200, "tracked": 950}, "fair", "20.0 % of the frames disagree"),
        (
            {"source": "trust", "degenerate": 20},
            "good",
            "2.0 % of the frames show too plain a shape to check",
        ),
        (
            {"source": "trust", "degenerate": 990},
            "fair",
            "99.0 % of the frames show too plain a shape to check",
        ),
        (
            {"source": "trust", "given": {"distant_shift_m": 0.009}},
            "good",
            "distant frames agree within 9.0 mm",
        ),
        (
            {"source": "trust", "given": {"distant_shift_m": 0.019}},
            "fair",
            "distant frames agree within 19.0 mm",
        ),
        (
            {"source": "trust", "given": {"distant_shift_m": 0.021}},
            "not good",
            "distant frames agree within 21.0 mm",
        ),
        ({"source": "trust", "recommended": "refine"}, "fair", "worth refining"),
        ({"source": "trust", "recommended": "ignore"}, "not good", "better ignored"),
        ({"source": "trust", "given": {"largest_jump_m": 0.047}}, "not good", "jumps by 47 mm"),
        ({"source": "trust", "given": {"distant_unmatched": 0.3}}, "good", "frames agree within"),
        (
            {"source": "trust", "given": {"distant_unmatched": 0.45}},
            "fair",
            "45 % of the pairs of distant frames",
        ),
        (
            {"source": "trust", "given": {"distant_unmatched": 0.7}},
            "not good",
            "70 % of the pairs of distant frames",
        ),
    ],
)
def test_grades_and_their_reasons(changes: dict[str, Any], grade: str, reason: str) -> None:
    found, verdict = judged(**changes)
    assert found == grade and reason in verdict
    # No millimetres are promised: those of the reasons are what was measured.
    assert verdict.startswith(f"{grade} for ground truth: ")


def test_only_what_limits_is_named() -> None:
    _, verdict = judged(loop_correction_m=0.008, held_out_residual_m=0.014)
    assert verdict == (
        "not good for ground truth: held-out depth is off by 14.0 mm, 3.5 times the sensor's noise"
    )


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
    tracked = tracked_of(poses, residual_m=unknown, inlier_share=unknown, ties=())
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
    loop = tie(circle, 0, 22, "loop")
    figures = figures_of(orbit, "tracked", replace(tracked, ties=(*tracked.ties, loop)), [])
    assert figures["loop_correction_mm"] == pytest.approx(22, abs=ROUNDED_MM)
    assert figures["grade"] == "not good" and "loops close within 22.0 mm" in figures["verdict"]
