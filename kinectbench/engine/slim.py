"""A recording whose scan is deleted after the build: keeps what releases and reports need.

Its stages stay current. What would have to be made from the deleted frames is refused until the scan is back.
"""

from pathlib import Path

from kinectbench.core.artefacts.manifest import Failed, Manifest, Sources
from kinectbench.core.errors import RecordingError
from kinectbench.core.storage import replaced_file
from kinectbench.engine.artefact import whole_hash, whole_manifest

# Folders of `build/<recording>/` of which only later stages read more than the JSON files. Of 300 frames of
# 640x480 with 50 views 33 MB of 78 stay, and the scan of 43 MB goes, too.
SLIMMED, KEPT = ("sequence", "reconstruction"), ".json"


def slim(build: Path) -> int:
    """Delete the frames and the scene's volume of a build; returns the bytes freed.

    So it is with a recording that failed on the way.

    Args:
        build: `build/<recording>/`; nobody may be building it.
    """
    freed = 0
    for name in SLIMMED:
        folder = build / name
        manifest = whole_manifest(folder)
        if manifest is None:
            continue
        kept = {file: size for file, size in manifest.files.items() if file.endswith(KEPT)}
        gone = len(manifest.files) - len(kept) + (manifest.removed or 0)
        # First write the files to keep, so that a kill here loses nothing.
        with replaced_file(folder / Manifest.FILE) as temporary:
            slimmed = manifest.model_copy(update={"files": kept, "removed": gone})
            temporary.write_text(slimmed.text(), encoding="utf-8")
        for path in sorted(folder.rglob("*")):
            if path.is_file() and not path.name.endswith(KEPT):
                freed += path.stat().st_size
                path.unlink()
    return freed


def keep_failed_source(build: Path) -> None:
    """Keep the deleted scan's identity in failed.json, so that its reason can be repeated.

    Args:
        build: `build/<recording>/` of a recording that could not be read; of another nothing is changed.
    """
    failed, sources = Failed.read_if_there(build), Sources.read_if_there(build)
    if failed is not None and sources is not None and not is_slim(build / "sequence"):
        with replaced_file(build / Failed.FILE) as temporary:
            whole = failed.model_copy(update={"scan_sha256": whole_hash(sources)})
            temporary.write_text(whole.text(), encoding="utf-8")


def is_slim(folder: Path) -> bool:
    """Whether files of a stage's folder were deleted."""
    manifest = whole_manifest(folder)
    return manifest is not None and manifest.removed is not None


def kept_source(build: Path) -> str | None:
    """The one hash over the files of a scan that was deleted; None if none was."""
    manifest = whole_manifest(build / "sequence")
    if manifest is not None:
        return None if manifest.removed is None else manifest.inputs.get("recording")
    failed = Failed.read_if_there(build)
    return None if failed is None else failed.scan_sha256


def refuse_slim(recording: str, folder: Path) -> None:
    """Refuse a stage's folder to make another stage from, if files of it were deleted.

    Raises:
        RecordingError: they were.
    """
    if is_slim(folder):
        raise RecordingError(
            f"{folder}: its frames were deleted after the build; fetch the scan again and run "
            f"`kinectbench build {recording} --force`",
            what="deleted",
        )
