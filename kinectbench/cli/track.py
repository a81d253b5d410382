"""`kinectbench track`: estimate trajectories, and compare them with a reference in TUM format."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinectbench.cli import console
from kinectbench.cli.build import build_recordings, exit_status, show_rows
from kinectbench.cli.common import Common, Ids, takes
from kinectbench.core import KinectBenchError

if TYPE_CHECKING:
    from kinectbench.core.sequence import GivenTrajectory
    from kinectbench.core.trajectory.clock_offset import ClockOffset
    from kinectbench.engine.summary import RecordingSummary
    from kinectbench.stages.track.comparison import TrajectoryComparison

# {key: title} of the shown figures of a comparison.
COMPARED = {
    "recording": "recording",
    "matched": "matched",
    "tracked_percent": "tracked %",
    "ate_rmse_mm": "ATE rmse mm",
    "ate_median_mm": "median",
    "ate_max_mm": "max",
    "rpe_frame_mm": "RPE mm/frame",
    "rpe_frame_deg": "°/frame",
    "rpe_metre_mm": "mm/m",
    "rpe_metre_deg": "°/m",
}
# Poses that differ less from the reference are the same, except for rounding.
SAME_M = 1e-6


@dataclass(frozen=True)
class _Compared:
    """The comparison of a recording's trajectory with the reference.

    Attributes:
        recording: the recording's id.
        comparison: the differences between the two trajectories.
        with_itself: whether the poses of the reference came with the recording, and `track` adopted them.
        picture: path of the plot.
    """

    recording: str
    comparison: "TrajectoryComparison"
    with_itself: bool
    picture: Path

    def json_value(self) -> dict[str, Any]:
        """Return the comparison as JSON values, in millimetres and degrees."""
        what = {"with_itself": self.with_itself, "picture": str(self.picture)}
        return {"recording": self.recording, **self.comparison.row(), **what}


@takes("config", "overrides", "jobs", "force", "wait", "verbose", "as_json")
def track_command(
    common: Common,
    ids: Ids = None,
    compare: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="tell ATE and RPE against a trajectory in TUM format, and plot it; "
            "one file for every recording named, so name the one that it is of",
        ),
    ] = None,
) -> int:
    """Give every frame a camera pose, and leave out frames that disagree with it."""
    from kinectbench.engine.summary import BuiltRecording

    # Report an unreadable file before building.
    reference = None if compare is None else _reference(compare)
    built_rows = build_recordings(common, ids, "track", ("track",) if common.force else ())
    rows = [each.summary for each in built_rows]
    compared: list[_Compared | None] = [None] * len(rows)
    if compare is not None and reference is not None:
        for index, row in enumerate(rows):
            if row.error is None:
                rows[index], compared[index] = _compare(row, common.root, reference, compare)
    if common.as_json:
        values = [row.json_value() for row in rows]
        if compare is not None:
            comparisons = [one and one.json_value() for one in compared]
            values = [value | {"comparison": one} for value, one in zip(values, comparisons, strict=True)]
        console.say_json(values)
    else:
        show_rows([BuiltRecording.of(row) for row in rows], "track")
        console.say(*_verdicts(rows))
        _show([one for one in compared if one is not None], compare)
    return exit_status([BuiltRecording.of(row) for row in rows])


def _reference(path: Path) -> "GivenTrajectory":
    from kinectbench.core.trajectory.trajectory_file import read_trajectory_file

    reference, warnings = read_trajectory_file(path)
    console.lines("warning", warnings, "yellow")
    return reference


def _compare(
    row: "RecordingSummary", root: Path, reference: "GivenTrajectory", name: Path
) -> "tuple[RecordingSummary, _Compared | None]":
    """Compare a recording's trajectory with the reference, and plot both.

    `root` is the benchmark's folder, `name` the path of the reference. Return the recording's summary and the
    comparison. If the comparison fails, return the summary with the error, and None.
    """
    from kinectbench.core import replaced_file
    from kinectbench.engine.steps import read_tracked
    from kinectbench.stages.track.comparison import compare_with
    from kinectbench.stages.track.pictures import COMPARISON

    build = root / "build" / row.recording
    picture = build / COMPARISON
    try:
        sequence, trajectory = read_tracked(build)
        comparison, png = compare_with(trajectory, reference)
        with replaced_file(picture) as temporary:
            temporary.write_bytes(png)
    except KinectBenchError as error:
        why = f"{name}: {error}"
        console.recording_lines(row.recording, "error", [why], "red")
        return row.model_copy(update={"error": why, "code": error.code, "status": "failed"}), None
    given = sequence.given_trajectory
    # If the reference's stamps lie between the frames', errors are not quite 0 although the poses are the
    # same.
    same = comparison.error.ate_m.max < SAME_M or (given is not None and given.equals(reference, SAME_M))
    itself = trajectory.source == "trust" and same
    return row, _Compared(row.recording, comparison, itself, picture)


def _verdicts(rows: "Sequence[RecordingSummary]") -> Iterator[str]:
    """Yield a line for each recording with a current trajectory: its verdict, and a better setting if any."""
    for row in rows:
        # A failed run may have left an older trajectory of other settings.
        if row.verdict is None or "track" not in (*row.made, *row.current):
            continue
        done = "ignore" if row.source == "tracked" else row.source
        better = row.recommended not in (None, done)
        advice = f"; recommended is `trajectory: {row.recommended}`" if better else ""
        yield f"{row.recording}: {row.verdict}{advice}"


def _clock_line(recording: str, clock: "ClockOffset") -> str:
    """Return a line on the reference's clock offset, its effect on ATE, and the setting that corrects it."""
    when = f"{abs(1000 * clock.late_s):.0f} ms {'late' if clock.late_s > 0 else 'early'}"
    return (
        f"{recording}: the stamps of the reference are {when}: moved by that, ATE is "
        f"{1000 * clock.ate_moved_m:.2f} mm, not {1000 * clock.ate_m:.2f}; if it is the recording's own "
        f"trajectory, put `camera: {{trajectory_delay_s: {clock.late_s:.3f}}}` into benchmark.yaml"
    )


def _show(compared: Sequence[_Compared], reference: Path | None) -> None:
    if not compared:
        return

    rows = [one.json_value() for one in compared]
    shown = [{**row, "tracked_percent": 100 * row["tracked_share"]} for row in rows]
    formats = {key: ".1f" if key == "tracked_percent" else ".2f" for key in COMPARED}
    console.out.print(console.text_table(shown, COMPARED, formats, title=f"against {reference}"))
    for one in compared:
        if one.with_itself:
            console.say(
                f"{one.recording}: these are the given poses themselves, which are trusted: "
                "the comparison says nothing of how right they are"
            )
        if (clock := one.comparison.clock) is not None:
            console.say(_clock_line(one.recording, clock))
        console.say(f"picture: {one.picture}")
