"""Pictures of objects: single ones, and contact sheets of a family."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from kinectbench.core import StorageError
from kinectbench.core.geometry import join
from kinectbench.core.images import png, shrunk
from kinectbench.core.pictures import LIGHT, PAPER, cast_pieces, fit_viewpoint, look_along
from kinectbench.lab.simulate.objects import families, make_object
from kinectbench.lab.simulate.objects.shapes import Subject

COLUMNS = 4
LABEL_PX = 22
SUPERSAMPLING = 2
# Viewing direction: from the front, the right and above.
FORWARD = np.array([-0.55, -0.8, -0.42])


def picture(subject: Subject, size_px: int) -> NDArray[np.uint8]:
    """Draw a subject's coloured pieces in one oblique parallel view, from its front right and from above.

    Returns:
        (size_px, size_px, 3) uint8 RGB.
    """
    pieces = [piece.mesh for piece in subject.pieces]
    view = fit_viewpoint(join(pieces).vertices, look_along(FORWARD, np.array([0.0, 0.0, 1.0])))
    distance_m, normals_view, which = cast_pieces(pieces, view, size_px * SUPERSAMPLING)
    shade = 0.5 + 0.55 * np.clip(normals_view @ LIGHT, 0.0, 1.0)
    colors = np.array([piece.color_rgb for piece in subject.pieces] + [(0.0, 0.0, 0.0)]) * 255
    # Black pieces are drawn a little lighter, so that their shape is visible.
    drawn = np.where(
        np.isfinite(distance_m)[..., None], (25 + 0.9 * colors[which]) * shade[..., None], np.array(PAPER)
    )
    return shrunk(np.clip(drawn, 0, 255).astype(np.uint8), size_px)


def contact_sheet(family: str, seeds: Sequence[int], size_px: int) -> NDArray[np.uint8]:
    """Draw objects of one of `families()` in rows of four, each with its name and size in cm below it.

    Returns:
        (rows * (size_px + 22), 4 * size_px, 3) uint8 RGB.

    Raises:
        SettingsError: unknown family.
    """
    rows = -(-len(seeds) // COLUMNS)
    step_px = size_px + LABEL_PX
    sheet = np.empty((rows * step_px, COLUMNS * size_px, 3), np.uint8)
    sheet[:] = PAPER
    for at, seed in enumerate(seeds):
        subject = make_object(family, seed)
        top, left = at // COLUMNS * step_px, at % COLUMNS * size_px
        sheet[top : top + size_px, left : left + size_px] = picture(subject, size_px)
        width, depth, height = (np.ptp(subject.mesh.vertices, axis=0) * 100).round().astype(int).tolist()
        label = f"{subject.name}  {width} x {depth} x {height} cm"
        where = (left + 6, top + size_px + 14)
        cv2.putText(sheet, label, where, cv2.FONT_HERSHEY_SIMPLEX, 0.38, (70, 70, 70), 1, cv2.LINE_AA)
    return sheet


def write_contact_sheets(folder: Path, count: int = 12, size_px: int = 280) -> list[Path]:
    """Write a PNG of the first objects of each family, `FAMILY.png`, into a folder.

    Args:
        folder: the folder, which is made if missing.
        count: number of objects; their seeds are 0 to count - 1.
        size_px: edge of one picture.

    Returns:
        The files, in the order of `families()`.

    Raises:
        StorageError: a file cannot be written.
    """
    paths = [folder / f"{family}.png" for family in families()]
    for family, path in zip(families(), paths, strict=True):
        sheet = contact_sheet(family, range(count), size_px)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path.write_bytes(png(sheet[..., ::-1]))
        except OSError as error:
            raise StorageError(
                f"{path}: cannot be written ({error.strerror}); choose another folder", what="not-writable"
            ) from error
    return paths
