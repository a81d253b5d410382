"""Plots of a trajectory: path from above, health over time, covisibility, and errors."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from kinectbench.core.artefacts.trajectory import TrajectoryHealth
from kinectbench.core.even_choice import evenly
from kinectbench.core.pictures import INK, PLOT_PAPER, SOFT, figure_png, new_figure
from kinectbench.core.sequence import counts_frames
from kinectbench.core.trajectory.compare import TrajectoryError
from kinectbench.core.trajectory.coverage import convergence_point, from_above
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float64

# File of the picture by `track --compare`, in `build/<recording>/`.
COMPARISON = "compare.png"
# Blue, orange, vermilion and green of Okabe and Ito, which colour-blind people distinguish.
BLUE, ORANGE, RED, GREEN = "#0072b2", "#e69f00", "#d55e00", "#009e73"
TIME_COLORS = "viridis"
# Largest numbers to draw: more would cover one another.
ARROWS, MAX_LOOPS_DRAWN, MAX_KEYFRAMES_DRAWN = 24, 200, 150
# Smallest half-width of the axes, so that the noise of a camera that hardly moves does not fill the picture.
MIN_REACH_M = 0.25
NOTHING = "no frame has a pose"
TIME, FRAME = "time, s", "frame"


def write_pictures(folder: Path, trajectory: Trajectory) -> None:
    """Write trajectory.png and, if the trajectory has its health, health.png and covisibility.png."""
    (folder / "trajectory.png").write_bytes(path_picture(trajectory))
    if trajectory.health is not None:
        (folder / "health.png").write_bytes(health_picture(trajectory.health, trajectory.stamps_ns))
        (folder / "covisibility.png").write_bytes(covisibility_picture(trajectory.health))


def timeline(stamps_ns: NDArray[np.int64]) -> tuple[Float64, str]:
    """Return the horizontal axis for plots over frames, and its label.

    Args:
        stamps_ns: (n,) stamps of the sequence, n > 0.

    Returns:
        (n,) seconds since the first frame, or frame indices if the recording has no times; and the label.
    """
    if counts_frames(stamps_ns):
        return np.arange(len(stamps_ns), dtype=np.float64), FRAME
    return (stamps_ns - stamps_ns[0]) / 1e9, TIME


def path_picture(trajectory: Trajectory) -> bytes:
    """Plot the cameras from above, the first one's viewing direction upwards; return a PNG file.

    The picture shows time (colour), keyframes (at most 150, with 24 viewing directions), loops and lost
    stretches; and the point where the optical axes meet, if the health has an arc. Axes are in metres from
    the first camera with a pose.
    """
    figure = new_figure(6.6, 5.6, margins=(0.11, 0.14, 0.1, 0.02))
    axes = figure.add_subplot(xlabel="right, m", ylabel="ahead, m")
    # A narrow path is padded by wider axis limits, not by an empty margin.
    axes.set_aspect("equal", adjustable="datalim")
    good = trajectory.good_frames
    if not len(good):
        _say(axes, NOTHING)
        return figure_png(figure)
    T = trajectory.T_world_camera
    R_above_world = from_above(T[good])
    places = (T[:, :3, 3] - T[good[0], :3, 3]) @ R_above_world.T
    moments, when = timeline(trajectory.stamps_ns)
    health = trajectory.health
    if health is not None:
        _draw_gaps(axes, places, good, health)
        _draw_loops(axes, places, health)
    x, y = places[good, :2].T
    points = axes.scatter(x, y, c=moments[good], s=7, cmap=TIME_COLORS, linewidths=0, zorder=3)
    figure.colorbar(points, label=when, shrink=0.8, fraction=0.05, pad=0.03)
    keyframes = np.intersect1d([] if health is None else health.keyframes, good).astype(np.int64)
    if len(keyframes):
        # More circles than this would hide the path.
        keyframes = keyframes[evenly(len(keyframes), MAX_KEYFRAMES_DRAWN)]
        axes.plot(*places[keyframes, :2].T, "o", color=INK, markersize=3.6, fillstyle="none",
                  markeredgewidth=0.8, label="keyframes", zorder=4)  # fmt: skip
        some = keyframes[evenly(len(keyframes), ARROWS)]
        looks = T[some, :3, 2] @ R_above_world.T
        axes.quiver(*places[some, :2].T, *looks[:, :2].T, color=SOFT, width=0.003, scale=18, zorder=2)
    shown = places[good, :2]
    if health is not None and health.arc_rad is not None:
        meeting = (convergence_point(T[good]) - T[good[0], :3, 3]) @ R_above_world.T
        axes.plot(*meeting[:2], "+", color=INK, markersize=9, label="where they look")
        shown = np.concatenate([shown, meeting[None, :2]])
    _fit(axes, shown)
    if axes.get_legend_handles_labels()[0]:
        figure.legend(loc="lower center", ncols=6, frameon=False, fontsize=8)
    return figure_png(figure)


def health_picture(health: TrajectoryHealth, stamps_ns: NDArray[np.int64]) -> bytes:
    """Plot residual, inlier ratio, speed, turn rate and blur of each frame over time; return a PNG file.

    Without stamps the horizontal axis is the frame index. Frames without a pose are shaded; a line marks
    where the camera was found again. The health has a row for each frame.
    """
    rows = health.per_frame
    moments, when = timeline(stamps_ns)
    speed, turn = ("step, m", "turn, °") if when == FRAME else ("speed, m/s", "turn, °/s")
    panels = (
        ("residual_m", "residual, mm", BLUE, 1000.0),
        ("inlier_share", "inliers, %", GREEN, 100.0),
        ("speed_m_per_s", speed, INK, 1.0),
        ("turn_rad_per_s", turn, INK, 180 / np.pi),
        ("blur", "blur, × median", ORANGE, 1.0),
    )
    figure = new_figure(8.6, 6.8, margins=(0.09, 0.08, 0.01, 0.05))
    grid = figure.subplots(len(panels), 1, sharex=True)
    for axes, (key, label, color, unit) in zip(grid, panels, strict=True):
        # Unknown values, None, become NaN.
        values = unit * np.array([getattr(row, key) for row in rows], np.float64)
        _mark_states(axes, moments, [row.state for row in rows])
        if np.isfinite(values).any():
            axes.plot(moments, values, ".-", color=color, linewidth=0.8, markersize=2.5)
            # A few outliers must not flatten the rest.
            top = 1.15 * min(float(np.nanmax(values)), 4 * float(np.nanmedian(values)) + 1e-9)
            axes.set_ylim(0, 102 if key == "inlier_share" else max(top, 1e-3))
        else:
            _say(axes, "not known")
        axes.set_ylabel(label, fontsize=9)
        axes.tick_params(labelsize=8)
    grid[-1].set_xlabel(when)
    figure.align_ylabels(grid)
    handles, labels = grid[0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="upper right", ncols=3, frameon=False, fontsize=8)
    return figure_png(figure)


def covisibility_picture(health: TrajectoryHealth) -> bytes:
    """Plot the share of each keyframe's points that each other one sees, and the loops; return a PNG file."""
    figure = new_figure(5.6, 4.8, margins=(0.11, 0.11, 0.03, 0.07))
    axes = figure.add_subplot(xlabel="… that this keyframe sees", ylabel="points of this keyframe …")
    keyframes = np.array(health.covisibility.keyframes, np.int64)
    if not len(keyframes):
        _say(axes, "no keyframe has a pose")
        return figure_png(figure)
    shares = 100 * np.array(health.covisibility.share, np.float64)
    image = axes.imshow(shares, cmap="cividis", vmin=0, vmax=100, interpolation="nearest")
    figure.colorbar(image, label="points, %", shrink=0.9)
    if accepted := [row for row in health.loops if row.believed]:
        ends = np.array([(row.a, row.b) for row in accepted])
        # Only some keyframes have a row; a loop is drawn at the nearest rows.
        at = np.abs(ends[..., None] - keyframes).argmin(axis=-1)
        axes.plot(*np.concatenate([at, at[:, ::-1]]).T, "s", color=RED, markersize=3.5, fillstyle="none",
                  markeredgewidth=0.9, label="loops")  # fmt: skip
        figure.legend(loc="upper right", frameon=False, fontsize=8)
    ticks = evenly(len(keyframes), 7)
    axes.set_xticks(ticks, [str(keyframes[t]) for t in ticks], fontsize=8)
    axes.set_yticks(ticks, [str(keyframes[t]) for t in ticks], fontsize=8)
    return figure_png(figure)


