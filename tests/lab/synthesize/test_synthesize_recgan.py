"""The authors' files, read back by their loading rule: an asymmetric shape, so that a mirrored axis shows."""

import numpy as np
import pytest
from recgan_reader import block_maximum, centring_shift, load, theirs
from synthesis_shapes import asymmetric, mesh_of

from kinectbench.core.voxels.pair_file import Pair, unpack
from kinectbench.core.voxels.resample import reduce_blocks
from kinectbench.lab.synthesize.make import make_synthetic_pair, recgan_bytes
from kinectbench.lab.synthesize.mesh_check import check_mesh
from kinectbench.lab.synthesize.models import SynthesisSettings
from kinectbench.lab.synthesize.views import DepthCamera, ViewAngles, all_views, virtual_camera
from kinectbench.release.exchange.layouts import recgan_path

VIEWS = [view for view in all_views(5) if view.name in ("0_0_0", "0_1_2", "3_4_1", "2_2_2")]


@pytest.fixture(scope="module")
def pairs() -> list[Pair]:
    checked = check_mesh(mesh_of(asymmetric()), 100)
    eye = DepthCamera(checked.mesh, virtual_camera(320))
    return [make_synthetic_pair(checked, eye, view, SynthesisSettings(up="y"))[0] for view in VIEWS]


@pytest.mark.parametrize("n", range(len(VIEWS)))
def test_the_loading_rule_gives_our_grids_back(n: int, pairs: list[Pair]) -> None:
    pair = pairs[n]
    seen_file, full_file = recgan_bytes(pair)
    assert theirs(seen_file).shape == theirs(full_file).shape
    full, partial_256 = unpack(pair.full), unpack(pair.partial_256)
    shift = centring_shift(full | partial_256)
    assert max(map(abs, shift)) <= 1  # the cube is centred on the shape's box already
    back = load(full_file)[::-1, ::-1, :]
    np.testing.assert_array_equal(back, np.roll(full, shift, axis=(0, 1, 2)))
    back_64 = block_maximum(load(seen_file)).astype(bool)[::-1, ::-1, :]
    np.testing.assert_array_equal(back_64, reduce_blocks(np.roll(partial_256, shift, axis=(0, 1, 2)), "any"))
    assert shift != (0, 0, 0) or (back_64 == unpack(pair.partial)).all()


def test_no_mirror_image_would_pass(pairs: list[Pair]) -> None:
    """The shape tells every other order and direction of the axes apart, by far."""
    back = load(recgan_bytes(pairs[1])[1])
    full = unpack(pairs[1].full)
    for flips in np.ndindex(2, 2, 2):
        turned = back[tuple(slice(None, None, -1 if flip else 1) for flip in flips)] > 0
        overlap = np.count_nonzero(turned & full) / np.count_nonzero(turned | full)
        assert overlap > 0.9 if flips == (1, 1, 0) else overlap < 0.7


def test_back_projection_in_their_axes_falls_onto_the_shape() -> None:
    """x = -(u - w/2) z / f and y = -(v - h/2) z / f, z forward: their points lie in their cells."""
    checked = check_mesh(mesh_of(asymmetric()), 100)
    camera = virtual_camera(320)
    eye = DepthCamera(checked.mesh, camera)
    pair = make_synthetic_pair(checked, eye, VIEWS[1], SynthesisSettings(up="y"))[0]
    depth_m = eye.depth_m(pair.T_world_camera)
    v, u = np.nonzero(depth_m)
    z = depth_m[v, u].astype(float)
    focal_px = 320 / (2 * np.tan(np.radians(49.124) / 2))
    points = np.stack([-(u - 160) * z / focal_px, -(v - 160) * z / focal_px, z], axis=-1)
    corner = (pair.T_world_grid[:3, 3] - pair.T_world_camera[:3, 3]) @ pair.T_world_camera[:3, :3]
    side_m = 256 * pair.voxel_size_m
    low = np.array([-(corner[0] + side_m), -(corner[1] + side_m), corner[2]])
    cells = np.floor((points - low) / pair.voxel_size_m).astype(int)
    marked = np.zeros((256, 256, 256), bool)
    marked[tuple(cells.T)] = True
    partial = unpack(pair.partial_256)[::-1, ::-1, :]
    assert np.count_nonzero(marked != partial) < 0.01 * np.count_nonzero(partial)


def test_folders_and_names() -> None:
    view = ViewAngles((0, 1, 2), 6)
    model = "2d1ea225c279836cd67b3c7873295e75"
    assert recgan_path("25d", "bench", "test", view.n**3, f"{model}_{view.name}") == (
        f"P1_02828884_bench/test_216_25d_vox256/{model}_0_1_2.npz"
    )
    assert recgan_path("3d", "couch", "validation", 125, "m_4_0_3") == (
        "P1_04256520_couch/val_125_3d_vox256/m_4_0_3.npz"
    )
