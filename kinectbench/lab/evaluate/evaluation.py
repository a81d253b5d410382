"""Compute all metrics of a build against the truth, and the content of evaluation.json.

The metrics of the trajectory and of the floor are computed here, the others in the modules beside this one.
"""

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench._version import __version__
from kinectbench.core.artefacts.object_grids import unmeasured_faces
from kinectbench.core.geometry import TriangleMesh, rotation_angle_rad
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.clock_offset import ClockOffset, clock_offset
from kinectbench.core.trajectory.compare import MIN_MATCHED, TrajectoryError, compare_poses, has_pose
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Progress, no_progress
from kinectbench.lab.evaluate.build import Build, BuildRegistration, register_build
from kinectbench.lab.evaluate.measured import measured_surface
from kinectbench.lab.evaluate.pairs import MaskFigures, PairFigures, mask_figures, pair_figures
from kinectbench.lab.evaluate.refined import RefinedFigures, refined_figures
from kinectbench.lab.evaluate.solid import SolidFigures, check_fills_cells, solid_figures
from kinectbench.lab.evaluate.surface import SurfaceFigures, errors_at_object, surface_errors, surface_figures
from kinectbench.lab.simulate.truth import Truth
from kinectbench.stages.segment.find.floor import Floor


@dataclass(frozen=True)
class TrajectoryFigures:
    """Tracked share and pose errors of a recording; frame indices are those of the build.

    Attributes:
        frames: number of frames in the sequence.
        tracked: number of frames with a pose.
        tracked_share: `tracked / frames`.
        lost: indices of frames for which no pose was found.
        rejected: indices of frames whose pose was found but discarded, as their depth disagrees with it.
        foreign_tracked: indices of frames that show another scene but have a pose.
        error: errors of the poses with known truth; None if there are fewer than three.
        given_clock: clock offset of the given trajectory against the true poses; None if there is none or it
            cannot be determined.
    """

    frames: int
    tracked: int
    tracked_share: float
    lost: tuple[int, ...]
    rejected: tuple[int, ...]
    foreign_tracked: tuple[int, ...]
    error: TrajectoryError | None
    given_clock: ClockOffset | None


def trajectory_figures(
    trajectory: Trajectory,
    truth: Truth,
    registration: BuildRegistration,
    stamps_ns: NDArray[np.int64],
    given: GivenTrajectory | None = None,
) -> TrajectoryFigures:
    """Compare the built poses with the true poses; list the frames that were lost, rejected or foreign.

    ATE aligns the positions by least squares, independently of `registration`.

    Args:
        trajectory: the built trajectory.
        truth: the simulator's truth.
        registration: registration of the build to the truth.
        stamps_ns: (n,) int64, stamps of the build's frames.
        given: the trajectory that came with the recording; None if there is none.
    """
    posed = has_pose(trajectory.T_world_camera)
    common = posed & registration.shown
    error = None
    if common.sum() >= MIN_MATCHED:
        true_frame = registration.true_frame[common]
        error = compare_poses(trajectory.T_world_camera[common], truth.T_world_camera[true_frame])
    rejected = tuple(row.frame for row in trajectory.health.rejected) if trajectory.health else ()
    lost = np.setdiff1d(np.flatnonzero(~posed), rejected)
    foreign = posed & (registration.true_frame >= 0) & ~registration.shown
    return TrajectoryFigures(
        frames=len(posed),
        tracked=int(posed.sum()),
        tracked_share=float(posed.mean()),
        lost=tuple(lost.tolist()),
        rejected=rejected,
        foreign_tracked=tuple(np.flatnonzero(foreign).tolist()),
        error=error,
        given_clock=_given_clock(truth, registration, stamps_ns, given),
    )


def _given_clock(
    truth: Truth, registration: BuildRegistration, stamps_ns: NDArray[np.int64], given: GivenTrajectory | None
) -> ClockOffset | None:
    shown = registration.shown
    if given is None or not shown.any():
        return None
    return clock_offset(stamps_ns[shown], truth.T_world_camera[registration.true_frame[shown]], given)


@dataclass(frozen=True)
class FloorFigures:
    """Angle and height of the built floor relative to the true one.

    Attributes:
        angle_rad: angle between the two planes.
        height_m: height of the built plane above the true floor at the object's origin; < 0 below it.
    """

    angle_rad: float
    height_m: float


def floor_figures(floor: Floor, truth: Truth, registration: BuildRegistration) -> FloorFigures:
    """Return the angle between the built and the true floor, and their difference in height at the object.

    Args:
        floor: the built floor, in the build's world.
        truth: the truth of the simulated scene.
        registration: registration of the build's world to the truth's.
    """
    T = registration.T_truth_built
    normal = T[:3, :3] @ floor.plane_world[:3]
    # In the truth's world the plane is n . (R^T (x - t)) + d = 0.
    offset = floor.plane_world[3] - normal @ T[:3, 3]
    up, foot = truth.T_world_object[:3, 2], truth.T_world_object[:3, 3]
    cosine, sine = float(normal @ up), float(np.linalg.norm(np.cross(normal, up)))
    # The point foot + h up lies on the built plane.
    return FloorFigures(float(np.arctan2(sine, cosine)), float(-(normal @ foot + offset) / cosine))


