"""The images that masks are drawn on: a recorded frame's depth, and the pictures of a view that shows it."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from kinectbench.core.artefacts.views import ViewsFile
from kinectbench.core.sequence import Sequence
from kinectbench.engine.artefact import whole_manifest
from kinectbench.stages.sample_views.views import picture_digest


class Shown(NamedTuple):
    """A view's name, and the index of the frame that it shows."""

    name: str
    frame: int


def image_digest(sequence: Sequence, frame: int) -> str:
    """SHA-256 of a frame's depth image as recorded: its size and every pixel in native units."""
    depth = sequence.frames.depth_native(frame)
    return hashlib.sha256(f"{depth.shape}".encode() + depth.astype("<u2").tobytes()).hexdigest()


def views_of(views: Path, sequence: str) -> Mapping[tuple[int, bool], Shown]:
    """Return `views_shown`, or {} if the views were not made from the sequence with this fingerprint."""
    manifest = whole_manifest(views)
    return {} if manifest is None or manifest.inputs.get("ingest") != sequence else views_shown(views)


def views_shown(views: Path) -> Mapping[tuple[int, bool], Shown]:
    """Return the views that show a recorded frame, each under two keys, because a mask may name either.

    The keys are (number of the view, False) and (index of the view's frame, True).
    """
    shown = [Shown(row.view, row.frame) for row in ViewsFile.read(views).views if row.frame is not None]
    return {key: view for view in shown for key in ((int(view.name), False), (view.frame, True))}


def picture_digests(pictures: Mapping[str, bytes], sequence: Sequence, frame: int) -> set[str]:
    """Return two digests of a frame's pictures: as they are, and with the recorded file as colour image."""
    _, color = sequence.frames.color_encoded(frame) or ("", b"")
    return {
        picture_digest(each) for each in (pictures, {**pictures, "color.jpg": color} if color else pictures)
    }
