"""`kinectbench fetch` for a recipe: download its scans; with --stream also build each, then delete it."""

import shutil
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from math import isclose
from pathlib import Path
from typing import TYPE_CHECKING

from kinectbench.cli import console
from kinectbench.cli.common import CANNOT_BE_USED, SOME_FAILED, Common
from kinectbench.cli.progress_bars import progress_bar
from kinectbench.core import KinectBenchError, StorageError, listed_below

if TYPE_CHECKING:
    from kinectbench.release.recipe import FetchedScan, Recipe
    from kinectbench.settings.sources import Scan

# Largest number of bytes of disk that `--stream` uses at any time, built files included.
STREAM_BYTES = 5_000_000_000
# Bytes that the build of a scan needs besides its archive: at most this multiple of the archive, plus a
# constant. Measured: 114 MB for 300 frames of 640x480 (archive of 43 MB): a copy of the frames, and files of
# constant size.
BUILD_RATIO, BUILD_BYTES = 2, 300_000_000

# Intrinsics with a smaller relative difference count as equal: data sets publish four digits.
SAME_CAMERA = 1e-3


def fetch_recipe(
    common: Common,
    folder: Path,
    out: Path | None,
    categories: tuple[str, ...],
    limit: int | None,
    *,
    stream: bool,
) -> int:
    """Fetch up to `limit` scans of each category into the recipe's benchmark; return the exit status.

    With `stream`, each scan is built and its frames are deleted before the next scan is fetched.
    """
    from kinectbench.core.store.attempts import StoreGoneError
    from kinectbench.release.recipe import NoRoomError, opened_recipe
    from kinectbench.stages.ingest.readers import format_of

    def is_read(path: Path) -> bool:
        return format_of(path) is not None

    with opened_recipe(folder, out, partial(console.waiting, "fetch"), is_read=is_read) as recipe:
        scans = recipe.chosen(categories, limit)
        if stream:
            return _stream(common, recipe, scans)
        try:
            with progress_bar("fetch") as progress:
                rows = recipe.fetch_all(scans, progress)
        except (NoRoomError, StoreGoneError):
            recipe.add_to_benchmark([scan for scan in scans if (recipe.out / recipe.place(scan)).exists()])
            raise
        recipe.add_to_benchmark([row.scan for row in rows if row.error is None])
        return _tell(common, recipe, rows, f"next: kinectbench build -c {recipe.out / 'benchmark.yaml'}")


def _stream(common: Common, recipe: "Recipe", scans: "Sequence[Scan]") -> int:
    """Fetch, build and delete one scan after another; return the exit status.

    Scans that are built already, or whose build would fail again, are not fetched.
    """
    from kinectbench.core import require_extra, storage_errors
    from kinectbench.engine.artefact import whole_manifest
    from kinectbench.engine.failures import forget_failure, stored_failure, would_fail_again
    from kinectbench.engine.pipeline import STAGE_NAMES
    from kinectbench.engine.slim import is_slim, slim
    from kinectbench.release.recipe import BENCHMARK, FetchedScan, remove_scan

    require_extra("build")
    rows, left, used = [], Counter(scan.scan for scan in scans), set[str]()
    for number, scan in enumerate(scans, 1):
        build = recipe.out / "build" / scan.id
        failed, has_frames = stored_failure(build), not is_slim(build / "sequence")
        if not has_frames and whole_manifest(build / "pairs") is not None:
            forget_failure(build, STAGE_NAMES)  # of a later run, such as one that was killed
            slim(build)  # a killed run may have left some
            used.add(scan.scan)
            row = FetchedScan(scan, False)
        elif failed is not None and would_fail_again(failed):
            row = FetchedScan(scan, False, f"{scan.id}: failed before: {failed.error}")
        else:
            console.lines("fetch", [f"{scan.id}, {number} of {len(scans)}"], "cyan")
            row = recipe.fetch(scan, partial(_refuse_beyond, recipe.out))
            if row.error is None:
                used.add(scan.scan)
                if not has_frames:  # a build would refuse what is left
                    with storage_errors(build):
                        shutil.rmtree(build)
                row = _built(common, recipe, row)
        rows.append(row)
        left[scan.scan] -= 1
        if not left[scan.scan] and scan.scan in used:  # of several cameras all are built
            remove_scan(recipe.out, scan)
    return _tell(common, recipe, rows, f"next: kinectbench publish -c {recipe.out / BENCHMARK}")


