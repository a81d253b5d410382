"""The planes that the object may stand on, the evidence for each, and the choice among them."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from kinectbench.core.geometry import ransac_plane, refine, transform_points
from kinectbench.core.types import Bools, Float64
from kinectbench.core.voxels.point_cells import cell_numbers
from kinectbench.stages.segment.find.hints import Facing, facings, up_or_held
from kinectbench.stages.segment.find.planes import (
    MAX_NOISE_M,
    SceneSurface,
    above_m,
    carries_what_is_looked_at,
    floor_frame,
    is_below,
    is_flat,
    refined_near,
    turn_rad,
)

# Planes tried for each way of holding the cameras.
CANDIDATES = 6
# A plane has this share of the points, and this many: the normal of fewer says little (chosen by hand).
MIN_INLIER_SHARE, MIN_PLANE_POINTS = 0.01, 50
# A camera looks down on a plane from this height on. Some do not: poses are off (chosen by hand).
MIN_CAMERA_HEIGHT_M, MIN_ABOVE_SHARE = 0.1, 0.8
# Surface farther below a plane than this many times the distance of its inliers (50 mm) is lower. Far from
# the cameras that distance grows: noise grows with the square of the distance.
BELOW_INLIERS = 2.5
# A point's distance is measured to this many of the cameras, as a search visits all (chosen by hand).
SOME_CAMERAS = 40
# An object hides what is below its support. This much may be seen right below a plane, as a share of the
# plane's own points. Measured: floors and tables 0 to .02, a table of a noisy recording .13; the tops of
# tables, beds, couches and chairs on a floor without depth .21 to 2.4, of a box that hovers 6.4.
MAX_UNDER_SHARE = 0.17
# Weights of the evidence by how the cameras are held: mostly with the upper edge up, more rarely on their
# left or right side, seldom looking steeply down (chosen by hand).
FACING_WEIGHTS = (1.0, 0.2, 0.2, 0.02)
# A person is warned if a smaller share of the cameras looks down on the chosen plane, if a larger share of
# the surface lies lower, or if another plane has this share of its evidence (chosen by hand).
REPORTED_ABOVE_SHARE, REPORTED_BELOW_SHARE, REPORTED_RIVAL = 0.95, 0.05, 0.5
# A refused plane is reported if it has this many times the evidence of the chosen one; the second number is
# for parallel planes, as the top of a table and the floor about it are (chosen by hand).
REPORTED_REFUSED, REPORTED_REFUSED_PARALLEL = 1.0, 5.0
# Planes whose normals differ by less are one floor, or parallel (chosen by hand).
SAME_DEG = 15.0
TAKEN = "the plane that was taken for the floor"
GIVE = "if that is not what the object stands on, give its plane: `floor: {plane_world: [a, b, c, d]}`"

Reason = Literal["", "turned", "cameras", "clutter", "top", "less", "lower", "higher"]
# Why a plane is not the floor: the first three hold by themselves, the others mean that another one is.
REASONS: dict[Reason, str] = {
    "turned": "its normal is not up, however the cameras were held",
    "cameras": "too few of the cameras look down on it",
    "clutter": "what lies about it scatters: it cuts through several things",
    "top": "much is seen right below it: it is the top of something",
    "less": "less speaks for it than for another plane",
    "lower": "a plane parallel to it lies lower",
    "higher": "what the cameras look at stands on a higher plane",
}
NEVER: tuple[Reason, ...] = ("turned", "cameras", "clutter")
# Reasons that rest on a limit, which a plane may miss by little.
BY_A_LIMIT: tuple[Reason, ...] = ("cameras", "clutter", "top")


@dataclass(frozen=True)
class PlaneCandidate:
    """A plane of the scene that the object may stand on.

    Attributes:
        plane: (4,), its unit normal up.
        points: number of points of the surface on it.
        inlier_share: share of the surface on it.
        above_share: share of the cameras that lie more than 0.1 m above it.
        below_share: share of the surface that lies below the plane.
        under_share: points right below the plane's own area, divided by the points on it.
        tilt_rad: angle between its normal and up, radians; up is by gravity, or else as the cameras were
            held.
        way: index in `facings` of the way of holding cameras for which its normal is up; 0: the usual way.
        reason: why it was not chosen; "" if it was.
    """

    plane: Float64
    points: int
    inlier_share: float
    above_share: float
    below_share: float
    under_share: float
    tilt_rad: float
    way: int
    reason: Reason = ""

    @property
    def evidence(self) -> float:
        """Return a score of how likely the plane is the floor.

        It is the product of three shares: the surface on the plane, the cameras above it, and the surface
        that is not below it. An unusual way of holding the cameras lowers it by a factor.
        """
        return self.inlier_share * self.above_share * (1 - self.below_share) * FACING_WEIGHTS[self.way]


@dataclass(frozen=True)
class PlaneChoice:
    """The chosen plane (None if none was chosen), and all candidates, with the reasons against them."""

    chosen: PlaneCandidate | None
    candidates: tuple[PlaneCandidate, ...]

    @property
    def likeliest(self) -> str:
        """The objection to the plane with most evidence, if no plane was chosen; "" if there is no plane."""
        best = max(self.candidates, key=lambda each: each.evidence, default=None)
        if best is None:
            return ""
        share = f"{best.inlier_share:.0%}"
        return f"; {share} of the surface lies on the likeliest plane, but {REASONS[best.reason]}"

    def scaled(self, scale: float) -> "PlaneChoice":
        """Return the same planes in a world that is `scale` times as large."""
        larger = np.array([1.0, 1.0, 1.0, scale])
        chosen = None if self.chosen is None else replace(self.chosen, plane=self.chosen.plane * larger)
        return PlaneChoice(
            chosen, tuple(replace(each, plane=each.plane * larger) for each in self.candidates)
        )

    def warnings(self) -> tuple[str, ...]:
        """Objections to the chosen plane, one line each."""
        chosen = self.chosen
        if chosen is None:
            return ()
        others = [each for each in self.candidates if each.reason]
        lines = []
        if chosen.above_share < REPORTED_ABOVE_SHARE:
            lines.append(f"only {chosen.above_share:.0%} of the cameras look down on {TAKEN}; {GIVE}")
        if chosen.below_share > REPORTED_BELOW_SHARE and not any(each.reason == "higher" for each in others):
            lines.append(f"{chosen.below_share:.0%} of the surface lies lower than {TAKEN}; {GIVE}")
        rivals = [each for each in others if each.reason == "less" and _turn_deg(each, chosen) > SAME_DEG]
        rival = max(rivals, key=lambda each: each.evidence, default=None)
        if rival is not None and rival.evidence > REPORTED_RIVAL * chosen.evidence:
            lines.append(
                f"{chosen.inlier_share:.0%} of the surface lies on {TAKEN}, and {rival.inlier_share:.0%} on "
                f"another that may be it, turned by {_turn_deg(rival, chosen):.0f} degrees; {GIVE}"
            )
        refused = [each for each in others if each.reason in BY_A_LIMIT and _outweighs(each, chosen)]
        if refused:
            most = max(refused, key=lambda each: each.evidence)
            lines.append(
                f"{chosen.inlier_share:.0%} of the surface lies on {TAKEN}, and {most.inlier_share:.0%} on "
                f"another that was refused: {REASONS[most.reason]}; {GIVE}"
            )
        return tuple(lines)


NO_CHOICE = PlaneChoice(None, ())


def choose_plane(
    surface: SceneSurface, T_world_camera: Float64, up_world: Float64 | None, seed: int
) -> PlaneChoice:
    """Choose the plane that the object stands on, among up to six planes for each way of holding the cameras.

    The plane with most evidence decides which way is up, even if it is the top of something. Then the floor
    is chosen among the planes that face up in this sense and have hardly any surface below them. It is the
    one with most evidence; but a parallel plane at least 0.2 m lower is preferred, as a table top may fill
    more of the frames than the floor. Finally, a plane above the floor is chosen in its place if it carries
    the object that the cameras look at, even if there is surface below it.

    Args:
        surface: the scene's surface, scaled so that the cameras are at least 1 m from what they look at.
        T_world_camera: (m, 4, 4) poses of the good frames, in the scaled world.
        up_world: (3,) unit, up by gravity; None if unknown.
        seed: of RANSAC.
    """
    up = up_or_held(T_world_camera, up_world)
    surface = replace(surface, times_noise=_times_noise(surface, T_world_camera))
    candidates: list[PlaneCandidate] = []
    for way, facing in enumerate(facings(T_world_camera, up_world)):
        for plane, inliers in _planes(surface, facing, seed):
            candidate = _candidate(plane, inliers, surface, T_world_camera[:, :3, 3], up, way)
            candidates.append(replace(candidate, reason=_refusal(candidate, facing, surface)))
    possible = [each for each in candidates if each.reason not in NEVER]
    if not possible:
        return PlaneChoice(None, tuple(candidates))
    way = max(possible, key=lambda each: each.evidence).way
    upward = [each for each in possible if each.way == way]
    floors = [each for each in upward if not each.reason]
    floor = _lowest(floors, surface) if floors else None
    chosen = _support(upward, floor, surface) or floor
    return PlaneChoice(
        None if chosen is None else replace(chosen, reason=""),
        tuple(_with_reason(each, chosen, floor, surface) for each in candidates),
    )


def _planes(surface: SceneSurface, facing: Facing, seed: int) -> list[tuple[Float64, Bools]]:
    """Find up to six planes (4,) by RANSAC among the points whose normals `facing` accepts.

    Each is returned with a mask (n,) of the points on it.
    """
    points_world, normals_world, inlier_m = surface.points_world, surface.normals_world, surface.inlier_m
    rng = np.random.default_rng(seed)
    left = facing(normals_world)
    least = max(MIN_PLANE_POINTS, MIN_INLIER_SHARE * len(points_world))
    planes: list[tuple[Float64, Bools]] = []
    for _ in range(CANDIDATES):
        indices = np.flatnonzero(left)
        if len(indices) < least:
            break
        plane = ransac_plane(points_world[indices], normals_world[indices], rng, inlier_m)
        plane = refine(points_world[indices], plane, 2 * inlier_m, inlier_m)
        inliers = left & (np.abs(above_m(plane, points_world)) < 2 * inlier_m)
        left &= ~inliers
        if inliers.sum() >= MIN_INLIER_SHARE * len(points_world):
            planes.append((plane, inliers))
    return planes


def _times_noise(surface: SceneSurface, T_world_camera: Float64) -> Float64:
    """Return the depth noise of each point (n,), divided by that at the focus, but at least 1.

    It grows with the square of the distance from the nearest camera.
    """
    cameras = T_world_camera[:: max(1, len(T_world_camera) // SOME_CAMERAS), :3, 3]
    median_m = float(np.median(np.linalg.norm(cameras - surface.focus_world, axis=1)))
    far_m, _ = cKDTree(cameras).query(surface.points_world)
    return np.asarray(np.maximum(far_m / max(median_m, 1.0), 1.0) ** 2)


def _candidate(
    plane: Float64, inliers: Bools, surface: SceneSurface, cameras_world: Float64, up: Float64, way: int
) -> PlaneCandidate:
    """Measure the evidence for a plane (4,), its unit normal up; `inliers` (n,) are the points on it.

    `cameras_world` (m, 3) are the cameras' positions, `up` (3,) is the unit vector from which its tilt is
    measured, and `way` is as in `PlaneCandidate`.
    """
    local = transform_points(floor_frame(plane), surface.points_world)
    below = local[:, 2] < -BELOW_INLIERS * surface.inlier_m * surface.times_noise
    # Numbers of cells need no dense grid, which one pose kilometres off would make too large for the memory.
    cell = cell_numbers(np.floor(local[:, :2] / (2 * surface.spacing_m)).astype(np.int64))
    under = np.isin(cell[below], cell[inliers])
    above = above_m(plane, cameras_world) > MIN_CAMERA_HEIGHT_M
    return PlaneCandidate(
        plane=plane,
        points=int(inliers.sum()),
        inlier_share=float(inliers.mean()),
        above_share=float(above.mean()),
        below_share=float(below.mean()),
        under_share=float(under.sum() / inliers.sum()),
        tilt_rad=turn_rad(plane, up),
        way=way,
    )


def _refusal(candidate: PlaneCandidate, facing: Facing, surface: SceneSurface) -> Reason:
    """Return why a plane cannot be the floor, or that it is the top of something; "" without objection."""
    if not facing(candidate.plane[None, :3])[0]:
        return "turned"
    if candidate.above_share < MIN_ABOVE_SHARE:
        return "cameras"
    if refined_near(candidate.plane, surface)[1] > MAX_NOISE_M:
        return "clutter"
    return "top" if candidate.under_share > MAX_UNDER_SHARE else ""


def _lowest(planes: list[PlaneCandidate], surface: SceneSurface) -> PlaneCandidate:
    """Return the plane with most evidence, or the lowest flat plane that is parallel to it and well below."""
    most = max(planes, key=lambda each: each.evidence)
    lower = [
        each for each in planes if is_below(each.plane, most.plane, surface) and is_flat(each.plane, surface)
    ]
    return max([most, *lower], key=lambda each: surface.focus_above_m(each.plane))


def _support(
    planes: list[PlaneCandidate], floor: PlaneCandidate | None, surface: SceneSurface
) -> PlaneCandidate | None:
    """Return the highest plane above the floor that carries the object; None if no plane does."""
    higher = [each for each in planes if floor is None or is_below(floor.plane, each.plane, surface)]
    for each in sorted(higher, key=lambda each: surface.focus_above_m(each.plane)):
        if is_flat(each.plane, surface) and carries_what_is_looked_at(each.plane, surface):
            return each
    return None


def _with_reason(
    candidate: PlaneCandidate,
    chosen: PlaneCandidate | None,
    floor: PlaneCandidate | None,
    surface: SceneSurface,
) -> PlaneCandidate:
    """Return a candidate with the reason why `chosen` was chosen in its place.

    The planes `floor` and `chosen` are the same, unless a plane above the floor carries the object.
    """
    if candidate is chosen:
        return replace(candidate, reason="")
    if candidate.reason or chosen is None:
        return candidate
    if candidate is floor:
        return replace(candidate, reason="higher")
    lower = is_below(chosen.plane, candidate.plane, surface)
    return replace(candidate, reason="lower" if lower else "less")


def _turn_deg(one: PlaneCandidate, other: PlaneCandidate) -> float:
    """Return the angle between the normals of two planes, degrees."""
    return float(np.degrees(turn_rad(one.plane, other.plane)))


def _outweighs(refused: PlaneCandidate, chosen: PlaneCandidate) -> bool:
    """Whether the evidence for a refused plane is so strong that the user is warned."""
    parallel = _turn_deg(refused, chosen) <= SAME_DEG
    return refused.evidence > (REPORTED_REFUSED_PARALLEL if parallel else REPORTED_REFUSED) * chosen.evidence
