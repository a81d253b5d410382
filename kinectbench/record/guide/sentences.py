"""The guide's sentences: one at a time, chosen by a fixed rule from the observations until now.

The first condition that holds decides: the camera is lost; it moves too fast; the object is not known yet;
the camera is too near, or too far away; a sector of the ring around the object is unseen from every height;
much is unseen, and a sector was not seen from a high position; an opening was not looked into; openings are
left, and a sector was not seen from a low or a high position; enough was seen. A sentence stays for at least
five seconds, unless the camera is lost.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from kinectbench.core.types import Bools, Float64, Int64
from kinectbench.stages.segment.judge.frontiers import Frontier
from kinectbench.stages.track.odometry import KEYFRAME_SHIFT, KEYFRAME_TURN_RAD

Kind = Literal[
    "begin", "lost", "slower", "nearer", "farther", "left", "right", "higher", "lower", "top", "enough"
]

# Directions from the object: sectors of 30 degrees seen from above, and three ranges of elevation.
SECTORS, HEIGHT_EDGES_RAD = 12, tuple(np.radians([15.0, 45.0]))
HEIGHTS = ("low", "middle", "high")
# A direction counts as seen after this many frames: a tenth of a second at 30 Hz.
FRAMES_ENOUGH = 3
# Too fast means a new keyframe (`stages.track.odometry`) in less than a third of a second. The tracker of a
# build still follows beyond that, but pictures blur, and frames overlap less than a loop closure needs.
FASTEST_SHIFT_PER_S, FASTEST_TURN_RAD_PER_S = 3 * KEYFRAME_SHIFT, 3 * KEYFRAME_TURN_RAD
# Distances as multiples of the distance from which a ball around the object just fits into the picture.
# Nobody is sent nearer than the minimum range of a Kinect (0.5 m, with a margin).
TOO_NEAR, TOO_FAR, LEAST_DISTANCE_M, MARGIN_M = 0.7, 2.0, 0.6, 0.2
# A camera within this angle of an opening's best viewing direction looked into it. After this many keyframes
# of this kind, what is still unseen there cannot be seen (chosen by hand).
LOOKED_RAD, LOOKED_ENOUGH = np.radians(20.0), 2
# A camera within these angles of a direction has reached it (chosen by hand: half a sector, and a third of a
# height).
THERE_TURN_RAD, THERE_RISE_RAD = np.radians(15.0), np.radians(10.0)
# Angle by which the way to an opening goes beyond it, so that two keyframes look into it (chosen by hand).
BEYOND_RAD = np.radians(10.0)
# For a steeper opening nobody has to walk around the object: the camera looks into it from any side.
STEEP_RAD = np.radians(60.0)
# A camera is held at least this high above the floor. An underside that it would see at a flatter angle than
# the second value is skipped: rays would graze it (chosen by hand).
LOWEST_M, LOOKS_UP_RAD = 0.2, np.radians(5.0)
# Voxels that no frame saw, though a camera could, as a share of the solid's volume: with less, it is enough.
# Chosen here: twice a layer of voxels around a bottle, which is unseen by chance (`guided_walk.py`).
LITTLE_UNKNOWN = 0.02
# A sentence stays at least this long, and the next must have held for this long before it is shown. While the
# camera is lost, changes are shown at once: no other sentence helps then.
STAYS_S, HOLDS_S = 5.0, 0.5


class Advice(NamedTuple):
    """A sentence, and the motion that it asks for.

    Attributes:
        kind: the motion asked for, such as "left", or the statement made, such as "lost".
        sentence: one line.
        distance_m: for `nearer` and `farther`, the distance from the middle of the object at which to stop,
            metres, as in the sentence; else None.
        turn_rad: angle to go `left` or `right` around the object to look into the opening; None: go on until
            the advice changes.
        rise_rad: angle to go up or down around the object for `higher`, `top`, `lower`; None: go on until the
            advice changes.
    """

    kind: Kind
    sentence: str
    distance_m: float | None = None
    turn_rad: float | None = None
    rise_rad: float | None = None


class Ring:
    """Counts the frames that saw the object, by the direction from which they saw it.

    Attributes:
        frames: (12, 3) number of frames from each sector (counterclockwise from the floor's x axis) and
            height (low, middle, high).
    """

    def __init__(self) -> None:
        """Start without frames."""
        self.frames: Int64 = np.zeros((SECTORS, len(HEIGHTS)), np.int64)

    def add(self, towards_rad: float, rise_rad: float) -> None:
        """Add a frame seen from a direction: azimuth and elevation around the object, radians."""
        self.frames[sector_of(towards_rad), height_of(rise_rad)] += 1

    @property
    def unseen_rad(self) -> Float64:
        """Centres (n,) of the sectors that are unseen from every height, radians."""
        return _middles_rad(np.asarray((self.frames < FRAMES_ENOUGH).all(axis=1)))


@dataclass(frozen=True)
class Situation:
    """The camera's state and the observations until now; lengths in metres, floor frame.

    Attributes:
        lost: whether the camera has no pose.
        shift_per_s: speed of the camera relative to its distance from the object, 1/s.
        turn_rad_per_s: angular speed of the camera.
        position: (3,) position of the camera; None: the object is not known yet.
        center: (3,) centre of the object.
        fits_m: distance from the object at which a ball around it just fits into the picture.
        first_rad: azimuth around the object at which the recording began.
        ring: directions from which the object was seen.
        frontiers: openings to unseen space, which no keyframe looked into, the largest first.
        unknown_share: volume that no frame saw, though a camera could from the side or from above, as a share
            of the solid's.
        positions: (n, 3) positions of the keyframes.
    """

    lost: bool = False
    shift_per_s: float = 0.0
    turn_rad_per_s: float = 0.0
    position: Float64 | None = None
    center: Float64 = field(default_factory=lambda: np.zeros(3))
    fits_m: float = 1.0
    first_rad: float = 0.0
    ring: Ring = field(default_factory=Ring)
    frontiers: Sequence[Frontier] = ()
    unknown_share: float = 0.0
    positions: Float64 = field(default_factory=lambda: np.zeros((0, 3)))


def advice(now: Situation) -> Advice:
    """Choose the advice for a situation: the first condition that holds decides."""
    if now.lost:
        return Advice("lost", "lost: go back to where the picture shows")
    if now.shift_per_s > FASTEST_SHIFT_PER_S or now.turn_rad_per_s > FASTEST_TURN_RAD_PER_S:
        return Advice("slower", "slower")
    if now.position is None:
        return Advice("begin", "point the camera at the object, and go slowly around it")
    distance_m = float(np.linalg.norm(now.position - now.center))
    good_m = round(max(now.fits_m, LEAST_DISTANCE_M + MARGIN_M), 1)
    if distance_m < max(TOO_NEAR * now.fits_m, LEAST_DISTANCE_M):
        return Advice("farther", f"farther, to {good_m:.1f} m", good_m)
    if distance_m > TOO_FAR * max(now.fits_m, LEAST_DISTANCE_M):
        return Advice("nearer", f"nearer, to {good_m:.1f} m", good_m)
    for rule in (_around, _from_high, _into_openings, _at_other_heights):
        found = rule(now, now.position)
        if found is not None:
            return found
    return Advice("enough", "enough")


def directions_of(points: Float64, center: Float64) -> tuple[Float64, Float64]:
    """Return azimuth and elevation (n,) of points (n, 3) around a centre (3,), radians."""
    x, y, z = (points - center).T
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))


def sector_of(towards_rad: float) -> int:
    """Return the sector of the ring, 0 to 11, in which an azimuth (radians) lies."""
    return int(np.floor(towards_rad / (2 * np.pi) * SECTORS)) % SECTORS


def height_of(rise_rad: float) -> int:
    """Return the height of the ring, 0 to 2, in which an elevation (radians) lies."""
    return int(np.searchsorted(HEIGHT_EDGES_RAD, rise_rad))


def _middles_rad(sectors: Bools) -> Float64:
    return np.asarray((np.flatnonzero(sectors) + 0.5) * 2 * np.pi / SECTORS)


def _around(now: Situation, position: Float64) -> Advice | None:
    """Return advice to go to the nearest unseen sector; None if every sector was seen."""
    unseen_rad = now.ring.unseen_rad
    if not len(unseen_rad):
        return None
    towards_rad, _ = directions_of(position[None], now.center)
    return _to_nearest(unseen_rad, float(towards_rad[0]), now.first_rad, "is unseen")


def _into_openings(now: Situation, position: Float64) -> Advice | None:
    """Return advice to look into the largest opening that fewer than two keyframes looked into; else None."""
    for each in now.frontiers:
        center, rise_rad = np.array(each.center_m), _rise_rad(each, now.fits_m)
        if each.obstructed or rise_rad is None or _was_looked_into(each, rise_rad, now.positions):
            continue
        look = np.array(each.look_from)
        towards_rad, at_rad = (float(values[0]) for values in directions_of(position[None], center))
        turn_rad = float(_wrapped(np.arctan2(look[1], look[0]) - towards_rad))
        at_top, too_high = each.direction == "up", at_rad - rise_rad > THERE_RISE_RAD
        too_low = rise_rad - at_rad > THERE_RISE_RAD
        # Tops and undersides can be seen from any side, so the camera goes up or down first.
        first = (at_top and too_low) or (each.underside and too_high)
        if rise_rad < STEEP_RAD and abs(turn_rad) > THERE_TURN_RAD and not first:
            side = _side(towards_rad + turn_rad, now.first_rad)
            where = "the top" if at_top else side
            return _sideways(turn_rad, f"an opening at {where} is unseen", abs(turn_rad) + BEYOND_RAD)
        to_go_rad = abs(rise_rad - at_rad)
        if too_low:
            if at_top:
                return Advice("top", "look into the opening at the top", rise_rad=to_go_rad)
            sentence = "hold the camera higher: an opening at the side is unseen"
            return Advice("higher", sentence, rise_rad=to_go_rad)
        if too_high and not at_top:
            below = "what lies below is unseen" if rise_rad < 0 else "an opening at the side is unseen"
            return Advice("lower", f"hold the camera lower: {below}", rise_rad=to_go_rad)
    return None


def _from_high(now: Situation, position: Float64) -> Advice | None:
    """If much is unseen that a camera could see level or from above, ask for a round from high; else None."""
    return (
        _around_at(now, position, len(HEIGHTS) - 1, "higher") if now.unknown_share > LITTLE_UNKNOWN else None
    )


def _at_other_heights(now: Situation, position: Float64) -> Advice | None:
    """If openings are left or much is unseen, ask for another round, first low, then high; else None."""
    closed = all(each.obstructed or _rise_rad(each, now.fits_m) is None for each in now.frontiers)
    if closed and now.unknown_share <= LITTLE_UNKNOWN:
        return None
    lowest_rad = float(np.arcsin(np.clip((LOWEST_M - now.center[2]) / now.fits_m, -1, 1)))
    too_low = lowest_rad > HEIGHT_EDGES_RAD[0] - THERE_RISE_RAD
    low = None if too_low else _around_at(now, position, 0, "lower")
    return low or _around_at(now, position, len(HEIGHTS) - 1, "higher")


def _around_at(now: Situation, position: Float64, height: int, kind: Kind) -> Advice | None:
    """Ask for a round at a height (of `HEIGHTS`); None if each sector was seen from there."""
    unseen_rad = _middles_rad(now.ring.frames[:, height] < FRAMES_ENOUGH)
    if not len(unseen_rad):
        return None
    towards_rad, at_rad = (float(values[0]) for values in directions_of(position[None], now.center))
    if height_of(at_rad) != height:
        return Advice(kind, f"hold the camera {kind}, and go around once more")
    return _to_nearest(unseen_rad, towards_rad, now.first_rad, f"is unseen from {HEIGHTS[height]}")


def _rise_rad(each: Frontier, fits_m: float) -> float | None:
    """Return the elevation from which to look into an opening from `fits_m` away; None if that is too low.

    The result is at most 60 degrees. A camera has to stay above the floor: if the best elevation is lower,
    the result is the lowest possible one, unless an underside would be seen at too flat an angle from there.
    """
    lowest_rad = float(np.arcsin(np.clip((LOWEST_M - each.center_m[2]) / fits_m, -1, 1)))
    best_rad = float(np.arcsin(np.clip(each.look_from[2], -1, 1)))
    if each.underside and best_rad < -LOOKS_UP_RAD < lowest_rad:
        return None
    return float(min(max(best_rad, lowest_rad), STEEP_RAD))


def _was_looked_into(each: Frontier, rise_rad: float, positions: Float64) -> bool:
    """Return whether two or more keyframes looked into an opening.

    They lie near its viewing direction: the azimuth of `look_from`, and the elevation `rise_rad`.
    """
    if not len(positions):
        return False
    towards_rad, at_rad = directions_of(positions, np.array(each.center_m))
    turned = np.abs(_wrapped(towards_rad - np.arctan2(each.look_from[1], each.look_from[0])))
    there = at_rad > rise_rad - LOOKED_RAD
    if rise_rad < STEEP_RAD:
        there &= (at_rad < rise_rad + LOOKED_RAD) & (turned < LOOKED_RAD)
    return int(there.sum()) >= LOOKED_ENOUGH


def _to_nearest(unseen_rad: Float64, towards_rad: float, first_rad: float, why: str) -> Advice:
    """Return advice to go from azimuth `towards_rad` to the nearest one in `unseen_rad`.

    The sentence names the side of the object, relative to the azimuth `first_rad` at which the recording
    began, and ends in `why`, such as "is unseen".
    """
    turns_rad = _wrapped(unseen_rad - towards_rad)
    nearest = int(np.argmin(np.abs(turns_rad)))
    return _sideways(float(turns_rad[nearest]), f"{_side(float(unseen_rad[nearest]), first_rad)} {why}")


def _sideways(turn_rad: float, why: str, to_go_rad: float | None = None) -> Advice:
    """Return advice to go right or left around the object, by `to_go_rad` (None: until the advice changes).

    It is right for `turn_rad` > 0, which is counterclockwise from above. `why` ends the sentence.
    """
    kind: Kind = "right" if turn_rad > 0 else "left"
    return Advice(kind, f"go {kind}: {why}", turn_rad=to_go_rad)


def _side(towards_rad: float, first_rad: float) -> str:
    """Return the name of the object's side at azimuth `towards_rad`; "the front" is at `first_rad`."""
    quarter = round(float(_wrapped(towards_rad - first_rad)) / (np.pi / 2)) % 4
    return ("the front", "the right side", "the back", "the left side")[quarter]


def _wrapped(angle_rad: Float64 | float) -> Float64:
    return np.asarray(np.angle(np.exp(1j * np.asarray(angle_rad))))


class Speaker:
    """Chooses the shown sentence; it changes at most every five seconds, unless the camera is lost."""

    def __init__(self) -> None:
        """Start without a sentence."""
        self.said: Advice | None = None
        self._since_s = -np.inf
        self._other: tuple[str, float] | None = None

    def hear(self, heard: Advice, now_s: float) -> Advice:
        """Return the sentence to show at `now_s` (increasing, seconds), given the current advice `heard`."""
        if self.said is None:
            self.said, self._since_s = heard, now_s
        if heard.sentence == self.said.sentence:
            self.said, self._other = heard, None  # its distances may have changed
        elif self._other is None or self._other[0] != heard.sentence:
            self._other = heard.sentence, now_s
        elif now_s - self._other[1] >= HOLDS_S and now_s - self._since_s >= self._stays_s(heard):
            self.said, self._since_s, self._other = heard, now_s, None
        return self.said

    def _stays_s(self, heard: Advice) -> float:
        """Return how long the shown sentence stays before `heard` may replace it, seconds."""
        return 0.0 if self.said is not None and "lost" in (self.said.kind, heard.kind) else STAYS_S
