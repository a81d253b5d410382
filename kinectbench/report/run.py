"""Pages of what lies on disk: of a benchmark with its build folders, or of the scores of a release alone."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kinectbench.config import BenchmarkSettings, RecordingSettings
from kinectbench.errors import StorageError
from kinectbench.release.release import Release
from kinectbench.report.page import Progress, make_page, write_report
from kinectbench.workspace import replaced_file


def page_of_benchmark(
    settings: BenchmarkSettings, root: Path, scores: Path, progress: Progress | None = None
) -> Path:
    """Write `scores/index.html` from `build/` and all score files in `scores`; returns its path."""
    return write_report(settings, root / "build", read_scores(scores), scores / "index.html", progress)


def page_of_release(release: Release, scores: Path) -> Path:
    """Write `scores/index.html` with the score tables of a release that has no build folders here."""
    info = release.metadata
    recordings = [
        RecordingSettings(id=name, path="-", category=r.category, object=r.object, split=r.split)
        for name, r in info.recordings.items()
    ]
    settings = BenchmarkSettings(name=info.name, license=info.license, recordings=recordings)
    text = make_page(settings, (), read_scores(scores, info.benchmark_sha256))
    out = scores / "index.html"
    with replaced_file(out) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return out


def read_scores(folder: Path, benchmark_sha256: str | None = None) -> Sequence[Mapping[str, Any]]:
    """All score tables in a folder: scores.json in it and in its subfolders, sorted.

    Args:
        folder: of the scores.
        benchmark_sha256: leave out the scores of any other benchmark.

    Raises:
        StorageError: a file is not JSON.
    """
    tables = []
    for path in [*sorted(folder.glob("scores.json")), *sorted(folder.glob("*/scores.json"))]:
        try:
            table = json.loads(path.read_text())
        except (OSError, ValueError) as error:
            raise StorageError(f"{path}: not readable scores ({error}); score again") from error
        if benchmark_sha256 is None or table.get("benchmark_sha256") == benchmark_sha256:
            tables.append(table)
    return tables
