"""What is known before the floor is found: which way is up, and where the cameras look.

Up is known by gravity if that was recorded, else by how people hold cameras.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from kinectbench.core.sequence import Sequence as Recorded
from kinectbench.core.trajectory.association import poses_at
from kinectbench.core.trajectory.coverage import from_above, looked_at, median_middle_depth_m
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Bools, Float64, Int64
from kinectbench.stages.ingest.recording import Recording

# Gravity is not interpolated between given poses that are farther apart; directions change little within it.
MAX_GAP_S = 1.0
# The frames' ups agree if their mean is at least this long: as of unit vectors that are 26 degrees off on
# average (chosen by hand). They disagree where poses are of an object that is turned about.
MIN_AGREEMENT = 0.9
# A plane's normal is up by gravity within 26 degrees: ramps, drift and a sloping yard (chosen by hand).
MIN_GRAVITY_COSINE = 0.9
# It is up within 53 degrees of the cameras' upper edges, or of an edge beside where phones are held upright.
MIN_UP_COSINE = 0.6
# It is up for cameras that look down on it more steeply, at most 37 degrees off.
MIN_DOWN_COSINE = 0.8
# The normal of a wall that is looked at straight on is square to all four edges, or tips to the lower one
# where cameras look down a little. That of a floor looked at from 84 degrees down leans by this much.
MIN_HELD_COSINE = 0.1
# Cosines computed at once: 34 MB, where all of a long recording may be gigabytes.
MOST_COSINES = 1 << 22

# Which of the unit normals (n, 3), world frame, may be those of a floor: (n,) bool.
Facing = Callable[[Float64], Bools]


@dataclass(frozen=True)
class FloorHint:
    """Prior knowledge about the floor.

    Attributes:
        up_world: (3,) unit, up by gravity; None if unknown.
        plane_world: (4,) the plane that the user gave: a, b, c, d with unit (a, b, c) up and a x + b y + c z
            + d = 0, metres; or None.
        middle_depth_m: median depth in the middle of the images, metres, which helps to find the point that
            the cameras look at (`looked_at`); None: that point is where their axes meet.
        picked_world: (3,) a point on the object that the user picked, which replaces the point that the
            cameras look at; or None.
    """

    up_world: Float64 | None = None
    plane_world: Float64 | None = None
    middle_depth_m: float | None = None
    picked_world: Float64 | None = None

    def focus_world(self, T_world_camera: Float64) -> Float64:
        """Return the point (3,) near which to search for the object: the picked point, else the target."""
        if self.picked_world is not None:
            return self.picked_world
        return looked_at(T_world_camera, self.middle_depth_m)


NOTHING_KNOWN = FloorHint()


def floor_hint(
    sequence: Recorded,
    trajectory: Trajectory,
    plane: Sequence[float] | None = None,
    picked_world: Float64 | None = None,
) -> FloorHint:
    """Return the hint of `hint_of`, with the depth in the middle of the images and a picked point added."""
    good = trajectory.good_frames
    hint = hint_of(sequence, sequence.stamps_ns[good], trajectory.T_world_camera[good], plane)
    middle_depth_m = median_middle_depth_m(sequence, good)
    return replace(hint, middle_depth_m=middle_depth_m, picked_world=picked_world)


def hint_of(
    known: Recorded | Recording,
    stamps_ns: Int64,
    T_world_camera: Float64,
    plane: Sequence[float] | None = None,
) -> FloorHint:
    """Make a hint from a recording's gravity and the user's plane, in the world of the poses.

    Gravity is converted to the axes of each camera first, so that it also holds if the given poses were
    refined or replaced. Some drivers give acceleration the opposite sign: measured gravity is ignored if the
    cameras would be upside down.

    Args:
        known: the recording, with its given trajectory, if any.
        stamps_ns: (n,) stamps of the frames with a pose, nanoseconds.
        T_world_camera: (n, 4, 4) their poses.
        plane: the plane (a, b, c, d) that the user gave in that world, its normal of any length but 0.
    """
    plane_world = None if plane is None else np.array(plane) / np.linalg.norm(plane[:3])
    if known.up_world is not None and known.given_trajectory is not None:
        T_given = poses_at(known.given_trajectory, stamps_ns, MAX_GAP_S)
        posed = np.isfinite(T_given[:, 0, 0])
        up_cameras = np.swapaxes(T_given[posed, :3, :3], 1, 2) @ np.array(known.up_world)
        return FloorHint(_up_world(T_world_camera[posed], up_cameras), plane_world)
    up_at = {sample.stamp_ns: sample.up_camera for sample in known.up_cameras}
    measured = [k for k, stamp_ns in enumerate(stamps_ns.tolist()) if stamp_ns in up_at]
    if not measured:
        return FloorHint(None, plane_world)
    T_measured = T_world_camera[measured]
    up_world = _up_world(T_measured, np.array([up_at[int(stamps_ns[k])] for k in measured]))
    if up_world is not None and up_world @ from_above(T_measured)[2] < -MIN_UP_COSINE:
        up_world = None
    return FloorHint(up_world, plane_world)


def _up_world(T_world_camera: Float64, up_cameras: Float64) -> Float64 | None:
    """Average up directions (n, 3), each given in the axes of its camera (n, 4, 4).

    Return a unit vector (3,) in the world, or None if the directions disagree.
    """
    up = (T_world_camera[:, :3, :3] @ up_cameras[:, :, None])[:, :, 0].sum(axis=0)
    length = float(np.linalg.norm(up))
    return up / length if length > MIN_AGREEMENT * len(up_cameras) else None


def up_or_held(T_world_camera: Float64, up_world: Float64 | None) -> Float64:
    """Return up (3,), unit: by gravity if that is known, else as the cameras (n, 4, 4) were held."""
    return from_above(T_world_camera)[2] if up_world is None else up_world


def facings(T_world_camera: Float64, up_world: Float64 | None) -> list[Facing]:
    """Return tests whether a normal may be that of a floor, one per way of holding cameras, likeliest first.

    Args:
        T_world_camera: (n, 4, 4), n > 0.
        up_world: (3,) unit, up by gravity, which gives a single test. If None, there are four: the upper
            edges of the images are up; the right edges or the left edges are up, as with a phone held
            upright; any of these edges is up, but the cameras look down steeply.
    """
    if up_world is not None:
        return [partial(_along, up_world, MIN_GRAVITY_COSINE)]
    right, down = (T_world_camera[:, :3, axis].mean(axis=0) for axis in (0, 1))
    edges = [edge / max(float(np.linalg.norm(edge)), 1e-9) for edge in (-down, right, -right)]
    steep = partial(_looked_down_on, T_world_camera[:, :3, 2], edges)
    return [*(partial(_along, edge, MIN_UP_COSINE) for edge in edges), steep]


def _along(up: Float64, least: float, normals: Float64) -> Bools:
    """Return which unit normals (n, 3) have a cosine above `least` to the direction `up` (3,): (n,) bool."""
    return np.asarray(normals @ up > least)


def _looked_down_on(axes: Float64, edges: Sequence[Float64], normals: Float64) -> Bools:
    """Return which unit normals (n, 3) may belong to a floor seen steeply: (n,) bool.

    Such a normal points towards most cameras and leans towards an image edge. `axes` (m, 3) are the cameras'
    optical axes; `edges` are the directions (3,) of the image edges that may be up.
    """
    parts = np.array_split(normals, 1 + len(normals) * len(axes) // MOST_COSINES)
    against = np.concatenate([np.median(-part @ axes.T, axis=1) for part in parts]) > MIN_DOWN_COSINE
    held: Bools = np.max([normals @ edge for edge in edges], axis=0) > MIN_HELD_COSINE
    return against & held
