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
    for v in range(height):
        for u in range(width):
            d = float(keyframe[v, u])
            if d <= 0:
                continue
            px, py = (u - cx) / fx * d, (v - cy) / fy * d
            z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * d + T[2, 3]
            if z < 0.1:
                continue
            x = fx * (T[0, 0] * px + T[0, 1] * py + T[0, 2] * d + T[0, 3]) / z + cx
            y = fy * (T[1, 0] * px + T[1, 1] * py + T[1, 2] * d + T[1, 3]) / z + cy
            if x < 0 or y < 0 or x >= width - 1 or y >= height - 1:
                continue
            reach = 4 * (SIGMA_NEAR_M + SIGMA_GROWTH_PER_M * (z - SIGMA_NEAR_DEPTH_M) ** 2) + 0.003
            i, j = int(y), int(x)
            a, b = y - i, x - j
            near = frame[int(y + 0.5), int(x + 0.5)]
            if near <= 0 or abs(near - z) > reach:
                continue
            d00, d01, d10, d11 = frame[i, j], frame[i, j + 1], frame[i + 1, j], frame[i + 1, j + 1]
            seen = float(near)
            if max(abs(d00 - near), abs(d01 - near), abs(d10 - near), abs(d11 - near)) < reach:
                seen = (d00 * (1 - b) + d01 * b) * (1 - a) + (d10 * (1 - b) + d11 * b) * a
            total[v, u] += d + (seen - z)
            count[v, u] += 1
