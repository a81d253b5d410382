"""Download a release, or part of it, from a URL or folder; check every file, skip files already here."""

import contextlib
import hashlib
import os
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from kinectbench.core import (
    TEXT_BYTES,
    ReleaseError,
    SettingsError,
    printable,
    replaced_file,
    sha256_file,
    write_below,
)
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, ReleaseInfo
from kinectbench.core.artefacts.targets import (
    SHA256SUMS,
    TARGETS_CSV,
    Target,
    benchmark_sha256,
    list_of_files,
    parse_sums,
    parse_targets,
)
from kinectbench.core.store.address import joined, shown, unusable, url_of
from kinectbench.core.store.attempts import MissingObjectError
from kinectbench.core.store.store import Store, in_parallel
from kinectbench.core.types import Progress, no_progress
from kinectbench.release.contents import MOST_FILE_BYTES, MOST_FILES, PREVIEWS, SURFACES, most_bytes
from kinectbench.release.own_folder import is_ours, owned, remains
from kinectbench.release.published import release_store, release_text

# Environment variable with a URL below which a plain NAME is looked up.
RELEASES_VARIABLE = "KINECTBENCH_RELEASES"
CACHE_VARIABLE = "KINECTBENCH_CACHE"
# Folders of a release with a folder or file for each recording; of pictures, below their split.
BY_RECORDING = ("pairs", "views", "objects", SURFACES)


@dataclass(frozen=True)
class ReleasePart:
    """The part of a release to download.

    Attributes:
        split: train, validation or test; None: all splits.
        categories: names of categories, such as chair; empty: all categories.
        views: number of views of each recording, taken in the order of their names; None: all views.
    """

    split: str | None = None
    categories: tuple[str, ...] = ()
    views: int | None = None


@dataclass(frozen=True)
class Fetched:
    """The result of a download.

    Attributes:
        folder: the release's folder on this machine.
        benchmark_sha256: the hash that identifies the release.
        pairs: number of pairs in the requested part.
        fetched: number of the part's files, without SHA256SUMS, that were downloaded now.
        kept: number of the part's files, without SHA256SUMS, that were already here.
    """

    folder: Path
    benchmark_sha256: str
    pairs: int
    fetched: int
    kept: int


def release_url(name: str | Path) -> str:
    """Return the URL of a release, given its URL, a local folder, or a name.

    A name is appended to the URL in the environment variable KINECTBENCH_RELEASES.

    Raises:
        SettingsError: the URL is unusable; or `name` is neither URL nor folder, and it contains a "/" or the
            variable is not set.
    """
    if problem := unusable(str(name)):
        raise SettingsError(printable(problem, 300), what="bad-url")
    url = url_of(name)
    if url is not None:
        return url
    path = Path(name)
    if os.path.isdir(path):  # noqa: PTH112 - whatever the name is
        return path.resolve().as_uri()
    base = url_of(os.environ.get(RELEASES_VARIABLE, ""))
    if base is None or len(path.parts) != 1:
        raise SettingsError(
            f"{printable(shown(name))}: no such folder and no URL; name a release's URL or folder, or set "
            f"{RELEASES_VARIABLE} to the URL of a place that holds releases by their names",
            what="no-file",
        )
    return joined(base, str(name))


def fetch_release(
    url: str, out: Path, part: ReleasePart | None = None, progress: Progress = no_progress
) -> Fetched:
    """Download a release, or part of it, into a folder; resume a stopped download.

    Files that belong to no single recording are always downloaded. A later call may add another part to the
    folder. If several processes fetch into one folder, one downloads, and the others wait for its files.

    Args:
        url: URL of the release.
        out: the folder, which is made if missing.
        part: the part to fetch; None: everything.
        progress: called with (files done, files in all).

    Raises:
        ReleaseError: there is no release, it is damaged, a file is not the published one, or the folder
            holds something else.
        SettingsError: the part has no pair, or a requested category has none.
        StorageError: the store fails or lacks a file, or the disk cannot be written.
    """
    store = release_store(url)
    text, info = _head(store)
    sums = parse_sums(text, store.place(SHA256SUMS))
    _refuse_many(store, sums)
    if BENCHMARK_JSON not in sums:
        raise ReleaseError(_changed(store, BENCHMARK_JSON), what="changed")
    _refuse_other(out, text)
    table = _checked_text(store, TARGETS_CSV, sums.get(TARGETS_CSV))
    wanted = part or ReleasePart()
    targets = chosen_targets(parse_targets(table, store.place(TARGETS_CSV)), wanted)
    absent = sorted(set(wanted.categories) - {target.category for target in targets})
    if absent or not targets:
        named = f" ({printable(', '.join(absent))})" if absent else ""
        raise SettingsError(
            f"{store.place()}: no pair of that split and category{named}; its {TARGETS_CSV} lists all",
            what="no-pairs",
        )
    names = wanted_names(sums, targets, part)
    # Whoever finds all files does not wait for the lock: many processes may read one folder.
    present = in_parallel(partial(_is_here, out / name, sums[name]) for name in names)
    missing = [name for name, is_present in zip(names, present, strict=True) if not is_present]
    fetched = 0
    if missing or remains(out):
        with owned(out):
            _refuse_other(out, text)
            fetched = _bring_all(store, out, text, missing, _counter(progress, len(names)))
    progress(len(names), len(names))
    return Fetched(out, info.benchmark_sha256, len(targets), fetched, len(names) - fetched)


