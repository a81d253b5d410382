"""How probable it is that a voxel is inside: counted on simulated objects, by what the frames say of it."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Bools, Float32
from kinectbench.stages.segment.evidence import Evidence

# Counted on the families that may be looked at, each with the same weight; nothing below is from the others.
# How many of the unseen voxels that are not open are inside, by the number of enclosing directions of 26.
# (Of 15 it is 0.23 and of 16 0.40; but they are few, and under seats more than half.)
INTERIOR_SHARE = 15.5 / 26
ENCLOSING = np.array([0, 10, 12, 13, 14, 15, 16, 17, 19, 20, 21, 22, 24, 26], np.float32) / 26
INSIDE_SHARE = np.array(
    [0.0, 0.02, 0.05, 0.08, 0.18, 0.51, 0.55, 0.91, 0.92, 0.95, 0.97, 0.985, 0.995, 0.998], np.float32
)
HOLLOW_INSIDE_SHARE = np.float32(0.1)
# Under the object, and what is all but never inside there and elsewhere (`enclosure.shadow`).
UNDER_INSIDE_SHARE, EMPTY_UNDER_SHARE, EMPTY_BESIDE_SHARE = (np.float32(p) for p in (0.14, 0.01, 0.001))
# Of ten simulated things with flush sides under a seat seven were slabs throughout (seeds 4 to 18).
DOUBTFUL_INSIDE_SHARE = np.float32(0.75)
# How many of the observed voxels are inside, by their signed distance in voxels.
SIGNED_VOXELS = np.array(
    [-4, -3.25, -3, -2.5, -2, -1.5, -1, -0.5, -0.25, 0, 0.25, 0.5, 0.75, 1, 2, 3], np.float32
)
SIGNED_INSIDE_SHARE = np.array(
    [0.94, 0.9, 0.885, 0.94, 0.96, 0.98, 0.985, 0.945, 0.83, 0.5, 0.045, 0.01, 0.003, 0.002, 0.001, 0.0],
    np.float32,
)
# Of what is open and not in a cavity: among sealed voxels, by their share of what was not seen in a
# cube of `AMONG_M`, it is a streak that rays leave in a body.
AMONG_M, AMONG_SHARE = 0.085, np.array([0.2, 0.3, 0.5], np.float32)
AMONG_INSIDE_SHARE = np.array([0.65, 0.91, 0.98], np.float32)
# Elsewhere: below a crack, by how many directions upwards are open; open beside, and beside and below, by how
# many of the eight horizontal directions are; and next to the floor or to a cavity, by no ray of its own. (Of
# what is open beside in two directions or more it is 0.35; in furniture nearly all.)
CRACK_INSIDE_SHARE = np.array([0.55, 0.55, 0.55, 0.55, 0.4, 0.4, 0.4, 0.4, 0.4, 0.4], np.float32)
BESIDE_INSIDE_SHARE = np.array([0.57, 0.7, 0.51, 0.51, 0.51, 0.51, 0.51, 0.51, 0.51], np.float32)
BELOW_INSIDE_SHARE = np.array([0.57, 0.24, 0.15, 0.15, 0.15, 0.15, 0.1, 0.03, 0.01], np.float32)
# It is open below, too, if so many of the nine directions downwards are: most of them (own choice).
OPEN_BELOW = 5
# So far below what a measured surface tells, by how many of the eight horizontal directions are open: most
# boards are thicker than that. Counted on 54 objects of the 27 families looked at (seeds 31 and 32), their
# volumes weighing the same, in the first voxel of 5 mm. (Where three directions are open 0.8; from the fourth
# voxel down, 0.05 to 0.18.)
RIGHT_BELOW_M = 0.005
RIGHT_BELOW_INSIDE_SHARE = np.array([0.91, 0.72, 0.82, 0.8, 0.75, 0.65, 0.65, 0.65, 0.17], np.float32)
# Where rays are no narrower than this, what was measured is itself not known so well, and nothing is said of
# what lies below it (own choice): else a rack's IoU fell from .65 to .61.
RIGHT_BELOW_MAX_RAY_M = 0.005
# In a cavity, by how many of the nine directions upwards are open: its walls are where few are.
CAVITY_INSIDE_SHARE = np.array([0.22, 0.22, 0.19, 0.16, 0.09, 0.08, 0.08, 0.08, 0.04, 0.03], np.float32)

# Of what hangs high in the air and is open below. In the shade of a lamp, the only thing looked at that does,
# 0.05 of it is inside; but a body may hang there, too (own choice).
HUNG_INSIDE_SHARE = np.float32(0.3)


def unseen_probability(evidence: Evidence, voxel_size_m: float) -> Float32:
    """That a voxel is inside, by the directions that enclose it and the rules for shadows and hollows.

    Means something where `unseen` or `hollow` is set.

    Args:
        evidence: what the frames say.
        voxel_size_m: edge of a voxel.
    """
    probability = np.interp(evidence.enclosed, ENCLOSING, INSIDE_SHARE).astype(np.float32)
    under, empty = evidence.shadow.under, evidence.shadow.empty
    for where, share in (
        (under, UNDER_INSIDE_SHARE),
        (under & empty, EMPTY_UNDER_SHARE),
        (empty & ~under, EMPTY_BESIDE_SHARE),
        (evidence.hollows.doubtful & ~evidence.openings.open, DOUBTFUL_INSIDE_SHARE),
    ):
        probability[where] = np.minimum(probability[where], share)
    probability[evidence.hollows.sure] = HOLLOW_INSIDE_SHARE
    is_open = evidence.openings.open
    # Farther behind a surface than a wall is thick, enclosure says nothing.
    enclosed = np.where(evidence.behind[is_open], np.float32(1), probability[is_open])
    probability[is_open] = np.minimum(enclosed, _open_probability(evidence, voxel_size_m))
    right_below = _right_below(evidence, voxel_size_m)
    least = RIGHT_BELOW_INSIDE_SHARE[evidence.openings.levels[right_below]]
    probability[right_below] = np.maximum(probability[right_below], least)
    return probability


def _right_below(evidence: Evidence, voxel_m: float) -> Bools:
    """Voxels open below, not above, and right below what lies just behind a measured surface: bool."""
    told = evidence.behind & ~evidence.openings.open
    below = np.zeros_like(told)
    if evidence.ray_width_m >= RIGHT_BELOW_MAX_RAY_M:
        return below
    for layers in range(1, max(1, round(RIGHT_BELOW_M / voxel_m)) + 1):
        below[:, :, :-layers] |= told[:, :, layers:]
    aside = (
        evidence.openings.cavity
        | evidence.openings.hung
        | (evidence.openings.ups > 0)
        | (evidence.openings.downs < OPEN_BELOW)
    )
    found: Bools = below & evidence.openings.open & ~aside
    return found


def _open_probability(evidence: Evidence, voxel_m: float) -> Float32:
    """Of the open voxels, in their order, (n,) float32."""
    at = evidence.openings.open
    ups, levels, downs = evidence.openings.ups[at], evidence.openings.levels[at], evidence.openings.downs[at]
    beside = np.where(downs >= OPEN_BELOW, BELOW_INSIDE_SHARE[levels], BESIDE_INSIDE_SHARE[levels])
    alone = np.where(ups > 0, CRACK_INSIDE_SHARE[ups], beside)
    among = _among_sealed(evidence, voxel_m)
    of_body = np.where(among < AMONG_SHARE[0], alone, np.interp(among, AMONG_SHARE, AMONG_INSIDE_SHARE))
    of_body = np.where(evidence.openings.hung[at], np.minimum(of_body, HUNG_INSIDE_SHARE), of_body)
    return np.asarray(np.where(evidence.openings.cavity[at], CAVITY_INSIDE_SHARE[ups], of_body), np.float32)


def _among_sealed(evidence: Evidence, voxel_m: float) -> Float32:
    """Of what was not seen in a cube around each open voxel, the share that is sealed: (n,) float32."""
    from scipy import ndimage

    sealed = evidence.unseen & ~evidence.openings.open & (evidence.enclosed >= INTERIOR_SHARE)
    unseen = (evidence.unseen & ~evidence.behind) | evidence.openings.open
    cells = 2 * max(1, round((AMONG_M / voxel_m - 1) / 2)) + 1
    near, all_near = (
        ndimage.uniform_filter(part.astype(np.float32), cells)[evidence.openings.open]
        for part in (sealed, unseen)
    )
    # A running sum leaves a little where there is nothing.
    return np.asarray(near / np.maximum(all_near, np.float32(1e-4)), np.float32)


def measured_probability(signed_m: NDArray[np.floating], voxel_size_m: float) -> Float32:
    """That a voxel next to a measured surface is inside, by its signed distance from it (metres)."""
    voxels = signed_m / np.float32(voxel_size_m)
    return np.asarray(np.interp(voxels, SIGNED_VOXELS, SIGNED_INSIDE_SHARE), np.float32)
