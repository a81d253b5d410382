"""The files of a release, and how their checksums hang together.

benchmark.json   name, licence, versions, settings, recordings with their quality, `benchmark_sha256`
targets.csv      one line per pair          targets/<split>.csv   those of one split
splits.json      split -> recordings        SHA256SUMS            one line per file
README.md        the card                   croissant.json        metadata for machines
READING.md       how to read a pair with numpy alone
pairs/<recording>/<view>.npz   views/<recording>/   objects/<recording>/   schemas/
LICENSE   CITATION.cff   CHANGELOG.md   datasheet.md   lineage.json   privacy.json
thresholds.json   index.html

SHA256SUMS has a line for every file but itself, in the format of `sha256sum -c`, sorted by path.
`benchmark_sha256` is the SHA-256 of SHA256SUMS without the line of benchmark.json, which can therefore hold
it: it names the published bytes whatever the version of the package that published them. In a shell:
`grep -v '  benchmark.json$' SHA256SUMS | sha256sum`.
"""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from kinectbench.errors import ReleaseError
from kinectbench.workspace import sha256_text

FORMAT_VERSION = 1
BENCHMARK_JSON = "benchmark.json"
TARGETS_CSV = "targets.csv"
SPLITS_JSON = "splits.json"
CARD = "README.md"
READING = "READING.md"
CROISSANT = "croissant.json"
DATASHEET = "datasheet.md"
LINEAGE_JSON = "lineage.json"
PRIVACY_JSON = "privacy.json"
THRESHOLDS_JSON = "thresholds.json"
PREVIEW = "index.html"
SCHEMAS = "schemas"
SPLIT_TARGETS = "targets"
LICENSE = "LICENSE"
CITATION = "CITATION.cff"
CHANGELOG = "CHANGELOG.md"
SHA256SUMS = "SHA256SUMS"

_LINE = re.compile(r"([0-9a-f]{64})  (.+)")
_SAFE_PATH = re.compile(r"(?!\.)[A-Za-z0-9._-]+(/(?!\.)[A-Za-z0-9._-]+)*")


def release_files(folder: Path) -> Iterator[Path]:
    """Every file and link below a release but SHA256SUMS, sorted; links are not followed."""
    for path in sorted(folder.rglob("*")):
        if (path.is_symlink() or not path.is_dir()) and path != folder / SHA256SUMS:
            yield path


def sums_text(sums: Mapping[str, str]) -> str:
    """SHA256SUMS of {relative path: SHA-256}."""
    return "".join(f"{sha256}  {name}\n" for name, sha256 in sorted(sums.items()))


def read_sums(text: str, where: str) -> dict[str, str]:
    """Parse SHA256SUMS: {relative path: SHA-256}; every path is safe to join to the release's folder.

    Raises:
        ReleaseError: a malformed, repeated or unsafe line; it names the line.
    """
    sums: dict[str, str] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        match = _LINE.fullmatch(line)
        if not match or not _SAFE_PATH.fullmatch(match[2]) or match[2] in sums:
            raise ReleaseError(f"{where}, line {number}: malformed, repeated or unsafe; download it again")
        sums[match[2]] = match[1]
    return sums


def benchmark_sha256(text: str) -> str:
    """What identifies a release, from its SHA256SUMS."""
    lines = text.splitlines(keepends=True)
    return sha256_text("".join(line for line in lines if not line.endswith(f"  {BENCHMARK_JSON}\n")))
