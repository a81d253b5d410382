"""Colour that is enlarged or far beside depth is told; where no edges show anything, that is told, too."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from shutil import copytree

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from wrong_recordings import change_images

from kinectbench.doctor import Diagnosis, inspect
from kinectbench.doctor.edges import fit_edges
from kinectbench.doctor.finding import fact_lines
from kinectbench.doctor.probe import probe_recording
from kinectbench.stages.ingest.readers import open_recording

CHAIR = Path(__file__).parents[2] / "recordings/chair_01"


def moved(zoom: float, right_px: float) -> Callable[[NDArray[np.generic]], NDArray[np.generic]]:
    """Enlarge images about their middle, then move them to the right."""

    def change(image: NDArray[np.generic]) -> NDArray[np.generic]:
        height, width = image.shape[:2]
        x, y = (width - 1) / 2 * (1 - zoom) + right_px, (height - 1) / 2 * (1 - zoom)
        matrix = np.array([[zoom, 0, x], [0, zoom, y]])
        return np.asarray(cv2.warpAffine(image, matrix, (width, height), flags=cv2.INTER_NEAREST))

    return change


def line_of_registration(diagnosis: Diagnosis) -> str:
    return dict(fact_lines(diagnosis.facts))["colour registered"]


@pytest.mark.parametrize(("zoom", "right_px"), [(1.55, 9), (1.25, 0), (0.75, 0), (1.0, 40)])
def test_colour_that_lies_elsewhere_is_told_with_where(zoom: float, right_px: float, tmp_path: Path) -> None:
    folder = tmp_path / "r"
    copytree(CHAIR, folder)
    (folder / "groundtruth.txt").unlink()
    if zoom < 1:  # a colour camera that sees more than the depth camera
        change_images("depth", moved(1 / zoom, 0))(folder)
    else:
        change_images("rgb", moved(zoom, right_px))(folder)
    diagnosis, _ = inspect(folder)
    (found,) = (each for each in diagnosis.findings if each.name == "color_not_registered")
    assert found.severity == "warning" and "`color_registered: false`" in found.advice
    said = re.findall(r"about ([\d.]+) times as large", found.what)
    assert [float(each) for each in said] == ([] if zoom == 1 else [pytest.approx(zoom, rel=0.06)])
    (right,) = re.findall(r"(\d+) px to the right", found.what) or ["0"]
    assert float(right) == pytest.approx(right_px, abs=6)
    assert diagnosis.facts["color_registered"] is True
    assert line_of_registration(diagnosis) == "assumed, but its edges lie elsewhere"


def shadowed(depth: NDArray[np.generic]) -> NDArray[np.generic]:
    """Depth without measurements left of near things, where one camera of a stereo pair sees nothing."""
    near = cv2.erode(np.where(depth == 0, 65535, depth).astype(np.uint16), np.ones((1, 11)), anchor=(0, 0))
    return np.where(depth > 1.06 * near, 0, depth).astype(np.uint16)


def textured(color: NDArray[np.generic]) -> NDArray[np.generic]:
    """Colour with a pattern of edges on all surfaces, another in each frame."""
    noise = np.random.default_rng(int(color.sum()) % 1000).normal(0, 20, (60, 80))
    pattern = cv2.resize(noise, color.shape[1::-1], interpolation=cv2.INTER_NEAREST)[..., None]
    return np.asarray(np.clip(color + pattern, 0, 255), np.uint8)


def test_colour_of_another_lens_beside_depth_of_a_stereo_pair_is_found(tmp_path: Path) -> None:
    """As of a D435 without alignment: depth has holes beside each jump, and colour has other edges, too."""
    folder = tmp_path / "r"
    copytree(CHAIR, folder)
    change_images("depth", shadowed)(folder)
    change_images("rgb", textured)(folder)
    right, _ = inspect(folder)
    assert right.facts["color_registration"] == "seen"
    change_images("rgb", moved(1.42, 5))(folder)
    diagnosis, _ = inspect(folder)
    (found,) = (each for each in diagnosis.findings if each.name == "color_not_registered")
    (zoom,) = re.findall(r"about ([\d.]+) times as large", found.what)
    assert float(zoom) == pytest.approx(1.42, rel=0.06)


def flat(depth: NDArray[np.generic]) -> NDArray[np.generic]:
    """Depth of a bare wall."""
    return np.where(depth == 0, 0, 8000).astype(np.uint16)


def test_where_nothing_shows_registration_it_is_called_assumed(tmp_path: Path) -> None:
    folder = tmp_path / "r"
    copytree(CHAIR, folder)
    right, _ = inspect(folder)
    assert right.facts["color_registration"] == "seen" and line_of_registration(right) == "yes"
    change_images("depth", flat)(folder)
    diagnosis, _ = inspect(folder)
    assert line_of_registration(diagnosis) == "assumed: nothing shows it"
    unproven = [[each.name for each in of.findings].count("color_unproven") for of in (right, diagnosis)]
    assert unproven == [0, 1]
    assert not [each for each in diagnosis.findings if each.name == "color_not_registered"]


def test_colour_that_fits_nowhere_is_placed_nowhere() -> None:
    """Not mirrored, upside down, or of another frame."""
    probe = probe_recording(open_recording(CHAIR))
    colors = [frame.bgr for frame in probe.whole if frame.bgr is not None]
    assert len(colors) == len(probe.whole)
    later = colors[len(colors) // 2 :] + colors[: len(colors) // 2]
    for others in ([each[:, ::-1] for each in colors], [each[::-1] for each in colors], later):
        whole = (replace(frame, bgr=bgr) for frame, bgr in zip(probe.whole, others, strict=True))
        fit = fit_edges(replace(probe, whole=tuple(whole)))
        assert fit is not None and fit.place is not None and not fit.place.clear
