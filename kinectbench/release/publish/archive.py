"""Deterministic zip archives of a release: the same folder always gives the same bytes."""

import shutil
import zipfile
from collections.abc import Sequence
from pathlib import Path

from kinectbench.core import ReleaseError, replaced_file, sha256_file
from kinectbench.core.artefacts.benchmark import ReleaseInfo
from kinectbench.core.artefacts.targets import SHA256SUMS
from kinectbench.core.types import Progress, no_progress
from kinectbench.release.publish.attribution import reasons_against_distribution
from kinectbench.release.published import listed_files
from kinectbench.settings.models import BenchmarkSettings

# Files that are stored, as they are already compressed.
STORED = (".npz", ".png", ".jpg")
MIDNIGHT = (1980, 1, 1, 0, 0, 0)
REGULAR_0644 = 0o100644 << 16
DEFLATE_LEVEL = 9


def _archive_stem(info: ReleaseInfo) -> str:
    """Return the name of a release's archive without suffix: `<name>-<version>`.

    Without a version, the first 8 digits of benchmark_sha256 replace it. If the release is the private part
    of a benchmark with held-back truth, the name ends with `-private`.
    """
    private = "-private" if info.public_benchmark_sha256 else ""
    return f"{info.name}-{info.version or info.benchmark_sha256[:8]}{private}"


def refuse_unstated(settings: BenchmarkSettings, ids: Sequence[str] | None) -> None:
    """Raise an error if the planned release must not be distributed; called before anything is built.

    Args:
        settings: the benchmark's settings.
        ids: the recordings to publish; None: all.

    Raises:
        ReleaseError: the licence or source of a recording is not stated.
    """
    wanted = {
        recording.id: recording.model_copy(
            update={"license": settings.license_of(recording), "source": settings.source_of(recording)}
        )
        for recording in settings.recordings
        if not ids or recording.id in ids
    }
    _refuse(reasons_against_distribution(wanted))


def _refuse(reasons: Sequence[str]) -> None:
    if reasons:
        raise ReleaseError(f"no archive is made: {'; and '.join(reasons)}", what="no-archive")


def write_archive(release: Path, out: Path, progress: Progress = no_progress) -> Path:
    """Pack a release as `out/<stem>.zip`, with its checksum in `<stem>.zip.sha256`; return the zip's path.

    Only SHA256SUMS and the files in it are packed. Entries are sorted, with fixed times and permissions. npz
    files and pictures are stored uncompressed, all other files are deflated.

    Args:
        release: the release's folder.
        out: the folder for the archive, which is made if missing.
        progress: called with (files checked and packed, twice the files in all).

    Raises:
        ReleaseError: there is no release, it must not be distributed, or a file is missing or lacks its hash.
        StorageError: the disk is full or read-only.
    """
    info = ReleaseInfo.read(release)
    _refuse(info.distribution.reasons if info.distribution else ())
    listed = listed_files(release, lambda done, total: progress(done, 2 * total))
    stem, names = _archive_stem(info), [SHA256SUMS, *listed]
    path = out / f"{stem}.zip"
    with replaced_file(path) as temporary:
        with zipfile.ZipFile(temporary, "w") as archive:
            for done, name in enumerate(sorted(names)):
                _add(archive, release / name, f"{stem}/{name}")
                progress(len(listed) + done, 2 * len(listed))
        sha256 = sha256_file(temporary)
    with replaced_file(path.with_name(f"{path.name}.sha256")) as temporary:
        temporary.write_text(f"{sha256}  {path.name}\n", encoding="utf-8")
    return path


def _add(archive: zipfile.ZipFile, file: Path, name: str) -> None:
    """Add one file to an archive in blocks, so that it is never in memory as a whole."""
    entry = zipfile.ZipInfo(name, MIDNIGHT)
    entry.create_system = 3  # Unix, on every system
    entry.external_attr = REGULAR_0644
    if file.suffix not in STORED:
        entry.compress_type = zipfile.ZIP_DEFLATED
        entry._compresslevel = DEFLATE_LEVEL  # type: ignore[attr-defined]
    entry.file_size = file.stat().st_size
    with file.open("rb") as source, archive.open(entry, "w") as target:
        shutil.copyfileobj(source, target, 1 << 20)
