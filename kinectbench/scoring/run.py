"""Scoring a folder of predictions, of one method or of several, and writing the results."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import get_args

from kinectbench.errors import SettingsError
from kinectbench.release.release import Release
from kinectbench.scoring.counts import PROTOCOLS
from kinectbench.scoring.predictions import split_methods
from kinectbench.scoring.score import Missing, check_words, score
from kinectbench.scoring.table import ScoreTable, write_scores
from kinectbench.scoring.thresholds import thresholds_text
from kinectbench.voxels.resample import HALF_PIXEL
from kinectbench.workspace import replaced_file


def score_methods(
    release: Release,
    predictions: Path,
    out: Path,
    *,
    method: str | None = None,
    protocols: Sequence[str] | None = None,
    thresholds_file: Path | None = None,
    save_thresholds: Path | None = None,
    missing: str = "error",
    upsampling: str = HALF_PIXEL,
    surface: bool = True,
    jobs: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> list[ScoreTable]:
    """Score every method in a folder and write `out/scores.json`, or `out/<method>/scores.json` of several.

    Args:
        release: the truth.
        predictions: one method's folder (its subfolders are recordings), or a folder of methods.
        out: folder for the results.
        method: name of a single method; default: its folder's.
        protocols: default: all.
        thresholds_file: see `read_thresholds`.
        save_thresholds: freeze what was found on validation in this file.
        missing: "error" or "empty".
        upsampling: "half-pixel" or "corner-aligned".
        surface: whether surface metrics are computed.
        jobs: processes.
        progress: called with (pairs done, pairs in all) for each method in turn.

    Raises:
        SettingsError: a name or a file for thresholds is given to several methods, `missing` is neither word,
            or there are no thresholds to be saved.
        PredictionError: no predictions there.
    """
    if missing not in get_args(Missing):
        raise SettingsError(f"--missing {missing}: choose error or empty")
    check_words(protocols or tuple(PROTOCOLS), upsampling)
    methods = split_methods(predictions, release.targets)
    if method is not None:
        if len(methods) > 1:
            raise SettingsError(f"--method names one method, but {predictions} holds {len(methods)}")
        methods = dict(zip([method], methods.values(), strict=True))
    if save_thresholds is not None and len(methods) > 1:
        raise SettingsError(f"--save-thresholds is of one method, but {predictions} holds {len(methods)}")
    tables = []
    for name, folder in methods.items():
        target = out if len(methods) == 1 else out / name
        table = score(
            release,
            folder,
            method=name,
            protocols=tuple(protocols or PROTOCOLS),
            thresholds_file=thresholds_file,
            missing="empty" if missing == "empty" else "error",
            upsampling=upsampling,
            surface=surface,
            jobs=jobs,
            progress=progress,
            resume_in=target,
        )
        write_scores(table, target)
        tables.append(table)
        if save_thresholds is not None:
            _freeze(release, table, save_thresholds)
    return tables


def _freeze(release: Release, table: ScoreTable, path: Path) -> None:
    """Write the thresholds that were found on validation to a file."""
    if table.threshold_source != "validation":
        raise SettingsError(
            f"--save-thresholds {path}: the thresholds are not from validation; predict it too"
        )
    objects = {t.object for t in release.split("validation") if t.name in table.hashes}
    origin = {"method": table.method, "benchmark_sha256": release.benchmark_sha256}
    with replaced_file(path) as temporary:
        temporary.write_text(thresholds_text(table.thresholds, sorted(objects), origin))
