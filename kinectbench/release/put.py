"""A release is put into a store, benchmark.json last: none is taken for whole before it is."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, ReleaseInfo
from kinectbench.core.artefacts.targets import SHA256SUMS, benchmark_sha256, parse_sums
from kinectbench.core.errors import ReleaseError
from kinectbench.core.store.store import Store, in_parallel
from kinectbench.core.types import Progress
from kinectbench.core.untrusted import TEXT_BYTES
from kinectbench.release.published import release_text


def put_release(folder: Path, store: Store, progress: Progress | None = None) -> int:
    """Bring what lies at a URL to be this release; what lies there already of it is not put again.

    While it is put, the place holds no benchmark.json, and nobody takes it for a release.

    Args:
        folder: a release on this machine.
        store: its URL. Files of an earlier release that are not of this one are removed.
        progress: called with (files put, files to be put).

    Returns:
        The number of files that were put.

    Raises:
        ReleaseError: the place holds something else than a release.
        StorageError: the store fails.
    """
    text = release_text(folder / SHA256SUMS)
    sums = parse_sums(text, str(folder / SHA256SUMS))
    listed = {each.name: each.size for each in store.objects()}
    there, whole = _released(store, listed)
    _refuse_other(store, listed, sums, there)
    changed = [
        name
        for name, sha256 in sums.items()
        if not (whole and there.get(name) == sha256 and listed.get(name) == (folder / name).stat().st_size)
    ]
    extra = [name for name in listed if name not in sums and name != SHA256SUMS]
    if not changed and not extra:
        return 0
    store.delete([BENCHMARK_JSON] if BENCHMARK_JSON in listed else [])
    data = [name for name in changed if name != BENCHMARK_JSON]
    total = len(data) + 2
    in_parallel(
        (partial(store.put, name, folder / name) for name in data),
        lambda done: progress(done, total) if progress else None,
    )
    store.delete(extra)
    for name in (SHA256SUMS, BENCHMARK_JSON):
        store.put(name, folder / name)
    if progress:
        progress(total, total)
    return total


def _released(store: Store, listed: Mapping[str, int]) -> tuple[dict[str, str], bool]:
    """The hashes of the release that lies there, none if there is none; and whether it is whole."""
    if SHA256SUMS not in listed:
        return {}, False
    try:
        text = store.read(SHA256SUMS, TEXT_BYTES).decode()
        sums = parse_sums(text, SHA256SUMS)
        if BENCHMARK_JSON not in listed:
            return sums, False
        info = ReleaseInfo.parse(store.read(BENCHMARK_JSON).decode(), BENCHMARK_JSON)
    except (ReleaseError, UnicodeDecodeError):
        return {}, False
    return sums, info.benchmark_sha256 == benchmark_sha256(text)


def _refuse_other(
    store: Store, listed: Mapping[str, int], sums: Mapping[str, str], there: Mapping[str, str]
) -> None:
    """Refuse a place that holds what is neither a release nor the beginning of this one."""
    known = {BENCHMARK_JSON, SHA256SUMS, *sums, *there}
    others = [name for name in listed if name not in known]
    if others and BENCHMARK_JSON not in listed:
        raise ReleaseError(
            f"{store.place(others[0])}: not of a release; publish to a place that is empty or holds a release"
        )
