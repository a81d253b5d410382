"""Compare the views' masks with true silhouettes, and the pairs' grids with the true solid."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import RecordingError
from kinectbench.core.geometry import Grid, invert_rigid
from kinectbench.core.types import Progress
from kinectbench.core.voxels.pair_file import Pair, pack, unpack
from kinectbench.core.voxels.resample import reduce_blocks
from kinectbench.core.voxels.view_grids import containment
from kinectbench.lab.evaluate.build import Build, BuildRegistration
from kinectbench.lab.evaluate.solid import grid_iou, known_iou, share
from kinectbench.lab.simulate.truth import Truth


@dataclass(frozen=True)
class MaskRow:
    """Agreement of one view's mask with the true silhouette.

    Attributes:
        view: the view's name.
        frame: index in the sequence.
        valid_iou: IoU of mask and silhouette over pixels with valid depth.
        iou: IoU over all pixels. A mask contains only pixels with depth, so silhouette pixels without depth
            lower this IoU.
    """

    view: str
    frame: int
    valid_iou: float
    iou: float


@dataclass(frozen=True)
class MaskFigures:
    """Agreement of all views' masks with the true silhouettes; the IoUs are None if no view is compared.

    Attributes:
        mean_valid_iou: mean over the views of `MaskRow.valid_iou`.
        worst_valid_iou: the lowest `valid_iou`.
        worst_view: the view with the lowest `valid_iou`.
        mean_iou: mean over the views of `MaskRow.iou`.
        worst_iou: the lowest `iou`.
        without_truth: views that are not compared: their frame is not in the truth, or shows another scene.
        rows: one for each compared view.
    """

    mean_valid_iou: float | None
    worst_valid_iou: float | None
    worst_view: str | None
    mean_iou: float | None
    worst_iou: float | None
    without_truth: tuple[str, ...]
    rows: tuple[MaskRow, ...]


def mask_figures(build: Build, truth: Truth, registration: BuildRegistration) -> MaskFigures:
    """Compare the mask of every view with the object's silhouette in that frame.

    Raises:
        RecordingError: a silhouette is missing, damaged, or has another size than the mask.
        StorageError: a view's depth is missing or damaged.
    """
    rows, without = [], []
    for view in build.views or ():
        if not registration.shown[view.frame]:
            without.append(view.name)
            continue
        index = int(registration.true_frame[view.frame])
        silhouette, valid = truth.mask(index), build.valid_depth(view)
        if silhouette.shape != view.mask.shape or valid.shape != view.mask.shape:
            raise RecordingError(
                f"{truth.folder}: silhouette {index:06d} is {silhouette.shape[1]}x{silhouette.shape[0]}, "
                f"view {view.name} is {view.mask.shape[1]}x{view.mask.shape[0]}; are they of one recording?",
                what="other-truth",
            )
        overlap = grid_iou(view.mask & valid, silhouette & valid)
        rows.append(MaskRow(view.name, view.frame, overlap, grid_iou(view.mask, silhouette)))
    if not rows:
        return MaskFigures(None, None, None, None, None, tuple(without), ())
    worst = min(rows, key=lambda row: row.valid_iou)
    return MaskFigures(
        mean_valid_iou=float(np.mean([row.valid_iou for row in rows])),
        worst_valid_iou=worst.valid_iou,
        worst_view=worst.view,
        mean_iou=float(np.mean([row.iou for row in rows])),
        worst_iou=min(row.iou for row in rows),
        without_truth=tuple(without),
        rows=tuple(rows),
    )


@dataclass(frozen=True)
class EvaluatedPair:
    """Metrics of one pair against the truth, each in [0, 1]. `full` and `known` are grids of the pair.

    Attributes:
        view: the view's name.
        frame: index in the sequence.
        iou: IoU of `full` and the seeable solid (`core.voxels.seeable`), over all cells except slits: gaps
            that only a finer sensor could see into, and walls thinner than a voxel.
        known_iou: the same IoU over `known` cells; None if no cell of the true solid is known.
        exact_iou: IoU of `full` and the solid inside the true mesh, over all cells.
        true_unknown_share: share of the seeable solid that is not `known`.
        containment: share of the partial view's cells, at 64^3, that lie in the seeable solid dilated by one
            cell.
    """

    view: str
    frame: int
    iou: float
    known_iou: float | None
    exact_iou: float
    true_unknown_share: float
    containment: float


@dataclass(frozen=True)
class Summary:
    """Mean and worst value of one metric over all pairs, and the name of the view with the worst value."""

    mean: float
    worst: float
    worst_view: str


@dataclass(frozen=True)
class PairFigures:
    """All pairs against the truth: a summary of each metric of `EvaluatedPair`, None if no pair has it.

    Attributes:
        iou: IoU of `full` and the seeable solid: the inside of the true mesh, and space that no camera could
            see.
        known_iou: the same IoU over `known` cells.
        exact_iou: IoU of `full` and the inside of the true mesh.
        true_unknown_share: share of the seeable solid that is not `known`; the worst is the largest.
        containment: share of the partial view's cells that lie in the seeable solid dilated by one cell.
        without_truth: pairs that are not compared: their frame is not in the truth, or shows another scene.
        rows: one for each compared pair.
    """

    iou: Summary | None
    known_iou: Summary | None
    exact_iou: Summary | None
    true_unknown_share: Summary | None
    containment: Summary | None
    without_truth: tuple[str, ...]
    rows: tuple[EvaluatedPair, ...]


def pair_figures(
    build: Build, truth: Truth, registration: BuildRegistration, progress: Progress
) -> PairFigures:
    """Compare every pair with the true solid, placed by the true camera pose of the pair's frame.

    The view's depth was recorded from the true pose. So the true solid is aligned exactly with the partial
    view, whatever pose the build estimated. An error of the estimated pose shifts `full`, and lowers its IoU.

    Args:
        build: a build with views and pairs.
        truth: the true solid and camera poses.
        registration: gives the truth's frame index of each frame.
        progress: called with (pairs done, pairs in all).

    Raises:
        PairError: a pair is missing or damaged.
    """
    views = {view.name: view for view in build.views or ()}
    names = [name for name in build.pair_names or () if name in views]
    rows, without = [], []
    for done, name in enumerate(names, start=1):
        frame = views[name].frame
        if registration.shown[frame]:
            T_world_camera = truth.T_world_camera[registration.true_frame[frame]]
            rows.append(evaluated_pair(name, frame, build.pair(name), truth, T_world_camera))
        else:
            without.append(name)
        progress(done, len(names))
    return PairFigures(
        iou=_summary(rows, "iou", min),
        known_iou=_summary(rows, "known_iou", min),
        exact_iou=_summary(rows, "exact_iou", min),
        true_unknown_share=_summary(rows, "true_unknown_share", max),
        containment=_summary(rows, "containment", min),
        without_truth=tuple(without),
        rows=tuple(rows),
    )


def evaluated_pair(
    view: str, frame: int, pair: Pair, truth: Truth, T_world_camera: NDArray[np.float64]
) -> EvaluatedPair:
    """Compare one pair with the true solid.

    `T_world_camera` (4, 4) is the true pose of the frame's camera in the truth's world.
    """
    cells = truth.cells(_grid_in_truth(pair, T_world_camera))
    true, judged = cells.solid & cells.judged, cells.judged
    full, known = unpack(pair.full), unpack(pair.known)
    # Like `verify`: these are the cells before the partial rule thinned them out.
    touched = pack(reduce_blocks(unpack(pair.partial_256), "any"))
    return EvaluatedPair(
        view=view,
        frame=frame,
        iou=grid_iou(full & judged, true),
        known_iou=known_iou(full & judged, true, known),
        exact_iou=grid_iou(full, cells.exact),
        true_unknown_share=share(~known, of=true),
        containment=containment(touched, pack(cells.solid)),
    )


def _grid_in_truth(pair: Pair, T_world_camera: NDArray[np.float64]) -> Grid:
    """Return a pair's 256^3 grid in the truth's world, placed by the true camera pose (4, 4)."""
    T_camera_grid = invert_rigid(pair.T_world_camera) @ pair.T_world_grid
    return replace(pair.grid, T_world_grid=T_world_camera @ T_camera_grid)


def _summary(
    rows: Sequence[EvaluatedPair], figure: str, worst: Callable[[list[float]], float]
) -> Summary | None:
    values = {row.view: float(getattr(row, figure)) for row in rows if getattr(row, figure) is not None}
    if not values:
        return None
    least = worst(list(values.values()))
    view = next(view for view, value in values.items() if value == least)
    return Summary(float(np.mean(list(values.values()))), least, view)
