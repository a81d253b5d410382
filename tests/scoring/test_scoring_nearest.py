"""What makes the scoring of a view fast must not change what it finds."""

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
    moving = NearestOfMoving(Samples(tree), len(points))
    for step in range(60):
        points = points + 0.1 * 0.8**step * rng.normal(size=3)
        asked = rng.random(len(points)) < 0.9
        distances, found = moving.of(points, asked)
        exact, which = tree.query(points[asked])
        np.testing.assert_array_equal(found, which)
        np.testing.assert_allclose(distances, exact, rtol=1e-14)


def test_one_sample_is_the_nearest_of_all() -> None:
    moving = NearestOfMoving(Samples(cKDTree(np.zeros((1, 3)))), 2)
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
    from kinectbench.scoring.camera.boxes import near_together

    rng = np.random.default_rng(2)
    samples = rng.integers(0, 9, (count, 3)) / 8.0 if even else rng.random((count, 3)) ** 3
    samples[-1] *= 1e5
    points = rng.random((500, 3)) * 1.5 - 0.2
    tree = cKDTree(samples)
    order, begins = near_together(points), np.full((len(points), 2), -1)
    assert np.array_equal(np.sort(order), np.arange(len(points)))
    exact, expected = tree.query(points)[1], tree.query(points, k=2)[0]
    for _ in range(2):  # without a guess, and from what was found
        far, found = Samples(tree).nearest(points, order, begins)
        assert (begins >= 0).all() and np.array_equal(found, exact[order])
        np.testing.assert_array_equal(far, expected[order])
    alone = Samples(tree).nearest_of_all(points)
    np.testing.assert_array_equal(alone[0], expected[:, 0])
    assert np.array_equal(alone[1], exact)
