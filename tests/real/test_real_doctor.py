"""The doctor on real recordings: no alarm on right ones, and wrong copies of one are named."""

import os
import re
from pathlib import Path

import pytest
from slow import slow
from wrong_recordings import WRONG, make_wrong

from kinectbench.doctor import inspect
from kinectbench.settings.models import CameraSettings, TrackingSettings

DATA = os.environ.get("KINECTBENCH_DATA")
pytestmark = pytest.mark.skipif(not DATA, reason="KINECTBENCH_DATA does not name a folder of real recordings")
ROOT = Path(DATA or ".")
FREIBURG1 = CameraSettings(fx=517.3, fy=516.5, cx=318.6, cy=255.3)
# What rests on how real depth and colour are; tests/doctor/test_doctor.py has all of them.
BY_PICTURES = (
    "65535 for none",
    "colour beside depth",
    "colour three frames late",
    "half-resolution intrinsics",
    "inverse trajectory",
    "mirrored colour",
    "poses 200 ms late",
    "scale x 10",
)
# Keyframes are too far apart for one to stand out; twice its principal point lies outside the image, which
# cannot be opened; half of its depth is beyond 16 bits at ten times the scale.
NOT_HERE = {"a frame of another scene", "intrinsics of twice the size", "millimetres x 10 in the images"}


@pytest.mark.parametrize(
    ("name", "settings", "expected"),
    [
        ("tum_fr3_cabinet", None, {"trajectory_grade"}),
        slow(
            "7scenes_redkitchen_000-149",
            None,
            {"color_display_only", "arc", "trajectory_grade", "trajectory_check"},
        ),
        # Its depth lags the motion capture, by some 28 ms, and scatters by 13 mm about the desk by its poses.
        (
            "tum_fr1_xyz_150-179",
            FREIBURG1,
            {"reader", "arc", "trajectory_delay", "trajectory_grade", "no_floor"},
        ),
    ],
)
def test_no_alarm_on_right_recordings(name: str, settings: CameraSettings | None, expected: set[str]) -> None:
    diagnosis, _ = inspect(ROOT / name, settings, tracking=TrackingSettings())
    assert {found.name for found in diagnosis.findings} == expected and not diagnosis.stops
    assert diagnosis.facts["poses_read_as"] == "as given"
    # As `build` says it of all three: none of their trajectories is good as it was given.
    (graded,) = [found for found in diagnosis.findings if found.name == "trajectory_grade"]
    assert " for ground truth: " in graded.what and graded.advice == "recommended is `trajectory: refine`"


def test_the_offset_of_a_motion_capture_is_found_and_taken_away() -> None:
    """Depth of freiburg1_xyz lags the motion capture by 28 ms, by the error of all its frames."""
    diagnosis, _ = inspect(ROOT / "tum_fr1_xyz_150-179", FREIBURG1)
    (found,) = [each for each in diagnosis.findings if each.name == "trajectory_delay"]
    said = re.search(r"camera: \{trajectory_delay_s: (-?[\d.]+)\}", found.advice)
    assert said and float(said[1]) == pytest.approx(-0.028, abs=0.008)
    moved = FREIBURG1.model_copy(update={"trajectory_delay_s": float(said[1])})
    after, _ = inspect(ROOT / "tum_fr1_xyz_150-179", moved)
    # A build finds the desk with the same doubt: it scatters by 14 mm there, too.
    (floor,) = [each for each in after.findings if each.name in ("no_floor", "floor_doubtful")]
    assert floor.name == "floor_doubtful" and "14 mm about the floor" in floor.what
    assert "trajectory_delay" not in {each.name for each in after.findings}
    assert after.facts["pose_disagreement"] < 0.85 * diagnosis.facts["pose_disagreement"]  # type: ignore[operator]


def test_a_phone_that_looks_down_76_degrees_sees_the_floor() -> None:
    diagnosis, _ = inspect(ROOT / "phone_looking_down")
    assert "no_floor" not in {found.name for found in diagnosis.findings} and not diagnosis.stops
    # ARKit's poses say how high it was held; the boards lie on the floor.
    assert diagnosis.facts["camera_height_m"] == pytest.approx(0.51, abs=0.05)


@pytest.mark.parametrize(
    "name", [name if name in BY_PICTURES else slow(name) for name in sorted(set(WRONG) - NOT_HERE)]
)
def test_wrong_copies_of_the_cabinet_are_named(name: str, tmp_path: Path) -> None:
    _, finding, words = WRONG[name]
    diagnosis, _ = inspect(make_wrong(ROOT / "tum_fr3_cabinet", name, tmp_path / "wrong"))
    said = [f"{found.what}; {found.advice}" for found in diagnosis.findings if found.name == finding]
    assert said and any(words in text for text in said), diagnosis.findings
