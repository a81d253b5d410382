"""Artefacts of a build, each with a fingerprint of all its inputs; and hashes of recordings' files.

An artefact is a folder that one stage makes.
"""

import contextlib
import os
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from pydantic import JsonValue

from kinectbench._version import __version__
from kinectbench.core import (
    RecordingError,
    StorageError,
    canonical_json,
    replaced_file,
    replaced_folder,
    sha256_file,
    sha256_text,
)
from kinectbench.core.artefacts.benchmark import PUBLISH_VERSION
from kinectbench.core.artefacts.manifest import Manifest, SourceFile, Sources, Timing
from kinectbench.core.even_choice import evenly

FORMAT_VERSION = 1
# Files from this size on are refused as sparse if they are this many times larger than their disk usage.
# Compressing file systems make a recording less than ten times smaller.
HOLES_FROM_BYTES, MOST_SPARSENESS = 1 << 28, 1000
# Number of a recording's files whose names and sizes are compared. This is enough to tell recordings apart,
# and the status of thousands of recordings with thousands of files each is still quick.
COMPARED_FILES = 32

# Versions of files that are kept on disk and reused. Artefacts of another version are made again; those of
# the same version are kept, whatever the package's version. A change of an algorithm's output raises its
# version here by one. If the output changes only through an input, that input's version is raised instead.
# A test finds a forgotten version by one small sample (`tests/support/stage_sample.py`): a recording of one
# format, with trusted, refined and tracked poses, with and without a box and masks; baselines and scores of
# simple shapes. It misses changes that need other formats, scenes or settings.
# First the stages of a build; then candidate boxes, releases, synthetic models, score tables, and baselines.
VERSIONS: dict[str, int] = {
    "ingest": 24,
    "track": 16,
    "fuse": 7,
    "segment": 66,
    "sample-views": 8,
    "pairs": 4,
    "suggest": 8,
    "publish": PUBLISH_VERSION,
    "synthesize": 3,
    "score": 14,
    "baselines": 4,
}


def fingerprint(
    stage: str, version: int, settings: Mapping[str, JsonValue], inputs: Mapping[str, str]
) -> str:
    """Return the fingerprint of a stage's output: a hash of its name, version, settings and inputs."""
    return sha256_text(canonical_json([FORMAT_VERSION, stage, version, settings, inputs]))


@dataclass(frozen=True)
class Artefact:
    """A folder that one stage makes, and the values that identify its content.

    Attributes:
        folder: path of the folder.
        stage: name of the stage.
        version: version of the stage's output.
        settings: the settings it depends on, as plain JSON values.
        inputs: fingerprint of each input, by name.
    """

    folder: Path
    stage: str
    version: int
    settings: Mapping[str, JsonValue]
    inputs: Mapping[str, str]

    @cached_property
    def fingerprint(self) -> str:
        """The hash that identifies this artefact; the folder's manifest holds it."""
        return fingerprint(self.stage, self.version, self.settings, self.inputs)

    def is_current(self) -> bool:
        """Whether the folder holds this very artefact, with all its files present and of the right size."""
        manifest = whole_manifest(self.folder)
        return manifest is not None and manifest.fingerprint == self.fingerprint

    @contextlib.contextmanager
    def write(self) -> Iterator[Path]:
        """Yield an empty folder to fill; after the block it replaces the artefact, or is deleted on failure.

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
    """Return the manifest of a folder if all its files are present and of the right size; else None."""
    if not os.path.isdir(folder):  # noqa: PTH112 - usual before a build; False if it cannot be looked at
        return None
    try:
        manifest = Manifest.read(folder)
        # Strings, because joining paths takes longer than reading the sizes.
        above = f"{folder}{os.sep}"
        sizes = {name: os.stat(above + name).st_size for name in manifest.files}  # noqa: PTH116
    except (OSError, ValueError, StorageError):
        return None
    return manifest if sizes == manifest.files else None


def content_hash(files: Iterable[Path], root: Path, cache: Path | None = None) -> str:
    """Hash the names and contents of files.

    A file whose size and times equal those in the cache is not read again. The times include ctime, which
    distinguishes files of equal name, size and modification time, such as those from two archives.

    Args:
        files: the files.
        root: names are relative to this folder, so that a moved recording keeps its hash.
        cache: JSON file that keeps sizes, times and hashes (`Sources`); None: no cache.

    Raises:
        RecordingError: a file cannot be read, or is a sparse file with almost no content.
        StorageError: the cache cannot be written.
    """
    known = {} if cache is None else _known(cache)
    entries: dict[str, SourceFile] = {}
    for path in files:
        name = _relative(path, root)
        try:
            stat = path.stat()
            _refuse_holes(path, stat)
            seen = known.get(name)
            now = SourceFile(stat.st_size, stat.st_mtime_ns, seen.sha256 if seen else "", stat.st_ctime_ns)
            entries[name] = now if now == seen else now._replace(sha256=sha256_file(path))
        except OSError as error:
            raise RecordingError(
                f"{path}: cannot be read ({error.strerror}); check the file", what="unreadable"
            ) from error
    sources = Sources.model_validate(entries)
    if cache is not None and entries != known:
        with replaced_file(cache) as temporary:
            temporary.write_text(sources.text(), encoding="utf-8")
    return whole_hash(sources)


def whole_hash(sources: Sources) -> str:
    """Return the hash that `content_hash` would return, from the known hashes of the files' contents."""
    return _hash_of(sources.sha256)


