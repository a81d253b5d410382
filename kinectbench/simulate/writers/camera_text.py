"""Cameras and matrices as recordings write them: JSON values, and rows of text."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera
from kinectbench.simulate.writers.frame import Rig


def camera_json(camera: Camera) -> dict[str, float]:
    """Size and intrinsics in pixels as plain JSON values: width, height, fx, fy, cx, cy."""
    return {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}


def color_json(rig: Rig) -> dict[str, Any]:
    """How colour lies to depth, as plain JSON values (own rule).

    `color_registered`, which readers know; where it is false also `color_camera` (as `camera_json`) and
    `T_color_depth` (four rows, metres, depth camera to colour camera), for whoever wants to register it.
    """
    if rig.color_registered:
        return {"color_registered": True}
    return {
        "color_registered": False,
        "color_camera": camera_json(rig.color),
        "T_color_depth": rig.T_color_depth.tolist(),
    }


def matrix_rows(matrix: NDArray[np.float64]) -> list[str]:
    """The rows of a matrix (n, m) as text: numbers with every digit they have, spaces between."""
    return [" ".join(repr(number) for number in row) for row in matrix.tolist()]
