"""Pages of what lies on disk: of a benchmark with its build folders, or of the scores of a release alone."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kinectbench.config import BenchmarkSettings, RecordingSettings
from kinectbench.errors import StorageError
from kinectbench.release.metadata import read_metadata
from kinectbench.release.release import Release
from kinectbench.report.page import Progress, make_page, write_report
from kinectbench.workspace import replaced_file


def page_of_benchmark(
    settings: BenchmarkSettings, root: Path, scores: Path, progress: Progress | None = None
) -> tuple[Path, list[str]]:
    """Write `scores/index.html` from `build/` and the score files in `scores`.

    Returns:
        Its path, and a warning for each score file of another benchmark than the one published.
    """
    published = root / "benchmark"
    sha256 = read_metadata(published).benchmark_sha256 if published.is_dir() else None
    tables, warnings = read_scores(scores, sha256)
    return write_report(settings, root / "build", tables, scores / "index.html", progress), warnings


def page_of_release(release: Release, scores: Path) -> tuple[Path, list[str]]:
    """The same with the score tables of a release that has no build folders here."""
    info = release.metadata
    recordings = [
        RecordingSettings(id=name, path="-", category=r.category, object=r.object, split=r.split)
        for name, r in info.recordings.items()
    ]
    settings = BenchmarkSettings(name=info.name, license=info.license, recordings=recordings)
    tables, warnings = read_scores(scores, info.benchmark_sha256)
    text = make_page(settings, (), tables)
    out = scores / "index.html"
    with replaced_file(out) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return out, warnings


def read_scores(
    folder: Path, benchmark_sha256: str | None = None
) -> tuple[Sequence[Mapping[str, Any]], list[str]]:
    """All score tables in a folder: scores.json in it and in its subfolders, sorted.

    Args:
        folder: of the scores.
        benchmark_sha256: leave out the scores of any other benchmark, which cannot be compared.

    Returns:
        The tables, and a warning for each that is left out.

    Raises:
        StorageError: a file is not JSON.
    """
    tables, warnings = [], []
    for path in [*sorted(folder.glob("scores.json")), *sorted(folder.glob("*/scores.json"))]:
        try:
            table = json.loads(path.read_text())
        except (OSError, ValueError) as error:
            raise StorageError(f"{path}: not readable scores ({error}); score again") from error
        if not isinstance(table, dict):
            raise StorageError(f"{path}: holds no score table; score again")
        if benchmark_sha256 is None or table.get("benchmark_sha256") == benchmark_sha256:
            tables.append(table)
        else:
            warnings.append(f"{path}: scores of another benchmark, left out of the page; score again")
    return tables, warnings