def _built(common: Common, recipe: "Recipe", row: "FetchedScan") -> "FetchedScan":
    """Build a fetched scan and delete its frames; return the outcome."""
    from kinectbench.cli.build import build_jobs
    from kinectbench.engine.slim import keep_failed_source, slim
    from kinectbench.engine.stages import Job
    from kinectbench.release.recipe import BENCHMARK
    from kinectbench.settings.file import load_benchmark

    recipe.add_to_benchmark([row.scan])
    settings, build = load_benchmark(recipe.out / BENCHMARK), recipe.out / "build" / row.scan.id
    job = Job(settings, settings.by_id()[row.scan.id], recipe.out)
    (built,) = build_jobs([job], "pairs", Common(jobs=common.workers))
    slim(build)
    keep_failed_source(build)
    error = None if built.error is None else f"{row.scan.id}: not built: {built.error}"
    return replace(row, error=error)


def _refuse_beyond(out: Path, size: int) -> None:
    """Raise an error if a scan of `size` bytes and its build would exceed the disk space of `--stream`.

    Raises:
        StorageError: this scan alone would exceed it; a smaller scan may still fit.
        NoRoomError: this scan and the present content of `out` together would exceed it.
    """
    from kinectbench.release.recipe import NoRoomError

    used = sum(path.lstat().st_size for path in listed_below(out))
    needed = size + max(BUILD_RATIO * size, BUILD_BYTES)
    if needed > STREAM_BYTES:
        raise StorageError(
            f"{size} bytes are too large for --stream; fetch it without, and build it", what="no-room"
        )
    if used + needed > STREAM_BYTES:
        raise NoRoomError(
            f"{out}: holds {used / 1e9:.2f} GB; the next scan and its build may take {needed / 1e9:.2f} "
            f"GB, and --stream keeps to {STREAM_BYTES / 1e9:.0f} GB: publish what is here, and go on with "
            "--out NEW_FOLDER"
        )


def _tell(common: Common, recipe: "Recipe", rows: "Sequence[FetchedScan]", then: str) -> int:
    """Print the outcomes of the scans, then the line `then`; return 1 if all failed, 3 if some, else 0."""
    errors = [row.error for row in rows if row.error is not None]
    fetched, present = sum(row.fetched for row in rows), len(rows) - len(errors)
    lines = [f"{recipe.out}: {len(rows)} scans chosen, {fetched} fetched now, {len(errors)} failed"]
    result = {
        "recipe": str(recipe.out),
        "scans": [{"id": row.scan.id, "fetched": row.fetched, "error": row.error} for row in rows],
    }
    common.tell(result, [*lines, *([then] if present else [])])
    scans = [row.scan for row in rows if row.error is None]
    warnings = [
        *recipe.other_attribution(scans),
        *_other_cameras(recipe, [row.scan for row in rows if row.fetched]),
    ]
    console.lines("warning", warnings, "yellow")
    console.lines("error", errors, "red")
    return (SOME_FAILED if present else CANNOT_BE_USED) if errors else 0


def _other_cameras(recipe: "Recipe", scans: "Sequence[Scan]") -> list[str]:
    """Return a warning for each scan whose intrinsics differ from the recipe's; the recipe's are used."""
    from kinectbench.stages.ingest.intrinsics import NEEDED
    from kinectbench.stages.ingest.readers import open_recording, says_intrinsics

    lines = []
    for scan in scans:
        path = recipe.out / recipe.place(scan)
        given = {} if scan.camera is None else scan.camera.model_dump(include=set(NEEDED), exclude_none=True)
        if scan.camera is None or not given or not path.exists() or not says_intrinsics(path):
            continue
        try:
            own = open_recording(path, scan.camera.model_copy(update=dict.fromkeys(NEEDED))).camera
        except KinectBenchError:  # it has none, or the build reports the fault
            continue
        for key, value in given.items():
            if not isclose(value, getattr(own, key), rel_tol=SAME_CAMERA):
                said = f"the recipe says {key} {value:g}, the recording says {getattr(own, key):g}"
                lines.append(f"{scan.id}: {said}; the recipe's is taken: correct `camera` in sources.yaml")
                break
    return lines
