"""The contact sheet of an inspection: findings and some frames, in one HTML file without other files."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from kinectbench.core import replaced_file
from kinectbench.core.even_choice import evenly
from kinectbench.core.images import data_uri, depth_picture, shrunk
from kinectbench.core.pages import render_page
from kinectbench.doctor.edges import depth_jumps
from kinectbench.doctor.finding import Diagnosis, fact_lines
from kinectbench.doctor.probe import Probe, WholeFrame

FRAMES, WIDTH_PX = 8, 320
EDGE_RGB = (255, 120, 20)
TONES = {"stops": "bad", "warning": "warn", "note": ""}


@dataclass(frozen=True)
class Picture:
    """A picture on the contact sheet: frame index, caption, and the image as a `data:` URI."""

    index: int
    what: str
    uri: str


def write_diagnosis_page(diagnosis: Diagnosis, probe: Probe | None, out: Path) -> None:
    """Write the contact sheet of a diagnosis, with pictures from the probe if there is one.

    Raises:
        StorageError: the page cannot be written.
    """
    grave = {finding.severity for finding in diagnosis.findings}
    shown = {
        "title": Path(str(diagnosis.facts["path"])).name or str(diagnosis.facts["path"]),
        "diagnosis": diagnosis,
        "figures": fact_lines(diagnosis.facts),
        "tones": TONES,
        "tone": "bad" if "stops" in grave else "warn" if "warning" in grave else "good",
        "pictures": [] if probe is None else list(_pictures(probe)),
    }
    with replaced_file(out) as temporary:
        temporary.write_text(render_page("doctor/page.html", shown), encoding="utf-8")


def _pictures(probe: Probe) -> Iterator[Picture]:
    count = len(probe.whole)
    for index in evenly(count, FRAMES).tolist():
        frame = probe.whole[index]
        if frame.bgr is not None:
            yield Picture(frame.index, "colour", data_uri(shrunk(frame.bgr[..., ::-1], WIDTH_PX)))
        yield Picture(frame.index, "depth", data_uri(shrunk(depth_picture(frame.depth), WIDTH_PX)))
        if frame.bgr is not None:
            yield Picture(frame.index, "edges", data_uri(_edges(frame, frame.bgr)))


def _edges(frame: WholeFrame, bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return colour with depth discontinuities drawn on it: (height, WIDTH_PX, 3) RGB.

    The image has the aspect ratio of depth.
    """
    height, width = frame.depth.shape
    size = (WIDTH_PX, round(WIDTH_PX * height / width))
    picture = np.array(cv2.resize(bgr, size, interpolation=cv2.INTER_AREA)[..., ::-1], np.uint8)
    picture[depth_jumps(frame.depth, size) > 0] = EDGE_RGB
    return picture
