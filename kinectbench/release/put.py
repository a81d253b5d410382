"""Upload a release to a store, benchmark.json last, so that a partial one is never taken for complete.

A stopped upload is resumed: files beside a `SHA256SUMS` without `benchmark.json` are of that list.
Files outside the new list are deleted before the new `SHA256SUMS` is uploaded, and its files follow.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, ReleaseInfo
from kinectbench.core.artefacts.targets import SHA256SUMS, TARGETS_CSV, benchmark_sha256, parse_sums
from kinectbench.core.errors import ReleaseError
from kinectbench.core.store.store import Store, in_parallel
from kinectbench.core.types import Progress
from kinectbench.core.untrusted import TEXT_BYTES
from kinectbench.release.published import release_store, release_text


@dataclass(frozen=True)
class PutSummary:
    """The changes made to a store.

    Attributes:
        put: number of uploaded files.
        kept: number of files that lay there already.
        removed: number of files that were removed, for they are not of the release.
        replaced: `benchmark.json` of the release that lay there, if it is another; else None.
    """

    put: int
    kept: int
    removed: int
    replaced: ReleaseInfo | None = None


@dataclass(frozen=True)
class _Place:
    """The state of a store.

    Attributes:
        sizes: bytes of every file by its name.
        text: `SHA256SUMS` of a release; empty if there is none.
        sums: the hash of every file by its name.
        info: `benchmark.json` of a release; None if there is none.
        stated: its text.
    """

    sizes: Mapping[str, int]
    text: str
    sums: Mapping[str, str]
    info: ReleaseInfo | None
    stated: str

    @property
    def is_whole(self) -> bool:
        """Whether it is a complete release for whoever downloads it."""
        stated = self.info
        return stated is not None and stated.benchmark_sha256 == benchmark_sha256(self.text, self.stated)

    @property
    def is_known(self) -> bool:
        """Whether the files are those of the list: a release, or the remains of a stopped upload.

        If benchmark.json names another list, another program wrote it.
        """
        return self.is_whole or BENCHMARK_JSON not in self.sizes


def put_release(folder: Path, store: Store, progress: Progress | None = None) -> PutSummary:
    """Make the content of a URL this release; files that are already there are not uploaded again.

    A file is there already if the list there has its hash, and the store its size. While files are put, the
    place holds no benchmark.json, so that it is not taken for a release.

    Args:
        folder: a release on this machine.
        store: its URL. Files of an earlier release that are not of this one are removed.
        progress: called with (files uploaded, files in all).

    Raises:
        ReleaseError: the place holds something else than a release, or the beginning of one; or its URL has a
            query.
        StorageError: the store fails.
    """
    release_store(store.url)
    text = release_text(folder / SHA256SUMS)
    sums = parse_sums(text, str(folder / SHA256SUMS))
    place = _look(store)
    _refuse_other(store, place)
    same = {
        name
        for name, sha256 in sums.items()
        if place.is_known
        and place.sums.get(name) == sha256
        and place.sizes.get(name) == (folder / name).stat().st_size
    }
    if place.text == text:
        same.add(SHA256SUMS)
    wanted = [name for name in (SHA256SUMS, *sums) if name not in same]
    _clear(store, place, same, begins=bool(wanted))
    if wanted:
        _put(folder, store, [name for name in wanted if name != BENCHMARK_JSON], progress)
    removed = sum(name not in sums and name != SHA256SUMS for name in place.sizes)
    put = {*wanted, BENCHMARK_JSON} if wanted else set[str]()
    identity = benchmark_sha256(text, release_text(folder / BENCHMARK_JSON))
    replaced = None if place.info is None or place.info.benchmark_sha256 == identity else place.info
    return PutSummary(len(put), len(sums) + 1 - len(put), removed, replaced)


def _put(folder: Path, store: Store, names: list[str], progress: Progress | None) -> None:
    """Upload files, the list first and benchmark.json last."""
    total, first = len(names) + 1, [name for name in names if name == SHA256SUMS]
    for name in first:
        store.put(name, folder / name)
    in_parallel(
        (partial(store.put, name, folder / name) for name in names if name != SHA256SUMS),
        lambda done: progress(len(first) + done, total) if progress else None,
    )
    store.put(BENCHMARK_JSON, folder / BENCHMARK_JSON)
    if progress:
        progress(total, total)


def _clear(store: Store, place: _Place, same: set[str], begins: bool) -> None:
    """Delete other files; after an interruption at any point an upload is still possible.

    Files that the list there does not have go while benchmark.json still says that this is a release's place.
    Those that it has go after benchmark.json, if it is a release to anybody until then.

    Args:
        store: the place.
        place: its present state.
        same: what stays.
        begins: whether files will be uploaded.
    """
    kept = same | {BENCHMARK_JSON} | ({SHA256SUMS} if place.text else set())
    unlisted = [name for name in place.sizes if name not in kept and name not in place.sums]
    listed = [name for name in place.sizes if name not in kept and name in place.sums]
    store.delete(unlisted if place.is_whole else unlisted + listed)
    if begins:
        store.delete([BENCHMARK_JSON] if BENCHMARK_JSON in place.sizes else [])
        store.delete(listed if place.is_whole else [])


def _look(store: Store) -> _Place:
    """The state of a store. Others use the names SHA256SUMS and benchmark.json, too: both are read."""
    sizes = {each.name: each.size for each in store.objects()}
    text, sums, info, stated = "", dict[str, str](), None, ""
    try:
        if SHA256SUMS in sizes:
            found = store.read(SHA256SUMS, TEXT_BYTES).decode()
            parsed = parse_sums(found, SHA256SUMS)
            if BENCHMARK_JSON in parsed and TARGETS_CSV in parsed:
                text, sums = found, parsed
    except (ReleaseError, UnicodeDecodeError):
        pass
    try:
        if BENCHMARK_JSON in sizes:
            stated = store.read(BENCHMARK_JSON).decode()
            info = ReleaseInfo.parse(stated, BENCHMARK_JSON)
    except (ReleaseError, UnicodeDecodeError):
        pass
    return _Place(sizes, text, sums, info, stated)


def _refuse_other(store: Store, place: _Place) -> None:
    """Refuse a store that holds neither a release nor the beginning of one."""
    known = {BENCHMARK_JSON, SHA256SUMS, *place.sums} if place.text else set(place.sums)
    others = [name for name in place.sizes if name not in known]
    if others and place.info is None:
        raise ReleaseError(
            f"{store.place(others[0])}: not of a release; publish to a place that is empty or holds a "
            "release",
            what="other-content",
        )
