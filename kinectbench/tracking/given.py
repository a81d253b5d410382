"""A given trajectory, brought to the frames' time stamps."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import interpolate_rigid
from kinectbench.sequence import GivenTrajectory


def poses_at(given: GivenTrajectory, stamps_ns: NDArray[np.int64], max_gap_s: float) -> NDArray[np.float64]:
    """T_world_camera at each stamp, by slerp between the two poses around it.

    Args:
        given: the trajectory.
        stamps_ns: (n,) int64, the frames.
        max_gap_s: two poses farther apart than this are not bridged.

    Returns:
        (n, 4, 4) float64; NaN where the trajectory says nothing. A stamp met exactly needs no bridge.
    """
    poses = np.full((len(stamps_ns), 4, 4), np.nan)
    after = np.searchsorted(given.stamps_ns, stamps_ns)
    for index, (stamp, right) in enumerate(zip(stamps_ns, after, strict=True)):
        if right < len(given.stamps_ns) and given.stamps_ns[right] == stamp:
            poses[index] = given.T_world_camera[right]
        elif 0 < right < len(given.stamps_ns):
            gap_ns = int(given.stamps_ns[right] - given.stamps_ns[right - 1])
            if gap_ns <= max_gap_s * 1e9:
                fraction = int(stamp - given.stamps_ns[right - 1]) / gap_ns
                poses[index] = interpolate_rigid(
                    given.T_world_camera[right - 1], given.T_world_camera[right], fraction
                )
    return poses
