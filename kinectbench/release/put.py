"""Upload a release to a store, benchmark.json last, so that a partial upload never looks complete.

A stopped upload can be resumed. It has left `SHA256SUMS`, no `benchmark.json`, and some of the files that
`SHA256SUMS` lists. The next upload first deletes the files that are not in the new list, then uploads the new
`SHA256SUMS`, then the other files. A store with a file in neither list is refused.

To a dataset of the Hugging Face hub it is uploaded in one commit: it appears whole or not at all.
"""

import re
from collections.abc import Mapping, Set
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from glob import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from kinectbench.core import TEXT_BYTES, ReleaseError, SettingsError, StorageError, printable, require_extra
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, ReleaseInfo
from kinectbench.core.artefacts.targets import SHA256SUMS, TARGETS_CSV, benchmark_sha256, parse_sums
from kinectbench.core.store.store import Store, in_parallel
from kinectbench.core.types import Progress, no_progress
from kinectbench.release.contents import release_files
from kinectbench.release.published import listed_files, release_store, release_text

if TYPE_CHECKING:
    from huggingface_hub import HfApi


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


SCHEME = "hf://"
# user/name or organisation/name, as the hub's `validate_repo_id` accepts it.
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,95}/[A-Za-z0-9][A-Za-z0-9._-]{0,95}")
# Files that the hub writes into a new data set, or that people add before the first upload.
ITS_OWN = frozenset({".gitattributes", "README.md"})


def hub_name(url: str) -> str:
    """Return the dataset's name `user/name`, given its URL hf://user/name.

    Raises:
        SettingsError: the URL names no dataset, or huggingface_hub is not installed.
    """
    name = url.removeprefix(SCHEME).removeprefix("datasets/").rstrip("/")
    if not NAME.fullmatch(name):
        raise SettingsError(f"--to {printable(url)}: wanted hf://user/name, of a data set", what="bad-url")
    require_extra("hub", f"--to {printable(url)}")
    return name


def put_on_hub(folder: Path, name: str, sums: Mapping[str, str] | None = None) -> PutSummary:
    """Make a dataset of the hub equal to a release: upload the folder, delete files of an earlier release.

    The dataset is created if missing. The hub itself skips the upload of files that it already has. Files in
    the folder that SHA256SUMS does not list are not uploaded.

    Args:
        folder: the release's folder on this machine.
        name: the dataset, user/name.
        sums: result of `listed_files`; None: the folder's files are checked here.

    Raises:
        ReleaseError: the dataset holds files that belong to no release; or a file in the folder is missing,
            damaged, or differs from SHA256SUMS.
        StorageError: the hub does not answer, or refuses.
    """
    from huggingface_hub import HfApi

    text, names = release_text(folder / SHA256SUMS), {SHA256SUMS, *(sums or listed_files(folder))}
    there_too = (path.relative_to(folder).as_posix() for path in release_files(folder))
    others = [escape(name) for name in there_too if name not in names]
    info = ReleaseInfo.read(folder)
    identity = benchmark_sha256(text, release_text(folder / BENCHMARK_JSON))
    message = f"{' '.join(part for part in (info.name, info.version) if part)}, benchmark_sha256 {identity}"
    where: dict[str, object] = {"repo_id": name, "repo_type": "dataset"}
    try:
        api = HfApi()
        api.create_repo(**where, exist_ok=True)
        there = set(api.list_repo_files(**where))
        listed = _listed(api, name) if {SHA256SUMS, BENCHMARK_JSON} <= there else set[str]()
        _refuse_other_files(name, there - ITS_OWN - listed - (names if BENCHMARK_JSON in there else set()))
        gone = sorted((there & listed) - names - ITS_OWN)
        what: dict[str, object] = {"folder_path": folder, "ignore_patterns": others, "delete_patterns": gone}
        api.upload_folder(**where, **what, commit_message=message)
    except ReleaseError:
        raise
    except Exception as error:  # the hub and its HTTP library raise many kinds
        raise _refusal(name, error) from error
    return PutSummary(put=len(names), kept=0, removed=len(gone))


def _listed(api: "HfApi", name: str) -> set[str]:
    """Return the file names that the dataset's SHA256SUMS lists; empty if SHA256SUMS is damaged."""
    with TemporaryDirectory() as folder:
        found = api.hf_hub_download(name, SHA256SUMS, repo_type="dataset", local_dir=folder)
        with suppress(ReleaseError):
            return set(parse_sums(release_text(Path(found)), SHA256SUMS))
    return set()


def _refuse_other_files(name: str, others: Set[str]) -> None:
    """Raise an error if a dataset holds `others`, files that do not belong to its release."""
    if others:
        raise ReleaseError(
            f"{SCHEME}{name}: holds {printable(min(others))}, which is not of a release; publish to a data "
            "set that is empty or holds a release alone",
            what="other-content",
        )


def _refusal(name: str, error: Exception) -> StorageError:
    """Convert an error of the hub to a StorageError, whose message is one line and gives advice."""
    status = getattr(getattr(error, "response", None), "status_code", None)
    said = printable((str(error).strip().splitlines() or [type(error).__name__])[0], 200)
    if status in (401, 403) or type(error).__name__ == "LocalTokenNotFoundError":
        advice = "log in with `hf auth login`, or set HF_TOKEN to a token that may write there"
        return StorageError(f"{SCHEME}{name}: is not permitted ({said}); {advice}", what="not-permitted")
    what = "no-answer" if status is None else "refused"
    return StorageError(f"{SCHEME}{name}: cannot be put ({said}); run the same command again", what=what)
