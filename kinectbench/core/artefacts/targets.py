"""targets.csv, the pairs to predict; splits.json; and SHA256SUMS.

SHA256SUMS has a line for every file but itself, in the format of `sha256sum -c`, sorted by path.
`benchmark_sha256` is the SHA-256 of SHA256SUMS without the line of benchmark.json, followed by the content of
benchmark.json without its hashes, so that benchmark.json can hold it. In earlier releases, without
`benchmark_sha256_version`, it covers the list alone: `grep -v '  benchmark.json$' SHA256SUMS | sha256sum`.
"""

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, get_args

from pydantic import Field

from kinectbench.core.artefacts.benchmark import (
    BENCHMARK_JSON,
    HASH_KEYS,
    SHA256,
    SHA256_VERSION_KEY,
    ReleaseFile,
)
from kinectbench.core.artefacts.views import UNKNOWN_SHARE
from kinectbench.core.errors import ReleaseError
from kinectbench.core.names import Named, first_clash, reserved_problem
from kinectbench.core.storage import NAME, canonical_json, sha256_text
from kinectbench.core.types import Split
from kinectbench.core.untrusted import MOST_NAME, MOST_PART_BYTES, printable
from kinectbench.core.untrusted_text import csv_rows, strict_json

TARGETS_CSV = "targets.csv"
SPLITS_JSON = "splits.json"
SHA256SUMS = "SHA256SUMS"
SPLITS: tuple[Split, ...] = get_args(Split)

_VIEW = re.compile("[0-9]{3,6}")
_SUM_LINE = re.compile(r"([0-9a-f]{64})  (.+)")
_SHARE = re.compile(r"(0\.[0-9]+|1\.0)?")
_SAFE_PATH = re.compile(r"(?!\.)[A-Za-z0-9._-]+(/(?!\.)[A-Za-z0-9._-]+)*")


def _column(description: str) -> Any:
    """Declare a column of targets.csv with its description."""
    return field(metadata={"description": description})


@dataclass(frozen=True, order=True)
class Target:
    """One line of targets.csv: a pair to predict; the fields describe the columns."""

    recording: str = _column("id of the recording")
    object: str = _column("the thing recorded; it belongs to one split")
    view: str = _column("zero-padded index of the view")
    category: str = _column("such as chair")
    split: str = _column("train, validation or test")
    file: str = _column("the pair file, relative to the release")
    sha256: str = _column("SHA-256 of the pair file")
    unknown_share: float | None = field(
        default=None,
        metadata={"description": f"{UNKNOWN_SHARE}; empty where the truth is held back or imported"},
    )

    truth: str = field(
        default="",
        metadata={"description": "`reference mesh`, or empty: fused; the column exists only where one is"},
    )

    @property
    def name(self) -> str:
        """The name of the pair in messages, `<recording>/<view>`."""
        return f"{self.recording}/{self.view}"


# Column of targets.csv → its content.
ALL_COLUMNS: dict[str, str] = {column.name: column.metadata["description"] for column in fields(Target)}
TRUTH_COLUMN = "truth"
COLUMNS = {name: text for name, text in ALL_COLUMNS.items() if name != TRUTH_COLUMN}
TRUTHS = ("", "reference mesh")
NUMBER_COLUMNS = ("unknown_share",)
# Those of releases published before pairs stated their share of unknown.
EARLIER_COLUMNS = tuple(name for name in COLUMNS if name not in NUMBER_COLUMNS)


def parse_targets(text: str, where: str) -> tuple[Target, ...]:
    """Parse targets.csv; every name and path is safe to join to a folder.

    Older tables, without the column `unknown_share`, are accepted.

    Raises:
        ReleaseError: a line is malformed, repeated, unsafe or too long; the message names it.
    """
    try:
        rows = csv_rows(text)
    except ValueError as error:
        raise ReleaseError(f"{where}: not a table ({error}); download the release again") from error
    columns = tuple(rows[0]) if rows else ()
    if columns not in (tuple(ALL_COLUMNS), tuple(COLUMNS), EARLIER_COLUMNS):
        raise ReleaseError(f"{where}, line 1: the columns must be {','.join(COLUMNS)}")
    targets: dict[str, Target] = {}
    for line, row in enumerate(rows[1:], start=2):
        problem = _row_problem(row, len(columns))
        target = None if problem else _target(row)
        if target and target.file in targets:
            problem = f"{target.file} is listed twice"
        if problem or target is None:
            raise ReleaseError(f"{where}, line {line}: {problem}; download the release again")
        targets[target.file] = target
    return tuple(targets.values())


def _target(row: list[str]) -> Target:
    """Convert the cells of a line of targets.csv."""
    values: dict[str, Any] = dict(zip(ALL_COLUMNS, row, strict=False))
    share = values.get("unknown_share")
    return Target(**values | {"unknown_share": float(share) if share else None})


