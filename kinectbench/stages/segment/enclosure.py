"""What a seat or a top hides: hollows behind aprons, and the shadow under the object."""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Bools, Float32
from kinectbench.stages.segment.morphology import opened
from kinectbench.stages.segment.rays import (
    BEYOND,
    INSIDE,
    NEUTRAL,
    OUTSIDE,
    UNSEEN,
    Tally,
    tally_rays,
)

# From so many directions of 26 on what looks like a hollow would otherwise be inside (chosen on furniture).
ENCLOSED = 14.5 / 26
# So many of the 8 horizontal directions enclose what is of the object and not under it.
LEVEL_ENCLOSED = 5
# Under the object a voxel with at most so many enclosing directions of the 17 that do not go up is empty, and
# anywhere one with fewer of 26.
EMPTY_UNDER, EMPTY_BESIDE = 2, 4.5 / 26
# A top juts out over its apron by more than this on all sides; voxels of 5 mm count it in steps.
OVERHANG_M = 0.0045
# A hollow is at least so high and lies no deeper than this under the top, and so many of nine ways down from
# it lead outside.
MIN_HOLLOW_M, MAX_HOLLOW_M, OPEN_BELOW = 0.035, 0.12, 5
# So high at most is what looks like a thick slab and may be a hollow behind flush sides.
MAX_DOUBTFUL_M = 0.2
# So high at least is what of a hollow would else be inside.
MIN_ENCLOSED_HOLLOW_M = 0.015
# Right under a hollow it is open, or as enclosed as behind an apron; above what is half enclosed is none.
OPEN_BENEATH, APRON_BENEATH = 12.5 / 26, 16.5 / 26
# An apron is upright: under the back of an animal or the body of a kettle, which lean in, overhang grows by
# more than this share of the way down, as far below the top as even a low apron reaches.
MAX_LEAN, LEAN_REACH_M = 0.3, 0.025
# The least overhang over the uppermost layer of a hollow, as a share of that over the next one.
FULL_OVERHANG = 0.6
NOT_UNDER = 30_000


@dataclass(frozen=True)
class Hollows:
    """What may be empty under a top; bool, of the grid's shape.

    Attributes:
        sure: behind an apron.
        doubtful: enclosed by flush sides but open below: a thick slab, or a hollow no camera looked into.
    """

    sure: Bools
    doubtful: Bools


def hollows(state: NDArray[np.uint8], tally: Tally, voxel_size_m: float) -> Hollows:
    """Unseen voxels behind an apron: under a top, open from below.

    From no camera above the seat can the space between the aprons of a chair be told from a thick slab: top
    and sides enclose both. But a slab or a cushion is flush, and a top juts out over the apron that it rests
    on. So a voxel is hollow if the outline of some layer above it, within 12 cm, juts out over that of its
    own layer by 5 mm in all of the four directions along the grid, and most of the nine ways down from it
    lead outside. Beside legs, which are flush, three directions are enough if the hollows found so far leave
    the voxel hardly enclosed. The uppermost layer of a hollow must be overhung nearly as far as the one below
    it. What is less than 35 mm high is no hollow, nor what has less than 15 mm that would else be inside:
    cushions are rounded below; nor what is half enclosed beneath, as a cushion in a frame is; nor what
    steps in farther and farther right below its top, as a round body does. What would be a hollow but
    for its flush sides is doubtful, unless its sides go down further than 20 cm from its top, as those of no
    seat do, or a hollow begins under it. Own rule.

    Args:
        state: as for `tally_rays`, nothing SEALED; the grid is upright, its last axis points up.
        tally: of its rays.
        voxel_size_m: edge of a voxel, metres.
    """
    bordered = _bordered(state)
    enclosed = tally.enclosed
    outside = tally.down(OUTSIDE, BEYOND)
    least, second = _overhang(bordered)
    below = _under_inside(bordered)
    overhang, reach, doubtful_reach = (
        int(length_m / voxel_size_m + 1e-6) for length_m in (OVERHANG_M, MAX_HOLLOW_M, MAX_DOUBTFUL_M)
    )
    unseen = state == UNSEEN
    possible = unseen & (below <= reach) & (second > overhang)
    sure = possible & (least > overhang) & (outside >= OPEN_BELOW)
    without_sure = tally_rays(np.where(sure, np.uint8(OUTSIDE), state)).enclosed if sure.any() else enclosed
    found = sure | (possible & (without_sure < ENCLOSED))
    high = (3, 3, max(1, round(MIN_HOLLOW_M / voxel_size_m)))
    open_below = opened(found, high)
    # Where a cushion is rounded below, its lowest layers look like the upper end of the shadow under it.
    high_enclosed = (3, 3, max(1, round(MIN_ENCLOSED_HOLLOW_M / voxel_size_m)))
    filled = opened(found & (enclosed >= ENCLOSED), high_enclosed)
    hollow = open_below & filled.any(axis=2, keepdims=True)
    # Where the outline steps in over two layers, the upper one is still the top's, frayed at its edge.
    frayed = least[:, :, 1:] < FULL_OVERHANG * least[:, :, :-1]
    frayed[:, :, :-1] &= ~hollow[:, :, 2:]
    hollow[:, :, 1:] &= ~frayed
    hollow = _upright(hollow, least, max(3, round(LEAN_REACH_M / voxel_size_m)))
    hollow = _open_beneath(hollow, state, enclosed)
    under = unseen & (below <= doubtful_reach)
    inside = unseen & (without_sure >= ENCLOSED)
    body = (inside & ~under & (below < NOT_UNDER)).any(axis=2, keepdims=True)
    slab = open_below.any(axis=2, keepdims=True)
    flush = inside & under & (outside >= OPEN_BELOW) & ~slab & ~body
    return Hollows(hollow, opened(flush, high))


