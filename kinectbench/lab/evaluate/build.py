"""Read the build of one recording, and register its frames and its world frame to the simulator's truth."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import RecordingError, StorageError
from kinectbench.core.artefacts.solid_method import SolidMethod
from kinectbench.core.geometry import Camera, TriangleMesh, invert_rigid, read_own_ply
from kinectbench.core.images import read_gray
from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.compare import align_worlds, has_pose, match_stamps
from kinectbench.core.trajectory.trajectory import Trajectory, read_trajectory
from kinectbench.core.types import Float32
from kinectbench.core.voxels.pair_file import Pair, read_pair
from kinectbench.engine.failures import stored_failure
from kinectbench.engine.pipeline import STAGE_NAMES
from kinectbench.engine.stages import current_stages
from kinectbench.lab.simulate.truth import Truth
from kinectbench.stages.ingest.sequence_folder import read_sequence
from kinectbench.stages.sample_views.views import View, read_views
from kinectbench.stages.segment.object_model import ObjectModel, read_object

NS_PER_S = 10**9


@dataclass(frozen=True)
class Build:
    """The built artefacts of one recording; an attribute is None if its stage was not built.

    Attributes:
        stamps_ns: (n,) int64, stamps of the sequence's frames.
        camera: intrinsics of the depth images.
        depth_m: function from a frame index to its depth: (height, width) float32, metres, 0 = none.
        trajectory: the tracked poses, one per frame.
        given: the trajectory that came with the recording, as stored; or None.
        scene: function without arguments that reads the fused mesh of the whole scene, in the trajectory's
            world frame.
        model: the object, a closed mesh and labelled voxels, in the trajectory's world frame.
        views: the frames that were chosen as single depth views of the object.
        valid_depth: function that returns the mask of a view's pixels that have depth: (height, width) bool.
        pair_names: names of the views that became pairs.
        pair: function from a view's name to its pair.
    """

    stamps_ns: NDArray[np.int64]
    camera: Camera
    depth_m: Callable[[int], Float32]
    trajectory: Trajectory | None
    given: GivenTrajectory | None
    scene: Callable[[], TriangleMesh] | None
    model: ObjectModel | None
    views: tuple[View, ...] | None
    valid_depth: Callable[[View], NDArray[np.bool_]]
    pair_names: tuple[str, ...] | None
    pair: Callable[[str], Pair]

    @property
    def limits(self) -> SensorLimits | None:
        """Limits of the sensor's resolution, range and positions used for free space; None if unknown."""
        method = None if self.model is None else self.model.quality.method
        return method.air.limits if isinstance(method, SolidMethod) and method.air is not None else None


def read_build(folder: Path) -> Build:
    """Open the folder `build/<recording>/`; depth images and pairs are read only when needed.

    A stage that is not current (see `current_stages`) counts as not built: other settings or another version
    of the package may have made it. Nor does a stage that failed in the last run, nor what follows it: what
    lies there was made before, by other settings.

    Raises:
        StorageError: the folder has no build, or an outdated one, or an artefact is damaged.
    """
    current, failed = current_stages(folder), stored_failure(folder)
    if failed is not None and failed.stage in STAGE_NAMES:
        made = STAGE_NAMES[: STAGE_NAMES.index(failed.stage)]
        current = {name: path for name, path in current.items() if name in made}
    if "ingest" not in current:
        if (folder / "sequence").is_dir():
            raise StorageError(
                f"{folder}: what was built there is out of date (another version, or a file is gone); "
                "build it again",
                what="not-built",
            )
        raise StorageError(
            f"{folder}: nothing was built there; run `kinectbench build`, or name build/<id>",
            what="not-built",
        )
    sequence = read_sequence(folder / "sequence")
    names = tuple(sorted(path.stem for path in (folder / "pairs").glob("*.npz")))

    def valid_depth(view: View) -> NDArray[np.bool_]:
        """Return the mask of a view's pixels that have depth: (height, width) bool."""
        path = folder / "views" / f"{view.name}.depth.png"
        try:
            return read_gray(path) > 0
        except OSError as error:
            raise StorageError(f"{path}: cannot be read ({error.strerror}); build the views again") from error

    return Build(
        stamps_ns=sequence.stamps_ns,
        camera=sequence.camera,
        depth_m=sequence.depth_m,
        trajectory=read_trajectory(folder / "trajectory", sequence.stamps_ns) if "track" in current else None,
        given=sequence.given_trajectory,
        scene=(lambda: read_own_ply(folder / "reconstruction" / "mesh.ply")) if "fuse" in current else None,
        model=read_object(folder / "object") if "segment" in current else None,
        views=tuple(read_views(folder / "views")) if "sample-views" in current else None,
        valid_depth=valid_depth,
        pair_names=names if "pairs" in current else None,
        pair=lambda name: read_pair(folder / "pairs" / f"{name}.npz"),
    )


