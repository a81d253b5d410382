"""Compute the share of a closed mesh outside the scored cube."""

from collections.abc import Iterator

import numpy as np

from kinectbench.core.types import Float64, Int32

# Number of triangles processed at a time; with their pieces they take some 30 MB.
AT_ONCE = 1 << 16


def outside_share(vertices: Float64, faces: Int32, side: float) -> float:
    """Return the exact share of a closed mesh's volume that lies outside the cube [0, side]^3.

    The volume is the integral of the height z over the faces, projected along z; each face counts with the
    sign of its normal's z. For the part inside, faces are cut at the cube's walls, and heights are clipped to
    [0, side].

    Args:
        vertices: (n, 3) float64, in any unit.
        faces: (m, 3) int32, all oriented outwards or all inwards.
        side: the cube's side, in the same unit.

    Returns:
        A share from 0 to 1; 1 if the mesh has no volume.

    Source: the divergence theorem. A volume that several surfaces enclose counts once for each of them.
    """
    inside = whole = 0.0
    beyond = np.asarray(((vertices < 0) | (vertices > side)).any(axis=1))
    leaves = np.asarray(beyond[faces].any(axis=1))
    for begin in range(0, len(faces), AT_ONCE):
        triangles = vertices[faces[begin : begin + AT_ONCE]]
        under = _areas(triangles) * _mean(triangles[:, :, 2])
        whole += float(under.sum())
        inside += float(under[~leaves[begin : begin + AT_ONCE]].sum())
        for piece in _within_walls(triangles[leaves[begin : begin + AT_ONCE]], side):
            inside += float((_areas(piece) * _mean(np.clip(piece[:, :, 2], 0, side))).sum())
    return 1.0 if whole == 0 else float(np.clip(1 - inside / whole, 0, 1))


def _mean(heights: Float64) -> Float64:
    """Return each row's mean: (k, 3) to (k,). `numpy.mean` takes three times as long on so short an axis."""
    mean: Float64 = (heights[:, 0] + heights[:, 1] + heights[:, 2]) / 3
    return mean


def _areas(triangles: Float64) -> Float64:
    """Return the signed areas (k,) of triangles (k, 3, 3), projected along z."""
    a, b = (triangles[:, corner, :2] - triangles[:, 0, :2] for corner in (1, 2))
    areas: Float64 = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    return areas


def _within_walls(triangles: Float64, side: float) -> Iterator[Float64]:
    """Clip triangles to 0 <= x, y <= side; yield them in pieces that cross neither z = 0 nor z = side."""
    for axis in (0, 1):
        triangles = _cut(_cut(triangles, axis, 0)[1], axis, side)[0]
    below, above = _cut(triangles, 2, 0)
    yield below
    yield from _cut(above, 2, side)


def _cut(triangles: Float64, axis: int, at: float) -> tuple[Float64, Float64]:
    """Cut triangles (k, 3, 3) where coordinate `axis` equals `at`; return the pieces below and above."""
    height = triangles[:, :, axis] - at
    up, down = height > 0, height < 0
    count = np.add(np.add(up[:, 0], up[:, 1], dtype=np.int8), up[:, 2])
    mixed = (count > 0) & (down[:, 0] | down[:, 1] | down[:, 2])
    if not mixed.any():
        return triangles[count == 0], triangles[count > 0]
    below, above = triangles[~mixed & (count == 0)], triangles[~mixed & (count > 0)]
    # The corner that is alone on its side comes first; the orientation is kept.
    one_up = count[mixed] == 1
    alone = np.where(one_up, up[mixed].argmax(axis=1), up[mixed].argmin(axis=1))
    order = (alone[:, None] + np.arange(3)) % 3
    rows = np.arange(len(order))[:, None]
    corners, heights = triangles[mixed][rows, order], height[mixed][rows, order]
    a, b, c = (corners[:, n] for n in range(3))
    p, q = (
        a + (end - a) * (heights[:, :1] / (heights[:, :1] - heights[:, [n]])) for n, end in ((1, b), (2, c))
    )
    tip = np.stack([a, p, q], axis=1)
    remainder = np.concatenate([np.stack([p, b, c], axis=1), np.stack([p, c, q], axis=1)])
    twice = np.concatenate([one_up, one_up])
    return (
        np.concatenate([below, tip[~one_up], remainder[twice]]),
        np.concatenate([above, tip[one_up], remainder[~twice]]),
    )
