"""Given poses far from the origin, as of a map: refused before anything is fused; nearer ones are held."""

import numpy as np
import pytest
from analytic_scenes import sequence_of
from raising import raises

from kinectbench.core.errors import TrackingError
from kinectbench.settings.models import TrackingSettings, TrajectoryMode
from kinectbench.stages.fuse.blocks import BLOCK_VOXELS, BlockVolume
from kinectbench.stages.fuse.mesh import extract_mesh
from kinectbench.stages.track import track
from kinectbench.stages.track.track import WORLD_REACH_M

FINEST_M = 0.002


@pytest.mark.parametrize("mode", [None, "trust", "refine"])
def test_poses_of_a_map_are_refused(mode: TrajectoryMode | None) -> None:
    T = np.tile(np.eye(4), (4, 1, 1))
    T[0] = np.nan
    T[2, :3, 3] = [500_000, -5_000_000, 100]  # UTM
    sequence = sequence_of([np.ones((24, 32), np.float32)] * 4, given=T)
    with raises(TrackingError, "tracking.bad-given", match="frame 2 lies 5000000 m .* subtract the first"):
        track(sequence, mode, TrackingSettings())


def ball_at(middle_m: float) -> BlockVolume:
    """The finest volume of a scene: a ball of 10 mm at (middle, -middle, middle)."""
    middle = (np.array([1, -1, 1]) * middle_m / FINEST_M).astype(np.int64)
    first = middle // BLOCK_VOXELS - 2
    blocks = np.stack(np.meshgrid(*[np.arange(5)] * 3, indexing="ij"), -1).reshape(-1, 3) + first
    within = np.stack(np.meshgrid(*[np.arange(BLOCK_VOXELS)] * 3, indexing="ij"), -1)
    voxels = blocks[:, None, None, None] * BLOCK_VOXELS + within
    tsdf = FINEST_M * np.linalg.norm(voxels - middle + 0.3, axis=-1) - 0.01
    weight, votes = np.ones(tsdf.shape, np.float32), np.full(tsdf.shape, 9 << 16, np.uint32)
    return BlockVolume(blocks.astype(np.int32), FINEST_M, np.eye(4), tsdf.astype(np.float32), weight, votes)


def test_the_farthest_scene_is_held() -> None:
    """Cameras at the limit that see 20 m far; five times as far its vertices would be one another's."""
    meshes = [extract_mesh(ball_at(middle_m), 0.0) for middle_m in (0.0, WORLD_REACH_M + 20)]
    assert len(meshes[0].faces) == len(meshes[1].faces) > 500
    assert len(meshes[0].vertices) == len(meshes[1].vertices)
    assert len(extract_mesh(ball_at(5 * WORLD_REACH_M), 0.0).vertices) < len(meshes[0].vertices)
