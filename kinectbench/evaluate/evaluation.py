"""Everything that a build is measured by, and its file evaluation.json."""

from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench import __version__
from kinectbench.evaluate.build import Build
from kinectbench.evaluate.floor import FloorFigures, floor_figures
from kinectbench.evaluate.masks import MaskFigures, mask_figures
from kinectbench.evaluate.pairs import PairFigures, pair_figures
from kinectbench.evaluate.registration import Registration, register
from kinectbench.evaluate.solid import SolidFigures, solid_figures
from kinectbench.evaluate.surface import SurfaceFigures, surface_errors, surface_figures
from kinectbench.evaluate.trajectory import TrajectoryFigures, trajectory_figures
from kinectbench.geometry import rotation_angle_rad
from kinectbench.simulate.truth import Truth

FORMAT_VERSION = 1
DIGITS = 6
# Of matrices and lists of errors, metres.
ARRAY_DECIMALS = 9

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class AlignmentFigures:
    """How the build's world was laid onto the truth's.

    Attributes:
        aligned: by the trajectories; False: the worlds were left as they are.
        moved_m: length of the shift of the world's origin.
        turned_rad: angle of the turn.
        T_truth_built: (4, 4).
    """

    aligned: bool
    moved_m: float
    turned_rad: float
    T_truth_built: NDArray[np.float64]


@dataclass(frozen=True)
class Evaluation:
    """A build against the truth; None for a stage that was not built.

    Attributes:
        subject: the truth's name of the object.
        alignment: how the worlds were laid onto each other.
        trajectory: of stage `track`.
        floor: of stage `segment`.
        surface: of the object's closed mesh.
        solid: of the same mesh and the labels.
        masks: of stage `sample-views`.
        pairs: of stage `pairs`.
    """

    subject: str
    alignment: AlignmentFigures
    trajectory: TrajectoryFigures | None
    floor: FloorFigures | None
    surface: SurfaceFigures | None
    solid: SolidFigures | None
    masks: MaskFigures | None
    pairs: PairFigures | None


def evaluate(
    build: Build,
    truth: Truth,
    *,
    align: bool = True,
    progress: Progress | None = None,
) -> Evaluation:
    """Measure a build against the truth of the same recording.

    Args:
        build: as far as it was built.
        truth: the simulator's.
        align: lay the build's world onto the truth's by the trajectories; False leaves it as it is.
        progress: called with (pairs done, pairs in all).

    Raises:
        RecordingError: the truth is of another recording, or damaged.
        StorageError: an artefact of the build is damaged.
        PairError: a pair is damaged.
    """
    registration = register(build, truth, align)
    model = build.model
    surface = solid = floor = None
    if model is not None:
        mesh = model.shape.mesh.transformed(registration.T_truth_built)
        surface = surface_figures(surface_errors(mesh, truth))
        solid = solid_figures(model, truth, registration)
        floor = floor_figures(model.floor, truth, registration)
    trajectory = masks = pairs = None
    if build.trajectory is not None:
        trajectory = trajectory_figures(build.trajectory, truth, registration)
    if build.views is not None:
        masks = mask_figures(build, truth, registration)
    if build.views is not None and build.pair_names is not None:
        pairs = pair_figures(build, truth, registration, progress or (lambda _done, _total: None))
    return Evaluation(
        truth.subject, _alignment(registration), trajectory, floor, surface, solid, masks, pairs
    )


def evaluation_json(evaluation: Evaluation) -> dict[str, Any]:
    """The content of evaluation.json: all figures in SI units and radians, to six digits."""
    head = {"format_version": FORMAT_VERSION, "package_version": __version__}
    return {**head, **_plain(evaluation)}


def _alignment(registration: Registration) -> AlignmentFigures:
    T = registration.T_truth_built
    moved_m, turned_rad = float(np.linalg.norm(T[:3, 3])), float(rotation_angle_rad(T[:3, :3]))
    return AlignmentFigures(registration.aligned, moved_m, turned_rad, T)


def _plain(value: Any) -> Any:
    """Dataclasses, tuples and arrays as JSON values; numbers are rounded."""
    if is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, np.ndarray):
        return np.round(value, ARRAY_DECIMALS).tolist()
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    return value
