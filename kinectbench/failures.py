"""Why a recording's last run failed: a small file beside its stages, there until that stage succeeds."""

import contextlib
import json
from collections.abc import Collection
from pathlib import Path

from kinectbench.errors import StorageError
from kinectbench.workspace import pretty_json, replaced_file

FAILED_JSON = "failed.json"


def keep_failure(build: Path, stage: str | None, error: str) -> None:
    """Write failed.json. A disk that takes nothing more keeps no reason.

    Args:
        build: `build/<recording>/`.
        stage: the name of the stage that failed; None if its process was killed.
        error: why, one line, as people are told.
    """
    content = {"format_version": 1, "stage": stage, "error": error}
    with contextlib.suppress(StorageError, OSError), replaced_file(build / FAILED_JSON) as temporary:
        temporary.write_text(pretty_json(content))


def forget_failure(build: Path, stages: Collection[str]) -> None:
    """Remove failed.json of `build/<recording>/` if it is of one of these stages, which have succeeded."""
    path = build / FAILED_JSON
    try:
        stage = json.loads(path.read_text())["stage"]
    except FileNotFoundError:
        return
    except (ValueError, KeyError, TypeError):
        stage = None  # damaged: nobody can read the reason
    if stage is None or stage in stages:
        path.unlink()
