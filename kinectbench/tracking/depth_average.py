"""Average the depth of a keyframe with that of the frames registered to it: less noise, better normals.

After the keyframe fusion of Meilland & Comport (IROS 2013): each pixel of the keyframe is looked up in the
frames around it, where they see the same surface.
"""

from dataclasses import dataclass, field

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import invert_rigid
from kinectbench.geometry.depth_noise import SIGMA_GROWTH_PER_M, SIGMA_NEAR_DEPTH_M, SIGMA_NEAR_M
from kinectbench.tracking.frame_maps import STORED_PER_M, Level

# More frames than this add nothing but time.
MAX_FRAMES = 16


@dataclass
class DepthAverage:
    """The depth of one keyframe while frames are added.

    Attributes:
        level: the keyframe at its finest resolution.
    """

    level: Level
    frames: int = 0
    _total: NDArray[np.float32] = field(init=False)
    _count: NDArray[np.float32] = field(init=False)

    def __post_init__(self) -> None:
        self._total = self.level.depth_m.copy()
        self._count = (self.level.depth_m > 0).astype(np.float32)

    def add(self, frame: Level, T_keyframe_frame: NDArray[np.float64]) -> None:
        """Add a frame that lies at T_keyframe_frame (4, 4) to the keyframe."""
        if self.frames >= MAX_FRAMES:
            return
        self.frames += 1
        T_frame_keyframe = np.ascontiguousarray(invert_rigid(T_keyframe_frame))
        _add(self._total, self._count, self.level.depth_m, frame.depth_m, frame.intrinsics, T_frame_keyframe)

    def mean_m(self) -> NDArray[np.float32]:
        """(height, width) float32 mean depth in metres, 0 = none."""
        return np.asarray(self._total / np.maximum(self._count, 1), np.float32)

    def stored(self) -> NDArray[np.uint16]:
        """(height, width) uint16 mean depth in 0.1 mm, 0 = none."""
        return np.asarray(np.rint(np.minimum(self.mean_m() * STORED_PER_M, 65535)), np.uint16)


@numba.njit(cache=True, error_model="numpy")
def _add(total, count, keyframe, frame, intrinsics, T):  # type: ignore[no-untyped-def]
    height, width = keyframe.shape
    fx, fy, cx, cy = intrinsics
    over_fx, over_fy = 1 / fx, 1 / fy
    r00, r01, r02, t0 = T[0, 0], T[0, 1], T[0, 2], T[0, 3]
    r10, r11, r12, t1 = T[1, 0], T[1, 1], T[1, 2], T[1, 3]
    r20, r21, r22, t2 = T[2, 0], T[2, 1], T[2, 2], T[2, 3]
    for v in range(height):
        b = (v - cy) * over_fy
        for u in range(width):
            d = float(keyframe[v, u])
            if d <= 0:
                continue
            a = (u - cx) * over_fx
            z = (r20 * a + r21 * b + r22) * d + t2
            if z < 0.1:
                continue
            over_z = 1 / z
            x = fx * ((r00 * a + r01 * b + r02) * d + t0) * over_z + cx
            y = fy * ((r10 * a + r11 * b + r12) * d + t1) * over_z + cy
            if x < 0 or y < 0 or x >= width - 1 or y >= height - 1:
                continue
            near = frame[np.uint32(y + 0.5), np.uint32(x + 0.5)]
            reach = 4 * (SIGMA_NEAR_M + SIGMA_GROWTH_PER_M * (z - SIGMA_NEAR_DEPTH_M) ** 2) + 0.003
            if near <= 0 or abs(near - z) > reach:
                continue
            # Unsigned, so that no index is taken for one from the end.
            i, j = np.uint32(y), np.uint32(x)
            down, right = y - i, x - j
            d00, d01, d10, d11 = frame[i, j], frame[i, j + 1], frame[i + 1, j], frame[i + 1, j + 1]
            seen = float(near)
            if max(abs(d00 - near), abs(d01 - near), abs(d10 - near), abs(d11 - near)) < reach:
                seen = (d00 * (1 - right) + d01 * right) * (1 - down)
                seen += (d10 * (1 - right) + d11 * right) * down
            total[v, u] += d + (seen - z)
            count[v, u] += 1
