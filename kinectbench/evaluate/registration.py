"""Where a build and the truth meet: which frame is which, and how their worlds lie to each other."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.errors import RecordingError
from kinectbench.evaluate.build import Build
from kinectbench.geometry import invert_rigid
from kinectbench.simulate.truth import Truth
from kinectbench.tracking.compare import align_worlds, has_pose, match_stamps

NS_PER_S = 10**9


@dataclass(frozen=True)
class Registration:
    """A build beside its truth.

    Attributes:
        true_frame: (n,) int64, for each frame of the build's sequence the frame of the truth, -1 for none.
        shown: (n,) bool, the true camera of that frame is known: it has a frame of the truth, and shows
            no other scene.
        T_truth_built: (4, 4), from the build's world to the truth's; the identity if not aligned.
        aligned: whether it was found from the trajectories.
    """

    true_frame: NDArray[np.int64]
    shown: NDArray[np.bool_]
    T_truth_built: NDArray[np.float64]
    aligned: bool

    @property
    def T_built_truth(self) -> NDArray[np.float64]:
        """(4, 4), from the truth's world to the build's."""
        return invert_rigid(self.T_truth_built)


def register(build: Build, truth: Truth, align: bool = True) -> Registration:
    """Match frames by stamp, and the worlds by the trajectories.

    A recording without a given trajectory has the world of its first camera; one with a given trajectory
    has the world of the truth, up to that trajectory's errors. Both are aligned as for ATE.

    Args:
        build: as far as it was built.
        truth: of the same recording.
        align: False leaves the worlds as they are.

    Raises:
        RecordingError: no frame of the build is one of the truth.
    """
    true_frame = true_frames(build.stamps_ns, truth.stamps_ns)
    matched = true_frame >= 0
    if not matched.any():
        raise RecordingError(
            f"{truth.folder}: no frame of the build has the stamp of a frame of this truth; "
            "is it the truth of this recording?"
        )
    shown = matched & has_pose(truth.T_world_camera)[true_frame]
    if not shown.any():
        raise RecordingError(f"{truth.folder}: every frame shows another scene; there is nothing to compare")
    T_truth_built = np.eye(4)
    usable = shown.copy()
    if build.trajectory is not None:
        usable &= has_pose(build.trajectory.T_world_camera)
    aligned = align and build.trajectory is not None and bool(usable.any())
    if aligned and build.trajectory is not None:
        T_truth_built = align_worlds(
            build.trajectory.T_world_camera[usable], truth.T_world_camera[true_frame[usable]]
        )
    return Registration(true_frame, shown, T_truth_built, aligned)


def true_frames(stamps_ns: NDArray[np.int64], truth_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """For each frame of a sequence its frame in the truth, -1 for none: (n,) int64.

    By stamp; a sequence whose recording has no stamps counts its frames in seconds, so its stamps are
    the frames' numbers.

    Args:
        stamps_ns: (n,) of the sequence.
        truth_ns: (m,) of the truth.
    """
    result = np.full(len(stamps_ns), -1, dtype=np.int64)
    numbers, rest = np.divmod(stamps_ns, NS_PER_S)
    counted = not rest.any() and numbers.min() >= 0 and numbers.max() < len(truth_ns)
    if counted and not np.isin(stamps_ns, truth_ns).any():
        return numbers
    built, true = match_stamps(stamps_ns, truth_ns)
    result[built] = true
    return result
