"""Let a build continue from the sequence that was stored while the recording was still being made.

A stored frame depends only on the files of that frame in the recording. It is used only if these files are
unchanged.
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
from kinectbench.stages.ingest.sequence_writer import SequenceWriter

# For a frame: its stamp; and for each of its files the name, the size and the time of the last change.
FrameMark: TypeAlias = tuple[int, tuple[tuple[str, int, int], ...]]


@dataclass(frozen=True)
class PartialSequence:
    """The first frames of a recording, already stored as the stage `ingest` stores them.

    Attributes:
        writer: the writer that has taken these frames.
        marks: for each frame its stamp, and its files' names, sizes and times, taken before the frame was
            read; None if a file was missing.
    """

    writer: SequenceWriter
    marks: tuple[FrameMark | None, ...]


# Returns the earlier sequence; called when the recording is to be stored.
Ask: TypeAlias = Callable[[], PartialSequence | None]
_ask: ContextVar[Ask | None] = ContextVar("partial_sequence", default=None)


@contextmanager
def using_partial_sequence(ask: Ask) -> Iterator[None]:
    """Within the block, let the next recording that is stored reuse the frames of `ask()`, if they match."""
    token = _ask.set(ask)
    try:
        yield
    finally:
        _ask.reset(token)


def partial_sequence() -> PartialSequence | None:
    """Return the sequence that the enclosing `using_partial_sequence` offers.

    The result is None if there is no such block, if the block has no sequence, or if this was called before.
    """
    ask = _ask.get()
    _ask.set(None)
    return ask() if ask else None


def frame_mark(place: ListedFrame) -> FrameMark | None:
    """Identify a frame's files by name, size and time; None if one is missing or the frame has no files."""
    if not isinstance(place, FrameFiles):
        return None
    files = [file for file in (place.depth, place.color, place.mask) if file is not None]
    try:
        stats = [(str(file), file.stat()) for file in files]
    except OSError:
        return None
    return place.stamp_ns, tuple((name, stat.st_size, stat.st_mtime_ns) for name, stat in stats)


def go_on_from(partial: PartialSequence, writer: SequenceWriter) -> None:
    """Copy the frames of an earlier sequence to a new writer, if they belong to the writer's recording.

    The writer must have taken no frame yet.
    """
    before, recording = partial.writer, writer.checks.recording
    if not _is_of(partial, recording):
        return
    try:
        for row in before.rows:
            for name in (row.depth, row.color, row.mask):
                if name is not None:
                    _same_file(before.folder / name, writer.folder / name)
    except OSError:  # files are gone or the disk is full: writing them reports it
        return
    writer.rows, writer.taken, writer.depth_digests = before.rows, before.taken, before.depth_digests
    writer.checks = before.checks
    writer.checks.recording = recording


def _same_file(source: Path, target: Path) -> None:
    """Hard-link a file, or copy it if the disk has no hard links."""
    target.parent.mkdir(exist_ok=True)
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)


def _is_of(partial: PartialSequence, recording: Recording) -> bool:
    """Whether an earlier sequence holds the first frames of this recording, from unchanged files."""
    if stored_by(partial.writer.checks.recording) != stored_by(recording):
        return False
    places, marks = recording.places[: partial.writer.taken], partial.marks
    return len(places) == len(marks) and all(
        mark is not None and mark == frame_mark(place) for mark, place in zip(marks, places, strict=True)
    )


def stored_by(recording: Recording) -> tuple[object, ...]:
    """Return the values that, besides the files, determine how frames are stored: camera, scales, path etc.

    Settings that only one format has are not included, such as the lowest confidence of a phone's depth.
    """
    color = recording.color_calibration
    colors = color and (color.camera, color.distortion, color.T_color_depth.tolist())
    codes: tuple[object, ...] = ()
    if isinstance(recording, FileRecording):
        codes = recording.depth_code, recording.channels, recording.kind
    whole = recording.path, recording.camera, recording.depth_scale, recording.float_scale
    return type(recording), *whole, recording.color_registered, colors, *codes
