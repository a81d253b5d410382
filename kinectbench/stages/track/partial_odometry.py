"""Let a build continue an odometry that was started during the recording.

The odometry of a frame depends only on the frames up to it, so it is the same whenever it is computed. An
earlier odometry is used only if its frames equal those of the sequence byte by byte.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from kinectbench.core.sequence import Sequence
from kinectbench.core.threads import ahead
from kinectbench.stages.ingest.sequence_folder import FolderFrames
from kinectbench.stages.track.odometry import Follower


@dataclass(frozen=True)
class PartialOdometry:
    """The odometry of the first frames of a sequence.

    Attributes:
        follower: the follower that has taken these frames.
        digests: digest of each of these frames, as `FolderFrames.digest` computes it.
    """

    follower: Follower
    digests: tuple[bytes, ...]


# Returns the earlier odometry; called when tracking starts.
Ask: TypeAlias = Callable[[], PartialOdometry | None]
_ask: ContextVar[Ask | None] = ContextVar("partial_odometry", default=None)


@contextmanager
def using_partial_odometry(ask: Ask) -> Iterator[None]:
    """Within the block, let the next tracked sequence continue an earlier odometry if the frames match.

    `ask` returns that odometry, or None; it is called when tracking starts.
    """
    token = _ask.set(ask)
    try:
        yield
    finally:
        _ask.reset(token)


def partial_odometry_of(sequence: Sequence) -> Follower | None:
    """Return the odometry of `using_partial_odometry` if its frames equal those of the sequence; else None.

    Only the first call within the block gets it.
    """
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
        and tuple(ahead(frames.digest, range(taken))) == partial.digests
    )
    maps.sequence = sequence
    return partial.follower if same else None
