"""Make the public files of recordings whose truth is held back."""

import numpy as np

from kinectbench.core.artefacts.object import FloorFile
from kinectbench.core.artefacts.views import ViewRow, ViewsFile
from kinectbench.core.types import Float64
from kinectbench.core.voxels.pair_file import INPUT_KEYS, Pair, PairInput

# Statements of a person that reveal the truth: the object's size, a review, and whether its underside is
# solid.
SAID_OF_TRUTH = ("box", "review", "underside")
VIEW_KEYS = ("view", "K", "width", "height", "pair")
STEEP = 1e-6
# Matrices are rounded, because the last bits of a product differ between processors.
DECIMALS = 12


def without_truth(pair: Pair, T_floor_world: Float64) -> PairInput:
    """Return the input of a pair, transformed to a world frame that this view has for itself (`own_world`).

    In a common world frame, the views of an object together would reveal its shape.

    Args:
        pair: the complete pair.
        T_floor_world: (4, 4) of the recording, metres.
    """
    T_own_world = own_world(T_floor_world @ pair.T_world_camera) @ T_floor_world
    values = {key: getattr(pair, key) for key in INPUT_KEYS}
    for key in ("T_world_grid", "T_world_camera"):
        values[key] = np.round(T_own_world @ values[key], DECIMALS) + 0.0  # no -0
    return PairInput(**values)


def own_world(T_floor_camera: Float64) -> Float64:
    """Return T_own_floor (4, 4), from the floor frame to a view's own world frame; z is up in both.

    In the own frame, the camera is above the origin and looks along x. If it looks straight down, the top of
    its image points along x.
    """
    forward, image_up = T_floor_camera[:2, 2], -T_floor_camera[:2, 1]
    along = forward if np.hypot(*forward) > STEEP else image_up
    cosine, sine = along / np.hypot(*along)
    T = np.eye(4)
    T[:2, :2] = [[cosine, sine], [-sine, cosine]]
    T[:2, 3] = -T[:2, :2] @ T_floor_camera[:2, 3]
    return T


def own_floor(floor: FloorFile) -> FloorFile:
    """Return floor.json in a view's own world frame: the floor is z = 0, and other planes are left out."""
    kept = floor.model_copy(
        update={"plane_world": np.array([0.0, 0.0, 1.0, 0.0]), "T_floor_world": np.eye(4)}
    )
    return FloorFile(**{key: getattr(kept, key) for key in kept.model_fields_set - {"candidates"}})


def own_views(views: ViewsFile) -> ViewsFile:
    """Return views.json reduced to views with a pair, and to their `VIEW_KEYS`: no frames, poses or shares.

    Refused views and warnings are left out, too.
    """
    rows = tuple(ViewRow(**{key: getattr(row, key) for key in VIEW_KEYS}) for row in views.views if row.pair)
    return views.model_copy(update={"views": rows, "refused": (), "warnings": ()})
