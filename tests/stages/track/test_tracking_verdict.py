"""What is said of a trajectory for ground truth: recommendations, grades, and what limits them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from analytic_scenes import health_of, ring
from health_scenes import DISTANCE_M, check_of, closed, figures_of, sequence_at, tracked_of
from slow import slow
from tracking_scenes import chair_circle, errors_m
from verdicts import GOOD_M

from kinectbench.core.artefacts.trajectory import GivenFigures, LoopClosure, RejectedFrame
from kinectbench.core.sequence import GivenTrajectory, Sequence
from kinectbench.settings.models import TrackingSettings, TrajectoryMode
from kinectbench.stages.track import track
from kinectbench.stages.track.health_figures import jumps
from kinectbench.stages.track.verdict import judge, recommend

pytestmark = pytest.mark.xdist_group("tracking")


@pytest.fixture(scope="module")
def circle() -> np.ndarray:
    return ring(24, DISTANCE_M)


@pytest.fixture(scope="module")
def orbit(circle: np.ndarray) -> Sequence:
    return sequence_at(circle)


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
        # Not good for ground truth as it is.
        (0.0, 0.020, 0.0101, "refine"),
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


def judged(
    loops: int = 20, believed_loops: int = 20, degenerate: int = 0, rejected: int = 0, **changes: Any
) -> tuple[str, str]:
    """The verdict on good poses, but for the changes."""
    closures = [LoopClosure(a=0, b=1, believed=k < believed_loops) for k in range(loops)]
    left_out = [RejectedFrame(frame=k) for k in range(rejected)]
    rows = {"loops": closures, "degenerate": range(degenerate), "rejected": left_out}
    return judge(health_of(**{**GOOD, **rows, **changes}))


def test_poses_that_consecutive_frames_contradict_are_not_good() -> None:
    torn = LoopClosure(a=3, b=5, overlap=0.9, inlier_share=0.99, correction_m=1.1, believed=False)
    found = health_of(**GOOD | {"keyframes": (0, 3, 5), "refused_loops": (torn,)})
    grade, words = judge(found)
    assert grade == "not good" and "frames 3 and 5 fit each other, but their poses are 1.1 m off" in words
    for other in ({"correction_m": 0.01}, {"overlap": 0.2}, {"b": 8}):
        row = torn.model_copy(update=other)
        assert judge(found.model_copy(update={"refused_loops": (row,)}))[0] != "not good"


def test_a_jump_is_not_good() -> None:
    poses = np.tile(np.eye(4), (30, 1, 1))
    poses[:, 0, 3] = 0.05 * np.arange(30)
    poses[20:, 0, 3] += 1.2
    poses[12:19] = np.nan  # lost, and found where the camera may have walked meanwhile
    (jump,) = jumps(poses, np.arange(30) * 100_000_000)
    assert (jump.from_frame, jump.to_frame, jump.moved_m) == (19, 20, 1.25)
    found = health_of(**GOOD | {"jumps": (jump,)})
    assert judge(found)[0] == "not good" and "the camera would move by 1.2 m" in judge(found)[1]
    given = found.model_copy(update={"source": "refine"})
    assert "the camera would move" not in judge(given)[1]


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
        ({"open_gap_s": 0.3}, "good", "the camera is lost for 0.3 s"),
        ({"open_gap_s": 1.0}, "fair", "the camera is lost for 1.0 s, and no loop joins the path"),
        ({"open_gap_s": 3.0}, "not good", "the camera is lost for 3.0 s, and no loop joins the path"),
        ({"source": "trust", "open_gap_s": 3.0}, "good", "frames agree within"),
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
        (  # of the 980 with a pose
            {"source": "trust", "degenerate": 60, "rejected": 20, "tracked": 980},
            "good",
            "4.1 % of the frames show too plain a shape to check",
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


# --- grades beside an error that is known

ALONG = np.linspace(0, 1, 48)[:, None] * np.array([1.0, 0.0, 0.0])


def walked(off_m: float | None) -> Sequence:
    """A circle around a chair with its true poses, which drift by so much until its end; None: without."""
    furniture = chair_circle()
    T_given = furniture.simulation.T_world_camera.copy()
    T_given[:, :3, 3] += (off_m or 0.0) * ALONG
    stamps_ns = furniture.sequence.stamps_ns
    given = None if off_m is None else GivenTrajectory(stamps_ns, T_given)
    return replace(furniture.sequence, given_trajectory=given)


@pytest.mark.parametrize(
    ("off_m", "mode", "grade"),
    [
        (0.0, "trust", "good"),
        (None, "ignore", "good"),
        (0.06, "refine", "good"),
        (0.06, "trust", "not good"),
        slow(0.25, "trust", "not good"),
    ],
)
def test_a_grade_is_worth_what_is_known_of_the_error(
    off_m: float | None, mode: TrajectoryMode, grade: str
) -> None:
    """Good poses are within 10 mm of the truth and others are not, as the benchmark `verdicts` counts it."""
    found = track(walked(off_m), mode, TrackingSettings())
    assert found.health is not None and found.health.grade == grade
    error_m = errors_m(found.T_world_camera, chair_circle().simulation.T_world_camera)
    ate_m = float(np.sqrt(np.mean(error_m**2)))
    assert (ate_m <= GOOD_M) == (grade == "good"), ate_m
    # No length is promised: what agrees within millimetres is told behind the colon, as a figure.
    promised, colon, figures = found.health.verdict.partition(": ")
    assert promised == f"{grade} for ground truth" and colon and figures
