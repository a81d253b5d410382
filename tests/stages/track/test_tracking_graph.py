"""Pose graphs with known answers, loops that close a circle, and loops that are refused."""

import numpy as np
import pytest
from analytic_scenes import Surface, box, displaced, ring, sphere
from tracking_scenes import (
    CORNER_VIEW,
    FLOOR,
    ROOM,
    errors_m,
    frame_maps,
    noisy_circle,
    painted,
    tie_at,
    walk,
    without_color,
)
from typed import present

from kinectbench.core.geometry import invert_rigid, rotation_angle_rad
from kinectbench.core.geometry.rigid import rigid_from_twist
from kinectbench.lab.simulate.path import look_at
from kinectbench.stages.track import keyframe_graph
from kinectbench.stages.track.covisibility import covisible, keyframe_thumbnail, shared_view
from kinectbench.stages.track.features import FeatureCache
from kinectbench.stages.track.frame_maps import MapCache
from kinectbench.stages.track.keyframe_graph import KeyframeGraph, build_graph
from kinectbench.stages.track.odometry import Odometry, follow
from kinectbench.stages.track.pose_graph import optimise, softened
from kinectbench.stages.track.tracked import Constraint, ConstraintKind

pytestmark = pytest.mark.xdist_group("tracking")

INFORMATION = np.diag([1e6] * 3 + [1e6] * 3)  # 1 mrad, 1 mm


# --- groups that are joined


def test_consecutive_frames_join_groups_before_the_sides_of_a_symmetric_object_do() -> None:
    """Six keyframes of an orbit, lost between frames 2 and 3; three loops see the front in the back."""
    poses = ring(6, 1.5)
    wrong = poses.copy()
    wrong[3:] = ring(6, 1.5)[[0, 1, 2]]
    follows = constraint_of(2, 3, between(poses, 2, 3), "loop")
    loops = [constraint_of(a, b, between(wrong, a, b), "loop") for a, b in ((0, 4), (1, 4), (1, 5))]
    builder = object.__new__(keyframe_graph._Builder)
    builder.row = {k: k for k in range(6)}
    builder.group = np.array([0, 0, 0, 1, 1, 1])
    builder.T_world = np.concatenate([poses[:3], [invert_rigid(poses[3]) @ T for T in poses[3:]]])
    builder.path_m = np.arange(6) * 1.5
    builder.lost = np.zeros(6, bool)
    builder.constraints, builder.refused = [follows, *loops], []
    builder._join_groups()
    assert set(builder.group.tolist()) == {0}
    assert np.allclose(builder.T_world, poses)
    assert builder.constraints == [follows] and [each.weight for each in builder.refused] == [0.0] * 3
    # A gap in which the camera was lost is bridged by whatever most constraints agree on.
    builder.group = np.array([0, 0, 0, 1, 1, 1])
    builder.T_world = np.concatenate([poses[:3], [invert_rigid(poses[3]) @ T for T in poses[3:]]])
    builder.lost[2] = True
    builder.constraints, builder.refused = [follows, *loops], []
    builder._join_groups()
    assert np.allclose(builder.T_world, wrong)


# --- pose graphs with known answers


def constraint_of(a: int, b: int, T_a_b: np.ndarray, kind: ConstraintKind = "odometry") -> Constraint:
    return tie_at(a, b, T_a_b, INFORMATION, kind)


def between(poses: np.ndarray, a: int, b: int, twist: np.ndarray | None = None) -> np.ndarray:
    T = invert_rigid(poses[a]) @ poses[b]
    between: np.ndarray = T if twist is None else T @ rigid_from_twist(twist)
    return between


def chained(poses: np.ndarray, constraints: list[Constraint]) -> np.ndarray:
    """Poses by the odometry alone: where the optimisation starts."""
    out = [poses[0]]
    for constraint in constraints:
        out.append(out[-1] @ constraint.T_a_b)
    return np.stack(out)


def circle_of_constraints(
    noise: np.random.Generator | None, n: int = 20
) -> tuple[np.ndarray, list[Constraint]]:
    """True poses of a circle, and constraints between neighbours with errors of about 2 mrad, 2 mm."""
    poses = ring(n, 1.5)
    twists = np.zeros((n, 6)) if noise is None else noise.normal(0, 0.002, (n, 6))
    if noise is not None:
        twists[:, 1] += 0.003  # a turn that is always overestimated: drift
    return poses, [constraint_of(k, k + 1, between(poses, k, k + 1, twists[k])) for k in range(n - 1)]


