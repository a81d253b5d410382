"""Shells, gaps, hanging flaps, bodies with a hole: closed surfaces, and what of them a camera can tell."""

import numpy as np
import pytest
from object_checks import check_solid, check_variety, drawn
from slow import slow

from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.voxels.seeable import seeable_solid

SEEDS = range(6)
SIZES_M = {
    "shell": ((0.4, 0.25, 0.17), (0.65, 0.65, 0.38)),
    "two_boxes": ((0.37, 0.25, 0.3), (0.87, 0.46, 0.71)),
    "flap_box": ((0.3, 0.18, 0.25), (1.1, 1.1, 0.46)),
    "sound_box": ((0.24, 0.14, 0.3), (0.46, 0.33, 0.71)),
}


@pytest.mark.parametrize("family", SIZES_M)
@pytest.mark.parametrize("seed", SEEDS)
def test_it_is_one_watertight_solid_of_true_size(family: str, seed: int) -> None:
    check_solid(drawn(family, seed), *SIZES_M[family], (0.5, 260), steady_m=0.02)


@pytest.mark.parametrize(
    ("family", "least", "most"),
    [
        ("shell", 1.5, 10.0),  # hollow, and no camera can tell
        slow("two_boxes", 0.0, 0.01),  # the gap is seen, wide or narrow
        slow("flap_box", 0.0, 0.05),
        slow("sound_box", 0.2, 3.0),  # a hole shows some of the inside
    ],
)
def test_what_a_camera_can_tell_of_it(family: str, least: float, most: float) -> None:
    found = seeable_solid(drawn(family, 43).mesh, np.eye(4), SensorLimits(line_width_m=0.06))
    assert least <= found.closed_share <= most


def test_they_vary() -> None:
    for family in SIZES_M:
        check_variety(family, SEEDS, 1.1)
