"""The page of a whole benchmark: one file that opens from disk, with every picture inside."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import yaml
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from kinectbench import __version__
from kinectbench.config import BenchmarkSettings
from kinectbench.release.metadata import ReleaseInfo
from kinectbench.report.recording import RecordingPart, collect
from kinectbench.report.scores_part import Beside, ScoresPart, scores_part
from kinectbench.scoring.published import SOURCE
from kinectbench.workspace import replaced_file

Progress = Callable[[str, int, int], None]

NOTHING_BESIDE = Beside()
# What stands in the page as it is.
OWN = {
    "style": "page.css",
    "page_script": "page.js",
    "gallery_script": "gallery.js",
    "three": "vendor/three/three.bundle.min.js",
}


@dataclass(frozen=True)
class Page:
    """Everything that the template shows.

    Attributes:
        settings: the benchmark's settings; `settings_yaml` is their text.
        package_version: of this package.
        recordings: a section each.
        scores: tables, charts, gallery.
        published_source: the paper whose own figures are shown.
        released: benchmark.json of a release whose build is not here; None where the page shows a build.
    """

    settings: BenchmarkSettings
    settings_yaml: str
    package_version: str
    recordings: tuple[RecordingPart, ...]
    scores: ScoresPart
    published_source: str
    released: ReleaseInfo | None = None

    @property
    def n_pairs(self) -> int:
        """Pairs of all recordings."""
        if self.released:
            return sum(recording.pairs for recording in self.released.recordings.values())
        return sum(len(part.tiles) for part in self.recordings)


def make_page(
    settings: BenchmarkSettings,
    recordings: Sequence[RecordingPart],
    scores: Sequence[Mapping[str, Any]],
    beside: Beside = NOTHING_BESIDE,
    released: ReleaseInfo | None = None,
) -> str:
    """Lay out the page from its parts: HTML text, the same for the same input.

    Of a release alone (`released`) the settings shown are those that it was built with.

    Raises:
        StorageError: a score table is not what scores.json should hold.
    """
    shown = released.settings if released else settings
    plain = shown.model_dump(mode="json", exclude_none=True)
    page = Page(
        settings=settings,
        settings_yaml=yaml.safe_dump(plain, sort_keys=False, allow_unicode=True),
        package_version=__version__,
        recordings=tuple(recordings),
        scores=scores_part(scores, beside),
        published_source=SOURCE,
        released=released,
    )
    # Names and reasons come from strangers: all text is escaped but what is our own.
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    own = {name: Markup(_packaged(file)) for name, file in OWN.items()}
    if page.scores.gallery is None:  # nothing to turn
        own |= {"three": Markup(""), "gallery_script": Markup("")}
    return environment.from_string(_packaged("page.html")).render(page=page, **own)


def write_report(
    settings: BenchmarkSettings,
    build: Path,
    scores: Sequence[Mapping[str, Any]],
    out: Path,
    progress: Progress | None = None,
    beside: Beside = NOTHING_BESIDE,
) -> Path:
    """Write the page of a benchmark.

    Args:
        settings: the benchmark.
        build: folder that holds a folder for each recording; what is not built yet is noted on the page.
        scores: score tables as in scores.json, one for each method; may be empty.
        out: the HTML file to write, in whole or not at all.
        progress: told (recording, done, total) before each recording, and ("", total, total) at the end.
        beside: ranks and galleries of the score tables.

    Returns:
        The file written: `out`.

    Raises:
        StorageError: a file in `build` or a score table is damaged, or `out` cannot be written.
        PairError: a pair file is missing or damaged.
    """
    report = progress or (lambda _recording, _done, _total: None)
    total = len(settings.recordings)
    parts = []
    for done, recording in enumerate(settings.recordings):
        report(recording.id, done, total)
        parts.append(collect(recording, build / recording.id))
    report("", total, total)
    text = make_page(settings, parts, scores, beside)
    with replaced_file(out) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return out


def _packaged(name: str) -> str:
    return resources.files("kinectbench.report").joinpath(name).read_text(encoding="utf-8")