def _upright(hollow: Bools, overhang: NDArray[np.int16], layers: int) -> Bools:
    """Those of its pieces (26 neighbours) whose overhang hardly grows in so many layers from above."""
    from scipy import ndimage

    if not hollow.any():
        return hollow
    pieces, count = ndimage.label(hollow, np.ones((3, 3, 3)))
    # The uppermost layer of a column may be frayed; below its apron a hollow is a shadow.
    above = np.pad(hollow, [(0, 0), (0, 0), (0, layers)])[:, :, layers:]
    runs = np.lib.stride_tricks.sliding_window_view(hollow, layers, axis=2).all(axis=-1)
    runs &= ~above[:, :, : runs.shape[2]]
    columns = np.nonzero(runs)
    of = pieces[columns]
    lower, upper = overhang[columns], overhang[columns[0], columns[1], columns[2] + layers - 2]
    grows = np.bincount(of, lower - upper, minlength=count + 1)
    upright: Bools = grows <= MAX_LEAN * (layers - 2) * np.bincount(of, minlength=count + 1)
    upright[0] = False
    kept: Bools = upright[pieces]
    return kept


def _open_beneath(hollow: Bools, state: NDArray[np.uint8], enclosed: Float32) -> Bools:
    """Those of its pieces (26 neighbours) under most of whose columns it is open, or the apron goes on."""
    from scipy import ndimage

    pieces, count = ndimage.label(hollow, np.ones((3, 3, 3)))
    lowest = hollow[:, :, 1:] & ~hollow[:, :, :-1]
    half = (enclosed >= OPEN_BENEATH) & (enclosed < APRON_BENEATH)
    shut = (state == INSIDE) | ((state == UNSEEN) & half)
    of = pieces[:, :, 1:][lowest]
    columns = np.bincount(of, minlength=count + 1)
    shut_columns = np.bincount(of, shut[:, :, :-1][lowest], minlength=count + 1)
    is_open = 2 * shut_columns <= columns
    is_open[0] = False
    kept: Bools = is_open[pieces]
    return kept


@dataclass(frozen=True)
class Shadow:
    """Unseen voxels in a shadow of the object; bool, of the grid's shape.

    Attributes:
        under: straight under a part of the object, and not in it.
        empty: there or elsewhere, all but never inside.
    """

    under: Bools
    empty: Bools


def shadow(state: NDArray[np.uint8], tally: Tally) -> Shadow:
    """Unseen voxels in a shadow of the object: hidden by it, but not of it.

    What is of the object is enclosed at its own height, too. So a voxel is under the object if straight up
    one meets it, straight down one does not, of the 8 horizontal directions less than 5 meet it, and one can
    pass: of two opposite ones neither does. It is empty if, of these 8 and the 9 directions downwards, at
    most 2 meet the object, or, wherever it is, fewer than 5 of all 26; and if all others (in the first case
    all horizontal ones) end where it was seen to be empty: what lies beyond the frames' reach stays open. Own
    rule: of 27 simulated objects (seeds 4 to 12), 16 % of what the 26 directions take for inside under the
    object is inside, 7 % of what is called empty there, and 0.1 % of what is called empty elsewhere.

    Args:
        state: as for `tally_rays`, nothing SEALED; the grid is upright.
        tally: of its rays.
    """
    seen_around = np.pad(state, 1, constant_values=NEUTRAL)
    level, level_empty = tally.level(INSIDE), tally.level(OUTSIDE)
    down = tally.down(INSIDE)
    inside, empty = tally.all(INSIDE), tally.all(OUTSIDE)
    overhung = _under_inside(seen_around) < NOT_UNDER
    held = _under_inside(np.ascontiguousarray(seen_around[:, :, ::-1]))[:, :, ::-1] < NOT_UNDER
    beneath = (state == UNSEEN) & overhung & ~held & (level < LEVEL_ENCLOSED)
    under = beneath & _passable(seen_around)
    below = under & (level + down <= EMPTY_UNDER) & (level + level_empty == 8)
    beside = (state == UNSEEN) & (inside + empty == 26) & (tally.enclosed < EMPTY_BESIDE)
    return Shadow(under, below | beside)


