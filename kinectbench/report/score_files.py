"""Find the score files that a page shows, and refuse those of another truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinectbench.errors import ReleaseError, SettingsError, StorageError
from kinectbench.release.metadata import strict_json
from kinectbench.report.gallery_file import Gallery, read_gallery
from kinectbench.scoring.read import BASELINES_FOLDER, MAX_BYTES, SCORES_JSON, find_scores


@dataclass(frozen=True)
class ScoreFile:
    """One scores.json and the gallery beside it."""

    path: Path
    table: Mapping[str, Any]
    gallery: Gallery | None


def files_in(folder: Path, benchmark_sha256: str | None) -> tuple[list[ScoreFile], list[str]]:
    """The scores.json in a folder and in its subfolders, sorted; those of another truth are left out.

    Args:
        folder: of the scores; it need not be there.
        benchmark_sha256: of the truth, if known.

    Returns:
        The files, and a warning for each that is left out.

    Raises:
        StorageError: a file is not JSON.
    """
    files, warnings = [], []
    for path in [*sorted(folder.glob(SCORES_JSON)), *sorted(folder.glob(f"*/{SCORES_JSON}"))]:
        file = _read(path)
        if benchmark_sha256 is None or file.table.get("benchmark_sha256") == benchmark_sha256:
            files.append(file)
        else:
            warnings.append(f"{path}: scores of another benchmark, left out of the page; score again")
    return files, warnings


def files_named(paths: Sequence[Path], benchmark_sha256: str | None) -> list[ScoreFile]:
    """The score files that were asked for by name, of one truth.

    Args:
        paths: files, methods' folders, or folders of methods; a file named twice counts once.
        benchmark_sha256: of the truth; None if only the files know it, who must then agree.

    Raises:
        SettingsError: one is missing, or was scored against another truth.
        StorageError: a file is not JSON.
    """
    files = []
    for path in {path.resolve(): path for path in find_scores(paths)}.values():
        file = _read(path)
        found = file.table.get("benchmark_sha256")
        benchmark_sha256 = benchmark_sha256 or str(found)
        if found != benchmark_sha256:
            raise SettingsError(
                f"{path}: scored against benchmark {str(found)[:12]}, the page is of "
                f"{benchmark_sha256[:12]}; score it against that one or leave it out"
            )
        files.append(file)
    return files


def baselines_of(files: Sequence[ScoreFile]) -> list[ScoreFile]:
    """The baselines that `score` kept beside score files, of the same truth; one of each name.

    One that was scored as a method is not shown twice.

    Args:
        files: what the page shows, of one truth.

    Raises:
        StorageError: a file is not JSON.
    """
    shown = {str(file.table.get("method")) for file in files}
    truths = {file.table.get("benchmark_sha256") for file in files}
    folders = {folder: None for file in files for folder in (file.path.parent, file.path.parent.parent)}
    found: dict[str, ScoreFile] = {}
    for folder in folders:
        for path in sorted((folder / BASELINES_FOLDER).glob(f"*/{SCORES_JSON}")):
            file = _read(path)
            name = str(file.table.get("method"))
            same = file.table.get("baseline") is True and file.table.get("benchmark_sha256") in truths
            if same and name not in shown:
                found.setdefault(name, file)
    return [*found.values()]


def _read(path: Path) -> ScoreFile:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ValueError("larger than any table of scores")
        table = strict_json(path.read_text(encoding="utf-8"), str(path))
    except (OSError, ValueError, ReleaseError) as error:
        raise StorageError(f"{path}: not readable scores ({error}); score again") from error
    if not isinstance(table, dict):
        raise StorageError(f"{path}: holds no score table; score again")
    return ScoreFile(path, table, read_gallery(path))