@dataclass(frozen=True)
class BuildRegistration:
    """How the n frames and the world frame of a build correspond to those of the truth.

    Attributes:
        true_frame: (n,) int64, index in the truth of each frame of the build's sequence, -1 for none.
        shown: (n,) bool, whether the frame has a true camera pose. False for frames that are not in the
            truth, and for frames of another scene, which the simulator can insert as a fault.
        T_truth_built: (4, 4), maps the build's world to the truth's world; the identity if not aligned.
        aligned: whether `T_truth_built` was computed from the trajectories.
    """

    true_frame: NDArray[np.int64]
    shown: NDArray[np.bool_]
    T_truth_built: NDArray[np.float64]
    aligned: bool

    @property
    def T_built_truth(self) -> NDArray[np.float64]:
        """(4, 4), maps the truth's world to the build's world."""
        return invert_rigid(self.T_truth_built)


def register_build(build: Build, truth: Truth, align: bool = True) -> BuildRegistration:
    """Match the build's frames to the truth's by stamp, and align the world frames by the trajectories.

    If the recording came without a trajectory, the build's world frame is that of its first camera. Otherwise
    it is the truth's world, up to the errors of the given trajectory. In both cases the alignment is that of
    the ATE.

    Args:
        build: the build; later stages may be missing.
        truth: the truth of the same recording.
        align: whether to align the worlds.

    Raises:
        RecordingError: the build and the truth have no frame in common, or all of them show another scene.
    """
    true_frame = true_frames(build.stamps_ns, truth.stamps_ns)
    matched = true_frame >= 0
    if not matched.any():
        raise RecordingError(
            f"{truth.folder}: no frame of the build has the stamp of a frame of this truth; "
            "is it the truth of this recording?",
            what="other-truth",
        )
    shown = matched & has_pose(truth.T_world_camera)[true_frame]
    if not shown.any():
        raise RecordingError(
            f"{truth.folder}: every frame shows another scene; there is nothing to compare",
            what="other-truth",
        )
    T_truth_built, aligned = np.eye(4), False
    if align and build.trajectory is not None:
        usable = shown & has_pose(build.trajectory.T_world_camera)
        aligned = bool(usable.any())
        if aligned:
            true_cameras = truth.T_world_camera[true_frame[usable]]
            T_truth_built = align_worlds(build.trajectory.T_world_camera[usable], true_cameras)
    return BuildRegistration(true_frame, shown, T_truth_built, aligned)


def true_frames(stamps_ns: NDArray[np.int64], truth_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the truth's frame index for each frame of a sequence, -1 for none: (n,) int64.

    Frames are matched by stamp. In a recording without stamps, frame `i` gets the stamp of `i` seconds. So if
    all stamps are whole seconds below m and none is a stamp of the truth, the seconds are used as the truth's
    frame indices.

    Args:
        stamps_ns: (n,) stamps of the sequence.
        truth_ns: (m,) stamps of the truth.
    """
    result = np.full(len(stamps_ns), -1, dtype=np.int64)
    numbers, remainder_ns = np.divmod(stamps_ns, NS_PER_S)
    counted = not remainder_ns.any() and numbers.min() >= 0 and numbers.max() < len(truth_ns)
    if counted and not np.isin(stamps_ns, truth_ns).any():
        return numbers
    built, true = match_stamps(stamps_ns, truth_ns)
    result[built] = true
    return result
