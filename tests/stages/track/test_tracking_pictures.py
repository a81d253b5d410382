"""Pictures of trajectories: what is drawn where, and that nothing breaks when there is little to draw."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analytic_scenes import health_of, ring
from read_pictures import decoded_picture
from typed import present

from kinectbench.core.artefacts.trajectory import LoopClosure, TrajectoryHealth
from kinectbench.core.trajectory.compare import compare_poses
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.stages.track.pictures import (
    comparison_picture,
    covisibility_picture,
    health_picture,
    path_picture,
    timeline,
    write_pictures,
)

# The colours of pictures.py as RGB.
RED, BLUE, ORANGE = (213, 94, 0), (0, 114, 178), (230, 159, 0)
PAPER = (253, 252, 249)
MAX_BYTES = 150_000


def loop(a: int, b: int, believed: bool = True) -> dict[str, Any]:
    return {"a": a, "b": b, "believed": believed}


def trajectory_of(poses: np.ndarray, **changes: object) -> Trajectory:
    """With the health figures that are drawn; every third frame is a keyframe, the 60 compared see all."""
    n = len(poses)
    posed = np.isfinite(poses).all(axis=(1, 2))
    keyframes = [int(k) for k in np.flatnonzero(posed)[::3]]
    compared = keyframes[:: len(keyframes) // 60 + 1]
    figures = {
        "keyframes": keyframes,
        "loops": [],
        "lost_stretches": [],
        "rejected": [],
        "covisibility": {"keyframes": compared, "share": np.ones((len(compared),) * 2).tolist()},
        "per_frame": [
            {
                "frame": i,
                "state": "tracked" if posed[i] else "lost",
                "residual_mm": 3.0 + 0.1 * (i % 4) if posed[i] else None,
                "shift_mm": 1.0 if posed[i] else None,
                "inlier_share": 0.9 if posed[i] else None,
                "speed_m_per_s": 0.4 if posed[i] and i else None,
                "turn_rad_per_s": 0.3 if posed[i] and i else None,
                "blur": None,
            }
            for i in range(n)
        ],
        **{"source": "tracked", "verdict": "", "grade": "good", "frames": n, "tracked": int(posed.sum())},
        **changes,
    }
    stamps_ns = np.arange(n, dtype=np.int64) * 10**8
    return Trajectory(stamps_ns, poses, "tracked", health=TrajectoryHealth.parse(json.dumps(figures), "here"))


def panels_of(trajectory: Trajectory) -> bytes:
    return health_picture(present(trajectory.health), trajectory.stamps_ns)


def pixels(png: bytes) -> np.ndarray:
    """(height, width, 3) int RGB."""
    assert len(png) < MAX_BYTES
    image = decoded_picture(png)
    return np.asarray(image)[..., ::-1].astype(int)


def near(image: np.ndarray, color: tuple[int, int, int], reach: int = 40) -> np.ndarray:
    """Which pixels have a colour, but for the blending at edges: (height, width) bool."""
    near: np.ndarray = np.abs(image - np.array(color)).max(axis=2) < reach
    return near


@pytest.fixture(scope="module")
def orbit() -> np.ndarray:
    return ring(60, 1.5)


def test_three_files_and_the_same_bytes_again(orbit: np.ndarray, tmp_path: Path) -> None:
    trajectory = trajectory_of(orbit, loops=[loop(0, 57)])
    written = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_pictures(tmp_path / name, trajectory)
        written.append({path.name: path.read_bytes() for path in (tmp_path / name).iterdir()})
    assert set(written[0]) == {"trajectory.png", "health.png", "covisibility.png"}
    assert written[0] == written[1]
    for png in written[0].values():
        image = pixels(png)
        assert image.shape[1] > 500 and near(image, PAPER, 2).any()
        # A version of the library in the file would change the bytes.
        assert b"matplotlib" not in png.lower()


def test_a_circle_is_round(orbit: np.ndarray) -> None:
    """The dots of the frames, whose colours are none of the greys, span a square."""
    image = pixels(path_picture(trajectory_of(orbit, keyframes=[])))
    colored = (np.ptp(image, axis=2) > 60)[:, : int(image.shape[1] * 0.86)]  # without the colour bar
    rows, columns = np.nonzero(colored)
    assert np.ptp(rows) > 300
    assert np.ptp(rows) == pytest.approx(np.ptp(columns), abs=4)


def test_beside_a_narrow_path_the_picture_is_not_empty(caplog: pytest.LogCaptureFixture) -> None:
    poses = np.tile(np.eye(4), (30, 1, 1))
    poses[:, 2, 3] = np.linspace(0, 3, 30)
    image = pixels(path_picture(trajectory_of(poses)))
    columns = np.flatnonzero((~near(image, PAPER, 8)).any(axis=0))
    assert columns[0] < 0.04 * image.shape[1] and columns[-1] > 0.96 * image.shape[1]
    assert caplog.records == []  # matplotlib has nothing to complain about


def test_where_stamps_only_count_frames_there_are_no_seconds(orbit: np.ndarray) -> None:
    stamps_ns = np.array([0, 1, 2, 5], np.int64) * 10**9
    moments, when = timeline(stamps_ns)
    assert (moments.tolist(), when) == ([0, 1, 2, 3], "frame")
    moments, when = timeline(stamps_ns + np.array([0, 0, 0, 10**8]))
    assert (moments.tolist(), when) == ([0, 1, 2, 5.1], "time, s")
    # A nanosecond does not show, but the labels do.
    counted = replace(trajectory_of(orbit), stamps_ns=np.arange(60, dtype=np.int64) * 10**9)
    timed = replace(counted, stamps_ns=counted.stamps_ns + (np.arange(60) == 59))
    for picture in (path_picture, panels_of):
        assert picture(counted) != picture(timed)


def test_where_they_look_is_drawn_if_it_is_one_point(orbit: np.ndarray) -> None:
    """The cross at the centre of the circle is of the axes' meeting, and of nothing else."""

    def ink_in_the_middle(arc_deg: float | None) -> int:
        image = pixels(path_picture(trajectory_of(orbit, keyframes=[], arc_deg=arc_deg)))
        rows, columns = np.nonzero((np.ptp(image, axis=2) > 60)[:, : int(image.shape[1] * 0.86)])
        row, column = (int(edges.min() + edges.max()) // 2 for edges in (rows, columns))
        return int(near(image, (31, 35, 40), 90)[row - 9 : row + 10, column - 9 : column + 10].sum())

    assert ink_in_the_middle(354.0) > 10 and ink_in_the_middle(None) == 0


def test_loops_lost_stretches_and_frames_left_out_are_drawn(orbit: np.ndarray) -> None:
    plain = pixels(path_picture(trajectory_of(orbit)))
    assert not near(plain, RED).any() and not near(plain, ORANGE, 20).any()
    poses = orbit.copy()
    poses[20:30] = np.nan
    lost = {"first_frame": 20, "last_frame": 29}
    assert near(pixels(path_picture(trajectory_of(poses, lost_stretches=[lost]))), RED).sum() > 50
    left_out = trajectory_of(poses, rejected=[{"frame": 25}])
    assert near(pixels(path_picture(left_out)), RED).sum() > 10
    # A loop across the circle: blended with the white ground by its transparency.
    across = pixels(path_picture(trajectory_of(orbit, loops=[loop(0, 30)])))
    assert (near(across, (102, 170, 209), 45) & ~near(plain, (102, 170, 209), 45)).sum() > 150
    doubted = pixels(path_picture(trajectory_of(orbit, loops=[loop(0, 30, False)])))
    assert (near(doubted, (240, 197, 102), 45) & ~near(plain, (240, 197, 102), 45)).sum() > 80


@pytest.mark.parametrize("lost", [range(0, 6), range(20, 40), range(54, 60)])
def test_the_lost_stretch_is_shaded_where_it_is(orbit: np.ndarray, lost: range) -> None:
    poses = orbit.copy()
    poses[list(lost)] = np.nan
    image = pixels(panels_of(trajectory_of(poses)))
    curve_rows = near(image, BLUE).any(axis=1)
    shade = near(image, (246, 220, 199), 12)[curve_rows]
    columns = np.flatnonzero(shade.mean(axis=0) > 0.5)
    # The axes leave a margin of a twentieth of the time on either side.
    frame = near(image[curve_rows], (255, 255, 255), 3) | shade | near(image[curve_rows], BLUE)
    inside = np.flatnonzero(frame.mean(axis=0) > 0.5)
    left, width = inside[0], np.ptp(inside)
    seconds = (columns[[0, -1]] - left) / width * 5.9 * 1.1 - 0.05 * 5.9
    expected = np.clip([lost[0] - 0.5, lost[-1] + 0.5], 0, 59) / 10
    np.testing.assert_allclose(seconds, expected, atol=0.06)


def test_frames_left_out_and_found_again_are_marked(orbit: np.ndarray) -> None:
    trajectory = trajectory_of(orbit)
    rows = present(trajectory.health).json_value()["per_frame"]
    for row in rows[30:40]:  # found once: one line
        row["state"] = "relocalised"
    rows[10]["state"] = rows[11]["state"] = "rejected"
    for row in rows:
        row["inlier_share"] = None  # its curve has the colour of the mark
    image = pixels(panels_of(trajectory_of(orbit, per_frame=rows)))
    before = pixels(panels_of(trajectory))
    greenish = image[..., 1] - image[..., 0] > 60
    lines = np.flatnonzero(greenish.sum(axis=0) > 300)  # down through all panels
    assert 1 <= len(lines) <= 3 and np.ptp(lines) <= 2
    shade = (249, 235, 199)
    assert near(image, shade, 10).sum() > 1000 > near(before, shade, 10).sum()


def test_covisibility_is_the_matrix() -> None:
    """Three keyframes: the first two see each other by half, the third sees nobody."""
    share = [[1, 0.5, 0], [0.5, 1, 0], [0, 0, 1]]
    health = health_of(30, covisibility={"keyframes": [0, 10, 20], "share": share})
    image = pixels(covisibility_picture(health))
    from matplotlib import colormaps

    full, half, none = ((255 * np.array(colormaps["cividis"](v)[:3])).astype(int) for v in (1.0, 0.5, 0.0))
    area = [near(image[:, : int(image.shape[1] * 0.8)], tuple(c), 6).sum() for c in (full, half, none)]
    assert area[0] > 10_000
    assert area[1] / area[0] == pytest.approx(2 / 3, rel=0.03)
    assert area[2] / area[0] == pytest.approx(4 / 3, rel=0.03)
    loops = (LoopClosure(**loop(1, 19)), LoopClosure(**loop(0, 10, False)))
    looped = pixels(covisibility_picture(health.model_copy(update={"loops": loops})))
    assert near(looped, RED).sum() > 10 and not near(image, RED).any()


@pytest.mark.parametrize("n", [1, 2])
def test_very_short_recordings(n: int, tmp_path: Path) -> None:
    write_pictures(tmp_path, trajectory_of(ring(8, 1.5)[:n]))
    for path in tmp_path.iterdir():
        assert pixels(path.read_bytes()).std() > 5


def test_everything_lost(tmp_path: Path) -> None:
    trajectory = trajectory_of(
        np.full((5, 4, 4), np.nan), lost_stretches=[{"first_frame": 0, "last_frame": 4}]
    )
    write_pictures(tmp_path, trajectory)
    images = {path.name: pixels(path.read_bytes()) for path in tmp_path.iterdir()}
    assert near(images["health.png"], (246, 220, 199), 12).sum() > 20_000  # shaded all over
    assert not near(images["trajectory.png"], RED).any()


def test_long_recordings_stay_small(tmp_path: Path) -> None:
    """10,000 frames, twice around, with figures that jump about."""
    rng = np.random.default_rng(0)
    poses = np.concatenate([ring(5000, 1.5)] * 2)
    poses[:, :3, 3] += rng.normal(scale=0.02, size=(10_000, 3))
    rows = [
        {
            **row,
            "residual_mm": float(r),
            "inlier_share": float(s),
            "blur": float(b),
            "speed_m_per_s": float(b),
        }
        for row, r, s, b in zip(
            present(trajectory_of(poses).health).json_value()["per_frame"],
            rng.uniform(2, 6, 10_000),
            rng.uniform(0.7, 1, 10_000),
            rng.uniform(0.5, 2, 10_000),
            strict=True,
        )
    ]
    few = np.arange(0, 10_000, 170)
    seen = {"keyframes": few.tolist(), "share": rng.uniform(size=(len(few), len(few))).tolist()}
    loops = [loop(int(a), int(a) + 5000) for a in rng.integers(0, 5000, 1000)]
    write_pictures(tmp_path, trajectory_of(poses, per_frame=rows, covisibility=seen, loops=loops))
    for path in tmp_path.iterdir():
        assert path.stat().st_size < MAX_BYTES, path.name


def test_comparison_shows_both_paths_and_the_errors(orbit: np.ndarray) -> None:
    estimate = orbit.copy()
    estimate[:, :3, 3] += np.random.default_rng(0).normal(scale=0.005, size=(60, 3))
    time_s = np.arange(60) / 10
    png = comparison_picture(compare_poses(estimate, orbit), estimate, orbit, time_s, "time, s")
    image = pixels(png)
    assert near(image, (138, 143, 152), 10).sum() > 500  # the reference
    assert near(image, BLUE).sum() > 300 and near(image, RED, 80).sum() > 50
    exact, again = (
        comparison_picture(compare_poses(orbit, orbit), orbit, orbit, time_s, "time, s") for _ in range(2)
    )
    assert exact != png and again == exact
