"""Print the warnings of a build: the most important first, and those on input that has no effect."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from kinectbench.cli import console
from kinectbench.core import listed

if TYPE_CHECKING:
    from kinectbench.engine.stages import Job


def tell_warnings(name: str, own: Sequence[str], first: str | None, show_all: str) -> None:
    """Print a recording's most important warning `first`, those on unused input, and the number of others.

    `own` has all of its warnings; without `first`, all are printed. `kinectbench <show_all>` is the command
    that prints all.
    """
    if first is None or first not in own:
        console.recording_lines(name, "warning", own, "yellow")
        return
    console.recording_lines(name, "do this first", [first], "yellow")
    # Somebody who has just drawn a mask expects it to be used.
    without_effect = [line for line in own if ": not used" in line and line != first]
    console.recording_lines(name, "warning", without_effect, "yellow")
    more = len(own) - 1 - len(without_effect)
    if not more:
        return
    shown = f"shown by `kinectbench {show_all}`, by the report and by --json"
    console.recording_lines(name, "note", [f"{more} more warning{'s' * (more > 1)}: {shown}"], "yellow")


def unused_inputs(job: "Job", upto: str) -> tuple[str, ...]:
    """Return warnings on unused input: masks not named in benchmark.yaml, or `pick` beside `segment_by`."""
    own, views = job.recording, upto in ("sample-views", "pairs")
    name, lines = own.id, list[str]()
    if own.pick and own.segment_by and (views or upto == "segment"):
        lines.append(f"pick: not used with `segment_by: {own.segment_by}`; remove one of them")
    if views and job.unused_masks is not None:
        to_do = f"add `masks: masks/{name}` to {name} in benchmark.yaml to use it"
        lines.append(f"{job.unused_masks}: not used; {to_do}")
    return tuple(lines)


def tell_unknown_categories(jobs: "Sequence[Job]") -> None:
    """Print a warning about recordings whose category is still the placeholder that `init` writes."""
    from kinectbench.settings.template import UNKNOWN_CATEGORY

    chosen = [job.recording for job in jobs]
    unknown = [recording.id for recording in chosen if recording.category == UNKNOWN_CATEGORY]
    if unknown:
        which = "every recording" if len(unknown) == len(chosen) > 1 else listed(unknown)
        line = f"no category is stated: set `category` in benchmark.yaml, such as chair or table ({which})"
        console.lines("warning", [line], "yellow")
