"""A recording as an unwritten `Sequence`: frames are read again at each access."""

from collections.abc import Callable
from collections.abc import Sequence as Items

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.sequence import Sequence
from kinectbench.stages.ingest.plausibility import trajectory_problem
from kinectbench.stages.ingest.recording import RawFrame, Recording
from kinectbench.stages.ingest.sequence_folder import onto_depth


def as_sequence(recording: Recording, indices: Items[int]) -> Sequence:
    """Some frames of a recording, with the depth and colour that `write_sequence` would write.

    Args:
        recording: that was opened.
        indices: of the frames, increasing; none of them damaged.

    Returns:
        Their sequence; colour that does not lie on depth is left out.
    """
    problem = trajectory_problem(recording)
    register = onto_depth(recording)
    return Sequence(
        camera=recording.camera,
        depth_scale=recording.depth_scale,
        stamps_ns=recording.stamps_ns[list(indices)],
        color_registered=recording.color_registered or register is not None,
        given_trajectory=None if problem else recording.given_trajectory,
        trajectory_error=problem,
        frames=_RecordedFrames(recording, indices, register),
    )


class _RecordedFrames:
    """Frames of an open recording; caches the last one, whose colour is read next."""

    def __init__(
        self, recording: Recording, indices: Items[int], register: Callable[[RawFrame], RawFrame] | None
    ) -> None:
        self._recording, self._indices, self._register = recording, indices, register
        self._last: tuple[int, RawFrame] | None = None

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        """Depth of one frame as recorded: (height, width) uint16, 0 = no measurement."""
        return self._frame(index).depth

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        """Encoded colour of one frame: (suffix, bytes); None if it is not registered to depth."""
        if self._register is not None:
            return self._register(self._frame(index)).color
        return self._frame(index).color if self._recording.color_registered else None

    def _frame(self, index: int) -> RawFrame:
        if self._last is None or self._last[0] != index:
            self._last = (index, self._recording.frame(self._indices[index]))
        return self._last[1]