def _row_problem(row: list[str], columns: int) -> str | None:
    """Return why a line of targets.csv that must have `columns` columns is invalid; None if it is valid."""
    if len(row) != columns:
        return f"{len(row)} columns instead of {columns}"
    share = row[len(EARLIER_COLUMNS)] if len(row) > len(EARLIER_COLUMNS) else ""
    if not _SHARE.fullmatch(share):
        return f"unknown_share '{printable(share)}' is not a share from 0 to 1"
    target = _target(row)
    if target.truth not in TRUTHS:
        return f"truth '{printable(target.truth)}' is neither empty nor {TRUTHS[1]}"
    if not all(NAME.fullmatch(name) for name in (target.recording, target.object, target.category)):
        return "a name with other characters than letters, digits, '.', '_' and '-'"
    if not _VIEW.fullmatch(target.view):
        return f"view '{printable(target.view)}' is not a zero-padded index"
    if target.split not in SPLITS:
        return f"split '{printable(target.split)}' is none of {', '.join(SPLITS)}"
    if target.file != f"pairs/{target.recording}/{target.view}.npz":
        return f"file '{printable(target.file)}' is not pairs/{target.recording}/{target.view}.npz"
    return None if re.fullmatch(SHA256, target.sha256) else "its SHA-256 is not 64 hex digits"


def columns_of(targets: Iterable[Target]) -> tuple[str, ...]:
    """The columns of targets.csv; they include `truth` only if some target's truth is a reference mesh."""
    return tuple(ALL_COLUMNS if any(target.truth for target in targets) else COLUMNS)


def targets_text(targets: Sequence[Target], columns: Sequence[str] = ()) -> str:
    """Write the text of targets.csv, or of one split's table in targets/.

    `columns` are those to write; by default, they are those of this version (earlier releases have fewer).
    """
    columns = columns or columns_of(targets)
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([getattr(target, name) for name in columns] for target in targets)
    return buffer.getvalue()


def by_recording(targets: Iterable[Target]) -> dict[str, list[Target]]:
    """Return the targets of each recording, in their order."""
    groups: dict[str, list[Target]] = {}
    for target in targets:
        groups.setdefault(target.recording, []).append(target)
    return groups


def check_names(targets: Sequence[Target], where: str) -> None:
    """Refuse names that differ only by case, an object in two categories or splits, and reserved categories.

    Raises:
        ReleaseError: one line that names the problem.
    """
    rows = [Named(*row) for row in dict.fromkeys((t.recording, t.object, t.category) for t in targets)]
    clash = first_clash(rows)
    reserved = filter(None, map(reserved_problem, sorted({row.category for row in rows})))
    problem = next(reserved, None) if clash is None else clash.problem
    if problem is not None:
        raise ReleaseError(f"{where}: {problem}")
    split_of: dict[str, str] = {}
    for target in targets:
        if split_of.setdefault(target.object, target.split) != target.split:
            raise ReleaseError(
                f"{where}: object '{target.object}' is in two splits, {split_of[target.object]} and "
                f"{target.split}; scores would not be honest",
                what="object-in-two-splits",
            )


class Splits(ReleaseFile):
    """splits.json: the recordings of each split, sorted."""

    FILE: ClassVar[str] = SPLITS_JSON

    train: tuple[str, ...] = Field((), description="ids of recordings to learn from")
    validation: tuple[str, ...] = Field((), description="ids of recordings to choose thresholds on")
    test: tuple[str, ...] = Field((), description="ids of recordings to be scored on")

    @classmethod
    def of(cls, targets: Sequence[Target]) -> "Splits":
        """Group the recordings of targets by split."""
        return cls(
            **{split: tuple(sorted({t.recording for t in targets if t.split == split})) for split in SPLITS}
        )


def sums_text(sums: Mapping[str, str]) -> str:
    """Return the text of SHA256SUMS for {relative path: SHA-256}."""
    return "".join(f"{sha256}  {name}\n" for name, sha256 in sorted(sums.items()))


def parse_sums(text: str, where: str) -> dict[str, str]:
    """Parse SHA256SUMS: {relative path: SHA-256}; every path is safe to join to the release's folder.

    Raises:
        ReleaseError: a line is malformed, repeated, unsafe or too long; the message names it.
    """
    sums: dict[str, str] = {}
    # As `sha256sum` reads it: `splitlines` would also end a line at signs that may be part of a name.
    for number, line in enumerate(text.removesuffix("\n").split("\n") if text else (), start=1):
        match = _SUM_LINE.fullmatch(line)
        if not match or not _SAFE_PATH.fullmatch(match[2]) or match[2] in sums:
            raise ReleaseError(f"{where}, line {number}: malformed, repeated or unsafe; download it again")
        if len(match[2]) > MOST_NAME or max(map(len, match[2].split("/"))) > MOST_PART_BYTES:
            raise ReleaseError(f"{where}, line {number}: longer than a file's name can be")
        sums[match[2]] = match[1]
    return sums


def list_of_files(sums: str) -> str:
    """Return the text of SHA256SUMS without the line of benchmark.json."""
    lines = sums.splitlines(keepends=True)
    return "".join(line for line in lines if not line.endswith(f"  {BENCHMARK_JSON}\n"))


def benchmark_sha256(sums: str, stated: str) -> str:
    """Compute the hash that identifies a release, by the rule of its `benchmark_sha256_version`.

    Args:
        sums: the text of SHA256SUMS.
        stated: the text of a valid benchmark.json.

    Raises:
        ValueError, RecursionError: `stated` is not JSON.
    """
    content: dict[str, object] = strict_json(stated)
    if content.get(SHA256_VERSION_KEY) is None:
        return sha256_text(list_of_files(sums))
    covered = {key: value for key, value in content.items() if key not in HASH_KEYS}
    return sha256_text(list_of_files(sums) + canonical_json(covered))
