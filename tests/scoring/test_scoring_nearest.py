"""What makes the scoring of a view fast must not change what it finds."""

import time

import numpy as np
import pytest
from scipy.spatial import cKDTree

from kinectbench.core.voxels.pair_file import pack
from kinectbench.scoring.camera.nearest import NearestOfMoving, Samples


@pytest.mark.parametrize("even", [False, True])
def test_points_that_move_keep_or_change_their_nearest(even: bool) -> None:
    """As a search of its own for each step would find, where steps become small, and of an even grid, too."""
    rng = np.random.default_rng(0)
    samples = np.argwhere(np.ones((12, 12, 12))) / 12.0 if even else rng.random((1500, 3))
    points = np.round(rng.random((400, 3)) * 24) / 24 if even else rng.random((400, 3))
    tree = cKDTree(samples)
    moving = NearestOfMoving(Samples(samples), len(points))
    for step in range(60):
        points = points + 0.1 * 0.8**step * rng.normal(size=3)
        asked = rng.random(len(points)) < 0.9
        distances, found = moving.of(points, asked)
        exact, which = tree.query(points[asked])
        assert even or np.array_equal(found, which)
        np.testing.assert_allclose(distances, exact, rtol=1e-14)
        np.testing.assert_allclose(np.linalg.norm(points[asked] - samples[found], axis=1), exact, rtol=1e-12)
        alone = NearestOfMoving(Samples(samples), len(points)).of(points, asked)
        assert np.array_equal(found, alone[1])


def test_one_sample_is_the_nearest_of_all() -> None:
    moving = NearestOfMoving(Samples(np.zeros((1, 3))), 2)
    for away in (3.0, 5.0):
        distances, found = moving.of(np.array([[away, 0, 0], [0, 0, 1.0]]), np.ones(2, bool))
        assert found.tolist() == [0, 0] and distances.tolist() == [away, 1.0]


@pytest.mark.parametrize("size", [(5, 6, 7), (9, 8, 16), (20, 11, 41)])
def test_faces_and_normals_of_cells_are_those_of_their_definition(size: tuple[int, int, int]) -> None:
    from kinectbench.scoring.camera.kernels import faces_of_cells, outward

    cells = np.random.default_rng(1).random(size) < 0.7
    padded = np.pad(cells, 4)
    inside, axes, signs = faces_of_cells(pack(np.pad(cells, 1)))
    expected = [
        (i, j, k, axis, sign)
        for i, j, k in np.argwhere(cells)
        for axis in range(3)
        for sign in (-1, 1)
        if not padded[tuple(np.array([i, j, k]) + 4 + sign * np.eye(3, dtype=int)[axis])]
    ]
    assert np.column_stack([inside, axes, signs]).tolist() == [[int(n) for n in row] for row in expected]
    normals = outward(pack(np.pad(cells, 1)), inside)
    steps = np.stack(np.meshgrid(*[np.arange(-3, 4)] * 3, indexing="ij"), axis=-1)
    for (i, j, k), normal in zip(inside[::17], normals[::17], strict=True):
        around = padded[i + 1 : i + 8, j + 1 : j + 8, k + 1 : k + 8]
        away = -(steps * around[..., None]).sum(axis=(0, 1, 2)).astype(float)
        length = np.linalg.norm(away)
        np.testing.assert_allclose(normal, away / length if length else away, atol=1e-14)


@pytest.mark.parametrize("count", [1, 2, 17, 3000])
@pytest.mark.parametrize("even", [False, True])
def test_the_two_nearest_are_those_of_a_tree(count: int, even: bool) -> None:
    """Wherever the search begins, and of samples that are there twice and far away, too."""
    from kinectbench.scoring.camera.nearest import near_together, two_nearest

    rng = np.random.default_rng(2)
    samples = rng.integers(0, 9, (count, 3)) / 8.0 if even else rng.random((count, 3)) ** 3
    samples[-1] *= 1e5
    points = rng.random((500, 3)) * 1.5 - 0.2
    which, begins = near_together(points), np.full((len(points), 2), -1)
    assert np.array_equal(np.sort(which), np.arange(len(points)))
    expected = cKDTree(samples).query(points, k=2)[0]
    own = Samples(samples)
    once = own.nearest(points)
    for _ in range(2):  # without a guess, and from what was found
        far = two_nearest(points, which, begins, True, *own.boxes[1:])
        assert (begins >= 0).all()
        np.testing.assert_array_equal(far, expected[which])
        again = own.nearest(points)
        np.testing.assert_array_equal(again[0], expected[:, 0])
        np.testing.assert_array_equal(
            np.linalg.norm(points - samples[again[1]], axis=1) - again[0] < 1e-12, True
        )
        assert np.array_equal(again[1], once[1])


def test_of_equally_near_samples_no_earlier_search_decides() -> None:
    """A hundred points in the middle of cells of an even grid: eight samples are equally near to each."""
    from kinectbench.scoring.camera.nearest import two_nearest

    samples = np.argwhere(np.ones((8, 8, 8))) / 8.0
    rng = np.random.default_rng(3)
    points = rng.integers(0, 7, (100, 3)) / 8.0 + 1 / 16
    boxes, which, found = Samples(samples).boxes[1:], np.arange(100), []
    for _ in range(4):  # from wherever
        places = rng.integers(0, len(samples), (100, 2))
        places[:, 1] = (places[:, 0] + 1) % len(samples)
        far = two_nearest(points, which, places, False, *boxes)
        assert np.array_equal(far[:, 0], far[:, 1])
        found.append(places[:, 0])
    assert all(np.array_equal(one, found[0]) for one in found)


def test_many_equal_samples_take_no_longer() -> None:
    """Stacked triangles have equal samples; each search would meet all of them."""
    samples = np.repeat(np.random.default_rng(4).random((5, 3)), 20_000, axis=0)
    points = np.random.default_rng(5).random((2000, 3))
    own = Samples(samples)
    started = time.process_time()
    distances, _ = own.nearest(points)
    assert time.process_time() - started < 2  # a scan for each: ten
    np.testing.assert_allclose(distances, cKDTree(samples[::20_000]).query(points)[0], rtol=1e-14)


def test_mean_offsets_are_those_of_a_search() -> None:
    rng = np.random.default_rng(6)
    samples, points, normals = rng.random((2000, 3)), rng.random((50, 3)), rng.normal(size=(50, 3))
    offsets = Samples(samples).offsets(points, normals, 0.11)
    for point, normal, offset in zip(points, normals, offsets, strict=True):
        near = samples[np.linalg.norm(samples - point, axis=1) < 0.11]
        assert len(near) and offset == pytest.approx(float(((near - point) @ normal).mean()))
    assert Samples(samples).offsets(points + 9, normals, 0.11).tolist() == [0.0] * 50


def test_a_step_is_a_similarity_about_its_middle() -> None:
    from scipy.spatial.transform import Rotation

    from kinectbench.scoring.camera.align import similarity_about

    rng = np.random.default_rng(7)
    for size in (0.0, 1e-9, 1e-4, 0.3, 3.0):
        step, middle = size * rng.normal(size=7), rng.normal(size=3)
        turn = np.exp(step[3]) * Rotation.from_rotvec(step[4:]).as_matrix()
        T = similarity_about(step, middle)
        np.testing.assert_allclose(T[:3, :3], turn, atol=1e-13 * np.exp(step[3]))
        np.testing.assert_allclose(T[:3, 3], middle + step[:3] - turn @ middle, atol=1e-12 * np.exp(step[3]))