def _bring_all(store: Store, out: Path, text: str, names: list[str], done: Callable[[int], None]) -> int:
    """Download those files of `names` that are missing in `out`; return the number of downloaded files.

    `text` is the content of SHA256SUMS; `done` is called with the number of files done.
    """
    # The list comes first: it identifies a fetch that was stopped; benchmark.json comes last.
    if not _is_here(out / SHA256SUMS, hashlib.sha256(text.encode()).hexdigest()):
        with replaced_file(out / SHA256SUMS) as temporary:
            temporary.write_bytes(text.encode())
    sums = parse_sums(text, store.place(SHA256SUMS))
    last = [name for name in names if name == BENCHMARK_JSON]
    fetched = in_parallel(
        (partial(_bring, store, out, name, sums[name]) for name in names if name != BENCHMARK_JSON), done
    )
    return sum(fetched) + sum(_bring(store, out, name, sums[name]) for name in last)


def mirror_release(url: str, out: Path, progress: Progress = no_progress) -> list[str]:
    """Copy a release into an empty folder for inspection; damaged or missing files raise no error.

    Returns:
        Names of files in the store that are not in SHA256SUMS; empty if the store cannot be listed.

    Raises:
        ReleaseError: there is no release at all, or its list of files cannot be read.
        StorageError: the store fails.
    """
    store, sums = _mirror_list(url, out)
    in_parallel((partial(_mirror, store, out, name) for name in sums), _counter(progress, len(sums)))
    return _others(store, sums)


def stored_hashes(
    url: str, out: Path, progress: Progress = no_progress
) -> tuple[dict[str, str | None], list[str]]:
    """Download, hash and delete each file of a release at a URL; return the hashes.

    `SHA256SUMS` and `benchmark.json` stay in the folder `out`.

    Returns:
        {name: SHA-256, or None if missing} in the order of SHA256SUMS, and the names that `mirror_release`
        returns.

    Raises:
        ReleaseError: as in `mirror_release`.
        StorageError: the store fails.
    """
    store, sums = _mirror_list(url, out)
    calls = (partial(_mirrored_hash, store, out, name) for name in sums)
    hashes = in_parallel(calls, _counter(progress, len(sums)))
    return dict(zip(sums, hashes, strict=True)), _others(store, sums)


def cached_release(url: str, progress: Progress = no_progress) -> Path:
    """Return the folder of a release in the local cache; download the release if it is missing."""
    _, info = _head(release_store(url))
    base = Path(os.environ.get(CACHE_VARIABLE) or Path.home() / ".cache" / "kinectbench")
    return fetch_release(url, base / "releases" / info.benchmark_sha256, progress=progress).folder


def chosen_targets(targets: Collection[Target], part: ReleasePart) -> tuple[Target, ...]:
    """Return the targets that belong to a part of the release, sorted by recording and view."""
    found: dict[str, list[Target]] = {}
    for target in sorted(targets):
        if part.split in (None, target.split) and (not part.categories or target.category in part.categories):
            found.setdefault(target.recording, []).append(target)
    return tuple(target for rows in found.values() for target in rows[: part.views])


def wanted_names(names: Collection[str], targets: Collection[Target], part: ReleasePart | None) -> list[str]:
    """Return the release's file names that a part needs; all names if `part` is None.

    A part needs the files of the recordings and views in `targets`, and all files that belong to no
    recording.
    """
    if part is None:
        return list(names)
    views: dict[str, set[str]] = {}
    for target in targets:
        views.setdefault(target.recording, set()).add(target.view)
    wanted = []
    for name in names:
        folder, _, tail = name.partition("/")
        picture = tail.partition("/")[2]
        if folder == PREVIEWS and "/" in picture:
            folder, tail = "views", picture
        recording, _, file = tail.partition("/")
        of = views.get(recording if file else recording.rpartition(".")[0])
        view = file.partition(".")[0]
        if folder not in BY_RECORDING or (of is not None and (not view.isdigit() or view in of)):
            wanted.append(name)
    return wanted


