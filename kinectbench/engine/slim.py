"""Delete the frames of a built recording, and keep the files that releases and reports need.

The stages stay up to date. A stage that needs the deleted frames is refused until the scan is back.
"""

from pathlib import Path

from kinectbench.core import RecordingError, replaced_file
from kinectbench.core.artefacts.manifest import Failed, Manifest, Sources
from kinectbench.engine.artefact import whole_hash, whole_manifest

# Folders of `build/<recording>/` that only later stages need, except for JSON files. For 300 frames of
# 640x480 with 50 views, 33 of 78 MB remain, and the scan of 43 MB can be deleted, too.
SLIMMED, KEPT = ("sequence", "reconstruction"), ".json"


def slim(build: Path) -> int:
    """Delete the frames and the scene's volume of a build, finished or failed; return the freed bytes.

    Args:
        build: `build/<recording>/`; no run may be building it.
    """
    freed = 0
    for name in SLIMMED:
        folder = build / name
        manifest = whole_manifest(folder)
        if manifest is None:
            continue
        kept = {file: size for file, size in manifest.files.items() if file.endswith(KEPT)}
        gone = len(manifest.files) - len(kept) + (manifest.removed or 0)
        # First write the manifest of the kept files, so that a kill here loses nothing.
        with replaced_file(folder / Manifest.FILE) as temporary:
            slimmed = manifest.model_copy(update={"files": kept, "removed": gone})
            temporary.write_text(slimmed.text(), encoding="utf-8")
        for path in sorted(folder.rglob("*")):
            if path.is_file() and not path.name.endswith(KEPT):
                freed += path.stat().st_size
                path.unlink()
    return freed


def keep_failed_source(build: Path) -> None:
    """Store the hash of a scan in failed.json, so that the failure stays valid once the scan is deleted.

    Args:
        build: `build/<recording>/`. Nothing is stored if there is no failed.json, if the scan was not
            hashed, or if `slim` has deleted the frames.
    """
    failed, sources = Failed.read_if_there(build), Sources.read_if_there(build)
    if failed is not None and sources is not None and not is_slim(build / "sequence"):
        with replaced_file(build / Failed.FILE) as temporary:
            whole = failed.model_copy(update={"scan_sha256": whole_hash(sources)})
            temporary.write_text(whole.text(), encoding="utf-8")


def is_slim(folder: Path) -> bool:
    """Whether files of a stage's folder were deleted by `slim`."""
    manifest = whole_manifest(folder)
    return manifest is not None and manifest.removed is not None


def kept_source(build: Path) -> str | None:
    """Return the hash over a scan's files if the scan was deleted after its build; else None."""
    manifest = whole_manifest(build / "sequence")
    if manifest is not None:
        return None if manifest.removed is None else manifest.inputs.get("recording")
    failed = Failed.read_if_there(build)
    return None if failed is None else failed.scan_sha256


def refuse_slim(recording: str, folder: Path) -> None:
    """Raise an error if `slim` deleted files from a folder that a stage needs as input.

    Raises:
        RecordingError: its files were deleted.
    """
    if is_slim(folder):
        raise RecordingError(
            f"{folder}: its frames were deleted after the build; fetch the scan again and run "
            f"`kinectbench build {recording} --force`",
            what="deleted",
        )
