"""Reading what the stages wrote, and copying it into a release."""

import shutil
from pathlib import Path
from typing import Any

from kinectbench.errors import ReleaseError
from kinectbench.release.metadata import read_text, strict_json


def built_json(path: Path) -> dict[str, Any]:
    """A JSON object that a stage wrote.

    Raises:
        ReleaseError: it is missing, or no such thing.
    """
    content = strict_json(read_text(path), str(path))
    if not isinstance(content, dict):
        raise ReleaseError(f"{path}: not a JSON object; run the build again")
    return content


def copy_built(source: Path, target: Path) -> None:
    """Copy one built file's bytes.

    Raises:
        ReleaseError: it is missing.
    """
    if not source.is_file():
        raise ReleaseError(f"{source}: missing; run the build again")
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)
