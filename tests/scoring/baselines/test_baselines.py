"""The baselines: hulls against every half-space, files that the scorer accepts, figures that can be known."""

import json
import shutil
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raising import raises
from scipy.spatial import ConvexHull
from slow import slow
from synthetic_release import ball, synthetic_pair
from typed import present

from kinectbench._version import __version__
from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.artefacts.object import FloorFile
from kinectbench.core.artefacts.targets import sums_text
from kinectbench.core.errors import ReleaseError, SettingsError
from kinectbench.core.storage import sha256_file
from kinectbench.core.voxels.convex_hull import filled_hull
from kinectbench.core.voxels.pair_file import Pair, PairInput, pack, read_pair, unpack
from kinectbench.core.voxels.resample import reduce_blocks
from kinectbench.release.release import Release
from kinectbench.report.run import write_galleries
from kinectbench.scoring.baselines import registry
from kinectbench.scoring.baselines.in_grids import comparison_baselines, score_baselines
from kinectbench.scoring.baselines.inputs import Inputs, TrainingTruth, read_training, up_in_grid
from kinectbench.scoring.baselines.kernels import mirror_gain
from kinectbench.scoring.baselines.predict import BaselineTask, possible_baselines, predicted, write_baselines
from kinectbench.scoring.baselines.registry import BASELINES, constant, empty, mean_shape, nearest, partial
from kinectbench.scoring.prediction_file import load_prediction
from kinectbench.scoring.predictions import check, split_methods
from kinectbench.scoring.score import score, score_methods

PAIR = synthetic_pair(0, "chair")
UP = np.array([0.0, -1.0, 0.0])
LEFT_OUT = ("mean-shape", "nearest")  # the release has no training pairs


@pytest.fixture(scope="module")
def few(release: Release) -> Release:
    """The release with a pair of each category and split, of its seven."""
    of = {(target.category, target.split): target for target in reversed(release.targets)}.values()
    return Release(release.folder, tuple(reversed(of)), release.metadata)


