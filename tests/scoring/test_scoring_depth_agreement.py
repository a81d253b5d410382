"""Predictions in the camera frame: every wrong unit and axis is named, and nothing of right ones."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.geometry import Camera, TriangleMesh, invert_rigid, rigid, transform_points
from kinectbench.core.geometry.camera import DepthRenderer
from kinectbench.lab.simulate.path import look_at
from kinectbench.scoring.camera_shape import CameraShape, occupancy_shape
from kinectbench.scoring.depth_agreement import (
    LARGE,
    SCENE,
    SMALL,
    Agreement,
    agreement,
    beyond_share,
    likeliest,
    remedy,
    shape_points,
)

CAMERA = Camera(320, 240, 262.5, 260.0, 157.5, 121.0)
OBJECTS = range(10)
NO_FACES = np.zeros((0, 3), np.int64)


@dataclass(frozen=True)
class Scene:
    """An object of some boxes without symmetry, and one view of it."""

    mesh: CameraShape
    depth_points_m: np.ndarray
    T_world_camera: np.ndarray
    T_world_grid: np.ndarray

    def judged(self, shape: CameraShape, T: np.ndarray | None = None) -> Agreement:
        T_camera_prediction = np.eye(4) if T is None else T
        return agreement(
            shape, self.depth_points_m, T_camera_prediction, self.T_world_camera, self.T_world_grid
        )


@cache
def scene(number: int) -> Scene:
    rng = np.random.default_rng(number)
    parts = []
    for _ in range(4):
        low = rng.uniform([-0.4, -0.4, 0.0], [0.1, 0.1, 0.5])
        parts.append(trimesh.creation.box(bounds=[low, low + rng.uniform(0.05, 0.5, 3)]))
    whole = trimesh.util.concatenate(parts)
    mesh = TriangleMesh(np.array(whole.vertices), np.array(whole.faces, np.int32))
    angle = rng.uniform(0, 2 * np.pi)
    eye = np.array([1.6 * np.cos(angle), 1.6 * np.sin(angle), rng.uniform(0.6, 1.5)])
    # A person does not point exactly at the middle.
    T_world_camera = np.asarray(look_at(eye, rng.uniform([-0.2, -0.2, 0.2], [0.2, 0.2, 0.6])))
    depth_m = DepthRenderer(mesh).depth_m(CAMERA, T_world_camera)
    points = CAMERA.backproject(np.rint(depth_m * 1000) / 1000)[depth_m > 0]
    in_camera = transform_points(invert_rigid(T_world_camera), mesh.vertices)
    T_world_grid = T_world_camera @ rigid(np.eye(3), in_camera.min(axis=0) - 0.05)
    return Scene(
        CameraShape("mesh", in_camera, mesh.faces.astype(np.int64)), points, T_world_camera, T_world_grid
    )


def slip(found: Agreement) -> str:
    """What is named of one prediction alone."""
    return likeliest([found])[0]


def cloud(points: np.ndarray) -> CameraShape:
    return CameraShape("points", points, NO_FACES)


def mirrored(signs: tuple[int, int, int]) -> np.ndarray:
    return np.diag([*map(float, signs), 1.0])


def scaled(factor: float) -> np.ndarray:
    return np.diag([factor] * 3 + [1.0])


AS_USUAL = MethodFile(name="net", frame="camera")
# Words by what makes them true.
UNITS = {
    1000.0: "1000 times too far: millimetres for metres?",
    0.001: "1000 times too near: metres for millimetres?",
    6.5535: "6.55 times too far: depth of 65535 = 10 m read as millimetres?",
    1 / 6.5535: "6.55 times too near: depth in millimetres read as 65535 = 10 m?",
}
AXES = {
    (1, -1, 1): "y up?",
    (-1, 1, 1): "x left?",
    (1, 1, -1): "z backward?",
    (-1, -1, 1): "x left and y up (axes: pytorch3d)?",
    (1, -1, -1): "y up and z backward (axes: opengl)?",
    (-1, 1, -1): "x left and z backward?",
    (-1, -1, -1): "x left, y up and z backward?",
}


@pytest.mark.parametrize("number", OBJECTS)
def test_every_wrong_unit_and_axis_is_named(number: int) -> None:
    one = scene(number)
    for form in (one.mesh, cloud(shape_points(one.mesh)[:2048])):
        for factor, words in UNITS.items():
            found = one.judged(form.transformed(scaled(factor)))
            assert (
                slip(found) == words
                and found.is_large
                and found.line(words, AS_USUAL).startswith(f"{found.distance_m:.3g} m from")
            )
        for signs, words in AXES.items():
            assert slip(one.judged(form.transformed(mirrored(signs)))) == words
        both = form.transformed(scaled(1000.0) @ mirrored((1, -1, -1)))
        assert slip(one.judged(both)) == (
            "1000 times too far: millimetres for metres? and y up and z backward (axes: opengl)?"
        )


def test_the_key_that_mends_a_slip_is_named() -> None:
    """Units and axes are those that the file must have, whatever is declared now."""
    mm = MethodFile(name="net", frame="camera", unit="mm", axes="cv")
    opengl = MethodFile(name="net", frame="camera", unit="m", axes="opengl")
    far, near, *others = UNITS.values()
    assert remedy(far, AS_USUAL) == "'unit': 'mm'" and remedy(near, mm) == "'unit': 'm'"
    assert remedy(AXES[-1, -1, 1], AS_USUAL) == "'axes': 'pytorch3d'"
    assert remedy(AXES[1, -1, -1], AS_USUAL) == "'axes': 'opengl'"
    assert remedy(AXES[1, -1, -1], opengl) == "'axes': 'cv'"
    assert remedy(AXES[-1, 1, -1], opengl) == "'axes': 'pytorch3d'"
    assert remedy(f"{far} and {AXES[1, -1, -1]}", AS_USUAL) == "'unit': 'mm' and 'axes': 'opengl'"
    for words in (*others, near, AXES[1, -1, 1], "in the world's frame?"):
        assert remedy(words, AS_USUAL) == "'T_camera_prediction'"


@pytest.mark.parametrize("number", OBJECTS)
def test_a_room_is_no_object(number: int) -> None:
    """Walls 2.5 m away all around, and the object itself; and the object alone, which has none."""
    one = scene(number)
    T_grid_camera, side_m = invert_rigid(one.T_world_grid) @ one.T_world_camera, 1.2
    walls = trimesh.sample.sample_surface(trimesh.creation.box(extents=(5, 5, 5)), 5000, seed=1)[0]
    middle = transform_points(invert_rigid(T_grid_camera), np.full(3, side_m / 2))
    room = cloud(np.concatenate([walls + middle, shape_points(one.mesh)[:5000]]))
    assert beyond_share(room, T_grid_camera, side_m) > SCENE
    assert beyond_share(one.mesh, T_grid_camera, side_m) == 0


@pytest.mark.parametrize("number", OBJECTS)
def test_a_wrong_frame_and_rows_for_columns_are_named(number: int) -> None:
    one = scene(number)
    world = one.mesh.transformed(one.T_world_camera)
    assert slip(one.judged(world)) == "in the world's frame?"
    in_cube = one.mesh.transformed(invert_rigid(one.T_world_grid) @ one.T_world_camera)
    assert slip(one.judged(in_cube)) == "in the frame of the pair's cube?"
    by_rows = rigid(one.T_world_camera[:3, :3].T, one.T_world_camera[:3, 3])
    words = "in the world's frame, with rows for columns in the rotation?"
    assert slip(one.judged(one.mesh.transformed(by_rows))) == words
    # A generator's mesh in its own frame, and a pose whose rotation is transposed.
    # Not near half a turn, whose rotation is its own transpose.
    turn = Rotation.from_rotvec([0.6 + 0.1 * number, -0.5, 0.8 - 0.1 * number]).as_matrix()
    right = rigid(turn, one.mesh.points_m.mean(axis=0)) @ scaled(0.7)
    own = one.mesh.transformed(np.linalg.inv(right))
    wrong = right.copy()
    wrong[:3, :3] = wrong[:3, :3].T
    assert not one.judged(own.transformed(right), right).slips
    found = one.judged(own.transformed(wrong), wrong)
    assert slip(found) == "rows for columns in the rotation of 'T_camera_prediction'?"


@pytest.mark.parametrize("number", OBJECTS)
def test_right_ones_raise_no_alarm(number: int) -> None:
    """Exact, sparse, noisy, coarse, smooth and half-right shapes."""
    one, rng = scene(number), np.random.default_rng(100 + number)
    exact = one.judged(one.mesh)
    assert exact.distance_m < 0.5 * SMALL * exact.diagonal_m and not exact.is_large
    points = shape_points(one.mesh)
    size_m = 0.04
    low = points.min(axis=0) - size_m
    cells = np.zeros(np.ceil((points.max(axis=0) + size_m - low) / size_m).astype(int), bool)
    cells[tuple(np.floor((points - low) / size_m).astype(int).T)] = True
    others = {
        "sparse": cloud(points[:512]),
        "noisy": cloud(points + rng.normal(0, 0.02, points.shape)),
        "coarse": occupancy_shape(cells, rigid(np.eye(3), low), size_m),
        "off by 5 cm": cloud(points + np.array([0.03, -0.03, 0.03])),
        "seen part alone": cloud(one.depth_points_m[::7]),
        "5 % too large": cloud((points - points.mean(axis=0)) * 1.05 + points.mean(axis=0)),
        "its box": cloud(shape_points(box_around(points))),
    }
    assert [kind for kind, shape in others.items() if one.judged(shape).slips] == []


def box_around(points: np.ndarray) -> CameraShape:
    box = trimesh.creation.box(bounds=[points.min(axis=0), points.max(axis=0)])
    return CameraShape("mesh", np.array(box.vertices), np.array(box.faces, np.int64))


def test_a_distance_that_nothing_explains_is_said() -> None:
    one = scene(0)
    found = one.judged(cloud(shape_points(one.mesh) + np.array([0.7, 0.9, -0.2])))
    assert slip(found) == "" and found.distance_m > LARGE * found.diagonal_m and found.is_large


def test_views_of_a_symmetric_object_are_decided_by_the_others() -> None:
    """A ball hides which axis is wrong, and says only that one is."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.3)
    ball.apply_translation([0, 0, 1.5])
    round_ = CameraShape("mesh", np.array(ball.vertices), np.array(ball.faces, np.int64))
    points = round_.points_m[round_.points_m[:, 2] < 1.4]
    wrong = round_.transformed(mirrored((1, 1, -1)))
    of_ball = agreement(wrong, points, np.eye(4), np.eye(4), np.eye(4))
    assert len(of_ball.slips) > 2 and likeliest([of_ball]) == ["y up and z backward (axes: opengl)?"]
    other = scene(0)
    both = [of_ball, other.judged(other.mesh.transformed(mirrored((1, 1, -1))))]
    assert likeliest([*both, agreement(round_, points, *[np.eye(4)] * 3)]) == [
        "z backward?",
        "z backward?",
        "",
    ]
