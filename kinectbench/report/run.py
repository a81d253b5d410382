"""Write the page of a benchmark with build folders, or of a release alone, from files on disk."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kinectbench.core import SettingsError
from kinectbench.core.artefacts.gallery import Gallery, read_gallery, write_gallery
from kinectbench.core.artefacts.scores import BASELINES_FOLDER, SCORES_JSON, ScoreTable
from kinectbench.core.types import NamedProgress, Progress, no_progress
from kinectbench.release.publish.publish_if_stale import scoring_folder
from kinectbench.release.release import Release, open_release
from kinectbench.report.gallery import PairTruth, baseline_cells, gallery_cells, read_pair_truth
from kinectbench.report.page import Groups, ScoreExtras, write_report
from kinectbench.report.space_gallery import space_cells
from kinectbench.report.space_table import is_baseline
from kinectbench.scoring.compare import ALL, ALPHA, compare, find_scores, too_small
from kinectbench.scoring.method_json import read_in_camera
from kinectbench.scoring.predictions import split_methods
from kinectbench.scoring.protocols import PROTOCOLS
from kinectbench.scoring.read_table import read_table
from kinectbench.scoring.release_contradictions import release_contradictions
from kinectbench.scoring.uncertainty import smallest_p
from kinectbench.settings.models import BenchmarkSettings, PairSettings, RecordingSettings

INDEX = "index.html"
COMPARED = ("known", "paper", "occluded")
NOT_EVERYWHERE = tuple(name for name in PROTOCOLS if name not in COMPARED)


@dataclass(frozen=True)
class ScoreFile:
    """The content of a scores.json, and of the gallery file beside it, if any."""

    path: Path
    table: ScoreTable
    gallery: Gallery | None


def files_in(folder: Path, benchmark_sha256: str | None) -> tuple[list[ScoreFile], list[str]]:
    """Read every scores.json in a folder and its direct subfolders, sorted by path.

    Files scored against another release are left out. So are files whose score version is not the newest.

    Args:
        folder: the folder of scores; it may be missing.
        benchmark_sha256: hash of the release, if known.

    Returns:
        The files, and a warning for each file that is left out.

    Raises:
        StorageError: a file is damaged.
    """
    paths = [*sorted(folder.glob(SCORES_JSON)), *sorted(folder.glob(f"*/{SCORES_JSON}"))]
    score_files = [_read(path) for path in paths]
    others = [file for file in score_files if benchmark_sha256 not in (None, file.table.benchmark_sha256)]
    newest = max((file.table.score_version for file in score_files if file not in others), default=0)
    older = [file for file in score_files if file not in others and file.table.score_version != newest]
    files = [file for file in score_files if file not in (*others, *older)]
    return files, [
        f"{file.path}: scores of {what}, left out of the page; score again"
        for what, left_out in (("another benchmark", others), ("an older version", older))
        for file in left_out
    ]


def files_named(paths: Sequence[Path], benchmark_sha256: str | None) -> list[ScoreFile]:
    """Read the requested score files; all must be of the same release and score version.

    Args:
        paths: files, methods' folders, or folders of methods; a file named twice counts once.
        benchmark_sha256: hash of the release; None: the files must agree on one.

    Raises:
        SettingsError: a file is missing, or was scored against another release or by another version.
        StorageError: a file, or the gallery beside it, is damaged.
    """
    files: list[ScoreFile] = []
    for path in find_scores(paths):
        file = ScoreFile(path, read_table(path), read_gallery(path))
        sha256 = file.table.benchmark_sha256
        benchmark_sha256 = benchmark_sha256 or sha256
        if sha256 != benchmark_sha256:
            raise SettingsError(
                f"{path}: scored against benchmark {sha256[:12]}, the page is of "
                f"{benchmark_sha256[:12]}; score it against that one or leave it out",
                what="other-scores",
            )
        if files and file.table.score_version != files[0].table.score_version:
            raise SettingsError(
                f"{path}: counted by score version {file.table.score_version}, {files[0].path} by "
                f"score version {files[0].table.score_version}; score both again or leave one out",
                what="other-scores",
            )
        files.append(file)
    return files


def kept_baselines(files: Sequence[ScoreFile]) -> list[ScoreFile]:
    """Read the scores of baselines that `score` has written beside score files; one file per baseline.

    Only scores of the same release, score version and upsampling are returned. Baselines in `files` are left
    out; other methods of their names do not count. All `files` are of one release.

    Raises:
        StorageError: a file is damaged.
    """
    shown = {file.table.method for file in files if is_baseline(file.table)}
    counted = {(file.table.benchmark_sha256, file.table.counted_by) for file in files}
    folders = {folder: None for file in files for folder in (file.path.parent, file.path.parent.parent)}
    baselines: dict[str, ScoreFile] = {}
    for folder in folders:
        for path in sorted((folder / BASELINES_FOLDER).glob(f"*/{SCORES_JSON}")):
            file = _read(path)
            comparable = (file.table.benchmark_sha256, file.table.counted_by) in counted
            if comparable and file.table.baseline and file.table.method not in shown:
                baselines.setdefault(path.parent.name, file)
    return [*baselines.values()]


def _read(path: Path) -> ScoreFile:
    return ScoreFile(path, read_table(path), read_gallery(path))


def grouped(tables: Sequence[ScoreTable], protocols: Sequence[str]) -> Groups:
    """Group methods that a paired test over objects cannot distinguish (see `compare`).

    Args:
        tables: score tables of one release. Incomplete tables get no letters, and neither do added baselines:
            more comparisons would only make methods harder to distinguish.
        protocols: the protocols to compare under. The first one under which two methods are scored decides
            whether the test set is too small.
    """
    compared = {
        index: table
        for index, table in enumerate(tables)
        if table.complete and table.rows and not table.baseline
    }
    groups: dict[str, dict[int, str]] = {}
    notes: list[str] = []
    by_protocol = {p: {i: table for i, table in compared.items() if table.pairs(p)} for p in protocols}
    several = {protocol: of for protocol, of in by_protocol.items() if len(of) > 1}
    notes += [
        f"no groups under {protocol}: fewer than two methods are scored under it"
        for protocol in protocols
        if len(compared) > 1 and protocol not in several
    ]
    too_small = _alone(next(iter(compared.values())), protocols) if compared and not several else ""
    for protocol, of_protocol in several.items():
        try:
            comparison = compare([*of_protocol.values()], protocol=protocol)
        except SettingsError as error:
            notes.append(f"no groups under {protocol}: {error}")
            continue
        scope = ALL if ALL in comparison.groups else next(iter(comparison.groups))
        if not groups:
            too_small = comparison.too_small.get(scope, "")
        of = comparison.groups[scope]
        groups[protocol] = dict(zip(of_protocol, (of[name] for name in comparison.methods), strict=True))
        notes += [note for note in comparison.notes if note not in notes]
    return Groups(groups, tuple(notes), too_small)


def _alone(table: ScoreTable, protocols: Sequence[str]) -> str:
    """Return a sentence if the objects of a table are too few to distinguish it from any method; else ""."""
    for protocol in protocols:
        overall = (table.overall or {}).get(protocol)
        if overall is not None and overall.objects:
            return too_small(overall.objects, 1) if smallest_p(overall.objects) > ALPHA else ""
    return ""


def page_of_benchmark(
    settings: BenchmarkSettings,
    root: Path,
    scores: Path | Sequence[Path],
    progress: NamedProgress = no_progress,
    out: Path | None = None,
    baselines: bool = True,
) -> tuple[Path, list[str]]:
    """Write the page of a benchmark from its `build/`, its release (if there is one) and score files.

    Args:
        settings: the benchmark's settings.
        root: the benchmark's folder.
        scores: a folder (scores of another release or version are left out), or a list of files and folders.
        progress: called with (recording, done, total) before each recording, and finally ("", total, total).
        out: the page's file; default: index.html in the folder of scores.
        baselines: whether baselines kept beside the scores are shown, too.

    Returns:
        The page's path, and a warning for each score file that was left out.

    Raises:
        SettingsError: a listed score file is missing, or of another release or version.
        ReleaseError: the release is damaged.
        StorageError, PairError: as in `write_report`, or a score file or gallery is damaged.
    """
    release = open_release(scoring_folder(root)) if (root / "benchmark").is_dir() else None
    tables, extras, warnings = _scores(scores, release, baselines)
    page = out or _folder(scores, root / "scores") / INDEX
    return write_report(settings, root / "build", tables, page, progress, extras), warnings


def page_of_release(
    release: Release, scores: Path | Sequence[Path], out: Path | None = None, baselines: bool = True
) -> tuple[Path, list[str]]:
    """Write the page of a release without build folders; arguments and result as in `page_of_benchmark`."""
    info = release.metadata
    # Not validated: names come from the release, and are only shown.
    recordings = [
        RecordingSettings.model_construct(
            id=name, path="-", category=r.category, object=r.object, split=r.split
        )
        for name, r in info.recordings.items()
    ]
    pairs = PairSettings(framing=info.framing, partial_rule=info.partial_rule)
    settings = BenchmarkSettings.model_construct(
        name=info.name, license=info.license, recordings=recordings, pairs=pairs
    )
    tables, extras, warnings = _scores(scores, release, baselines)
    page = out or _folder(scores, Path("scores")) / INDEX
    return write_report(settings, None, tables, page, extras=extras, released=info), warnings


def write_galleries(
    release: Release,
    predictions: Path | None,
    tables: Sequence[ScoreTable],
    out: Path,
    upsampling: str,
    jobs: int = 1,
    progress: Progress = no_progress,
) -> None:
    """Write a gallery.npz beside the scores of every method that `score_methods` or `score_baselines` scored.

    Args:
        release: the release that was predicted.
        predictions: the folder of the scored predictions; None: baselines, which are predicted again.
        tables: the score tables; with `predictions`, in the order of `split_methods`.
        out: the folder in which the scores are.
        upsampling: the convention used for scoring, "half-pixel" or "corner-aligned".
        jobs: number of processes for baselines.
        progress: called with (pairs done, pairs in all); with `predictions`, for each method in turn.
    """
    if predictions is None:
        for table, cells in zip(
            tables, baseline_cells(release, tables, upsampling, jobs, progress), strict=True
        ):
            write_gallery(cells, out / table.method / SCORES_JSON)
        return
    folders = split_methods(predictions, release.targets).values()
    for table, folder in zip(tables, folders, strict=True):
        if not table.rows:  # earlier scores were kept, with their gallery
            continue
        method = read_in_camera(folder)
        if method is None:
            cells = gallery_cells(release, folder, table, upsampling, progress)
        else:
            cells = space_cells(release, folder, method, table, progress)
        scores = out if len(tables) == 1 else out / table.method
        write_gallery(cells, scores / SCORES_JSON)


def _scores(
    scores: Path | Sequence[Path], release: Release | None, baselines: bool
) -> tuple[list[ScoreTable], ScoreExtras, list[str]]:
    """Read scores: return the tables to show, their groups and galleries, and a warning per left-out file."""
    sha256 = release.benchmark_sha256 if release else None
    warnings: list[str] = []
    if isinstance(scores, Path):
        files, warnings = files_in(scores, sha256)
    else:
        files = files_named(scores, sha256)
    files += kept_baselines(files) if baselines else []
    if release is not None:
        files, others = _of_release(files, release, refuse=not isinstance(scores, Path))
        warnings += others
    tables = [file.table for file in files]
    # The shown truth is the release's, whatever the scores contain.
    truths: dict[str, PairTruth] = {}
    if release is not None:
        targets = {target.name: target for target in release.split("test")}
        wanted = {name for file in files if file.gallery for name in file.gallery}
        truths = {name: read_pair_truth(release, targets[name]) for name in sorted(wanted & set(targets))}
    groups = grouped(tables, _compared_under(tables))
    return tables, ScoreExtras(groups, [file.gallery for file in files], truths), warnings


def _compared_under(tables: Sequence[ScoreTable]) -> list[str]:
    """Return the protocols to compare methods under: scored voxel protocols, then camera-frame protocols."""
    scored = {row.heading for table in tables for row in table.rows}
    in_space = [table.rows[0].heading for table in tables if table.rows and table.rows[0].in_space]
    return [name for name in (*COMPARED, *NOT_EVERYWHERE) if name in scored] + [*dict.fromkeys(in_space)]


def _of_release(
    files: Sequence[ScoreFile], release: Release, refuse: bool
) -> tuple[list[ScoreFile], list[str]]:
    """Return the files that agree with the release, and a warning for each other file.

    With `refuse`, a file that does not agree raises an error.
    """
    score_files, warnings = [], []
    for file in files:
        problem = next(release_contradictions(file.table, release), None)
        if problem is None:
            score_files.append(file)
        elif refuse:
            raise SettingsError(
                f"{file.path}: {problem}; score the predictions again or leave it out", what="other-scores"
            )
        else:
            warnings.append(f"{file.path}: {problem}; left out of the page, score again")
    return score_files, warnings


def _folder(scores: Path | Sequence[Path], default: Path) -> Path:
    """Return the folder for the page: the folder of scores if exactly one is given, else `default`."""
    if isinstance(scores, Path):
        return scores
    return scores[0] if len(scores) == 1 and scores[0].is_dir() else default
