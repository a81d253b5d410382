"""Score predictions again and compare a score table with the result, row by row."""

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from kinectbench._version import __version__
from kinectbench.core import SettingsError, printable, sha256_file
from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.artefacts.score_marks import Verified
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.types import Progress, no_progress
from kinectbench.core.voxels.resample import CONVENTIONS, HALF_PIXEL
from kinectbench.engine.artefact import VERSIONS
from kinectbench.release.release import Release
from kinectbench.scoring.predictions import split_methods
from kinectbench.scoring.read_table import differing, read_table
from kinectbench.scoring.score import score
from kinectbench.scoring.thresholds import FROM_FILE

# Keys of a table that are not compared, or are compared in a special way.
NOT_COMPARED = {"method", "package_version", "rows", "warnings", "hashes", "settings", "baseline", "verified"}


def recheck(
    release: Release,
    path: Path,
    predictions: Path,
    *,
    thresholds_file: Path | None = None,
    jobs: int = 1,
    progress: Progress = no_progress,
) -> list[str]:
    """Score predictions with the settings of a table, and compare the result with the table.

    If all values agree, `verified` is written into the table's file; it is valid only as long as the table's
    rows, settings and hashes of predictions do not change. Otherwise the file is not changed.

    Args:
        release: the release that was scored.
        path: the table's scores.json.
        predictions: one method's folder of predictions.
        thresholds_file: the file that the table's thresholds were read from, if any.
        jobs: number of processes.
        progress: called with (pairs done, pairs in all).

    Returns:
        One line for each difference; [] if the table is verified.

    Raises:
        SettingsError: the table is of another release or version, its threshold file is not given, or
            `predictions` holds several methods but none with the table's name.
        StorageError: the table is damaged or contradicts itself, or cannot be written.
        PredictionError, ReleaseError: as in `score`.
    """
    stated = read_table(path)
    folder = _folder(release, stated, path, predictions)
    _same_thresholds_file(stated, path, thresholds_file)
    table = score(
        release,
        folder,
        method=stated.method,
        protocols=stated.settings.protocols,
        thresholds_file=thresholds_file,
        missing=stated.settings.missing or "error",
        upsampling=_upsampling(stated, path),
        surface=bool(stated.settings.surface_metrics),
        close=stated.settings.close,
        jobs=jobs,
        progress=progress,
    )
    differences = [*_words(stated, table, folder), *_differences(stated, table)]
    if not differences:
        _verified(stated, table).write(path.parent, path.name)
    return differences


def _folder(release: Release, stated: ScoreTable, path: Path, predictions: Path) -> Path:
    """Return the folder with the predictions of a table's method; refuse tables that cannot be rechecked."""
    if stated.benchmark_sha256 != release.benchmark_sha256:
        raise SettingsError(
            f"{path}: scored against benchmark {stated.benchmark_sha256[:12]}, this is "
            f"{release.benchmark_sha256[:12]}; name its own with --benchmark",
            what="other-scores",
        )
    if stated.score_version != VERSIONS["score"]:
        raise SettingsError(
            f"{path}: counted by score version {stated.score_version}, this is version {VERSIONS['score']}; "
            "recheck it with the kinectbench that it names, or score again",
            what="other-scores",
        )
    methods = split_methods(predictions, release.targets)
    if len(methods) == 1:
        return next(iter(methods.values()))
    if stated.method in methods:
        return methods[stated.method]
    raise SettingsError(
        f"{predictions}: holds {len(methods)} methods; name the folder of {printable(stated.method)!r}"
    )


def _same_thresholds_file(stated: ScoreTable, path: Path, given: Path | None) -> None:
    """Refuse a threshold file that is missing, or is not the one that the table was made with."""
    source = stated.threshold_source
    if given is None and source.startswith(FROM_FILE):
        raise SettingsError(f"{path}: its thresholds are from a file ({source[:17]}); give it: --thresholds")
    if given is not None:
        if not given.is_file():
            raise SettingsError(f"{given}: no such file", what="no-file")
        if source != f"{FROM_FILE}{sha256_file(given)}":
            raise SettingsError(
                f"{given}: not the file of the thresholds of {path} ({source[:17]})", what="other-scores"
            )


