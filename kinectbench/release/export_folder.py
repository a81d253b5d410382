"""What every export shares: a folder of its own, and export.json with where it is from."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from kinectbench import __version__
from kinectbench.errors import SettingsError
from kinectbench.release.release import Release
from kinectbench.workspace import pretty_json, replaced_folder

EXPORT_JSON = "export.json"


@contextmanager
def export_folder(out: Path) -> Iterator[Path]:
    """Yield an empty folder that takes `out`'s place when the block ends well.

    Raises:
        SettingsError: `out` holds something else than an earlier export.
        StorageError: the disk is full or read-only.
    """
    if out.exists() and not (out.is_dir() and ((out / EXPORT_JSON).is_file() or not any(out.iterdir()))):
        raise SettingsError(f"{out}: holds something else; choose a new or empty folder")
    with replaced_folder(out) as folder:
        yield folder


def write_export_json(folder: Path, release: Release, rows: Mapping[str, Any]) -> None:
    """Write export.json: which release it is from, and what the exported files do not say."""
    content = {
        "format_version": 1,
        "package_version": __version__,
        "benchmark_sha256": release.benchmark_sha256,
        "name": release.metadata.name,
        "license": release.metadata.license,
    }
    (folder / EXPORT_JSON).write_text(pretty_json(content | dict(rows)))
