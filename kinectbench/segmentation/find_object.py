"""The object where the cameras look, with its feet, and the box around it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.config import SegmentationSettings
from kinectbench.geometry import OrientedBox
from kinectbench.segmentation.low_parts import low_cut_m, low_parts, low_pieces
from kinectbench.segmentation.scene import Scene, check_focus
from kinectbench.segmentation.select import CELL_M, fit_box, select_object


@dataclass(frozen=True)
class FoundObject:
    """The object as it was chosen in a scene.

    Attributes:
        chosen: (n,) bool, the scene's points above the floor cut that are the object's.
        feet: (v,) bool, the vertices that are low parts of it.
        box: upright box around both, floor frame.
    """

    chosen: NDArray[np.bool_]
    feet: NDArray[np.bool_]
    box: OrientedBox


def find_object(
    scene: Scene, vertices_floor: NDArray[np.float64], settings: SegmentationSettings, cell_m: float
) -> FoundObject:
    """Choose the piece the cameras look at, and what is connected to it near the floor.

    Args:
        scene: the fused surface in the floor frame.
        vertices_floor: (v, 3) vertices of its mesh, floor frame, metres.
        settings: floor cut and low cut.
        cell_m: cells of this edge that touch are connected.

    Raises:
        SegmentationError: nothing stands on the floor, or not where the cameras look.
    """
    points_floor, heights_m = scene.points_floor, vertices_floor[:, 2]
    chosen = select_object(points_floor, settings.floor_cut_m, scene.focus_floor)
    box = fit_box(points_floor[chosen])
    check_focus(box, scene.focus_floor)
    others = (points_floor[:, 2] > settings.floor_cut_m) & ~chosen
    specks = np.zeros(len(others), dtype=bool)
    specks[others] = low_pieces(points_floor[others], CELL_M)
    own = chosen[scene.owner] & (heights_m > settings.floor_cut_m)
    low = heights_m > low_cut_m(scene.floor, settings)
    feet = low & ~own & ((heights_m <= settings.floor_cut_m) | specks[scene.owner])
    feet[feet] = low_parts(vertices_floor[feet], vertices_floor[own], box, cell_m)
    if feet.any():
        box = fit_box(np.concatenate([points_floor[chosen], vertices_floor[feet]]))
        reached = np.zeros(len(chosen), dtype=bool)
        reached[scene.owner[feet]] = True
        chosen = chosen | (specks & reached)
    return FoundObject(chosen, feet, box)
