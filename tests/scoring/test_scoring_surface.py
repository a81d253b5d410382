"""Surface metrics against brute force, by hand, and in every edge case."""

import math
from dataclasses import astuple, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from references import upsample
from score_surfaces import surface_of, surface_reference
from synthetic_release import ball

from kinectbench.core.artefacts.score_figures import SurfaceMetrics
from kinectbench.core.voxels.pair_file import pack, unpack
from kinectbench.core.voxels.solid import packed_shell
from kinectbench.scoring.counts import occupied
from kinectbench.scoring.surface import SAME, size_cells, surface_metrics
from kinectbench.scoring.surface_kernels import cells_of, moments, nearest_cells, normal_agreement
from kinectbench.scoring.truth import PackedTruth

Bools = NDArray[np.bool_]
CUBE = (256, 256, 256)
RNG = np.random.default_rng(3)


def box(*corners: int) -> Bools:
    """Cells from corner to corner, ends included."""
    grid = np.zeros(CUBE, bool)
    x0, y0, z0, x1, y1, z1 = corners
    grid[x0 : x1 + 1, y0 : y1 + 1, z0 : z1 + 1] = True
    return grid


NOTHING, EVERYTHING = np.zeros(CUBE, bool), np.ones(CUBE, bool)


def truth_of(
    full: Bools, known: Bools = EVERYTHING, seen: Bools = NOTHING, sigma_m: float = 0.005
) -> PackedTruth:
    return PackedTruth(pack(full), pack(known), pack(seen), 0.004, sigma_m)


def measured(predicted: Bools, truth: PackedTruth, protocol: str = "known") -> SurfaceMetrics:
    return surface_metrics(pack(predicted), truth, [protocol])[protocol]


@pytest.mark.parametrize("share", [1e-6, 1e-4, 1e-3])
def test_nearest_is_exact_and_the_first_of_several(share: float) -> None:
    first, second = (RNG.random(CUBE, dtype=np.float32) < share for _ in range(2))
    first[0, 0, 0] = second[255, 255, 255] = second[7, 9, 250] = True  # never empty
    queries, targets = cells_of(pack(first)), cells_of(pack(second))
    np.testing.assert_array_equal(np.sort(queries.index), np.flatnonzero(first))
    squared, found = nearest_cells(queries, targets)
    points = np.argwhere(second)
    for n in RNG.integers(len(queries), size=60):
        offsets = points - np.unravel_index(queries.index[n], CUBE)
        away = (offsets**2).sum(axis=1)
        assert squared[n] == away.min()
        assert targets.index[found[n]] == np.ravel_multi_index(tuple(points[away.argmin()]), CUBE)


def test_normals_of_a_ball_and_of_thin_things() -> None:
    solid = ball((128.0, 127.3, 128.6), 60.0)
    cells = np.flatnonzero(unpack(packed_shell(pack(solid)))).astype(np.int32)
    inward = [128.0, 127.3, 128.6] - np.stack(np.unravel_index(cells, CUBE), axis=1) - 0.5
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    found = moments(pack(solid), cells)
    cosines = (found * inward).sum(axis=1) / np.linalg.norm(found.astype(float), axis=1)
    assert np.degrees(np.arccos(cosines)).max() < 12
    corner = moments(pack(EVERYTHING), np.array([0], np.int32))[0]
    assert corner.tolist() == [96, 96, 96]  # 4 * 4 * (1 + 2 + 3)
    full = box(0, 0, 0, 255, 3, 255)
    assert moments(pack(full), np.array([100 << 16 | 0 << 8 | 100], np.int32))[0].tolist() == [
        0,
        294,
        0,
    ]  # the most
    plate = box(100, 100, 9, 140, 140, 9)
    middle = np.array([120 << 16 | 120 << 8 | 9], np.int32)
    assert not moments(pack(plate), middle).any()


def test_normals_agree_whatever_their_lengths_and_signs() -> None:
    up, slant, none = ([[0, 0, 294]], [[3, 0, 4]], [[0, 0, 0]])
    pairs = [(up, up), (up, [[0, 0, -7]]), (up, slant), (up, none), (none, slant), (none, none)]
    first = np.array([row for (row,), _ in pairs], np.int16)
    second = np.array([row for _, (row,) in pairs], np.int16)
    back = np.arange(len(pairs))[::-1]
    cosines = normal_agreement(first, second[::-1], back)
    np.testing.assert_allclose(cosines, [1, 1, 0.8, 0, 0, 1], rtol=1e-15)


