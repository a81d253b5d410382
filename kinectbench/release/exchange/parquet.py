"""The targets of a release as a Parquet table, for millions of rows: typed, and readable by column.

The table is not part of a release, because pyarrow takes 170 MB, and a release's bytes must not depend on the
installed packages.
"""

from pathlib import Path

from kinectbench.core import require_extra
from kinectbench.core.artefacts.targets import NUMBER_COLUMNS, columns_of
from kinectbench.core.types import Progress, no_progress
from kinectbench.release.exchange.layouts import new_folder, write_export_json
from kinectbench.release.release import Release

TARGETS_PARQUET = "targets.parquet"
# Number of targets that are converted at a time, and that a reader gets at once.
ROWS_PER_GROUP = 100_000


def export_parquet(release: Release, out: Path, progress: Progress = no_progress) -> int:
    """Write targets.parquet with the columns and rows of targets.csv; `unknown_share` is a number or null.

    Args:
        release: the opened release.
        out: a new folder, or an earlier export, which is replaced.
        progress: called with (pairs done, pairs in all).

    Returns:
        The number of pairs.

    Raises:
        SettingsError: `out` holds something else, or pyarrow is not installed.
        StorageError: the disk is full or read-only.
    """
    require_extra("tables", "export: Parquet")
    import pyarrow as arrow
    from pyarrow import parquet

    names = columns_of(release.targets)
    schema = arrow.schema(
        [(name, arrow.float64() if name in NUMBER_COLUMNS else arrow.string()) for name in names]
    )
    done = 0
    with new_folder(out) as folder:
        with parquet.ParquetWriter(folder / TARGETS_PARQUET, schema, compression="zstd") as file:
            for start in range(0, len(release.targets), ROWS_PER_GROUP):
                group = release.targets[start : start + ROWS_PER_GROUP]
                file.write_table(
                    arrow.table({name: [getattr(target, name) for target in group] for name in names}, schema)
                )
                done += len(group)
                progress(done, len(release.targets))
        write_export_json(folder, release, {"targets": TARGETS_PARQUET})
    return done
