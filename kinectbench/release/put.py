"""Upload a release to a store, benchmark.json last, so that a partial upload never looks complete.

A stopped upload can be resumed. It has left `SHA256SUMS`, no `benchmark.json`, and some of the files that
`SHA256SUMS` lists. The next upload first deletes the files that are not in the new list, then uploads the new
`SHA256SUMS`, then the other files. A store with a file in neither list is refused.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from kinectbench.core import TEXT_BYTES, ReleaseError
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, ReleaseInfo
from kinectbench.core.artefacts.targets import SHA256SUMS, TARGETS_CSV, benchmark_sha256, parse_sums
from kinectbench.core.store.store import Store, in_parallel
from kinectbench.core.types import Progress, no_progress
from kinectbench.release.published import listed_files, release_store, release_text


@dataclass(frozen=True)
class PutSummary:
    """The changes made to a store.

    Attributes:
        put: number of uploaded files.
        kept: number of files that the store already had.
        removed: number of removed files that do not belong to the release.
        replaced: `benchmark.json` of the other release that was in the store before; None if there was none.
    """

    put: int
    kept: int
    removed: int
    replaced: ReleaseInfo | None = None


@dataclass(frozen=True)
class _StoreState:
    """The state of a store before an upload.

    Attributes:
        sizes: {file: size in bytes} of all files there.
        text: text of `SHA256SUMS`; empty if it is missing or does not list a release.
        sums: {file: hash} of `SHA256SUMS`.
        info: content of `benchmark.json`; None if it is missing or damaged.
        stated: text of `benchmark.json`; empty if it is missing or not UTF-8.
    """

    sizes: Mapping[str, int]
    text: str
    sums: Mapping[str, str]
    info: ReleaseInfo | None
    stated: str

    @property
    def is_whole(self) -> bool:
        """Whether benchmark.json and SHA256SUMS match, as in a complete release; no other file is checked."""
        stated = self.info
        return stated is not None and stated.benchmark_sha256 == benchmark_sha256(self.text, self.stated)

    @property
    def is_known(self) -> bool:
        """Whether the stored files are those in SHA256SUMS: a release, or the remains of a stopped upload.

        It is False if there is a benchmark.json that does not match SHA256SUMS: another program wrote one of
        them.
        """
        return self.is_whole or BENCHMARK_JSON not in self.sizes


def put_release(folder: Path, store: Store, progress: Progress = no_progress) -> PutSummary:
    """Upload a release to a store; files that the store already has are not uploaded again.

    The store has a file already if its SHA256SUMS states the same hash and the stored file has the same size.
    During the upload the store has no benchmark.json, so that nobody takes it for a complete release.

    Args:
        folder: the release's folder on this machine.
        store: the place to upload to. Files of an earlier release that are not in this one are removed.
        progress: called with (files checked and uploaded, files to check and to upload). The second number
            grows once it is known what to upload.

    Raises:
        ReleaseError: the store holds files that belong to neither a release nor a stopped upload; its URL has
            a query; or a file in the folder is missing, damaged, or differs from SHA256SUMS.
        StorageError: the store fails.
    """
    release_store(store.url)
    text, sums = release_text(folder / SHA256SUMS), listed_files(folder, progress)
    place = _read_state(store)
    _refuse_other(store, place, sums)
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
        _put(folder, store, [name for name in wanted if name != BENCHMARK_JSON], len(sums), progress)
    removed = sum(name not in sums and name != SHA256SUMS for name in place.sizes)
    put = {*wanted, BENCHMARK_JSON} if wanted else set[str]()
    identity = benchmark_sha256(text, release_text(folder / BENCHMARK_JSON))
    replaced = None if place.info is None or place.info.benchmark_sha256 == identity else place.info
    return PutSummary(len(put), len(sums) + 1 - len(put), removed, replaced)


def _put(folder: Path, store: Store, names: list[str], checked: int, progress: Progress) -> None:
    """Upload the named files, SHA256SUMS first, then benchmark.json; `checked` files count as done before."""
    total, first = checked + len(names) + 1, [name for name in names if name == SHA256SUMS]
    for name in first:
        store.put(name, folder / name)
    in_parallel(
        (partial(store.put, name, folder / name) for name in names if name != SHA256SUMS),
        lambda done: progress(checked + len(first) + done, total),
    )
    store.put(BENCHMARK_JSON, folder / BENCHMARK_JSON)
    progress(total, total)


def _clear(store: Store, place: _StoreState, same: set[str], begins: bool) -> None:
    """Delete files that do not belong to the new release, so that a stopped upload can still be resumed.

    Files that the store's SHA256SUMS does not list are deleted first, while benchmark.json is there. If the
    store has a complete release, its listed files are deleted after its benchmark.json, so that nobody sees
    it incomplete.
    """
    kept = same | {BENCHMARK_JSON} | ({SHA256SUMS} if place.text else set())
    unlisted = [name for name in place.sizes if name not in kept and name not in place.sums]
    listed = [name for name in place.sizes if name not in kept and name in place.sums]
    store.delete(unlisted if place.is_whole else unlisted + listed)
    if begins:
        store.delete([BENCHMARK_JSON] if BENCHMARK_JSON in place.sizes else [])
        store.delete(listed if place.is_whole else [])


def _read_state(store: Store) -> _StoreState:
    """Read the state of a store; ignore a SHA256SUMS or benchmark.json that does not describe a release."""
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
    return _StoreState(sizes, text, sums, info, stated)


def _refuse_other(store: Store, place: _StoreState, sums: Mapping[str, str]) -> None:
    """Raise an error if a store has a file that belongs to no release.

    Files listed in the store's SHA256SUMS belong to a release. So do the files in `sums` if the store's
    benchmark.json is valid, because its SHA256SUMS may be damaged.
    """
    known = {BENCHMARK_JSON, SHA256SUMS, *place.sums} if place.text else set(place.sums)
    if place.info is not None:  # whose list may be damaged
        known |= {BENCHMARK_JSON, SHA256SUMS, *sums}
    others = [name for name in place.sizes if name not in known]
    if others:
        raise ReleaseError(
            f"{store.place(others[0])}: not of the release there; publish to a place that is empty or holds "
            "a release alone",
            what="other-content",
        )
