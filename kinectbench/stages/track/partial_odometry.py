"""Odometry that began while a recording was made, and goes on in its build.

The odometry of a frame depends on the frames up to it alone, so that it is the same whenever it is computed.
What was done before counts only if its frames are those of the sequence, byte by byte.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from kinectbench.core.sequence import Sequence
from kinectbench.stages.ingest.sequence_folder import FolderFrames
from kinectbench.stages.track.odometry import Follower


@dataclass(frozen=True)
class PartialOdometry:
    """The odometry of a sequence's first frames.

    Attributes:
        follower: has taken them.
        digests: of each of them, as `FolderFrames.digest` gives it.
    """

    follower: Follower
    digests: tuple[bytes, ...]


# Asked for when the frames are to be tracked.
Ask: TypeAlias = Callable[[], PartialOdometry | None]
_ask: ContextVar[Ask | None] = ContextVar("partial_odometry", default=None)


@contextmanager
def using_partial_odometry(ask: Ask) -> Iterator[None]:
    """Within the block, the next sequence that is tracked goes on from what was done, if it is of it."""
    token = _ask.set(ask)
    try:
        yield
    finally:
        _ask.reset(token)


def partial_odometry_of(sequence: Sequence) -> Follower | None:
    """What was done of a sequence, with the frames of the sequence; None: nothing. It is given out once."""
    ask, frames = _ask.get(), sequence.frames
    _ask.set(None)
    partial = ask() if ask and isinstance(frames, FolderFrames) else None
    if partial is None or not isinstance(frames, FolderFrames):
        return None
    maps, taken = partial.follower.maps, len(partial.digests)
    of = maps.sequence
    same = (
        (of.camera, of.depth_scale, of.color_registered)
        == (sequence.camera, sequence.depth_scale, sequence.color_registered)
        and taken <= len(sequence)
        and np.array_equal(of.stamps_ns[:taken], sequence.stamps_ns[:taken])
        and all(frames.digest(index) == digest for index, digest in enumerate(partial.digests))
    )
    maps.sequence = sequence
    return partial.follower if same else None
