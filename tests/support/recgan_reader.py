"""How readers of the paper authors' files load them, written anew from their description."""

import io

import numpy as np


def theirs(content: bytes) -> np.ndarray:
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        assert archive.files == ["arr_0"]
        cells: np.ndarray = archive["arr_0"]
    assert cells.dtype == np.int8 and cells.ndim == 4 and cells.shape[3] == 1
    assert set(np.unique(cells)) <= {0, 1}
    return cells


def load(content: bytes) -> np.ndarray:
    """How readers of these files centre them in 256: pad in front (256 - d) // 2, crop (d - 256) // 2."""
    cells = theirs(content)[..., 0]
    cube = np.zeros((256, 256, 256), np.int8)
    source, target = [], []
    for d in cells.shape:
        crop, pad = max(0, (d - 256) // 2), max(0, (256 - d) // 2)
        count = min(d, 256)
        source.append(slice(crop, crop + count))
        target.append(slice(pad, pad + count))
    cube[tuple(target)] = cells[tuple(source)]
    return cube


def block_maximum(cells: np.ndarray) -> np.ndarray:
    maximum: np.ndarray = cells.reshape(64, 4, 64, 4, 64, 4).max(axis=(1, 3, 5))
    return maximum


def centring_shift(full: np.ndarray) -> tuple[int, ...]:
    """By how many of our cells their centring moves a shape along our x, y, z."""
    shift = []
    for axis, others in enumerate(((1, 2), (0, 2), (0, 1))):
        used = np.flatnonzero(full.any(axis=others))
        count = int(used[-1] - used[0]) + 1
        pad = (256 - count) // 2
        first = 256 - pad - count if axis < 2 else pad  # x and y are counted from the other end
        shift.append(first - int(used[0]))
    return tuple(shift)
