"""Trying again while a store may recover, and one line for each way in which it does not."""

import os
import random
import re
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from kinectbench.core.errors import StorageError
from kinectbench.core.storage import storage_errors
from kinectbench.core.untrusted import printable

T = TypeVar("T")

# Seconds without success, or a byte of progress, after which a store is given up: it may answer 503 for some
# minutes (own choice; the Rust crate object_store waits as long).
PATIENCE_S = 180.0
PATIENCE_VARIABLE = "KINECTBENCH_STORE_PATIENCE_S"
# Exponential backoff with jitter, as the AWS Architecture Blog advises; the bounds are object_store's.
FIRST_WAIT_S, LONGEST_WAIT_S = 0.1, 15.0
REASON_CHARS = 160

_STATUS = re.compile(r"status code: (\d{3})([A-Za-z -]*)")
_CODE = re.compile(r"<Code>([A-Za-z0-9]+)</Code>")
_OS_ERROR = re.compile(r"\(os error (\d+)\)")
_OS_MESSAGE = re.compile(r'message: "([A-Za-z -]+)"')
# Of 4xx what may be another moment: request timeout, conflict of two writers, too many requests; and of 5xx
# what will not: not implemented.
PASSING, LASTING = (408, 409, 429), (501,)

NO_CREDENTIALS = (
    "no credentials were found; set those of the store, for s3:// AWS_ACCESS_KEY_ID and "
    "AWS_SECRET_ACCESS_KEY, or AWS_SKIP_SIGNATURE=true for a bucket that everybody may read"
)
# What the errors of obstore say where credentials are missing: it asks the cloud's own machines for some.
_ASKS_FOR_CREDENTIALS = ("169.254.169.254", "169.254.170.2", "metadata.google.internal", "MissingAccount")


class MissingObjectError(StorageError):
    """There is no such object."""


class StoppedError(Exception):
    """Another call that belongs to this one has failed, or an interrupt ends them all."""


class UnsettledError(Exception):
    """What was read does not fit together, as somebody is writing: worth another attempt."""


def patience_s() -> float:
    """Seconds that a store may fail before it is given up."""
    try:
        return float(os.environ.get(PATIENCE_VARIABLE, PATIENCE_S))
    except ValueError:
        return PATIENCE_S


# Of each thread what ends its waiting; none in the main thread, where an interrupt does.
_thread = threading.local()
# Stores that were given up in this process and have not answered since: the next recordings, of ten thousand
# perhaps, do not wait for minutes each.
_given_up: set[str] = set()


def wait_until(stop: threading.Event) -> None:
    """Let this thread's attempts end when the event is set."""
    _thread.stop = stop


def _pause(seconds: float) -> None:
    stop: threading.Event | None = getattr(_thread, "stop", None)
    if stop is None:
        time.sleep(seconds)
    elif stop.wait(seconds):
        raise StoppedError


def patiently(place: str, call: Callable[[], T], progress: Callable[[], object] = lambda: None) -> T:
    """Call until it succeeds, fails for good, or has failed for too long.

    Args:
        place: the URL that errors name.
        call: is called again after each failure that may pass.
        progress: how far the calls have come; the time without success begins anew when it changes.

    Raises:
        MissingObjectError: there is nothing at that place.
        StorageError: it failed for good, or for too long; in one line.
        OSError: of the machine's own disk.
    """
    since, wait_s, so_far = time.monotonic(), FIRST_WAIT_S, progress()
    host = "/".join(place.split("/")[:3])
    while True:
        try:
            result = call()
            _given_up.discard(host)
            return result
        except Exception as error:
            _raise_if_lasting(place, error)
            if progress() != so_far:
                since, wait_s, so_far = time.monotonic(), FIRST_WAIT_S, progress()
            if time.monotonic() - since > patience_s() or host in _given_up:
                _given_up.add(host)
                raise StorageError(
                    f"{place}: the store did not answer well for {patience_s():.0f} s ({_reason(error)}); "
                    "run the same command again when it does: what was stored is kept"
                ) from error
            _pause(wait_s * random.uniform(0.5, 1))
            wait_s = min(2 * wait_s, LONGEST_WAIT_S)


def _raise_if_lasting(place: str, error: Exception) -> None:
    """Raise what no further attempt would change."""
    if isinstance(error, UnsettledError):
        return
    if isinstance(error, FileNotFoundError) or "NoSuchBucket" in str(error):
        raise _missing(place, str(error)) from error
    if isinstance(error, ValueError):  # a name that no store may have
        raise StorageError(f"{place}: {printable(str(error), REASON_CHARS)}") from error
    if type(error).__module__.partition(".")[0] != "obstore":
        raise error
    text = str(error)
    if place.startswith("file:"):
        found = _OS_ERROR.search(text)
        with storage_errors(Path(place)):
            raise OSError(int(found[1]), os.strerror(int(found[1]))) if found else _lasting(place, error)
    if any(word in text for word in _ASKS_FOR_CREDENTIALS):
        raise StorageError(f"{place}: {NO_CREDENTIALS}") from error
    name = type(error).__name__
    status = _STATUS.search(text)
    number = int(status[1]) if status else 0
    if name in ("PermissionDeniedError", "UnauthenticatedError") or number in (401, 403):
        raise StorageError(
            f"{place}: not permitted ({_reason(error)}); check the credentials, and what they may do there"
        ) from error
    if "Received redirect without LOCATION" in text:
        raise StorageError(f"{place}: the bucket is in another region; set AWS_REGION to it") from error
    if "Error parsing Path" in text:
        raise StorageError(f"{place}: holds names that lead out of it, or that no file has") from error
    if number in LASTING or (400 <= number < 500 and number not in PASSING) or name != "GenericError":
        raise _lasting(place, error) from error


def _missing(place: str, text: str) -> StorageError:
    if "NoSuchBucket" in text:
        return StorageError(f"{place}: there is no such bucket; make it, or correct the URL")
    return MissingObjectError(f"{place}: there is no such file; correct the URL")


def _lasting(place: str, error: Exception) -> StorageError:
    return StorageError(f"{place}: the store refuses it ({_reason(error)})")


def _reason(error: Exception) -> str:
    """Why in some words: the status and the store's own code, or else the end of the first line."""
    text = str(error)
    status, code = _STATUS.search(text), _CODE.search(text)
    if status:
        return f"{status[1]}{status[2].rstrip()}{f', {code[1]}' if code else ''}"
    if found := _OS_MESSAGE.search(text):
        return found[1]
    if "dns error" in text:
        return "no such host is known"
    if "error sending request" in text:
        return "it cannot be reached"
    first = text.partition("\n")[0]
    return printable(first.rpartition(" - ")[2] or first, REASON_CHARS)