def comparison_picture(
    error: TrajectoryError,
    T_world_camera_estimate: Float64,
    T_world_camera_reference: Float64,
    moments: Float64,
    when: str,
) -> bytes:
    """Plot a trajectory aligned to a reference, from above, and its errors over time; return a PNG file.

    Args:
        error: errors of these poses.
        T_world_camera_estimate: (n, 4, 4) the matched poses of the trajectory.
        T_world_camera_reference: (n, 4, 4) the matched poses of the reference.
        moments: (n,) the horizontal axis of the errors, from `timeline`.
        when: label of this axis.
    """
    figure = new_figure(6.6, 7.2)
    above, below = figure.subplots(2, 1, height_ratios=(3, 1))
    R_above_world = from_above(T_world_camera_reference)
    origin = T_world_camera_reference[0, :3, 3]
    aligned = error.T_reference_estimate @ T_world_camera_estimate
    reference, estimate = (
        (T[:, :3, 3] - origin) @ R_above_world.T for T in (T_world_camera_reference, aligned)
    )
    errors_mm = 1000 * error.position_errors_m
    above.plot(*reference[:, :2].T, color=SOFT, linewidth=1.4, label="reference")
    x, y = estimate[:, :2].T
    points = above.scatter(x, y, c=errors_mm, s=10, cmap="plasma_r", vmin=0,
                           vmax=max(float(errors_mm.max()), 0.1), linewidths=0, zorder=3,
                           label="trajectory, aligned")  # fmt: skip
    figure.colorbar(points, ax=above, label="position error, mm", shrink=0.8)
    above.set(xlabel="right, m", ylabel="ahead, m", aspect="equal")
    _fit(above, np.concatenate([reference[:, :2], estimate[:, :2]]))
    _legend(above)
    below.plot(moments, errors_mm, ".-", color=BLUE, linewidth=0.8, markersize=2.5)
    below.axhline(1000 * error.ate_m.rmse, color=RED, linewidth=1, linestyle="--", label="rmse")
    below.set(xlabel=when, ylabel="error, mm", ylim=(0, None))
    _legend(below)
    return figure_png(figure)


