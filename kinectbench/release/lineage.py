"""lineage.json: from the files of a recording, by every stage, to the views and their pairs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from kinectbench.config import BenchmarkSettings, RecordingSettings
from kinectbench.release.built import built_json
from kinectbench.workspace import MANIFEST

# Stage -> its folder, in their order.
STAGES = {
    "ingest": "sequence",
    "track": "trajectory",
    "fuse": "reconstruction",
    "segment": "object",
    "sample-views": "views",
    "pairs": "pairs",
}


def recording_lineage(
    settings: BenchmarkSettings, recording: RecordingSettings, build: Path, views: Sequence[str] | None
) -> dict[str, Any]:
    """Where the pairs of one recording come from.

    Args:
        settings: the benchmark's.
        recording: one of them.
        build: `build/<recording>/`.
        views: those with a pair; None: neither they nor a given box may be told.

    Returns:
        `source`, `license`, `files` (name -> SHA-256), `stages` (name -> `package_version`, `settings`,
        `fingerprint`), `views` (rows `view`, `frame`, `stamp_ns`).

    Raises:
        ReleaseError: a file of the build is missing or damaged.
    """
    # A recording that is one file has no name below itself.
    files = {
        name or Path(recording.path).name: entry[2]
        for name, entry in sorted(built_json(build / "sources.json").items())
    }
    content: dict[str, Any] = {
        "source": settings.source_of(recording),
        "license": settings.license_of(recording),
        "files": files,
        "stages": {stage: _stage(build / folder, views is None) for stage, folder in STAGES.items()},
    }
    if views is not None:
        rows = {row["view"]: row for row in built_json(build / "views" / "views.json")["views"]}
        content["views"] = [
            {key: rows[view][key] for key in ("view", "frame", "stamp_ns")} for view in views if view in rows
        ]
    return content


def _stage(folder: Path, hidden: bool) -> dict[str, Any]:
    """What a stage's manifest says; without a given box, which tells the object's size, if it is hidden."""
    manifest = built_json(folder / MANIFEST)
    settings = {key: value for key, value in manifest["settings"].items() if not (hidden and key == "box")}
    return {
        "package_version": manifest["package_version"],
        "settings": settings,
        "fingerprint": manifest["fingerprint"],
    }
