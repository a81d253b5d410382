"""The views' masks against the true silhouettes."""

from dataclasses import dataclass

import numpy as np

from kinectbench.errors import RecordingError
from kinectbench.evaluate.build import Build
from kinectbench.evaluate.overlap import iou
from kinectbench.evaluate.registration import Registration
from kinectbench.simulate.truth import Truth


@dataclass(frozen=True)
class MaskRow:
    """One view's mask.

    Attributes:
        view: its name.
        frame: index in the sequence.
        valid_iou: IoU with the true silhouette over pixels with valid depth.
        iou: the same over all pixels; a mask holds pixels with depth only.
    """

    view: str
    frame: int
    valid_iou: float
    iou: float


@dataclass(frozen=True)
class MaskFigures:
    """All views' masks.

    Attributes:
        mean_valid_iou: mean over the views, over pixels with valid depth; None without views.
        worst_valid_iou: the least of them.
        worst_view: the view that has it.
        mean_iou: mean over the views, over all pixels.
        worst_iou: the least of them.
        without_truth: views of frames that the truth does not have, or that show another scene.
        rows: one a view.
    """

    mean_valid_iou: float | None
    worst_valid_iou: float | None
    worst_view: str | None
    mean_iou: float | None
    worst_iou: float | None
    without_truth: tuple[str, ...]
    rows: tuple[MaskRow, ...]


def mask_figures(build: Build, truth: Truth, registration: Registration) -> MaskFigures:
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
                f"view {view.name} is {view.mask.shape[1]}x{view.mask.shape[0]}; are they of one recording?"
            )
        overlap = iou(view.mask & valid, silhouette & valid)
        rows.append(MaskRow(view.name, view.frame, overlap, iou(view.mask, silhouette)))
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
