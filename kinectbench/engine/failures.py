"""Stored failures: a failed stage is not run again until one of its inputs changes."""

import contextlib
from collections.abc import Collection, Iterator
from pathlib import Path

from kinectbench._version import __version__
from kinectbench.core import (
    KILLED,
    RecordingError,
    SegmentationError,
    ShapeError,
    StorageError,
    TrackingError,
    error_code,
    replaced_file,
)
from kinectbench.core.artefacts.manifest import Failed
from kinectbench.engine.artefact import Artefact

# Errors caused by the recording or the settings: the same run would fail again.
OF_THE_RECORDING = (RecordingError, TrackingError, SegmentationError, ShapeError)
# Errors caused by the machine, also as causes of other errors: the next run may succeed.
OF_THE_MACHINE = (OSError, MemoryError, ImportError, StorageError)


def stored_failure(build: Path) -> Failed | None:
    """Return why the last run of a recording failed; None if it succeeded, or if failed.json is unreadable.

    `build` is `build/<recording>/`.
    """
    try:
        return Failed.read_if_there(build)
    except (OSError, StorageError):
        return None


def would_fail_again(failed: Failed) -> bool:
    """Whether a retry is useless: with this package version, the recording or settings caused the failure."""
    return failed.fingerprint is not None and failed.package_version == __version__


def failed_before(build: Path, artefact: Artefact) -> Failed | None:
    """Return the failure in `build/<recording>/` if the artefact would fail again: same stage, same inputs.

    Returns:
        The stored failure; None if the stage should run.
    """
    failed, now = stored_failure(build), (artefact.stage, artefact.fingerprint, __version__)
    then = failed and (failed.stage, failed.fingerprint, failed.package_version)
    return failed if then == now else None


def keep_failure(
    build: Path,
    stage: str | None,
    error: str,
    failure: BaseException | None = None,
    tried: Artefact | None = None,
) -> None:
    """Write failed.json; do nothing if it cannot be written.

    Args:
        build: `build/<recording>/`.
        stage: name of the stage that failed; None if the process was killed.
        error: the reason, one line, as printed.
        failure: the exception, if known.
        tried: the artefact that was being made, if any.
    """
    failed = Failed(stage=stage, error=error, code=error_code(failure) if failure else KILLED)
    if tried is not None and failure is not None and _would_repeat(failure):
        again = {"fingerprint": tried.fingerprint, "package_version": __version__}
        failed = failed.model_copy(update=again)
    path, text = build / Failed.FILE, failed.text()
    with contextlib.suppress(StorageError, OSError):
        # With thousands of missing recordings, most of the time would go into writing the same reason again.
        if path.is_file() and path.read_text(encoding="utf-8", errors="replace") == text:
            return
        with replaced_file(path) as temporary:
            temporary.write_text(text, encoding="utf-8")


def forget_failure(build: Path, stages: Collection[str]) -> None:
    """Remove failed.json of `build/<recording>/` if it names one of `stages`, or no stage."""
    failed = stored_failure(build)
    if failed is None or failed.stage is None or failed.stage in stages:
        (build / Failed.FILE).unlink(missing_ok=True)


def _would_repeat(failure: BaseException) -> bool:
    """Whether the recording, not the machine, caused a failure, so that the same run would fail again."""
    behind = any(isinstance(each, OF_THE_MACHINE) for each in _chain(failure))
    return isinstance(failure, OF_THE_RECORDING) and not behind


def _chain(failure: BaseException) -> Iterator[BaseException]:
    each: BaseException | None = failure
    while each is not None:
        yield each
        each = each.__cause__ or each.__context__