@pytest.fixture(scope="module")
def written(few: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every possible baseline's files, not to be changed."""
    made = write_baselines(few, folder := tmp_path_factory.mktemp("baselines"))
    assert made == possible_baselines(few)
    return folder


def input_of(pair: Pair) -> PairInput:
    """What a baseline gets of a pair: no truth."""
    return PairInput(**{field.name: getattr(pair, field.name) for field in fields(PairInput)})


def inputs(pair: Pair = PAIR, base_rate: float = 0.1) -> Inputs:
    return Inputs(input_of(pair), base_rate, UP, None)


@pytest.mark.parametrize("seed", range(6))
def test_hull_is_exact(seed: int) -> None:
    occupied = np.random.default_rng(seed).random((14, 17, 12)) < 0.01 + 0.01 * seed
    cells = np.argwhere(np.ones_like(occupied))
    planes = ConvexHull(np.argwhere(occupied)).equations
    inside = (cells @ planes[:, :3].T + planes[:, 3] <= 1e-9).all(axis=1)
    np.testing.assert_array_equal(filled_hull(occupied).ravel(), inside)


def test_hull_of_a_box_and_of_a_ball() -> None:
    box = np.zeros((20, 20, 20), bool)
    box[3, 4, 5] = box[3, 4, 15] = box[3, 12, 5] = box[10, 4, 5] = box[10, 12, 15] = True
    box[3, 12, 15] = box[10, 4, 15] = box[10, 12, 5] = True
    assert filled_hull(box).sum() == 8 * 9 * 11
    solid = ball((128, 128, 128), 60.3)
    front = solid & ~np.roll(solid, 1, axis=2)
    half = filled_hull(front)
    assert not (half & ~solid).any() and not (front & ~half).any()
    assert half.sum() == pytest.approx(solid.sum() / 2, rel=0.03)


@pytest.mark.parametrize(
    "cells", [[], [(1, 2, 3)], [(1, 2, 3), (4, 4, 4)], [(0, 0, 5), (9, 0, 5), (0, 9, 5), (9, 9, 5)]]
)
def test_flat_partials_are_their_own_hull(cells: list[tuple[int, int, int]]) -> None:
    occupied = np.zeros((10, 10, 10), bool)
    for cell in cells:
        occupied[cell] = True
    np.testing.assert_array_equal(filled_hull(occupied), occupied)


def test_baselines_look_at_the_input_only() -> None:
    nothing = np.zeros_like(PAIR.full)
    blind = replace(PAIR, full=nothing, shell=nothing, known=nothing)
    for name in [name for name in BASELINES if name not in LEFT_OUT]:
        before, baseline = pack(unpack(PAIR.partial_256)), BASELINES[name]
        np.testing.assert_array_equal(baseline(inputs(blind)), baseline(inputs()), err_msg=name)
        np.testing.assert_array_equal(PAIR.partial_256, before)


def test_trivial() -> None:
    assert not empty(inputs()).any()
    assert constant(inputs(PAIR, 0.123))[0, 0, 0] == np.float16(0.123)
    assert constant(inputs(PAIR, 0.0)).min() > 0 and constant(inputs(PAIR, 1.0)).max() < 1
    np.testing.assert_array_equal(partial(inputs()), unpack(PAIR.partial_256))


def test_written_baselines_are_a_valid_submission(few: Release, written: Path) -> None:
    methods = split_methods(written, few.targets)
    assert list(methods) == sorted(set(BASELINES) - set(LEFT_OUT))
    tables = {}
    for name, folder in methods.items():
        assert check(few, folder) == []
        if name in ("mirror", "silhouette"):
            continue  # nothing is known of their figures
        tables[name] = score(few, folder, method=name, protocols=["paper", "known"], surface=False)
    rows = {
        (name, row.protocol): row
        for name, table in tables.items()
        for row in table.rows
        if row.category == "chair"
    }
    assert rows["empty", "known"].iou == 0
    constant_row = rows["base-rate", "paper"]
    assert constant_row.ce == pytest.approx(constant_row.base_rate_ce, rel=1e-3)
    assert present(rows["hull", "known"].iou) > present(rows["partial", "known"].iou) > 0
    assert rows["partial", "known"].precision == pytest.approx(0.5, abs=0.05)  # cells at the surface


@pytest.mark.slow  # test_release_alone.py says so of the command
def test_same_bytes_with_any_number_of_workers(few: Release, tmp_path: Path) -> None:
    names = ["base-rate", "partial"]
    write_baselines(few, tmp_path / "a", names)
    write_baselines(few, tmp_path / "b", names, jobs=2)
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.npz"))
    assert len(files) == 2 * 4
    assert all((tmp_path / "a" / f).read_bytes() == (tmp_path / "b" / f).read_bytes() for f in files)
    assert load_prediction(tmp_path / "a" / files[0]).shape == (16, 16, 16)


def test_baselines_say_which_release_they_are_for(few: Release, written: Path, tmp_path: Path) -> None:
    """Those of another release are told where they are scored; a run that was stopped says nothing."""
    for name in possible_baselines(few):
        method = MethodFile.read(written / name)
        assert (method.name, method.benchmark_sha256) == (name, few.benchmark_sha256)
        assert method.version == f"kinectbench {__version__}"
    assert check(few, written / "partial") == []
    other = Release(few.folder, few.targets, few.metadata.model_copy(update={"benchmark_sha256": "0" * 64}))
    shutil.copytree(written / "partial", tmp_path / "partial")
    (line,) = check(other, tmp_path / "partial")
    assert "the predictions are for another release" in line
    missing = replace(few.targets[0], file="pairs/none.npz")
    with pytest.raises(ReleaseError):
        write_baselines(Release(few.folder, (missing, *few.targets[1:]), few.metadata), tmp_path, ["partial"])
    assert MethodFile.read(tmp_path / "partial").benchmark_sha256 is None


def test_unknown_baseline(release: Release, tmp_path: Path) -> None:
    with raises(SettingsError, "settings.wrong-value", match="'hul'"):
        write_baselines(release, tmp_path, ["hul"])
    with raises(SettingsError, "settings.truth-held-back"):
        write_baselines(release, tmp_path, ["nearest"])


def test_the_carved_hull_has_nothing_that_was_seen_to_be_empty() -> None:
    whole, carved = registry.hull(inputs()), registry.carved_hull(inputs())
    surface, seen = unpack(PAIR.partial_256), unpack(PAIR.seen)
    assert not (carved & seen & ~surface).any() and not (surface & ~carved).any()
    assert not (carved & ~whole).any()


def test_silhouette_of_a_plate_is_a_pyramid() -> None:
    plate = np.zeros((64, 64, 64), bool)
    plate[20:44, 24:40, 10] = True
    camera = np.array([31.5, 31.5, -54.0])  # 64 cells before the plate
    filled = registry.extruded(plate, camera)
    cells = np.argwhere(np.ones_like(plate)).astype(float)
    behind = cells[:, 2] >= 10
    scale = 64 / np.maximum(cells[:, 2] - camera[2], 1)
    at = camera[:2] + (cells[:, :2] - camera[:2]) * scale[:, None]
    exact = behind & (np.abs(at[:, 0] - 31.5) < 12) & (np.abs(at[:, 1] - 31.5) < 8)
    wrong = filled.ravel() != exact
    edge = np.minimum(np.abs(np.abs(at[:, 0] - 31.5) - 12), np.abs(np.abs(at[:, 1] - 31.5) - 8))
    assert not (wrong & (edge > 0.5)).any()
    assert filled[:, :, 63].sum() > 1.5 * plate.sum()  # it grows with the distance
    ahead = registry.extruded(plate, np.array([31.5, 31.5, 5.0]))  # the camera is in the grid: straight on
    assert ahead[:, :, 63].sum() == plate.sum()


def test_silhouette_holds_the_partial_and_the_shape_behind_it() -> None:
    T_world_camera = PAIR.T_world_grid.copy()  # far before the grid: rays along z
    T_world_camera[:3, 3] += PAIR.T_world_grid[:3, :3] @ np.array([128, 128, -1e5]) * PAIR.voxel_size_m
    front = (full := unpack(PAIR.full)) & (full.argmax(axis=2)[..., None] + 1 >= np.arange(256))
    solid = registry.silhouette(inputs(replace(PAIR, T_world_camera=T_world_camera, partial_256=pack(front))))
    assert (solid & front).sum() == front.sum()
    assert (solid & full).sum() > 0.9 * full.sum()


def test_the_mirror_plane_of_a_box() -> None:
    """Two sides of an upright box: the corner is seen, the planes of symmetry are known."""
    shape, partial = np.zeros((2, 256, 256, 256), bool)
    shape[60:181, 40:200, 80:141] = True
    partial[60:181, 40:200, 80:82] = True
    partial[60:62, 40:200, 80:141] = True
    reduce = np.asarray(partial.reshape(64, 4, 64, 4, 64, 4).any(axis=(1, 3, 5)))
    empty_seen = ~np.asarray(shape.reshape(64, 4, 64, 4, 64, 4).any(axis=(1, 3, 5)))
    points = np.argwhere(partial) + np.float64(0.5)
    normal, offset = registry.best_plane(points, reduce, empty_seen, UP)
    image = registry.mirrored(points, normal, offset)
    assert abs(normal[1]) < 1e-9
    cells = np.clip(np.floor(image).astype(int), 0, 255)
    assert shape[tuple(cells.T)].mean() > 0.9
    np.testing.assert_allclose(registry.mirrored(image, normal, offset), points)


@pytest.mark.parametrize("hand", [1, -1])
def test_the_mirror_plane_is_found_on_either_side(hand: int) -> None:
    """One slope of a roof is given, and the other, across x = 150 or its mirror image, is to be hit."""
    roof, other = np.zeros((2, 256, 256, 256), bool)
    for x in range(104, 144):
        roof[x, 60:180, x - 24 : x - 20] = True
    other[45:] = roof[255:44:-1]  # x becomes 300 - x
    given, wanted = roof[::hand], other[::hand]
    reduced = np.asarray(wanted.reshape(64, 4, 64, 4, 64, 4).any(axis=(1, 3, 5)))
    points = np.argwhere(given) + np.float64(0.5)
    image = registry.mirrored(points, *registry.best_plane(points, reduced, ~reduced, UP))
    cells = np.floor(image / 4).astype(int).clip(0, 63)
    assert reduced[tuple(cells.T)].mean() > 0.9


def test_mirror_adds_to_the_partial() -> None:
    cut = np.arange(256)[:, None, None] < 140  # the rest is hidden: nothing was seen there
    front = unpack(PAIR.partial_256) & cut
    halved = replace(
        PAIR,
        partial_256=pack(front),
        partial=pack(reduce_blocks(front, "any")),
        seen=pack(unpack(PAIR.seen) & cut),
    )
    found = registry.mirror(inputs(halved))
    assert (found & front).sum() == front.sum() and found.sum() > front.sum()


def test_up_is_away_from_the_floor(release: Release, tmp_path: Path) -> None:
    pair = read_pair(release.pair_path(target := release.targets[0]))
    (folder := tmp_path / "objects" / target.recording).mkdir(parents=True)

    def up() -> Any:
        files = {file.relative_to(tmp_path).as_posix(): sha256_file(file) for file in folder.iterdir()}
        (tmp_path / "SHA256SUMS").write_text(sums_text(files | {"targets.csv": "0" * 64}))
        return up_in_grid(Release(tmp_path, release.targets, release.metadata), target, input_of(pair))

    assert up().tolist() == UP.tolist()
    plane, T = np.array([0, 0, 2, -1]), np.eye(4)
    (floor := FloorFile(plane_world=plane, T_floor_world=T, noise_m=0, inlier_share=1)).write(folder)
    np.testing.assert_allclose(pair.T_world_grid[:3, :3] @ up(), [0, 0, 1], atol=1e-12)
    flat = floor.model_copy(update={"plane_world": np.array([0, 0, 0, 1.0])}).text()
    for text in ("[", "{}", flat, flat.replace("0.0", '"a"', 1), flat.replace('"inlier_share"', '"other"')):
        (folder / "floor.json").write_text(text)
        with raises(ReleaseError, "release.damaged", match="floor"):
            up()


def test_baselines_that_learn(release: Release) -> None:
    """The validation split plays the training split."""
    targets = tuple(
        replace(target, split="train") for target in release.targets if target.split == "validation"
    )
    trained = Release(release.folder, targets, release.metadata)
    training = read_training(trained, "chair")
    assert isinstance(training, TrainingTruth) and read_training(release, "chair") is None
    pairs = [read_pair(trained.pair_path(target)) for target in targets if target.category == "chair"]
    blocks = [unpack(pair.full).reshape(64, 4, 64, 4, 64, 4).mean(axis=(1, 3, 5)) for pair in pairs]
    given = replace(inputs(pairs[1]), training=training)
    np.testing.assert_allclose(mean_shape(given), np.mean(blocks, axis=0), atol=1e-3)
    np.testing.assert_array_equal(nearest(given), unpack(pairs[1].full))
    task = BaselineTask(trained, next(t for t in targets if t.category == "chair"), 0.1, LEFT_OUT)
    for name, prediction in predicted(task):
        np.testing.assert_array_equal(
            prediction, BASELINES[name](replace(inputs(pairs[0]), training=training))
        )


def plain_extruded(partial: np.ndarray, camera_cells: np.ndarray) -> np.ndarray:
    """`extruded`, plane by plane in numpy, for a camera before the grid."""
    count = len(partial)
    far, cells = np.linspace(-0.5, count - 0.5, 512), np.arange(count)
    hit, filled = np.zeros((512, 512), bool), partial.copy()
    for k in range(count):
        share = (k - camera_cells[2]) / (count - 1 - camera_cells[2])
        crossings = [camera_cells[axis] * (1 - share) + far * share for axis in (0, 1)]
        i, j = (np.clip(np.rint(at).astype(int), 0, count - 1) for at in crossings)
        inside = np.outer(np.abs(i - crossings[0]) <= 0.5, np.abs(j - crossings[1]) <= 0.5)
        hit |= partial[:, :, k][np.ix_(i, j)] & inside
        rays = [
            np.rint(((cells - camera_cells[a] * (1 - share)) / share + 0.5) / count * 511) for a in (0, 1)
        ]
        p, q = (np.clip(found, 0, 511).astype(int) for found in rays)
        filled[:, :, k] |= hit[np.ix_(p, q)] & np.outer(rays[0] == p, rays[1] == q)
    return filled


@pytest.mark.parametrize("camera", [(30.0, 35.0, -40.0), (-20.0, 90.0, -5.0), (32.0, 32.0, -900.0)])
def test_silhouette_plane_by_plane(camera: tuple[float, float, float]) -> None:
    partial = np.random.default_rng(5).random((64, 64, 64)) < 0.003
    partial[:, :, :9] = False
    found = registry.extruded(partial, np.array(camera))
    np.testing.assert_array_equal(found, plain_extruded(partial, np.array(camera)))
    assert found.sum() > 3 * partial.sum()


def test_mirror_gain_by_hand() -> None:
    rng = np.random.default_rng(6)
    points, gain = rng.random((200, 3)) * 80 - 4, rng.integers(-1, 2, (18, 18, 18)).astype(np.int8)
    normal = np.array([0.6, 0.0, 0.8])
    cells = np.floor(registry.mirrored(points, normal, 40.0) / 4).astype(int)
    expected = sum(int(gain[tuple(cell)]) if ((cell >= 0) & (cell < 18)).all() else -1 for cell in cells)
    assert mirror_gain(points, points @ normal, normal, 40.0, 4, gain) == expected


@pytest.mark.parametrize("upsampling", [slow("half-pixel"), "corner-aligned"])
def test_baselines_beside_are_what_their_files_score(
    few: Release, written: Path, tmp_path: Path, upsampling: str
) -> None:
    names = possible_baselines(few)
    beside: dict[str, Any] = {"protocols": ["known", "paper"], "upsampling": upsampling}
    found = comparison_baselines(few, tmp_path / "scores", **beside, without=["hull"])
    assert [table.method for table in found] == [name for name in names if name != "hull"]
    for table in found:
        folder = written / table.method
        expected = score(few, folder, method=table.method, surface=False, **beside)
        assert table.baseline and not expected.baseline
        same = {"baseline": False, "hashes": {}}
        assert table.model_copy(update=same) == expected.model_copy(update={"hashes": {}})
        assert table.settings == expected.settings


@pytest.mark.parametrize(("fixed", "surface"), [(False, True), (True, False), slow(True, True)])
def test_baselines_scored_in_memory_have_the_rows_of_their_files(
    few: Release, written: Path, tmp_path: Path, fixed: bool, surface: bool
) -> None:
    """Voxel and surface metrics, thresholds, averages, CSV and gallery are the same to the byte."""
    file = tmp_path / "thresholds.json"
    file.write_text('{"thresholds": {"chair": 0.3, "table": 0.7}}')
    protocols = ["known"] if surface and not fixed else ["known", "paper"]
    settings: dict[str, Any] = {
        "protocols": protocols,
        "thresholds_file": file if fixed else None,
        "surface": surface,
    }
    done: list[tuple[int, int]] = []
    found = score_baselines(few, tmp_path / "a", **settings, progress=lambda *step: done.append(step))
    expected = score_methods(few, written, tmp_path / "b", **settings)
    names = {*possible_baselines(few)}
    assert {table.method for table in found} == names == {table.method for table in expected}
    pairs = len(few.split("test")) + (0 if fixed else len(few.split("validation")))
    assert done == [(n + 1, pairs) for n in range(pairs)]
    write_galleries(few, None, found, tmp_path / "a", "half-pixel")
    write_galleries(few, written, expected, tmp_path / "b", "half-pixel")
    of_files = {table.method: table for table in expected}
    for table in found:
        ours, theirs = (tmp_path / root / table.method for root in "ab")
        assert (ours / "scores.csv").read_bytes() == (theirs / "scores.csv").read_bytes()
        told, other = (json.loads((folder / "scores.json").read_text()) for folder in (ours, theirs))
        hashes = told.pop("hashes"), other.pop("hashes")
        assert told == other
        assert [{**of, "prediction": None} for of in hashes[1].values()] == [*hashes[0].values()]
        galleries = [np.load(folder / "gallery.npz") for folder in (ours, theirs)]
        for key in ("pairs", "cells"):
            np.testing.assert_array_equal(galleries[0][key], galleries[1][key])
        assert (table.rows[0].chamfer_mm is not None) == surface
        assert of_files[table.method].rows == table.rows


def test_baselines_beside_are_kept(few: Release, tmp_path: Path) -> None:
    calls: list[int] = []

    def made(protocols: list[str]) -> int:
        """How many pairs are counted."""
        calls.clear()
        dear = ["hull", "carved-hull", "mirror", "silhouette"]
        told: dict[str, Any] = {"progress": lambda done, _: calls.append(done)}
        comparison_baselines(few, tmp_path, protocols=protocols, without=dear, **told)
        return len(calls)

    assert made(["known"]) == len(few.targets)
    kept = tmp_path / "baselines" / "partial" / "scores.json"
    first = kept.read_bytes()
    assert made(["known"]) == 0
    kept.write_text("{")
    assert made(["known"]) == len(few.targets) and kept.read_bytes() == first
    assert made(["paper"]) == len(few.targets)
