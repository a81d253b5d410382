"""Write pages categories/<category>.html of a release: a picture and the main values of every object."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from kinectbench.core.artefacts.benchmark import RecordingInfo
from kinectbench.core.artefacts.targets import Target, by_recording
from kinectbench.core.images import data_uri
from kinectbench.core.pages import render_page
from kinectbench.core.voxels.pair_file import read_input, read_pair, unpack
from kinectbench.release.contents import CATEGORIES
from kinectbench.release.publish.card import category_words
from kinectbench.release.publish.index_page import BLUE, CLAY, NO_PICTURE, enlarged, seen_from_the_front
from kinectbench.settings.models import BenchmarkSettings

# Every second of 256 cells is shown: 128 pixels, 2 kB as a JPEG of this quality. A page of ten thousand
# objects takes 40 of the 64 MB that a page may have.
STEP, QUALITY = 2, 75


def category_texts(
    folder: Path | None,
    settings: BenchmarkSettings,
    targets: Sequence[Target],
    infos: Mapping[str, RecordingInfo],
    held_back: Sequence[str],
    isolated: Sequence[str] = (),
) -> Iterator[tuple[str, str]]:
    """Yield (file, text) of each category's page. Isolated recordings are listed without a picture.

    Args:
        folder: the release's folder; None: `NO_PICTURE` stands for each picture.
        settings: the benchmark's settings.
        targets: every pair.
        infos: {recording: its entry in benchmark.json}.
        held_back: splits of which only inputs are published.
        isolated: recordings of which a single view is published.

    Raises:
        PairError: a pair is damaged.
    """
    of_recording = by_recording(targets)
    for category in sorted({info.category for info in infos.values()}):
        shown: list[dict[str, Any]] = [
            {
                "name": name,
                "info": info,
                "held_back": info.split in held_back,
                "picture": None
                if name in isolated
                else _picture(folder, of_recording[name][0], info.split in held_back),
                "words": category_words(info),
            }
            for name, info in sorted(infos.items())
            if info.category == category
        ]
        objects = len({part["info"].object for part in shown})
        page = {"settings": settings, "category": category, "parts": shown, "objects": objects}
        yield f"{CATEGORIES}/{category}.html", render_page("release/publish/category.html", page)


def _picture(folder: Path | None, target: Target, held_back: bool) -> str:
    """Draw the full shape as the camera of `target` sees it; if truth is held back, only the partial."""
    if folder is None:
        return NO_PICTURE
    path = folder / target.file
    if held_back:
        drawn = enlarged(seen_from_the_front(unpack(read_input(path).partial), BLUE))
    else:
        drawn = seen_from_the_front(unpack(read_pair(path).full), CLAY)
    return data_uri(drawn[::STEP, ::STEP], QUALITY)
