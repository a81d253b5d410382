"""Build artefacts with a fingerprint of all their inputs, and hashes of sources.

An artefact is a folder that one stage makes.
"""

import contextlib
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from pydantic import JsonValue

from kinectbench._version import __version__
from kinectbench.core.artefacts.manifest import Manifest, SourceFile, Sources, Timing
from kinectbench.core.errors import RecordingError, StorageError
from kinectbench.core.storage import canonical_json, replaced_file, replaced_folder, sha256_file, sha256_text

FORMAT_VERSION = 1
# A larger file of which the disk holds so much less is mostly a hole; file systems that compress make a
# recording less than ten times smaller.
HOLES_FROM_BYTES, MOST_SPARSENESS = 1 << 28, 1000

# Versions of files that are kept on disk and reused. Artefacts of another version are made again; those
# of the same version are kept, whatever the package's version. A change of an algorithm's output
# raises its version here by one. A change that only reaches it by its inputs does not: their versions say so.
# A test finds a forgotten version by one small sample (`tests/support/stage_sample.py`): a recording of one
# format, with trusted, refined and tracked poses, with and without a box and masks; baselines and scores of
# simple shapes. It does not see what only other formats, scenes or settings would show.
# The stages of a build; then what stands beside them or on them: candidates of boxes, releases, synthetic
# models, tables of scores, and the predictions of baselines.
VERSIONS: dict[str, int] = {
    "ingest": 13,
    "track": 14,
    "fuse": 6,
    "segment": 41,
    "sample-views": 4,
    "pairs": 3,
    "suggest": 7,
    "publish": 42,
    "synthesize": 2,
    "score": 11,
    "baselines": 3,
}


def fingerprint(
    stage: str, version: int, settings: Mapping[str, JsonValue], inputs: Mapping[str, str]
) -> str:
    """Fingerprint of what this version of a stage makes from these settings and inputs."""
    return sha256_text(canonical_json([FORMAT_VERSION, stage, version, settings, inputs]))


@dataclass(frozen=True)
class Artefact:
    """A folder that one stage makes.

    Attributes:
        folder: where it lies.
        stage: name of the stage.
        version: of the stage's output.
        settings: the settings it depends on, as plain JSON values.
        inputs: fingerprint of each thing it is made from.
    """

    folder: Path
    stage: str
    version: int
    settings: Mapping[str, JsonValue]
    inputs: Mapping[str, str]

    @cached_property
    def fingerprint(self) -> str:
        """The manifest content that identifies the artefact in a folder."""
        return fingerprint(self.stage, self.version, self.settings, self.inputs)

    def is_current(self) -> bool:
        """Whether the folder holds this very artefact, with every file present at its size."""
        manifest = whole_manifest(self.folder)
        return manifest is not None and manifest.fingerprint == self.fingerprint

    @contextlib.contextmanager
    def write(self) -> Iterator[Path]:
        """Yield an empty folder to fill; on success it replaces the artefact, on failure it is deleted.

        Raises:
            StorageError: the disk is full or read-only.
        """
        with replaced_folder(self.folder) as temporary:
            yield temporary
            files = {
                str(path.relative_to(temporary)): path.stat().st_size
                for path in sorted(temporary.rglob("*"))
                if path.is_file() and path.name != Timing.FILE
            }
            Manifest(
                format_version=FORMAT_VERSION,
                package_version=__version__,
                stage=self.stage,
                stage_version=self.version,
                fingerprint=self.fingerprint,
                settings=dict(self.settings),
                inputs=dict(self.inputs),
                files=files,
            ).write(temporary)


def whole_manifest(folder: Path) -> Manifest | None:
    """The manifest of a folder with every file at its size; None if a file is missing."""
    if not folder.is_dir():  # as of most stages of thousands of recordings before they are built
        return None
    try:
        manifest = Manifest.read(folder)
        # By texts: to join paths takes longer than to look at the files.
        sizes = {name: os.stat(f"{folder}{os.sep}{name}").st_size for name in manifest.files}  # noqa: PTH116
    except (OSError, StorageError):
        return None
    return manifest if sizes == manifest.files else None


def content_hash(files: Iterable[Path], root: Path, cache: Path | None = None) -> str:
    """Hash of the names and contents of files.

    Contents are hashed once: a file with the size and modification time in the cache is not read again.

    Args:
        files: the files.
        root: names are taken relative to it (so that moving the recording changes nothing).
        cache: the folder to keep sizes, times and hashes in; None: hash every time.

    Raises:
        RecordingError: a file cannot be read, or is mostly a hole.
    """
    known = {} if cache is None else _known(cache)
    entries: dict[str, SourceFile] = {}
    for path in files:
        name = _relative(path, root)
        try:
            stat = path.stat()
            _refuse_holes(path, stat)
            seen = known.get(name)
            fresh = seen is not None and seen[:2] == (stat.st_size, stat.st_mtime_ns)
            digest = seen.sha256 if seen is not None and fresh else sha256_file(path)
        except OSError as error:
            raise RecordingError(
                f"{path}: cannot be read ({error.strerror}); check the file", what="unreadable"
            ) from error
        entries[name] = SourceFile(stat.st_size, stat.st_mtime_ns, digest)
    sources = Sources.model_validate(entries)
    if cache is not None and entries != known:
        with replaced_file(cache / Sources.FILE) as temporary:
            temporary.write_text(sources.text(), encoding="utf-8")
    return whole_hash(sources)


def whole_hash(sources: Sources) -> str:
    """Hash of the names and known content hashes of files."""
    return sha256_text(canonical_json(sources.sha256))


def _relative(path: Path, root: Path) -> str:
    """The name of a file, relative to its recording's path; "" if it is that."""
    if path == root:
        return ""
    whole, above = str(path), f"{root}{os.sep}"
    if whole.startswith(above):
        return whole.removeprefix(above)
    return Path(os.path.relpath(path, root)).as_posix()  # it lies beside, or the root is "."


def _refuse_holes(path: Path, stat: os.stat_result) -> None:
    """Refuse a sparse file with almost no content: reading its zeros may take hours."""
    on_disk = 512 * stat.st_blocks
    if stat.st_size > HOLES_FROM_BYTES and on_disk * MOST_SPARSENESS < stat.st_size:
        raise RecordingError(
            f"{path}: of its {stat.st_size} bytes the disk holds {on_disk}, the rest is a hole; copy it again"
        )


def _known(folder: Path) -> dict[str, SourceFile]:
    """The content of the cache; empty if it is damaged."""
    try:
        return Sources.read(folder).files
    except StorageError:
        return {}
