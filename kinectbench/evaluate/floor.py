"""The built floor against the true one."""

from dataclasses import dataclass

import numpy as np

from kinectbench.evaluate.registration import Registration
from kinectbench.segmentation.floor import Floor
from kinectbench.simulate.truth import Truth


@dataclass(frozen=True)
class FloorFigures:
    """How far the built floor is from the true one.

    Attributes:
        angle_rad: between the two planes.
        height_m: of the built plane above the true floor at the object's foot; < 0 below it.
    """

    angle_rad: float
    height_m: float


def floor_figures(floor: Floor, truth: Truth, registration: Registration) -> FloorFigures:
    """Angle of the planes, and the distance between them straight below the object (own rule)."""
    T = registration.T_truth_built
    normal = T[:3, :3] @ floor.plane_world[:3]
    # n . (R^T (x - t)) + d = 0 in the truth's world
    offset = floor.plane_world[3] - normal @ T[:3, 3]
    up, foot = truth.T_world_object[:3, 2], truth.T_world_object[:3, 3]
    cosine, sine = float(normal @ up), float(np.linalg.norm(np.cross(normal, up)))
    # foot + h up lies on the built plane
    return FloorFigures(float(np.arctan2(sine, cosine)), float(-(normal @ foot + offset) / cosine))