def _bordered(state: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """With a layer of OUTSIDE around it."""
    return np.pad(state, 1, constant_values=OUTSIDE)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _passable(state):  # type: ignore[no-untyped-def]
    """Whether of two opposite horizontal directions neither meets INSIDE, without the border."""
    nx, ny, nz = state.shape[0] - 2, state.shape[1] - 2, state.shape[2] - 2
    passable = np.zeros((nx, ny, nz), np.bool_)
    met, blocked = state.copy(), np.zeros((nx, ny, nz), np.bool_)
    for pair in range(4):
        blocked[:] = False
        for way in (-1, 1):
            dx, dy = (1, 0, 1, 1)[pair] * way, (0, 1, 1, -1)[pair] * way
            for a in range(nx):
                i = nx - a if dx > 0 else a + 1
                for b in range(ny):
                    j = ny - b if dy > 0 else b + 1
                    own, into, source = state[i, j], met[i, j], met[i + dx, j + dy]
                    into_blocked = blocked[i - 1, j - 1]
                    for k in range(1, nz + 1):
                        into[k] = source[k] if own[k] == UNSEEN else own[k]
                        into_blocked[k - 1] |= into[k] == INSIDE
        for i in range(nx):
            for j in range(ny):
                for k in range(nz):
                    passable[i, j, k] |= not blocked[i, j, k]
    return passable


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _under_inside(state):  # type: ignore[no-untyped-def]
    """How many voxels below the first INSIDE above it an UNSEEN voxel lies, itself counted; else a lot."""
    nx, ny, nz = state.shape[0] - 2, state.shape[1] - 2, state.shape[2] - 2
    under = np.full((nx, ny, nz), np.int16(NOT_UNDER))
    for i in range(nx):
        for j in range(ny):
            count = NOT_UNDER
            for c in range(nz):
                k = nz - 1 - c
                own = state[i + 1, j + 1, k + 1]
                if own == UNSEEN:
                    count = min(count + 1, NOT_UNDER)
                    under[i, j, k] = count
                else:
                    count = 0 if own == INSIDE else NOT_UNDER
    return under


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _overhang(state):  # type: ignore[no-untyped-def]
    """By how many voxels layers above jut out over a voxel's own: the least of four directions, the second.

    A layer's outline is where one first meets OUTSIDE; the layers above count up to the first OUTSIDE.
    """
    nx, ny, nz = state.shape[0] - 2, state.shape[1] - 2, state.shape[2] - 2
    least = np.full((nx, ny, nz), np.int16(NOT_UNDER))
    second = np.full((nx, ny, nz), np.int16(NOT_UNDER))
    reach = np.zeros((nx + 2, ny + 2, nz), np.int16)
    for direction in range(4):
        dx, dy = (1, 0, -1, 0)[direction], (0, 1, 0, -1)[direction]
        reach[:] = 0
        for a in range(nx):
            i = nx - a if dx > 0 else a + 1
            for b in range(ny):
                j = ny - b if dy > 0 else b + 1
                own, into, source = state[i, j, 1 : nz + 1], reach[i, j], reach[i + dx, j + dy]
                for k in range(nz):
                    into[k] = np.int16(0) if own[k] == OUTSIDE else min(source[k] + 1, NOT_UNDER)
        for i in range(nx):
            for j in range(ny):
                farthest = np.int16(0)
                for c in range(nz):
                    k = nz - 1 - c
                    own_reach = reach[i + 1, j + 1, k]
                    farthest = max(farthest, own_reach) if own_reach > 0 else np.int16(0)
                    juts = farthest - own_reach
                    if juts < least[i, j, k]:
                        least[i, j, k], second[i, j, k] = juts, least[i, j, k]
                    elif juts < second[i, j, k]:
                        second[i, j, k] = juts
    return least, second