# Version 2: metrics refer to the seeable solid. Names of metrics that refer to the exact solid, which had
# no prefix before, begin with `exact`.
FORMAT_VERSION = 2
DIGITS = 6
# Decimals of matrices and of lists of errors, metres.
ARRAY_DECIMALS = 9


@dataclass(frozen=True)
class AlignmentFigures:
    """The registration of the build's world to the truth's.

    Attributes:
        aligned: whether the worlds were aligned by the trajectories.
        moved_m: distance by which `T_truth_built` moves the origin.
        turned_rad: angle by which `T_truth_built` rotates.
        T_truth_built: (4, 4), maps the build's world to the truth's world.
    """

    aligned: bool
    moved_m: float
    turned_rad: float
    T_truth_built: NDArray[np.float64]


@dataclass(frozen=True)
class Evaluation:
    """All metrics of a build against the truth; an attribute is None if its stage was not built.

    Attributes:
        subject: the truth's name of the object.
        alignment: how the worlds were aligned.
        trajectory: metrics of stage `track`.
        scene: metrics of the mesh of stage `fuse` around the object and above the floor; None if the built or
            the true mesh has no surface there.
        floor: metrics of the floor of stage `segment`.
        surface: metrics of the object's closed mesh.
        measured: metrics of those faces of the closed mesh that are measured, around the object and above the
            floor; None if there are none. Here `visible` means true surface that at least one frame measured.
        solid: metrics of the closed mesh's volume and of the voxel labels.
        refined: metrics before and after the mesh is rigidly registered to the true one.
        masks: metrics of the views' masks, stage `sample-views`.
        pairs: metrics of the pairs, stage `pairs`.
    """

    subject: str
    alignment: AlignmentFigures
    trajectory: TrajectoryFigures | None
    scene: SurfaceFigures | None
    floor: FloorFigures | None
    surface: SurfaceFigures | None
    measured: SurfaceFigures | None
    solid: SolidFigures | None
    refined: RefinedFigures | None
    masks: MaskFigures | None
    pairs: PairFigures | None


def evaluate(
    build: Build, truth: Truth, *, align: bool = True, progress: Progress = no_progress
) -> Evaluation:
    """Measure a build against the truth of the same recording.

    Later stages may be missing in the build; `align` aligns its world with the truth's by the trajectories.
    `progress` is called with (pairs done, pairs in all).

    Raises:
        RecordingError: the truth is of another recording, damaged, or thinner than a cell.
        StorageError: an artefact of the build is damaged.
        PairError: a pair is damaged.
    """
    registration = register_build(build, truth, align)
    model = build.model
    surface = measured = solid = refined = floor = None
    if model is not None:
        check_fills_cells(truth)
        mesh = model.shape.mesh.transformed(registration.T_truth_built)
        surface = surface_figures(surface_errors(mesh, truth))
        shape = model.shape
        missed = unmeasured_faces(shape.mesh, shape.grid, shape.labels)
        samples = measured_surface(build, truth, registration)
        measured = _at_object(mesh.keep_faces(~missed), replace(truth, surface=samples.surface))
        solid = solid_figures(model, truth, registration, samples)
        refined = refined_figures(model, truth, registration, samples)
        floor = floor_figures(model.floor, truth, registration)
    trajectory = scene = masks = pairs = None
    if build.trajectory is not None:
        clocks = build.stamps_ns, build.given
        trajectory = trajectory_figures(build.trajectory, truth, registration, *clocks)
    if build.scene is not None:
        scene = _at_object(build.scene().transformed(registration.T_truth_built), truth)
    if build.views is not None:
        masks = mask_figures(build, truth, registration)
    if build.views is not None and build.pair_names is not None:
        pairs = pair_figures(build, truth, registration, progress)
    return Evaluation(
        subject=truth.subject,
        alignment=_alignment(registration),
        trajectory=trajectory,
        scene=scene,
        floor=floor,
        surface=surface,
        measured=measured,
        solid=solid,
        refined=refined,
        masks=masks,
        pairs=pairs,
    )


def evaluation_json(evaluation: Evaluation) -> dict[str, object]:
    """Return the content of evaluation.json: all metrics in SI units and radians, rounded by `_plain`."""
    head = {"format_version": FORMAT_VERSION, "package_version": __version__}
    return {**head, **_plain(evaluation)}


def _at_object(mesh: TriangleMesh, truth: Truth) -> SurfaceFigures | None:
    errors = errors_at_object(mesh, truth)
    return surface_figures(errors) if errors else None


def _alignment(registration: BuildRegistration) -> AlignmentFigures:
    T = registration.T_truth_built
    moved_m, turned_rad = float(np.linalg.norm(T[:3, 3])), float(rotation_angle_rad(T[:3, :3]))
    return AlignmentFigures(registration.aligned, moved_m, turned_rad, T)


def _plain(value: object) -> Any:
    """Convert dataclasses, tuples and arrays to JSON values.

    Floats are rounded to 6 significant digits, arrays to 9 decimals.
    """
    if is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, np.ndarray):
        return np.round(value, ARRAY_DECIMALS).tolist()
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    return value
