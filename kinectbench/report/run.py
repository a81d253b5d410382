"""Pages of what lies on disk: of a benchmark with its build folders, or of the scores of a release alone."""

from collections.abc import Callable, Sequence
from pathlib import Path

from kinectbench.config import BenchmarkSettings, PairSettings, RecordingSettings
from kinectbench.release.current import scoring_folder
from kinectbench.release.release import Release, open_release
from kinectbench.report.gallery import PairTruth, read_pair_truth
from kinectbench.report.gallery_cells import gallery_cells
from kinectbench.report.gallery_file import write_gallery
from kinectbench.report.page import Progress, make_page, write_report
from kinectbench.report.ranks import rank
from kinectbench.report.score_files import ScoreFile, baselines_of, files_in, files_named
from kinectbench.report.scores_part import Beside
from kinectbench.scoring.predictions import split_methods
from kinectbench.scoring.read import SCORES_JSON
from kinectbench.scoring.table import ScoreTable
from kinectbench.workspace import replaced_file

INDEX = "index.html"
RANKED = ("known", "paper", "occluded")


def page_of_benchmark(
    settings: BenchmarkSettings,
    root: Path,
    scores: Path | Sequence[Path],
    progress: Progress | None = None,
    out: Path | None = None,
    baselines: bool = True,
) -> tuple[Path, list[str]]:
    """Write the page of a benchmark from its `build/`, its release if there is one, and score files.

    Args:
        settings: the benchmark.
        root: its folder.
        scores: a folder, of which scores of another truth are left out, or files and folders by name.
        progress: see `write_report`.
        out: the page; default: index.html in the folder of scores.
        baselines: whether those that lie beside the scores are shown too.

    Returns:
        Its path, and a warning for each score file that was left out.

    Raises:
        SettingsError: a score file that was named is missing or of another truth.
    """
    release = open_release(scoring_folder(root)) if (root / "benchmark").is_dir() else None
    files, warnings = _files(scores, release, baselines)
    tables = [file.table for file in files]
    page = out or _folder(scores, root / "scores") / INDEX
    return write_report(settings, root / "build", tables, page, progress, _beside(files, release)), warnings


def page_of_release(
    release: Release, scores: Path | Sequence[Path], out: Path | None = None, baselines: bool = True
) -> tuple[Path, list[str]]:
    """The same with the score tables of a release that has no build folders here."""
    info = release.metadata
    recordings = [
        RecordingSettings(id=name, path="-", category=r.category, object=r.object, split=r.split)
        for name, r in info.recordings.items()
    ]
    pairs = PairSettings(framing=info.framing, partial_rule=info.partial_rule)
    settings = BenchmarkSettings(name=info.name, license=info.license, recordings=recordings, pairs=pairs)
    files, warnings = _files(scores, release, baselines)
    text = make_page(settings, (), [file.table for file in files], _beside(files, release), info)
    page = out or _folder(scores, Path("scores")) / INDEX
    with replaced_file(page) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return page, warnings


def write_galleries(
    release: Release,
    predictions: Path,
    tables: Sequence[ScoreTable],
    out: Path,
    upsampling: str,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write the gallery.npz of every method that `score_methods` just scored.

    Args:
        release: the truth.
        predictions: what was scored.
        tables: what it returned.
        out: its folder for the results.
        upsampling: the convention that it scored with.
        progress: called with (pairs done, pairs in all) for each method in turn.
    """
    folders = split_methods(predictions, release.targets).values()
    for table, folder in zip(tables, folders, strict=True):
        cells = gallery_cells(release, folder, table, upsampling, progress)
        scores = out if len(tables) == 1 else out / table.method
        write_gallery(cells, scores / SCORES_JSON)


def _files(
    scores: Path | Sequence[Path], release: Release | None, baselines: bool
) -> tuple[list[ScoreFile], list[str]]:
    sha256 = release.benchmark_sha256 if release else None
    warnings: list[str] = []
    if isinstance(scores, Path):
        files, warnings = files_in(scores, sha256)
    else:
        files = files_named(scores, sha256)
    return [*files, *(baselines_of(files) if baselines else [])], warnings


def _folder(scores: Path | Sequence[Path], default: Path) -> Path:
    """Where the page goes: beside the scores if they lie in one folder."""
    if isinstance(scores, Path):
        return scores
    return scores[0] if len(scores) == 1 and scores[0].is_dir() else default


def _beside(files: Sequence[ScoreFile], release: Release | None) -> Beside:
    """Ranks and galleries; the truth that is shown is the release's, whatever came with the scores."""
    truths: dict[str, PairTruth] = {}
    if release is not None:
        targets = {target.name: target for target in release.split("test")}
        wanted = {name for file in files if file.gallery for name in file.gallery.cells}
        truths = {name: read_pair_truth(release, targets[name]) for name in sorted(wanted & set(targets))}
    ranking = rank([file.path for file in files], RANKED)
    return Beside(ranking, [file.gallery for file in files], truths)