def _hash_of(sha256: Mapping[str, str]) -> str:
    """Hash files, given as {name: SHA-256 of the content}."""
    return sha256_text(canonical_json(sha256))


def has_sizes(
    root: Path, cache: Path, sha256: str, names: Collection[str] | None = None, *, few: bool = False
) -> bool:
    """Whether a path still holds the files with this hash, as far as names and sizes show.

    Args:
        root: path that the names are relative to.
        cache: file where `content_hash` keeps names and sizes; if missing or damaged, the result is True.
        sha256: the hash over the files, as `content_hash` returns it.
        names: the names of all files at the path; None: added files are not noticed.
        few: whether there are only few files. If so, all are compared, and a file with another time is read
            again (a mask that was drawn again, or each file of a copied folder). If not, the sizes of some
            files are compared, and none is read.
    """
    of_size, of_sha256 = map(SourceFile._fields.index, ("size", "sha256"))
    try:
        rows = Sources.unchecked(cache)  # compared with the hash below
    except (OSError, ValueError, RecursionError):
        return True
    try:
        if _hash_of({name: row[of_sha256] for name, row in rows.items()}) != sha256:
            return False
        if names is not None and rows.keys() != set(names):
            return False
        files = [*rows.items()]
        some = files if few else [files[n] for n in evenly(len(files), COMPARED_FILES)]
        for name, row in some:
            stat = os.stat(_place(root, name))  # noqa: PTH116
            if stat.st_size != row[of_size]:
                return False
            now = SourceFile(stat.st_size, stat.st_mtime_ns, row[of_sha256], stat.st_ctime_ns)
            if few and list(now) != row and sha256_file(Path(_place(root, name))) != row[of_sha256]:
                return False
    except (OSError, ValueError, TypeError, LookupError, AttributeError):  # or a name that no file can have
        return False
    return True


def _place(root: Path, name: str) -> str:
    """Return the path of a file from its name relative to the recording's path: inverse of `_relative`."""
    path = f"{root}{os.sep}{name}" if name else str(root)
    # The system would follow a root that is a link before it goes up.
    return os.path.normpath(path) if name.startswith("..") else path


def _relative(path: Path, root: Path) -> str:
    """Return the name of a file relative to its recording's path; "" for the path itself."""
    if path == root:
        return ""
    whole, above = str(path), f"{root}{os.sep}"
    if whole.startswith(above):
        return whole.removeprefix(above)
    return Path(os.path.relpath(path, root)).as_posix()  # the file is beside the root, or the root is "."


def _refuse_holes(path: Path, stat: os.stat_result) -> None:
    """Refuse a sparse file with almost no content, because reading its zeros may take hours."""
    on_disk = 512 * stat.st_blocks
    if stat.st_size > HOLES_FROM_BYTES and on_disk * MOST_SPARSENESS < stat.st_size:
        raise RecordingError(
            f"{path}: a sparse file, of whose {stat.st_size} bytes only {on_disk} are stored; copy it again"
        )


def _known(cache: Path) -> dict[str, SourceFile]:
    """Return the rows of the cache by file name; {} if the cache is missing or damaged."""
    try:
        return Sources.read_file(cache).files
    except StorageError:
        return {}