def test_two_plates_by_hand() -> None:
    """Boxes of 2 x 9 x 9 cells, one 3 cells beside the other: all distances are known."""
    values = measured(box(13, 50, 50, 14, 58, 58), truth_of(box(10, 50, 50, 11, 58, 58)))
    # every cell is a surface cell: half of each box is 2 cells from the other, half 3
    assert values.chamfer_mm == pytest.approx((2 + 3) / 2 * 4)
    assert values.surface_dice == 0.5  # 2 sigma is 10 mm: 2 cells are, 3 cells are not
    assert (values.f_score_10mm, values.f_score_20mm) == (0.5, 1.0)
    assert size_cells(pack(box(10, 50, 50, 11, 58, 58))) == math.sqrt(4 + 81 + 81)
    assert values.f_score_1pct == values.f_score_2pct == 0  # 0.13 and 0.26 cells


DIAGONAL_MM = math.sqrt(3) * 256 * 4
WORST = SurfaceMetrics(DIAGONAL_MM, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ONE = box(5, 6, 7, 5, 6, 7)
EDGES: dict[str, tuple[Bools, PackedTruth, SurfaceMetrics]] = {
    "both empty": (NOTHING, truth_of(NOTHING), SAME),
    "nothing predicted": (NOTHING, truth_of(ONE), WORST),
    "nothing there": (ONE, truth_of(NOTHING), WORST),
    "one voxel, the same": (ONE, truth_of(ONE), SAME),
    "full and full": (EVERYTHING, truth_of(EVERYTHING), SAME),
    "all unknown": (ONE, truth_of(EVERYTHING, known=NOTHING), SAME),
    "the surface is unknown": (ONE, truth_of(box(9, 9, 9, 20, 20, 20), known=ONE), WORST),
    "no sigma": (ONE, truth_of(ONE, sigma_m=0), SAME),
}


@pytest.mark.parametrize("name", list(EDGES))
def test_edges(name: str) -> None:
    predicted, truth, expected = EDGES[name]
    assert astuple(measured(predicted, truth)) == pytest.approx(astuple(expected))


def test_one_voxel_against_another() -> None:
    values = measured(box(5, 6, 7, 5, 6, 7), truth_of(box(5, 9, 3, 5, 9, 3)))
    assert values.chamfer_mm == pytest.approx(5 * 4)
    assert (values.f_score_20mm, values.f_score_10mm, values.normal_consistency) == (1, 0, 1)


def test_what_is_not_counted_does_not_matter() -> None:
    full = ball((120, 128, 128), 40)
    known = np.arange(256)[:, None, None] < 128
    truth = truth_of(full, known=np.broadcast_to(known, CUBE))
    assert measured(full | box(200, 100, 100, 230, 130, 130), truth) == measured(full, truth) == SAME


@pytest.mark.parametrize("seed", [0, 1])
def test_against_plain_numpy_and_a_tree(seed: int) -> None:
    rng = np.random.default_rng(seed)
    full = ball((120, 128, 130), 15) | box(100, 110, 110, 140, 114, 150)
    predicted = np.roll(full, 3 - seed, axis=seed) & ~box(120, 120, 120, 125, 140, 150)
    predicted |= rng.random(CUBE, dtype=np.float32) < 3e-6
    known, seen = rng.random(CUBE, dtype=np.float32) < 0.9, np.arange(256) < np.full(CUBE, 125)
    said = np.broadcast_to(np.arange(256) > 128, CUBE)
    truth = replace(truth_of(full, known, seen), others={"said": pack(said), "interior": pack(NOTHING)})
    masks = {"paper": EVERYTHING, "known": known, "occluded": known & ~seen}
    masks |= {"known-unsaid": known & ~said, "measured": known}
    found = surface_metrics(pack(predicted), truth, list(masks))
    surfaces = surface_of(predicted), surface_of(full)
    for protocol, mask in masks.items():
        trusted = known if protocol == "occluded" else mask
        lengths = truth.voxel_size_m, truth.surface_sigma_m
        expected = surface_reference(*surfaces, mask, trusted, *lengths)
        stated = {name: value for name, value in vars(found[protocol]).items() if value is not None}
        assert stated == pytest.approx(expected, abs=1e-9, rel=1e-9)


@pytest.mark.parametrize("threshold", [0.1, 0.3, 0.5, 0.85])
@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.bool_])
def test_occupied_compares_in_float64(threshold: float, dtype: type[np.generic]) -> None:
    values = np.array([threshold, np.nextafter(threshold, 0), np.nextafter(threshold, 1), 0, 1], np.float64)
    near = np.concatenate([values.astype(np.float16), np.nextafter(values.astype(np.float16), np.float16(1))])
    y = np.zeros(CUBE, dtype)
    y[0, 0, : len(near)] = near.astype(dtype)
    y[0, 1, :5] = values.astype(dtype)
    y[0, 2, 0] = dtype(-0.0)
    np.testing.assert_array_equal(unpack(occupied(y, threshold)), y.astype(np.float64) > threshold)


def test_occupied_of_a_small_cube() -> None:
    y = RNG.random((20, 20, 20)).astype(np.float32)
    for convention in ("half-pixel", "corner-aligned"):
        expected = upsample(y, convention=convention) > 0.4
        np.testing.assert_array_equal(unpack(occupied(y, 0.4, convention)), expected)
