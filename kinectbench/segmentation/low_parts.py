"""What of an object hardly rises above the floor: runners, discs, the tips of a star of feet."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.config import SegmentationSettings
from kinectbench.geometry import OrientedBox
from kinectbench.segmentation.floor import Floor
from kinectbench.segmentation.pieces import label_pieces

# The fused floor's surface strays this many of its standard deviations from the plane at most.
FLOOR_SIGMAS = 4.0
# No foot reaches farther beyond what stands on it.
MAX_BEYOND_M = 0.3
# A piece of surface that is nowhere higher is a bit of something low, such as a tube that lies on the floor.
MAX_LOW_M = 0.06


def low_cut_m(floor: Floor, settings: SegmentationSettings) -> float:
    """From which height on a surface may be the object's where it goes on above the floor cut, metres.

    `low_cut_m` of the settings, or four standard deviations of the floor if that is more, but at most the
    floor cut itself; that, too, where no floor was measured.

    Args:
        floor: of the recording.
        settings: both cuts.
    """
    if not floor.found:
        return settings.floor_cut_m
    return min(max(settings.low_cut_m, FLOOR_SIGMAS * floor.noise_m), settings.floor_cut_m)


def low_pieces(points_floor: NDArray[np.float64], cell_m: float) -> NDArray[np.bool_]:
    """Which of the points above the floor cut (n, 3) are of pieces that hardly rise above it: (n,) bool.

    Args:
        points_floor: evenly spread, of everything but the object, floor frame, metres.
        cell_m: cells of this edge that touch are connected.
    """
    if not len(points_floor):
        return np.zeros(0, dtype=bool)
    label = label_pieces(points_floor, cell_m)
    top_m = np.zeros(int(label.max()) + 1)
    np.maximum.at(top_m, label, points_floor[:, 2])
    low: NDArray[np.bool_] = (top_m <= MAX_LOW_M)[label]
    return low


def low_parts(
    low_floor: NDArray[np.float64], object_floor: NDArray[np.float64], box: OrientedBox, cell_m: float
) -> NDArray[np.bool_]:
    """Which of the low points are connected to the object (own rule).

    Args:
        low_floor: (n, 3) points of the surface between the low cut and the floor cut, and of low pieces,
            floor frame, metres.
        object_floor: (m, 3) points of the object above the floor cut, m > 0.
        box: around these; what lies more than 0.3 m beyond it is left out.
        cell_m: cells of this edge that touch are connected.

    Returns:
        (n,) bool.
    """
    from scipy import ndimage

    held = box.grown(MAX_BEYOND_M).contains(low_floor)
    if not held.any():
        return held
    cells = np.floor(np.concatenate([low_floor[held], object_floor]) / cell_m).astype(np.int64)
    cells -= cells.min(axis=0)
    occupied = np.zeros(cells.max(axis=0) + 1, dtype=bool)
    occupied[tuple(cells.T)] = True
    label = ndimage.label(occupied, np.ones((3, 3, 3)))[0][tuple(cells.T)]
    held[held] = np.isin(label[: held.sum()], label[held.sum() :])
    return held
