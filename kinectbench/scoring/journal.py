"""What an interrupted run has counted already: a JSON line per pair, beside the scores, until all is done."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kinectbench.scoring.pair_result import Job, PairResult
from kinectbench.workspace import canonical_json, storage_errors

NAME = ".counted.jsonl"


class Journal:
    """Results by pair, on disk as soon as they are known; None as folder keeps nothing."""

    def __init__(self, folder: Path | None) -> None:
        self._path = None if folder is None else folder / NAME
        self._earlier = {} if self._path is None else _read(self._path)

    def earlier(self, pair: str) -> Mapping[str, Any] | None:
        """What an earlier run wrote of a pair."""
        return self._earlier.get(pair)

    def add(self, job: Job, result: PairResult) -> None:
        """Remember a result.

        Raises:
            StorageError: the disk is full or read-only.
        """
        key = job.key(result.digest)
        if self._path is None or self._earlier.get(job.target.name, {}).get("key") == key:
            return
        line = canonical_json({"pair": job.target.name, "key": key, "result": result.to_json()})
        with storage_errors(self._path):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a") as file:
                file.write(line + "\n")

    def remove(self) -> None:
        """All is done: the table holds it."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)


def _read(path: Path) -> dict[str, dict[str, Any]]:
    """{pair: {"key", "result"}}; lines that were not written whole are left out."""
    found = {}
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError):
        return {}
    for line in lines:
        try:
            content = json.loads(line)
            PairResult.from_json(content["result"])
            found[str(content["pair"])] = {"key": content["key"], "result": content["result"]}
        except (ValueError, KeyError, TypeError, AttributeError):
            continue
    return found
