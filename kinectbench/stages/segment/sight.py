"""What of the unseen some camera could have seen past what was measured: the definition of air."""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.types import Bools, Float32, Float64, Int64
from kinectbench.core.voxels.lines_of_sight import count_seen, directions
from kinectbench.core.voxels.seeable import line_space, swept_from_outside

# Lines of sight of a solid, and of one that is only compared with others.
FINE: Final = 1600
COARSE: Final = 400
# What lines of half the width reach and whole ones do not is not judged by the definition (slits): here it is
# unknown. So a gap that was measured too narrow, by up to half a line, is still one.
NARROWER = 0.5


def look(
    surface: Bools, heights_m: Float32 | None, voxel_m: float, limits: SensorLimits, count: int
) -> NDArray[np.uint8]:
    """How each voxel could be seen (`core.voxels.lines_of_sight`), 0 where no line of sight reaches it.

    Args:
        surface: bool (nx, ny, nz), upright: what was measured, that ends a line.
        heights_m: (nz,) of the layers' middles above the plane it stands on, metres; None: no plane.
        voxel_m: edge of a voxel, metres.
        limits: of the sensor.
        count: of directions.
    """
    return swept_from_outside(surface, heights_m, voxel_m, narrow(limits), directions(count))


def narrow(limits: SensorLimits) -> SensorLimits:
    """The limits of lines that find slits, too."""
    return replace(limits, line_width_m=NARROWER * limits.line_width_m)


def rim_voxels(limits: SensorLimits, voxel_m: float) -> int:
    """How far a line of sight reaches beside its middle, in voxels, at least one."""
    return max(1, round(narrow(limits).line_width_m / 2 / voxel_m))


def seen_from(
    surface: Bools,
    heights_m: Float32 | None,
    voxel_m: float,
    limits: SensorLimits,
    pieces: NDArray[np.int32],
    to_camera: Float64,
) -> Int64:
    """How many voxels of each piece could be seen along each direction.

    Args:
        surface: as for `look`.
        heights_m: as for `look`.
        voxel_m: edge of a voxel, metres.
        limits: of the sensor.
        pieces: number of each voxel's piece, from 1 on, or 0.
        to_camera: (n, 3) unit vectors, upright frame.

    Returns:
        (n, k + 1), k the number of pieces.
    """
    return count_seen(line_space(surface, heights_m, voxel_m, narrow(limits)), to_camera, pieces)
