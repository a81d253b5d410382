"""Every bar of the tracker in one table, from the rows that were measured."""

from collections.abc import Callable, Sequence

import numpy as np
from figures import Figure, at_least, at_most, equals, stated
from tracking_cases import (
    DEPTH_ONLY,
    GROUPS,
    KITCHEN_STRIDES,
    ODOMETRY,
    OURS,
    REAL,
    REFINE,
    SIMULATED,
    SLAM,
    TIME,
    TIMED_FRAMES,
    Bar,
)
from tracking_recordings import OBJECTS
from tracking_rows import Row

MAX_CPU_MS, MAX_GROWTH, MAX_PEAK_MB = 60.0, 1.2, 2000.0
# The kitchen's reference is an estimate itself.
KITCHEN_FACTOR = 1.1
MIN_CPU_RATIO = 4.0
EXPECTED = {group: len(OBJECTS) for group in SIMULATED} | {"kitchen": len(KITCHEN_STRIDES), "cabinet": 1}
NOT_MEASURED = "not measured"


def bar_figures(rows: Sequence[Row]) -> list[Figure]:
    """The bars, in the order of the groups; a part that was not measured is stated as such."""
    figures: list[Figure] = []
    for group in GROUPS:
        of_group = [row for row in rows if row.case.group == group]
        for method in (OURS, DEPTH_ONLY):
            if group in EXPECTED and (method == OURS or group == "orbit"):
                figures += _accuracy(group, method, [row for row in of_group if row.method == method])
    return [*figures, _refined(rows), *_against_rivals(rows), *_time(rows)]


def markdown(figures: Sequence[Figure]) -> str:
    """The table."""
    verdicts = {True: "yes", False: "**falls short**", None: ""}
    lines = ["| what | measured | bar | holds |", "|---|---|---|---|"]
    for figure in figures:
        value = f"{figure.value:.4g}" if isinstance(figure.value, float) else str(figure.value)
        lines.append(f"| {figure.name} | {value} | {figure.bar or ''} | {verdicts[figure.met]} |")
    return "\n".join(lines)


def _accuracy(group: str, method: str, rows: list[Row]) -> list[Figure]:
    """The worst of a group in each figure."""
    what = group if method == OURS else f"{group}, depth only"
    if not rows:
        return [stated(what, NOT_MEASURED)]
    bar = rows[0].case.bars[method]
    assert isinstance(bar, Bar)
    found = f"{what} ({len(rows)} of {EXPECTED[group]})"
    figures = [_worst(f"{found}: ATE, mm", rows, Row.ate_mm, at_most, bar.ate_mm)]
    if bar.rpe_mm_per_m is not None:
        rpe_bar = bar.rpe_mm_per_m
        figures.append(_worst(f"{found}: RPE, mm/m", rows, lambda row: row.rpe_mm_per_m, at_most, rpe_bar))
    figures.append(_worst(f"{found}: share tracked", rows, lambda row: row.share, at_least, bar.share))
    unnamed = sum(row.outcome.unnamed for row in rows)
    figures.append(equals(f"{found}: frames lost and not reported", unnamed, 0))
    passed = sum(not row.short_of(bar) for row in rows)
    return [*figures, stated(f"{found}: recordings that hold all", passed)]


def _worst(
    what: str,
    rows: list[Row],
    value: Callable[[Row], float],
    held: Callable[[str, float, float], Figure],
    bar: float,
) -> Figure:
    """The largest value, or for `at_least` the smallest; NaN is worse than any number."""
    sign = 1 if held is at_most else -1
    worst = max(rows, key=lambda row: np.inf if np.isnan(value(row)) else sign * value(row))
    return held(f"{what}, worst: {worst.case.name}", value(worst), bar)


def _refined(rows: Sequence[Row]) -> Figure:
    """The refined trajectory's residual between distant frames against the given one's."""
    what = "cabinet, refine: point-to-plane residual between distant frames, mm"
    row = next((row for row in rows if row.method == REFINE), None)
    if row is None or not row.outcome.more:
        return stated(what, NOT_MEASURED if row is None else row.outcome.problem)
    more = row.outcome.more
    refined, given = more["refined_residual_mm"], more["given_residual_mm"]
    shares = f"{more['refined_share']:.1%} of the points compared; given {more['given_share']:.1%}"
    return Figure(f"{what} ({shares})", refined, f"< {given:.4g}", bool(refined < given))


def _against_rivals(rows: Sequence[Row]) -> list[Figure]:
    """On how many recordings we are better than each rival, and the CPU time of the slower one."""
    ours = {row.case.name: row for row in rows if row.method == OURS}
    figures: list[Figure] = []
    for method in (SLAM, ODOMETRY):
        for kind in ("simulated", *REAL[:2]):
            theirs = [row for row in rows if row.method == method and _kind(row) == kind]
            theirs = [row for row in theirs if row.case.name in ours]
            factor = KITCHEN_FACTOR if kind == "kitchen" else 1.0
            what = f"{kind}: recordings with a lower ATE than Open3D's {method}"
            what += f" times {factor}" if factor != 1 else ""
            if not theirs:
                figures.append(stated(what, NOT_MEASURED))
                continue
            lost = [row.case.name for row in theirs if not beaten(ours[row.case.name], row, factor)]
            what += f" (not on {', '.join(lost)})" if lost else ""
            figures.append(equals(what, len(theirs) - len(lost), len(theirs)))
    slam = [row for row in rows if row.method == SLAM and row.case.name in ours]
    both = [(ours[row.case.name], row) for row in slam]
    ratios = {t.case.name: t.cpu_ms / o.cpu_ms for o, t in both if o.posed.any() and t.posed.any()}
    if not ratios:
        return [*figures, stated(f"CPU time of {SLAM} to ours", NOT_MEASURED)]
    least = min(ratios, key=ratios.__getitem__)
    words = f"CPU time per frame of {SLAM} to ours, least of {len(ratios)}: {least}"
    return [*figures, at_least(words, ratios[least], MIN_CPU_RATIO)]


def beaten(ours: Row, theirs: Row, factor: float) -> bool:
    """Whether our ATE is lower than theirs times a factor, over the frames that both have.

    A rival that gave up early is so compared where it still went well. Where it has no poses to compare,
    having some is better.
    """
    both = ours.posed & theirs.posed
    our_mm, their_mm = ours.ate_mm(both), theirs.ate_mm(both)
    if np.isnan(our_mm):
        return ours.share > theirs.share
    return bool(our_mm < their_mm if factor == 1 else our_mm <= factor * their_mm)


def _kind(row: Row) -> str:
    return "simulated" if row.case.group in SIMULATED else row.case.group


def _time(rows: Sequence[Row]) -> list[Figure]:
    """Time and memory on one long recording and its beginnings."""
    timed = {row.case.first: row for row in rows if row.case.group == TIME and row.posed.any()}
    short, middle, long = (timed.get(frames) for frames in TIMED_FRAMES)
    first, second, third = TIMED_FRAMES
    names = (
        f"CPU time per frame at {second} frames, ms",
        f"CPU time per frame at {third} frames to that at {first}",
        f"peak memory at {third} frames, MB",
    )
    return [
        at_most(names[0], middle.cpu_ms, MAX_CPU_MS) if middle else stated(names[0], NOT_MEASURED),
        at_most(names[1], long.cpu_ms / short.cpu_ms, MAX_GROWTH)
        if long and short
        else stated(names[1], NOT_MEASURED),
        at_most(names[2], long.outcome.peak_mb, MAX_PEAK_MB) if long else stated(names[2], NOT_MEASURED),
    ]