def ends(constraints: list[Constraint]) -> list[tuple[int, int]]:
    return [(constraint.a, constraint.b) for constraint in constraints]


def off_mm(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    off_mm: np.ndarray = 1000 * np.linalg.norm(found[:, :3, 3] - true[:, :3, 3], axis=1)
    return off_mm


def test_ties_without_errors_give_the_true_poses() -> None:
    """From a start that is off by centimetres and degrees; the first pose stays."""
    poses, constraints = circle_of_constraints(None)
    constraints += [
        constraint_of(0, 19, between(poses, 0, 19), "loop"),
        constraint_of(3, 12, between(poses, 3, 12), "loop"),
    ]
    rng = np.random.default_rng(0)
    start = np.stack([T @ rigid_from_twist(rng.normal(0, 0.05, 6) * (k > 0)) for k, T in enumerate(poses)])
    found, weights = optimise(start, constraints, ends(constraints))
    assert off_mm(found, poses).max() < 0.01
    assert np.degrees(rotation_angle_rad((invert_rigid(found) @ poses)[:, :3, :3])).max() < 0.001
    np.testing.assert_allclose(weights, 1, atol=1e-6)


def test_a_loop_takes_the_drift_away() -> None:
    poses, constraints = circle_of_constraints(np.random.default_rng(1))
    start = chained(poses, constraints)
    loop = constraint_of(0, 19, between(poses, 0, 19), "loop")
    found, weights = optimise(start, [*constraints, loop], ends([*constraints, loop]))
    assert off_mm(start, poses)[-1] > 40
    assert off_mm(found, poses)[-1] < 0.1 * off_mm(start, poses)[-1]
    assert off_mm(found, poses).max() < 0.5 * off_mm(start, poses).max()
    assert weights[-1] > 0.3


def test_a_wrong_loop_is_switched_off_and_moves_nothing() -> None:
    """Three loops are right, one claims that the far side of the circle is its beginning."""
    poses, constraints = circle_of_constraints(np.random.default_rng(2))
    loops = [constraint_of(a, b, between(poses, a, b), "loop") for a, b in ((0, 19), (1, 18), (2, 16))]
    wrong = constraint_of(0, 10, displaced(np.eye(4), (0.05, 0.0, 0.0), 2.0), "loop")
    start = chained(poses, constraints)
    without, _ = optimise(start, [*constraints, *loops], ends([*constraints, *loops]))
    found, weights = optimise(start, [*constraints, *loops, wrong], ends([*constraints, *loops, wrong]))
    assert weights[-1] < 0.01 and weights[-4:-1].min() > 0.3
    assert off_mm(found, without).max() < 1.0


@pytest.mark.parametrize("by_m", [0.1, 0.3])
def test_a_loop_that_is_wrong_by_little_is_switched_off_too(by_m: float) -> None:
    poses, constraints = circle_of_constraints(None)
    loops = [constraint_of(a, b, between(poses, a, b), "loop") for a, b in ((0, 19), (1, 18))]
    wrong = constraint_of(5, 14, displaced(between(poses, 5, 14), (by_m, 0.0, 0.0), 0.0), "loop")
    found, weights = optimise(poses, [*constraints, *loops, wrong], ends([*constraints, *loops, wrong]))
    assert weights[-1] < 0.05 and off_mm(found, poses).max() < 2.0


def test_a_prior_pulls_but_ties_are_stronger() -> None:
    """Poses believed to 50 mm that are all 20 mm to the right: the world moves there, its shape stays."""
    poses, constraints = circle_of_constraints(None)
    shifted = poses.copy()
    shifted[:, 0, 3] += 0.02
    shifted[7, :3, 3] += [0.3, 0.0, 0.1]  # and one that is plainly wrong
    found, _ = optimise(poses, constraints, ends(constraints), shifted)
    expected = poses.copy()
    expected[:, 0, 3] += 0.02
    assert off_mm(found, expected).max() < 5.0
    relative = [between(found, k, k + 1) for k in range(19)]
    np.testing.assert_allclose(relative, [constraint.T_a_b for constraint in constraints], atol=0.001)
    # Priors may be missing.
    shifted[3:9] = np.nan
    found, _ = optimise(poses, constraints, ends(constraints), shifted)
    assert off_mm(found, expected).max() < 1.0


def test_little_to_optimise() -> None:
    poses = ring(3, 1.0)
    for few in (poses[:1], poses):
        constraints: list[Constraint] = []
        found, weights = optimise(few, constraints, [])
        np.testing.assert_array_equal(found, few)
        assert len(weights) == 0
    # A pose without constraints stays where it is.
    constraint = constraint_of(0, 1, between(poses, 0, 1))
    found, _ = optimise(poses, [constraint], [(0, 1)])
    assert off_mm(found, poses).max() < 1e-3


def test_what_a_tie_leaves_open_stays_open() -> None:
    """A constraint that knows nothing along x: a second one that knows it decides."""
    loose = INFORMATION.copy()
    loose[3, 3] = 0
    poses = np.stack([np.eye(4), displaced(np.eye(4), (0.1, 0.0, 0.0), 0.0)])
    wrong_in_x = displaced(poses[1], (0.03, 0.0, 0.0), 0.0)
    constraints = [
        tie_at(0, 1, wrong_in_x, loose, "odometry"),
        tie_at(0, 1, poses[1], 1e-2 * INFORMATION, "covisible"),
    ]
    found, _ = optimise(np.stack([np.eye(4), wrong_in_x]), constraints, [(0, 1), (0, 1)])
    assert off_mm(found, poses).max() < 1.0


def test_information_is_softened_by_what_is_systematic() -> None:
    """No constraint is better than tenths of a millimetre, a poor overlap is worse, unknown stays unknown."""
    sure = tie_at(0, 1, np.eye(4), 1e12 * np.eye(6), "loop", 1.0, 1.0)
    sigma = np.sqrt(np.diag(np.linalg.inv(softened(sure))))
    assert (sigma > 1e-4).all() and (sigma < 5e-3).all()
    half = tie_at(0, 1, np.eye(4), 1e12 * np.eye(6), "loop", 0.5, 0.95)
    assert (np.sqrt(np.diag(np.linalg.inv(softened(half)))) > 2 * sigma).all()
    open_x = tie_at(0, 1, np.eye(4), np.diag([1e6, 1e6, 1e6, 0.0, 1e6, 1e6]), "loop", 1.0, 1.0)
    assert softened(open_x)[3, 3] == 0 and np.isfinite(softened(open_x)).all()
    weak = tie_at(0, 1, np.eye(4), np.eye(6), "loop", 1.0, 1.0)
    np.testing.assert_allclose(softened(weak), np.eye(6), atol=1e-4)


# --- who sees the same


def test_shared_views_of_a_room() -> None:
    """All of itself, half after half a field of view, nothing from behind."""
    turned = displaced(CORNER_VIEW, (0.0, 0.0, 0.0), np.degrees(np.arctan(79.5 / 131.25)))
    back = displaced(CORNER_VIEW, (0.0, 0.0, 0.0), 180.0)
    sequence = painted(ROOM, np.stack([CORNER_VIEW, turned]))
    views = [keyframe_thumbnail(frame_maps(sequence, i)) for i in range(2)]
    assert shared_view(views[0], views[0], np.eye(4)) > 0.97
    assert 0.3 < shared_view(views[0], views[1], invert_rigid(CORNER_VIEW) @ turned) < 0.7
    assert shared_view(views[0], views[0], invert_rigid(CORNER_VIEW) @ back) == 0


def test_covisible_pairs_of_a_circle() -> None:
    """Cameras around a ball: the nearer on the circle, the more they share; opposite ones nothing."""
    poses = ring(12, 1.2, (0.0, 0.0, 0.3))
    sequence = painted([sphere((0.0, 0.0, 0.3), 0.3)], poses)
    views = [keyframe_thumbnail(frame_maps(sequence, i)) for i in range(12)]
    shares = {(i, j): share for share, i, j in covisible(views, poses)}
    assert all(i < j for i, j in shares)
    pairs = {k: [sorted((i, (i + k) % 12)) for i in range(12)] for k in (1, 3, 6)}
    around = {k: [shares.get((i, j), 0.0) for i, j in pairs[k]] for k in (1, 3, 6)}
    assert min(around[1]) > 0.6 and min(around[1]) > max(around[3]) and max(around[6]) < 0.05
    lost = poses.copy()
    lost[4] = np.nan
    assert not any(4 in pair[1:] for pair in covisible(views, lost))
    assert covisible(views[:1], poses[:1]) == []


# --- loops


@pytest.fixture(scope="module")
def circle() -> tuple[Odometry, KeyframeGraph]:
    """Without colour the way around drifts by a centimetre or two."""
    maps = MapCache(without_color(noisy_circle().sequence))
    features = FeatureCache(maps)
    odometry = follow(maps, features)
    return odometry, build_graph(maps, features, odometry)


def test_a_circle_is_closed(circle: tuple[Odometry, KeyframeGraph]) -> None:
    """More than 360 degrees: constraints connect its last keyframes to its first, and the drift is gone."""
    odometry, graph = circle
    keyframes = list(graph.keyframes)
    truth = noisy_circle().simulation.T_world_camera[keyframes]
    before = np.stack([present(odometry.frames[k]).T_segment_camera for k in keyframes])
    drifted, closed = errors_m(before, truth), errors_m(graph.T_world, truth)
    assert np.sqrt(np.mean(closed**2)) < 0.7 * np.sqrt(np.mean(drifted**2))
    assert closed.max() < 0.015
    opened_m, closed_m = (
        np.linalg.norm((invert_rigid(between(truth, 0, -1)) @ between(T, 0, -1))[:3, 3])
        for T in (before, graph.T_world)
    )
    assert opened_m > 0.01 and closed_m < 0.5 * opened_m and closed_m < 0.01
    loops = [constraint for constraint in graph.constraints if constraint.kind == "loop"]
    n = len(keyframes)
    assert any(
        keyframes.index(constraint.a) < n / 5 and keyframes.index(constraint.b) > 4 * n / 5
        for constraint in loops
    )


def test_ties_that_are_kept_are_right(circle: tuple[Odometry, KeyframeGraph]) -> None:
    _, graph = circle
    poses = noisy_circle().simulation.T_world_camera
    assert len(graph.constraints) > len(graph.keyframes)
    for constraint in graph.constraints:
        error = invert_rigid(between(poses, constraint.a, constraint.b)) @ constraint.T_a_b
        assert constraint.weight < 0.5 or np.linalg.norm(error[:3, 3]) < 0.04
        assert (
            constraint.a < constraint.b
            and constraint.a in graph.keyframes
            and constraint.b in graph.keyframes
        )
    assert all(constraint.weight <= 0.05 for constraint in graph.refused)
    pairs = [(constraint.a, constraint.b) for constraint in (*graph.constraints, *graph.refused)]
    assert len(set(pairs)) == len(pairs)
    # What is tried is bounded: so many pairs per keyframe and round.
    assert len(pairs) < 12 * len(graph.keyframes)


def test_two_places_that_look_alike_are_not_one() -> None:
    """The same box and ball at both ends of a walk past other things, depth only."""

    def alike(x: float) -> list[Surface]:
        return [box((x - 0.3, -0.2, 0.0), (x + 0.2, 0.15, 0.35)), sphere((x + 0.45, 0.3, 0.18), 0.18)]

    between_them = [
        box((0.9, -0.3, 0.0), (1.1, 0.1, 0.5)),
        sphere((1.4, 0.1, 0.25), 0.25),
        box((1.7, -0.1, 0.0), (1.95, 0.3, 0.15)),
    ]
    x = np.linspace(-0.1, 2.9, 30)
    poses = np.stack([look_at(np.array([each, 0.9, 1.1]), np.array([each, 0.0, 0.0])) for each in x])
    sequence = painted(
        [FLOOR, *alike(0.0), *between_them, *alike(2.8)], poses, noise=np.random.default_rng(0)
    )
    maps = MapCache(sequence)
    features = FeatureCache(maps)
    odometry = follow(maps, features)
    graph = build_graph(maps, features, odometry)
    keyframes = np.array(graph.keyframes)
    assert errors_m(graph.T_world, poses[keyframes]).max() < 0.01
    assert all(
        abs(poses[constraint.a, 0, 3] - poses[constraint.b, 0, 3]) < 1.5 for constraint in graph.constraints
    )
    # Told that they are one place, it does not believe it.
    a, b = int(keyframes[0]), int(keyframes[-1])
    false = constraint_of(a, b, displaced(between(poses, a, b), (2.8, 0.0, 0.0), 0.0), "loop")
    row = {frame: i for i, frame in enumerate(graph.keyframes)}
    constraints = [*graph.constraints, false]
    found, weights = optimise(
        graph.T_world, constraints, [(row[constraint.a], row[constraint.b]) for constraint in constraints]
    )
    assert weights[-1] < 0.01 and off_mm(found, graph.T_world).max() < 2.0


def test_an_empty_graph() -> None:
    maps = MapCache(painted(ROOM, walk(2, 0.1)))
    graph = build_graph(maps, FeatureCache(maps), Odometry((None, None), {}, (), ()))
    assert graph.keyframes == () and graph.constraints == () and graph.T_world.shape == (0, 4, 4)
