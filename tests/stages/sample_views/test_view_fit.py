"""The share of an object that the image border cuts off, and the gates of a view."""

import numpy as np
import pytest
import trimesh

from kinectbench.core.geometry import Camera, TriangleMesh, rigid
from kinectbench.core.geometry.camera import DepthRenderer
from kinectbench.settings.models import PairSettings, ViewSettings
from kinectbench.stages.sample_views.view_fit import ViewFit, refusal, truncated_share

CAMERA = Camera(320, 240, 262.5, 262.5, 159.5, 119.5)
GOOD = ViewFit(9000, 0.9, 0.0, 0.01, 0.98, 0.002)


@pytest.fixture(scope="module")
def renderer() -> DepthRenderer:
    plate = trimesh.creation.box((0.4, 0.2, 0.001))
    return DepthRenderer(TriangleMesh(np.asarray(plate.vertices), np.asarray(plate.faces, np.int32)))


@pytest.mark.parametrize("cut", [0.0, 0.25, 0.5, 0.9])
def test_a_plate_cut_by_the_border(renderer: DepthRenderer, cut: float) -> None:
    """A plate 1 m away: the right border runs through it so that `cut` of its width lies beyond."""
    right_m = (319.5 - CAMERA.cx) / CAMERA.fx
    centre_m = right_m + 0.4 * (cut - 0.5) - (0.1 if cut == 0 else 0)
    assert truncated_share(CAMERA, rigid(np.eye(3), [-centre_m, 0, -1]), renderer) == pytest.approx(
        cut, abs=0.07
    )


def test_nothing_in_sight_is_not_cut(renderer: DepthRenderer) -> None:
    assert truncated_share(CAMERA, rigid(np.eye(3), [0, 0, 1]), renderer) == 0.0


OUTLINE = "of the object's outline, less than 25%"


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({}, None),
        ({"pixels": 20}, "only 20 pixels on the object, less than 500"),
        ({"residual_m": 0.0161}, "depth is 16.1 mm (median) off the object, more than 15 mm"),
        ({"containment": 0.7}, "only 70.0% of the partial lies in the object, less than 85%"),
        (
            {"visible_share": 0.2},
            f"depth on only 20.0% {OUTLINE} (0% is cut by the image)",
        ),
        (
            {"truncated_share": 0.8},
            f"depth on only 18.0% {OUTLINE} (80% is cut by the image)",
        ),
    ],
)
def test_gates(changed: dict[str, float], reason: str | None) -> None:
    assert refusal(ViewFit(**{**vars(GOOD), **changed}), ViewSettings(), PairSettings()) == reason