def _draw_gaps(axes: Axes, places: Float64, good: NDArray[np.int64], health: TrajectoryHealth) -> None:
    """Draw dotted lines over lost stretches, and crosses at the interpolated places of rejected frames."""
    label = "lost"
    for row in health.lost_stretches:
        ends = [*good[good < row.first_frame][-1:], *good[good > row.last_frame][:1]]
        axes.plot(*places[ends, :2].T, ":", color=RED, linewidth=1.8, marker="o", markersize=5,
                  fillstyle="none", label=label, zorder=5)  # fmt: skip
        label = "_"
    rejected = [row.frame for row in health.rejected]
    if rejected:
        between = [np.interp(rejected, good, places[good, axis]) for axis in range(2)]
        axes.plot(*between, "x", color=RED, markersize=5, label="left out", zorder=4)


def _draw_loops(axes: Axes, places: Float64, health: TrajectoryHealth) -> None:
    for wanted, color, style, label in ((True, BLUE, "-", "loops"), (False, ORANGE, "--", "uncertain loops")):
        rows = [row for row in health.loops if row.believed is wanted]
        every = -(-len(rows) // MAX_LOOPS_DRAWN) or 1
        for row in rows[::every]:
            axes.plot(*places[[row.a, row.b], :2].T, style, color=color, linewidth=0.7, alpha=0.6,
                      label=label, zorder=1)  # fmt: skip
            label = "_"


def _mark_states(axes: Axes, moments: Float64, states: Sequence[str]) -> None:
    """Shade frames without a pose, up to half-way to their neighbours; mark relocalisations."""
    edges = np.concatenate([moments[:1], (moments[:-1] + moments[1:]) / 2, moments[-1:]])
    for state, color, label in (("lost", RED, "lost"), ("rejected", ORANGE, "left out")):
        for first, last in _runs(states, state):
            axes.axvspan(edges[first], edges[last + 1], color=color, alpha=0.22, linewidth=0, label=label)
            label = "_"
    label = "found again"
    for first, _ in _runs(states, "relocalised"):
        axes.axvline(moments[first], color=GREEN, linewidth=1.5, label=label)
        label = "_"


def _runs(states: Sequence[str], state: str) -> list[tuple[int, int]]:
    """Return first and last index of each run of consecutive frames in a state."""
    indices = np.flatnonzero(np.array(states) == state)
    runs = np.split(indices, np.flatnonzero(np.diff(indices) > 1) + 1)
    return [(int(run[0]), int(run[-1])) for run in runs if len(run)]


def _fit(axes: Axes, points_m: Float64) -> None:
    """Set axis limits that show all points (n, 2), metres, with a margin; at least half a metre wide."""
    low_m, high_m = points_m.min(axis=0), points_m.max(axis=0)
    reach_m = np.maximum(0.56 * (high_m - low_m), MIN_REACH_M)
    left, bottom = (low_m + high_m) / 2 - reach_m
    right, top = (low_m + high_m) / 2 + reach_m
    # `auto` lets the limits change to keep the axes equal; nothing drawn later would move them.
    axes.set_xlim(left, right, auto=True)
    axes.set_ylim(bottom, top, auto=True)


def _say(axes: Axes, text: str) -> None:
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=SOFT)
    axes.set(xticks=[], yticks=[])


def _legend(axes: Axes) -> None:
    axes.legend(loc="best", frameon=True, framealpha=0.85, edgecolor="none", facecolor=PLOT_PAPER, fontsize=8)
