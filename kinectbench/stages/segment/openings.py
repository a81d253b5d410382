"""What no camera saw and lies open to free space, through an opening above, beside or below it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Bools
from kinectbench.stages.segment.morphology import broad, opened
from kinectbench.stages.segment.rays import BEYOND, INSIDE, NEUTRAL, OUTSIDE, SEALED, UNSEEN, tally_rays

# An opening is one if a cube of this edge passes, or of so many widths of the frames' rays if that is less:
# farther into a narrower one no sensor sees. At 1.6 m a Kinect's ray is 3 mm wide (own choice).
OPENING_M, OPENING_RAYS = 0.03, 10.0
# Rings, feet and edges lift what stands on the floor by up to 30 mm that nobody sees: up to this height above
# the floor one is more than 10 mm below such a bottom (own choice).
STAND_M = 0.02
# Where so many of the nine directions upwards lead outside in a whole such cube, it is a cavity. Cracks are
# open in three at most.
WIDE_OPEN_ABOVE = 4
# What is thicker than a seat, ends in free air below, and hangs at least as high above what is next as it is
# wide: cameras could have looked up into it, and it may be the shade of a lamp (own choices).
HUNG_M, HUNG_WIDTHS, HUNG_COLUMNS = 0.2, 1.0, 0.5
# A room is air that a cube of this edge fits into, with surface around it in so many of the eight horizontal
# directions and above it in so many of the nine upward ones: without these the air below a chair would be
# one, and half of the chair unknown. Cubes of 40 to 90 mm do equally well.
ROOM_M, ROOM_SIDES, ROOM_ROOFS = 0.06, 5, 5
# A doorway is a share of a room's boundary in this range: .03 to .09 in kennels, .32 to .39 in compartments
# of bookshelves, cabinets and refrigerators, which are no rooms; without one it was not looked into.
ROOM_DOORWAY = (0.01, 0.2)
# What lies around its corners is at most so many times as large as the room (.3 to 1.7 in kennels): what is
# larger is the closed body that the room is a niche of, and of which nobody saw the niche's ceiling.
ROOM_AROUND = 3.0


class Openings(NamedTuple):
    """What lies open to free space; arrays of the grid's shape.

    Attributes:
        open: bool, free space lies above or beside it through an opening that nobody looked into.
        ups: uint8, of open voxels, how many of the nine directions upwards lead to where it was seen empty.
        levels: uint8, how many of the eight horizontal ones do.
        downs: uint8, how many of the nine directions downwards do, narrow openings counted.
        cavity: bool, of these, what lies in a region that is wide open above.
        hung: bool, of these, what is open below and belongs to a thick body that hangs high in the air.
        room: bool, the air in rooms, of which frames saw a part through a doorway.
    """

    open: Bools
    ups: NDArray[np.uint8]
    levels: NDArray[np.uint8]
    downs: NDArray[np.uint8]
    cavity: Bools
    hung: Bools
    room: Bools


def find_openings(
    state: NDArray[np.uint8],
    unseen: Bools,
    behind: Bools,
    deep: Bools,
    contact: slice,
    voxel_m: float,
    cells: int,
) -> Openings:
    """What of the unseen, and of what is deep behind a surface, lies open to free space.

    Args:
        state: as for `tally_rays`; INSIDE as far as depth was fused.
        unseen: bool.
        behind: bool, just behind a surface.
        deep: bool, of these, farther behind than a thin wall's thickness: the surface says nothing there.
        contact: the layers right above the floor.
        voxel_m: edge of a voxel, metres.
        cells: edge of the cube that passes through an opening.
    """
    state = np.where(deep & (state == INSIDE), np.uint8(UNSEEN), state)
    state[_sealed(state, cells)] = SEALED
    rays = tally_rays(state)
    ups, levels = rays.up(OUTSIDE, BEYOND), rays.level(OUTSIDE, BEYOND)
    is_open = (unseen | deep) & ((ups > 0) | (levels > 0))
    cavity = _cavity(is_open & (ups > 0), rays.up(OUTSIDE), cells)
    is_open |= (unseen | deep) & _beside_cavity(state, cavity, cells)
    room = _room(state, levels, voxel_m)
    is_open |= (unseen | deep) & _around(state, room, cells)
    downs = rays.down(OUTSIDE, SEALED, BEYOND)
    hung = _hung((unseen | deep) & (downs > 0), state, contact, voxel_m, cells)
    is_open |= hung
    # Next to the floor nothing was measured: what stands above goes on down to it.
    is_open[:, :, contact] = is_open[:, :, contact.stop, None] & (unseen | deep)[:, :, contact]
    # It may stand on its edges.
    near_floor = slice(contact.start, contact.start + round(STAND_M / voxel_m))
    untold = (unseen & ~behind) | deep
    is_open[:, :, near_floor] |= opened(untold[:, :, near_floor], (cells, cells, 1))
    return Openings(is_open, ups, levels, downs, cavity, hung, room)


def _cavity(open_above: Bools, ups: NDArray[np.uint8], cells: int) -> Bools:
    """What of the voxels that are open above lies in a region that is wide open there (own rule).

    A crack between cushions leads into a body, the mouth of a bin into a cavity. Just below a mouth most
    directions upwards lead outside; below a crack most meet its sides, and few voxels see it.

    Args:
        open_above: bool.
        ups: uint8, how many of nine directions upwards lead outside.
        cells: edge of the cube that passes through an opening.
    """
    from scipy import ndimage

    region = broad(open_above, cells)
    pieces, count = ndimage.label(region)
    held = np.zeros(count + 1, dtype=bool)
    held[pieces[broad(region & (ups >= WIDE_OPEN_ABOVE), cells)]] = True
    held[0] = False
    cavity: Bools = held[pieces]
    return cavity


def _hung(open_below: Bools, state: NDArray[np.uint8], contact: slice, voxel_m: float, cells: int) -> Bools:
    """What of the voxels that are open below belongs to a thick body that hangs high in the air (own rule).

    From above the shade of a lamp looks like a body. A seat is thinner, and cameras that stand around a couch
    could not have looked up into it.

    Args:
        open_below: bool, unseen, or deep behind a surface.
        state: of each voxel, SEALED told apart.
        contact: the layers right above the floor.
        voxel_m: edge of a voxel, metres.
        cells: edge of the cube that passes through an opening.
    """
    from scipy import ndimage

    region = broad(open_below, cells)
    pieces, _ = ndimage.label(region, np.ones((3, 3, 3)))
    hung = np.zeros_like(region)
    for number, (x, y, z) in enumerate(ndimage.find_objects(pieces), start=1):
        if (z.stop - z.start) * voxel_m <= HUNG_M or z.start <= contact.stop:
            continue
        piece = pieces[x, y, z] == number
        columns = piece.any(axis=2)
        lowest = z.start + piece.argmax(axis=2)[columns]
        beneath = state[x, y][columns]
        at = np.arange(len(lowest))
        ends = np.isin(beneath[at, lowest - 1], (OUTSIDE, SEALED))
        inside = (beneath == INSIDE) & (np.arange(beneath.shape[1]) < lowest[:, None])
        # Down to the object's next surface, or to the floor.
        next_below = np.where(
            inside.any(axis=1), beneath.shape[1] - 1 - inside[:, ::-1].argmax(axis=1), contact.start - 1
        )
        if ends.sum() < HUNG_COLUMNS * len(ends) or not ends.any():
            continue
        gap_m = float(np.median((lowest - 1 - next_below)[ends])) * voxel_m
        thick_m = float(np.quantile(piece.sum(axis=2)[columns][ends], 0.9)) * voxel_m
        if thick_m > HUNG_M and gap_m >= HUNG_WIDTHS * np.sqrt(ends.sum()) * voxel_m:
            hung[x, y, z] |= piece
    return hung


def _beside_cavity(state: NDArray[np.uint8], cavity: Bools, cells: int) -> Bools:
    """What is unseen and lies open above or beside to a cavity, as the toe of a shoe: bool."""
    if not cavity.any():
        return cavity
    rays = tally_rays(np.where(cavity, np.uint8(OUTSIDE), state))
    near = (state == UNSEEN) & ~cavity & ((rays.up(OUTSIDE) > 0) | (rays.level(OUTSIDE) > 0))
    return broad(near, max(1, cells // 2))


def _room(state: NDArray[np.uint8], levels: NDArray[np.uint8], voxel_m: float) -> Bools:
    """The air in rooms: surface lies around it and above it, and a small doorway leads to it (own rule).

    Args:
        state: of each voxel, SEALED told apart.
        levels: uint8, how many of eight horizontal directions lead outside.
        voxel_m: edge of a voxel, metres.
    """
    from scipy import ndimage

    walls = np.isin(state, (INSIDE, NEUTRAL))
    around = tally_rays(np.where(walls, state, np.uint8(UNSEEN)))
    air = (state == OUTSIDE) | ((state == UNSEEN) & (levels > 0))
    air &= (around.level(INSIDE) >= ROOM_SIDES) & (around.up(INSIDE) >= ROOM_ROOFS)
    pieces, count = ndimage.label(broad(air, max(1, round(ROOM_M / voxel_m))))
    outside = np.isin(state, (OUTSIDE, SEALED))
    doorway, around_it = (_faces(pieces, count, cells) for cells in (outside, np.ones_like(outside)))
    held = (doorway > ROOM_DOORWAY[0] * around_it) & (doorway < ROOM_DOORWAY[1] * around_it)
    held[0] = False
    room: Bools = held[pieces]
    return room


def _faces(pieces: NDArray[np.int32], count: int, beside: Bools) -> NDArray[np.int64]:
    """How many faces of each piece, from 0 to `count`, touch other voxels of a mask: (count + 1,)."""
    faces = np.zeros(count + 1, np.int64)
    for axis in range(3):
        along = np.moveaxis(pieces, axis, 0), np.moveaxis(beside, axis, 0)
        for own, other in ((slice(1, None), slice(None, -1)), (slice(None, -1), slice(1, None))):
            touched = along[1][other] & (along[0][own] != along[0][other])
            faces += np.bincount(along[0][own][touched], minlength=count + 1)
    return faces


def _around(state: NDArray[np.uint8], room: Bools, cells: int) -> Bools:
    """What is unseen and in sight of the air in a room, below it, beside it or straight above it.

    No ray leads straight outside from the corners of a kennel, and yet nothing separates them from the air in
    its middle. Nobody sees a room's ceiling from above: obliquely through it one would look into all closed
    parts of a cabinet. Known and wrong of three kennels are .42 % at most, .10 % if that counted.
    """
    from scipy import ndimage

    if not room.any():
        return room
    state = np.where(room, np.uint8(OUTSIDE), np.where(state == OUTSIDE, np.uint8(SEALED), state))
    rays = tally_rays(state)
    near = (rays.up(OUTSIDE) > 0) | (rays.level(OUTSIDE) > 0)
    unseen, below = state == UNSEEN, room[:, :, 0]
    for layer in range(1, state.shape[2]):
        below = np.where(unseen[:, :, layer], below, room[:, :, layer])
        near[:, :, layer] |= below
    around = broad(unseen & near, cells)
    pieces, count = ndimage.label(room | around)
    sizes, rooms = (np.bincount(pieces[mask], minlength=count + 1) for mask in (around & ~room, room))
    small = sizes <= ROOM_AROUND * rooms
    small[0] = False
    kept: Bools = around & small[pieces]
    return kept


def opening_cells(ray_width_m: float, voxel_m: float) -> int:
    """Edge of the cube that passes through an opening, in voxels of an edge in metres, at least one.

    Args:
        ray_width_m: how wide the frames' rays are at the object, metres; 0 if that is not known.
        voxel_m: edge of a voxel, metres.
    """
    opening_m = min(OPENING_M, OPENING_RAYS * ray_width_m) if ray_width_m > 0 else OPENING_M
    return max(1, round(opening_m / voxel_m))


def _sealed(state: NDArray[np.uint8], cells: int) -> Bools:
    """Seen empty, in an opening between measured surfaces through which no cube of so many cells passes."""
    passable = np.pad(state != INSIDE, cells, constant_values=True)
    wide = opened(passable, (cells, cells, cells))[cells:-cells, cells:-cells, cells:-cells]
    sealed: Bools = (state == OUTSIDE) & ~wide
    return sealed
