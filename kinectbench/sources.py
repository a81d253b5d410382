"""Fingerprints of files outside `build/`: the recordings and masks themselves."""

import json
from collections.abc import Iterable
from pathlib import Path

from kinectbench.errors import RecordingError
from kinectbench.workspace import canonical_json, replaced_file, sha256_file, sha256_text


def content_hash(files: Iterable[Path], root: Path, cache: Path | None) -> str:
    """One hash over the names and contents of files.

    Contents are hashed once: a file whose size and modification time are as the cache says is believed.

    Args:
        files: the files.
        root: names are taken relative to it (so that moving the recording changes nothing).
        cache: a JSON file to keep sizes, times and hashes in; None: hash every time.

    Raises:
        RecordingError: a file cannot be read.
    """
    known: dict[str, list[object]] = {}
    if cache is not None:
        try:
            known = json.loads(cache.read_text())
        except (OSError, ValueError):
            known = {}
        if not isinstance(known, dict) or not all(_is_entry(entry) for entry in known.values()):
            known = {}  # a cache: damaged is as good as none
    entries: dict[str, list[object]] = {}
    for path in files:
        name = path.relative_to(root).as_posix() if path != root else ""
        try:
            stat = path.stat()
            seen = known.get(name, [])
            fresh = seen[:2] == [stat.st_size, stat.st_mtime_ns]
            digest = seen[2] if fresh else sha256_file(path)
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read ({error.strerror}); check the file") from error
        entries[name] = [stat.st_size, stat.st_mtime_ns, digest]
    if cache is not None and entries != known:
        with replaced_file(cache) as temporary:
            temporary.write_text(canonical_json(entries))
    return sha256_text(canonical_json({name: entry[2] for name, entry in entries.items()}))


def _is_entry(entry: object) -> bool:
    return isinstance(entry, list) and list(map(type, entry)) == [int, int, str]
