"""Upload a release to a dataset of the Hugging Face hub in one commit: it appears whole or not at all."""

import re
from collections.abc import Mapping, Set
from contextlib import suppress
from glob import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from kinectbench.core import ReleaseError, SettingsError, StorageError, printable, require_extra
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, ReleaseInfo
from kinectbench.core.artefacts.targets import SHA256SUMS, benchmark_sha256, parse_sums
from kinectbench.release.contents import release_files
from kinectbench.release.published import listed_files, release_text
from kinectbench.release.put import PutSummary

if TYPE_CHECKING:
    from huggingface_hub import HfApi

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
        _refuse_other(name, there - ITS_OWN - listed - (names if BENCHMARK_JSON in there else set()))
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


def _refuse_other(name: str, others: Set[str]) -> None:
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