def _head(store: Store) -> tuple[str, ReleaseInfo]:
    """Read a stored release's SHA256SUMS, as text, and benchmark.json; check that they agree."""
    try:
        stated = _text(store, BENCHMARK_JSON)
        info = ReleaseInfo.parse(stated, store.place(BENCHMARK_JSON))
        text = _text(store, SHA256SUMS)
    except MissingObjectError:
        raise ReleaseError(
            f"{store.place()}: no release there ({BENCHMARK_JSON} or {SHA256SUMS} is missing); "
            "correct the URL, or wait until it is published",
            what="not-one",
        ) from None
    if benchmark_sha256(text, stated) != info.benchmark_sha256:
        raise ReleaseError(
            f"{store.place(SHA256SUMS)}: not the list that {BENCHMARK_JSON} names; if it is being published, "
            "try again later",
            what="being-written",
        )
    return text, info


def _text(store: Store, name: str) -> str:
    try:
        return store.read(name, TEXT_BYTES).decode()
    except UnicodeDecodeError as error:
        raise ReleaseError(f"{store.place(name)}: not a UTF-8 text ({error})") from error


def _checked_text(store: Store, name: str, sha256: str | None) -> str:
    content = store.read(name, TEXT_BYTES)
    if hashlib.sha256(content).hexdigest() != sha256:
        raise ReleaseError(_changed(store, name), what="changed")
    return content.decode("utf-8", errors="replace")


def _changed(store: Store, name: str) -> str:
    return f"{store.place(name)}: changed since it was published (SHA-256 differs); ask whoever published it"


def _is_here(path: Path, sha256: str) -> bool:
    return path.is_file() and sha256_file(path) == sha256


def _bring(store: Store, out: Path, name: str, sha256: str) -> bool:
    """Download a file unless it is here already with this SHA-256; return whether it was downloaded."""
    path = out / name
    if _is_here(path, sha256):
        return False
    store.fetch(name, path, most_bytes(name))
    if sha256_file(path) != sha256:
        path.unlink()
        raise ReleaseError(_changed(store, name), what="changed")
    return True


def _mirror_list(url: str, out: Path) -> tuple[Store, dict[str, str]]:
    """Download SHA256SUMS unchanged; return the store, and the content of SHA256SUMS as {file: hash}."""
    store = release_store(url)
    try:
        text = store.read(SHA256SUMS, TEXT_BYTES)
        sums = parse_sums(text.decode("utf-8", errors="replace"), store.place(SHA256SUMS))
    except MissingObjectError:
        raise ReleaseError(
            f"{store.place()}: no release there ({SHA256SUMS} is missing)", what="not-one"
        ) from None
    _refuse_many(store, sums)
    write_below(out / SHA256SUMS, text)
    return store, sums


def _others(store: Store, sums: Collection[str]) -> list[str]:
    listed = store.objects(most=2 * MOST_FILES) if store.can_list else []
    return [each.name for each in listed if each.name not in sums and each.name != SHA256SUMS]


def _mirrored_hash(store: Store, out: Path, name: str) -> str | None:
    path = out / name
    _mirror(store, out, name)
    if not path.is_file():
        return None
    digest = sha256_file(path)
    if name != BENCHMARK_JSON:
        path.unlink()
    return digest


def _mirror(store: Store, out: Path, name: str) -> None:
    """Download a file without checking it; do nothing if the store lacks it."""
    with contextlib.suppress(MissingObjectError):
        store.fetch(name, out / name, MOST_FILE_BYTES)


def _refuse_other(out: Path, text: str) -> None:
    """Raise an error if `out` holds anything but the release whose SHA256SUMS has the content `text`."""
    if not out.exists():
        return
    if not out.is_dir():
        raise ReleaseError(f"{out}: a file; name another folder by --out", what="other-content")
    if (out / SHA256SUMS).is_file():
        if list_of_files(release_text(out / SHA256SUMS)) == list_of_files(text):
            return
        raise ReleaseError(
            f"{out}: holds another release; name another folder by --out, or remove it", what="other-content"
        )
    if any(not is_ours(path.name) for path in out.iterdir()):
        raise ReleaseError(
            f"{out}: holds something else than a release; name another folder by --out", what="other-content"
        )


def _refuse_many(store: Store, sums: Collection[str]) -> None:
    if len(sums) > MOST_FILES:
        raise ReleaseError(
            f"{store.place(SHA256SUMS)}: lists more than {MOST_FILES} files; no release has them",
            what="too-large",
        )


def _counter(progress: Progress, total: int) -> Callable[[int], None]:
    return lambda done: progress(done, total)
