"""Masks that a person drew beside the object, or of one pixel; a rule that leaves nothing of a surface."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from typed import present

from kinectbench.core.geometry import Camera, Grid, OrientedBox, rigid
from kinectbench.core.geometry.camera import DepthRenderer
from kinectbench.core.geometry.mesh import box_mesh
from kinectbench.core.voxels.known_cells import known_grid
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.settings.models import PairSettings
from kinectbench.stages.pairs import FullShape, MadePair, make_pair

CAMERA = Camera(320, 240, 260, 260, 159.5, 119.5)
BOX = box_mesh(OrientedBox((0, 0, 1.5), (0.6, 0.5, 0.4)))  # the world's axes are the camera's
WALL = box_mesh(OrientedBox((0, 0, 3.0), (6, 6, 0.1)))
OBJECT = DepthRenderer(BOX).depth_m(CAMERA, np.eye(4)) > 0


def made(mask: NDArray[np.bool_], camera: Camera = CAMERA, noise_m: float = 0, **settings: Any) -> MadePair:
    """The pair of a view of a box before a wall, with a person's mask."""
    object_m, wall_m = (DepthRenderer(mesh).depth_m(camera, np.eye(4)) for mesh in (BOX, WALL))
    depth_m = np.where(object_m > 0, object_m, wall_m)
    depth_m = (depth_m + np.random.default_rng(0).random(depth_m.shape) * noise_m).astype(np.float32)
    everywhere = Grid((16, 16, 16), 0.1, rigid(np.eye(3), (-0.8, -0.8, 0.7)))
    known = (known_grid(everywhere, np.ones(everywhere.shape, bool)),) * 2
    shape = FullShape(BOX, BOX.volume_m3, known, known, known, 0.001)
    view: Any = SimpleNamespace(frame=0, mask=mask, alignment=SimpleNamespace(T_world_camera=np.eye(4)))
    sequence: Any = SimpleNamespace(camera=camera, depth_m=lambda _: depth_m.copy())
    return make_pair(view, sequence, shape, PairSettings(**settings))


def one_pixel() -> NDArray[np.bool_]:
    mask = np.zeros_like(OBJECT)
    mask[tuple(np.argwhere(OBJECT)[0])] = True
    return mask


def test_the_object_itself_makes_a_pair() -> None:
    result = made(OBJECT)
    assert result.reason is None and unpack(present(result.pair).partial).sum() > 1000


@pytest.mark.parametrize("mask", [~OBJECT, ~OBJECT | one_pixel()], ids=["wall", "wall and a pixel"])
def test_depth_beyond_the_cube_is_not_in_the_shape(mask: NDArray[np.bool_]) -> None:
    result = made(mask)
    assert result.pair is None and "only 0.0% of the masked partial lies in" in present(result.reason)
    careless = made(~OBJECT, min_containment=0)
    assert careless.pair is None and "nothing of the masked partial lies in" in present(careless.reason)


@pytest.mark.parametrize("framing", ["object", "view"])
def test_a_rule_that_leaves_no_input_is_named(framing: str) -> None:
    result = made(OBJECT, framing=framing, partial_rule="majority", min_containment=0)
    assert result.pair is None and "set `pairs.partial_rule` to any" in present(result.reason)


def test_majority_keeps_blocks_that_noise_fills() -> None:
    camera = Camera(1280, 960, 1040, 1040, 639.5, 479.5)
    fine = np.repeat(np.repeat(OBJECT, 4, axis=0), 4, axis=1)
    pair = present(made(fine, camera, noise_m=0.01, partial_rule="majority", min_containment=0).pair)
    counts = unpack(pair.partial_256).reshape(64, 4, 64, 4, 64, 4).sum(axis=(1, 3, 5))
    assert pair.partial_rule == "majority" and (counts > 32).sum() > 100
    np.testing.assert_array_equal(unpack(pair.partial), counts > 32)


@pytest.mark.parametrize("framing", ["object", "view"])
def test_a_mask_of_one_pixel_is_refused(framing: str) -> None:
    result = made(one_pixel(), framing=framing)
    assert result.pair is None and "only one pixel of the mask has depth" in present(result.reason)
