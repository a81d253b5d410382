"""A sequence that was begun while its recording was made, and goes on in its build.

What was written of a frame depends on its files alone. It counts only if these are the same files, unchanged.
"""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from kinectbench.stages.ingest.recording import FileRecording, FrameFiles, ListedFrame, Recording
from kinectbench.stages.ingest.sequence_writer import SequenceWriter, Watch

# Of a frame: its stamp, and of each of its files the name, the size and when it was changed.
FrameMark: TypeAlias = tuple[int, tuple[tuple[str, int, int], ...]]


@dataclass(frozen=True)
class PartialSequence:
    """The first frames of a recording, as `ingest` stores them.

    Attributes:
        writer: has taken them.
        marks: of each of them, from before it was read.
    """

    writer: SequenceWriter
    marks: tuple[FrameMark | None, ...]


# Asked for when the recording is to be stored.
Ask: TypeAlias = Callable[[], PartialSequence | None]
_ask: ContextVar[Ask | None] = ContextVar("partial_sequence", default=None)


@contextmanager
def using_partial_sequence(ask: Ask) -> Iterator[None]:
    """Within the block, the next recording that is stored goes on from what was written, if it is of it."""
    token = _ask.set(ask)
    try:
        yield
    finally:
        _ask.reset(token)


def partial_sequence() -> PartialSequence | None:
    """What was written so far; None: nothing. It is given out once."""
    ask = _ask.get()
    _ask.set(None)
    return ask() if ask else None


def frame_mark(place: ListedFrame) -> FrameMark | None:
    """Tells whether a frame's files are those of before; None without own files, or if one is gone."""
    if not isinstance(place, FrameFiles):
        return None
    files = [file for file in (place.depth, place.color, place.mask) if file is not None]
    try:
        stats = [(str(file), file.stat()) for file in files]
    except OSError:
        return None
    return place.stamp_ns, tuple((name, stat.st_size, stat.st_mtime_ns) for name, stat in stats)


def go_on_from(partial: PartialSequence, writer: SequenceWriter, watch: Watch | None = None) -> None:
    """Take over what was written before, if it is of the writer's recording.

    Args:
        partial: of its first frames.
        writer: has taken nothing.
        watch: is shown those of these frames that it wants.
    """
    before, recording = partial.writer, writer.checks.recording
    if not _is_of(partial, recording):
        return
    try:
        for row in before.rows:
            for name in (row.depth, row.color, row.mask):
                if name is not None:
                    _same_file(before.folder / name, writer.folder / name)
    except OSError:  # they are gone, or the disk is full: whoever writes them says so
        return
    writer.rows, writer.taken = before.rows, before.taken
    writer.checks = before.checks
    writer.checks.recording = recording
    for row in writer.rows if watch else ():
        assert watch is not None and row.recorded is not None
        if watch.wants(row.recorded):
            watch.see(row.recorded, recording.frame(row.recorded))


def _same_file(source: Path, target: Path) -> None:
    """Give a file a second name, or copy it where the disk keeps no second names."""
    target.parent.mkdir(exist_ok=True)
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)


def _is_of(partial: PartialSequence, recording: Recording) -> bool:
    """Whether the frames that were taken are the recording's first ones."""
    if stored_by(partial.writer.checks.recording) != stored_by(recording):
        return False
    places, marks = recording.places[: partial.writer.taken], partial.marks
    return len(places) == len(marks) and all(
        mark is not None and mark == frame_mark(place) for mark, place in zip(marks, places, strict=True)
    )


def stored_by(recording: Recording) -> tuple[object, ...]:
    """What the stored frames depend on besides their files."""
    color = recording.color_calibration
    colors = color and (color.camera, color.distortion, color.T_color_depth.tolist())
    codes: tuple[object, ...] = ()
    if isinstance(recording, FileRecording):
        codes = recording.depth_code, recording.float_scale, recording.channels, recording.kind
    whole = recording.path, recording.camera, recording.depth_scale, recording.color_registered
    return type(recording), *whole, colors, *codes
