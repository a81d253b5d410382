"""A release is put into a store, benchmark.json last: none is taken for whole before it is.

A put that was stopped goes on: whatever lies beside a `SHA256SUMS` without `benchmark.json` is of that list.
For what is not of the new list is removed before the new `SHA256SUMS` is put, and that before any file of it.
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
    """What was done to a place.

    Attributes:
        put: number of files that were put.
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
    """What lies at a place.

    Attributes:
        sizes: bytes of every file by its name.
        text: `SHA256SUMS` of a release; empty if there is none.
        sums: what it says: the hash of every file by its name.
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
        """Whether it is a release to whoever fetches it."""
        said = self.info
        return said is not None and said.benchmark_sha256 == benchmark_sha256(self.text, self.stated)

    @property
    def is_known(self) -> bool:
        """Whether the files are those of the list: it is a release, or what a put that was stopped left.

        With a benchmark.json that names another list somebody else has written there.
        """
        return self.is_whole or BENCHMARK_JSON not in self.sizes


def put_release(folder: Path, store: Store, progress: Progress | None = None) -> PutSummary:
    """Bring what lies at a URL to be this release; what lies there already of it is not put again.

    A file is there already if the list there has its hash, and the store its size. While files are put, the
    place holds no benchmark.json, and nobody takes it for a release.

    Args:
        folder: a release on this machine.
        store: its URL. Files of an earlier release that are not of this one are removed.
        progress: called with (files put, files to be put).

    Raises:
        ReleaseError: the place holds something else than a release, or the beginning of one; or its URL has a
            query.
        StorageError: the store fails.
    """
    release_store(store.url)
    text = release_text(folder / SHA256SUMS)
    sums = parse_sums(text, str(folder / SHA256SUMS))
    there = _look(store)
    _refuse_other(store, there)
    same = {
        name
        for name, sha256 in sums.items()
        if there.is_known
        and there.sums.get(name) == sha256
        and there.sizes.get(name) == (folder / name).stat().st_size
    }
    if there.text == text:
        same.add(SHA256SUMS)
    wanted = [name for name in (SHA256SUMS, *sums) if name not in same]
    _clear(store, there, same, begins=bool(wanted))
    if wanted:
        _put(folder, store, [name for name in wanted if name != BENCHMARK_JSON], progress)
    removed = sum(name not in sums and name != SHA256SUMS for name in there.sizes)
    put = {*wanted, BENCHMARK_JSON} if wanted else set[str]()
    identity = benchmark_sha256(text, release_text(folder / BENCHMARK_JSON))
    replaced = None if there.info is None or there.info.benchmark_sha256 == identity else there.info
    return PutSummary(len(put), len(sums) + 1 - len(put), removed, replaced)


def _put(folder: Path, store: Store, names: list[str], progress: Progress | None) -> None:
    """Put files, the list before all others and benchmark.json after them."""
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


def _clear(store: Store, there: _Place, same: set[str], begins: bool) -> None:
    """Remove what is not of the new release; wherever this is stopped, the place can still be put to.

    Files that the list there does not have go while benchmark.json still says that this is a release's place.
    Those that it has go after benchmark.json, if it is a release to anybody until then.

    Args:
        store: the place.
        there: what lies there.
        same: what stays.
        begins: whether files will be put.
    """
    kept = same | {BENCHMARK_JSON} | ({SHA256SUMS} if there.text else set())
    unlisted = [name for name in there.sizes if name not in kept and name not in there.sums]
    listed = [name for name in there.sizes if name not in kept and name in there.sums]
    store.delete(unlisted if there.is_whole else unlisted + listed)
    if begins:
        store.delete([BENCHMARK_JSON] if BENCHMARK_JSON in there.sizes else [])
        store.delete(listed if there.is_whole else [])


def _look(store: Store) -> _Place:
    """What lies at a place. SHA256SUMS and benchmark.json are names that others use, too: they are read."""
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


def _refuse_other(store: Store, there: _Place) -> None:
    """Refuse a place that holds what is neither a release nor the beginning of one."""
    known = {BENCHMARK_JSON, SHA256SUMS, *there.sums} if there.text else set(there.sums)
    others = [name for name in there.sizes if name not in known]
    if others and there.info is None:
        raise ReleaseError(
            f"{store.place(others[0])}: not of a release; publish to a place that is empty or holds a "
            "release",
            what="other-content",
        )