def _upsampling(stated: ScoreTable, path: Path) -> str:
    """Return the name of the upsampling that a table's settings describe in words."""
    words = (stated.settings.upsampling or HALF_PIXEL).replace(",", "").split()
    names = [name for name in CONVENTIONS if name in words]
    if len(names) != 1:
        raise SettingsError(
            f"{path}: its upsampling is not one of {', '.join(CONVENTIONS)}; score again", what="other-scores"
        )
    return names[0]


def _words(stated: ScoreTable, computed: ScoreTable, folder: Path) -> Iterator[str]:
    """Report if the method's name differs from method.json, or if the table lacks warnings."""
    method = MethodFile.read_if_there(folder)
    if method is not None and stated.method not in (method.name, folder.resolve().name):
        name, said = printable(stated.method), printable(method.name)
        yield f"'method' states '{name}'; the predictions are of '{said}', as {MethodFile.FILE} says"
    if (stated.baseline or stated.settings.of_baseline) and not computed.settings.of_baseline:
        yield "'baseline' states that they are a baseline's, but it predicts otherwise"
    for line in computed.warnings:
        if line not in stated.warnings:
            yield f"'warnings' does not have: {line}"


def _differences(stated: ScoreTable, computed: ScoreTable) -> Iterator[str]:
    """Report values of a table that differ from those computed from its predictions, rows first."""
    rows = {(row.pair, row.heading): row for row in stated.rows}
    again = {(row.pair, row.heading): row for row in computed.rows}
    for pair, protocol in sorted(rows.keys() | again.keys()):
        of = f"{pair} under {protocol}"
        one, other = rows.get((pair, protocol)), again.get((pair, protocol))
        if one is None or other is None:
            yield f"{of}: {'not in the table' if one is None else 'its prediction cannot be scored'}"
        else:
            yield from (f"{of}: {line}" for line in list(differing(one, other, "", whole=True))[:1])
    for name in sorted(stated.hashes.keys() | computed.hashes.keys()):
        old, new = stated.hashes.get(name), computed.hashes.get(name)
        if old is None or new is None:
            yield f"{name}: {'not in the table' if old is None else 'its prediction cannot be scored'}"
        elif old.truth != new.truth or old.prediction not in (None, new.prediction):
            yield f"{name}: another file than the one that was scored"
    contents = [table.model_copy(update={"rows": ()}).json_value() for table in (stated, computed)]
    yield from _beyond_the_rows(*contents)


def _beyond_the_rows(stated: Mapping[str, Any], computed: Mapping[str, Any]) -> Iterator[str]:
    """Report differences outside the rows: in thresholds, base rates, failures, settings and so on."""
    settings = stated.get("settings", {})
    for key in sorted((stated.keys() | computed.keys()) - NOT_COMPARED):
        yield from differing(stated.get(key), computed.get(key), key, whole=True)
    for key in sorted((settings.keys() | computed["settings"].keys()) - {"baseline_version"}):
        yield from differing(settings.get(key), computed["settings"].get(key), f"settings.{key}", whole=True)


def _verified(stated: ScoreTable, computed: ScoreTable) -> ScoreTable:
    """Return the table marked as verified, with the computed warnings and the hashes that it lacked."""
    found = {"hashes": computed.hashes, "warnings": computed.warnings, "verified": None}
    table = stated.model_copy(update=found)
    mark = Verified(
        date=datetime.now(UTC).date().isoformat(),
        package_version=__version__,
        table_sha256=table.facts_sha256(),
        predictions_sha256=table.predictions_sha256(),
    )
    return table.model_copy(update={"verified": mark})
