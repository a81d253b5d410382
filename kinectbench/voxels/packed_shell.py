"""The surface of a solid on packed bits: the same as `morphology.shell_of`, without unpacking."""

import numba
import numpy as np
from numpy.typing import NDArray


def packed_shell(full: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Occupied cells with an empty 6-neighbour; outside the grid is empty.

    Args:
        full: (nx, ny, nz / 8) uint8, a solid packed along z, most significant bit first.

    Returns:
        The same shape, packed alike.
    """
    return np.asarray(_shell(np.ascontiguousarray(full)))


@numba.njit(cache=True)
def _shell(full):  # type: ignore[no-untyped-def]
    nx, ny, nb = full.shape
    shell = np.zeros_like(full)
    none = np.zeros(nb, np.uint8)
    for i in range(nx):
        for j in range(ny):
            here = full[i, j]
            left = full[i - 1, j] if i > 0 else none
            right = full[i + 1, j] if i < nx - 1 else none
            above = full[i, j - 1] if j > 0 else none
            below = full[i, j + 1] if j < ny - 1 else none
            for b in range(nb):
                bits = np.int64(here[b])
                if bits == 0:
                    continue
                before, after = bits >> 1, bits << 1
                if b > 0:
                    before |= (np.int64(here[b - 1]) & 1) << 7
                if b < nb - 1:
                    after |= np.int64(here[b + 1]) >> 7
                inner = left[b] & right[b] & above[b] & below[b] & before & after
                shell[i, j, b] = bits & ~inner
    return shell
