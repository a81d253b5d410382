"""Write pages categories/<category>.html of a release: a picture and the main values of every object."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from kinectbench.core.artefacts.benchmark import ReleaseInfo
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
    info: ReleaseInfo, settings: BenchmarkSettings, targets: Sequence[Target], folder: Path | None = None
) -> Iterator[tuple[str, str]]:
    """Yield (file, text) of each category's page. Isolated recordings are listed without a picture.

    Args:
        info: content of benchmark.json.
        settings: the benchmark's settings.
        targets: every pair.
        folder: the release's folder; None: `NO_PICTURE` stands for each picture.

    Raises:
        PairError: a pair is damaged.
    """
    of_recording, infos = by_recording(targets), info.recordings
    for category in sorted({each.category for each in infos.values()}):
        shown: list[dict[str, Any]] = [
            {
                "name": name,
                "info": each,
                "held_back": (hidden := info.hides(name)),
                "picture": None if info.isolates(name) else _picture(folder, of_recording[name][0], hidden),
                "words": category_words(each),
            }
            for name, each in sorted(infos.items())
            if each.category == category
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
