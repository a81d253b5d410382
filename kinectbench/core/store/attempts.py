"""Retry calls to a store while it may recover, and make one error message for each kind of failure."""

import logging
import math
import os
import random
import re
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from kinectbench.core.errors import SettingsError, StorageError
from kinectbench.core.storage import storage_errors
from kinectbench.core.untrusted import printable

T = TypeVar("T")
# If logging is not configured, warnings go to standard error.
_log = logging.getLogger(__name__)

# Seconds without success or progress after which a store is given up. A store may answer 503 for some
# minutes; the Rust crate object_store waits as long.
PATIENCE_S = 180.0
PATIENCE_VARIABLE = "KINECTBENCH_STORE_PATIENCE_S"
# Exponential backoff with jitter, as the AWS Architecture Blog advises; the bounds are object_store's.
FIRST_WAIT_S, LONGEST_WAIT_S = 0.1, 15.0
# Characters of a store's message: two lines of a terminal.
REASON_CHARS = 160
# Seconds of failure before a warning; most failures are shorter.
TELL_AFTER_S = 5.0

_STATUS = re.compile(r"status code: (\d{3})([A-Za-z -]*)")
_CODE = re.compile(r"<Code>([A-Za-z0-9]+)</Code>")
_OS_ERROR = re.compile(r"\(os error (\d+)\)")
_OS_MESSAGE = re.compile(r'message: "([A-Za-z -]+)"')
# 4xx errors that may pass (request timeout, conflict of two writers, too many requests), and the 5xx error
# that does not (not implemented).
PASSING, LASTING = (408, 409, 429), (501,)

NO_CREDENTIALS = (
    "no credentials were found; set those of the store, for s3:// AWS_ACCESS_KEY_ID and "
    "AWS_SECRET_ACCESS_KEY, or AWS_SKIP_SIGNATURE=true for a bucket that everybody may read"
)
# Parts of obstore's errors without credentials: it then asks metadata servers of the cloud's machines.
_ASKS_FOR_CREDENTIALS = ("169.254.169.254", "169.254.170.2", "metadata.google.internal", "MissingAccount")
# Parts of rustls's errors on a refused certificate, and on a server without TLS.
_TLS = ("InvalidCertificate", "invalid peer certificate", "InvalidContentType")
_TLS_REASON = re.compile(r"\b(UnknownIssuer|NotValidForName|Expired|CaUsedAsEndEntity|InvalidContentType)")
# Parts of the errors on an unknown host, by the resolvers of Linux and macOS, musl, and Windows.
_NO_SUCH_HOST = ("not known", "does not resolve", "No such host is known")


class MissingObjectError(StorageError):
    """The store has no file of this name."""

    what = "no-file"


class StoreGoneError(StorageError):
    """The store has stopped answering: callers should give up."""

    what = "no-answer"


class StoppedError(Exception):
    """Retries were ended because another call failed, or by an interrupt."""


class UnsettledError(Exception):
    """The result is incomplete or inconsistent for now, as while another process writes: retry."""


def patience_s() -> float:
    """Seconds of failure after which a store is given up.

    Raises:
        SettingsError: the environment variable is no number of seconds.
    """
    given = os.environ.get(PATIENCE_VARIABLE, "") or str(PATIENCE_S)
    try:
        seconds = float(given)
    except ValueError:
        seconds = math.nan
    if not 0 <= seconds < math.inf:
        raise SettingsError(
            f"{PATIENCE_VARIABLE}={printable(given)}: no number of seconds; set it to one, such as "
            f"{PATIENCE_S:.0f}, or unset it",
            what="bad-environment",
        )
    return seconds


# The event that ends this thread's waiting; the main thread has none, as an interrupt ends it.
_thread = threading.local()
# Host -> time of the first failure, for stores that this process gave up and that have not answered since:
# further calls to them do not wait for minutes again.
_given_up: dict[str, float] = {}
# Hosts for which the warning was printed.
_reported: set[str] = set()
# Hosts that have answered this process, so their names are known.
_answered: set[str] = set()


def wait_until(stop: threading.Event) -> None:
    """Make this thread stop its retries once the event is set."""
    _thread.stop = stop


def _pause(seconds: float) -> None:
    stop: threading.Event | None = getattr(_thread, "stop", None)
    if stop is None:
        time.sleep(seconds)
    elif stop.wait(seconds):
        raise StoppedError


def check_stopped() -> None:
    """Raise an error if the event that `wait_until` registered is set.

    Raises:
        StoppedError: the event is set.
    """
    stop: threading.Event | None = getattr(_thread, "stop", None)
    if stop is not None and stop.is_set():
        raise StoppedError


def has_answered(url: str) -> bool:
    """Whether the host of a URL has answered this process, so that its name is valid."""
    return _host(url) in _answered


def note_answer(url: str) -> None:
    """Remember that the host of a URL has answered this process."""
    _heard_of(_host(url))


def _host(url: str) -> str:
    return "/".join(url.split("/")[:3])


def patiently(
    place: str,
    call: Callable[[], T],
    progress: Callable[[], object] = lambda: None,
    answers: Callable[[], object] | None = None,
) -> T:
    """Call repeatedly until it succeeds, fails for good, or fails for too long; return the result.

    Args:
        place: the URL that errors name.
        call: the call; repeated after each failure that may pass.
        progress: returns how far the call has come; if the value changes, the time limit starts again.
        answers: a small call to the same store; if it succeeds, only this file fails, not the store.

    Raises:
        MissingObjectError: nothing is at that place.
        StoreGoneError: the store does not answer any more.
        StorageError: the call failed for good, or for too long.
        StoppedError: the event of `wait_until` was set during a pause.
        SettingsError: as in `patience_s`.
        Exception: an error of `call` that is neither of obstore nor a ValueError, such as an OSError of the
            local disk.
    """
    since, wait_s, so_far, most_s = time.monotonic(), FIRST_WAIT_S, progress(), patience_s()
    host = _host(place)
    while True:
        try:
            result = _called(place, call)
            _heard_of(host)
            return result
        except Exception as error:
            _raise_if_lasting(place, error, known=host in _answered)
            if progress() != so_far:
                since, wait_s, so_far = time.monotonic(), FIRST_WAIT_S, progress()
                _heard_of(host)
            left_s = since + most_s - time.monotonic()
            if left_s <= 0 or host in _given_up:
                raise _given_up_for(place, host, since, error, answers) from None
            _tell(place, host, time.monotonic() - since, left_s, error)
            _pause(min(wait_s * random.uniform(0.5, 1), left_s))
            wait_s = min(2 * wait_s, LONGEST_WAIT_S)


def _tell(place: str, host: str, failed_s: float, left_s: float, error: Exception) -> None:
    """Warn, once per host, if calls have failed for long (`failed_s`); retries go on for `left_s` seconds."""
    if failed_s >= TELL_AFTER_S and host not in _reported:
        _reported.add(host)
        _log.warning(
            "warning: %s: the store does not answer well (%s); trying again for %.0f s",
            *(place, _reason(error), left_s),
        )


def _called(place: str, call: Callable[[], T]) -> T:
    """Run a call; turn a panic of Rust, which is no `Exception`, into a message.

    Raises:
        StorageError: obstore panicked.
    """
    try:
        return call()
    except BaseException as error:
        if type(error).__name__ != "PanicException":
            raise
        raise StorageError(
            f"{place}: obstore cannot work with it ({printable(str(error), REASON_CHARS)}); correct the URL "
            "and the variables of the store",
            what="bad-address",
        ) from None


def _heard_of(host: str) -> None:
    _given_up.pop(host, None)
    _answered.add(host)


def _given_up_for(
    place: str, host: str, since: float, error: Exception, answers: Callable[[], object] | None
) -> StorageError:
    """Return the error after failures since `since` (`time.monotonic`); `error` is the last failure.

    It is a `StoreGoneError` if the whole store is down: the host was given up before, or `answers` fails too.
    """
    kind, since_s = StorageError, since
    if host in _given_up or not _has_answer(place, answers):
        kind, since_s = StoreGoneError, min(since, _given_up.setdefault(host, since))
    return kind(
        f"{place}: the store did not answer well for {time.monotonic() - since_s:.0f} s ({_reason(error)}); "
        "run the same command again when it does: what was stored is kept",
        what="no-answer",
    )


def _has_answer(place: str, answers: Callable[[], object] | None) -> bool:
    if answers is None:
        return False
    try:
        _called(place, answers)
    except FileNotFoundError:  # this is an answer
        return True
    except Exception:  # obstore has many kinds
        return False
    return True


def _raise_if_lasting(place: str, error: Exception, *, known: bool = False) -> None:
    """Raise an error if a retry cannot solve it; `known`: the host has answered before, so it exists."""
    if isinstance(error, UnsettledError):
        return
    if "NoSuchBucket" in str(error):
        raise StorageError(
            f"{place}: there is no such bucket; make it, or correct the URL", what="no-bucket"
        ) from None
    if isinstance(error, FileNotFoundError):
        raise MissingObjectError(f"{place}: there is no such file; correct the URL") from None
    if isinstance(error, ValueError):  # an invalid name
        raise StorageError(f"{place}: {printable(str(error), REASON_CHARS)}", what="bad-address") from None
    if type(error).__module__.partition(".")[0] != "obstore":
        raise error
    text = str(error)
    if place.startswith("file:"):
        found = _OS_ERROR.search(text)
        with storage_errors(Path(place)):
            raise OSError(int(found[1]), os.strerror(int(found[1]))) if found else _lasting(place, error)
    if any(word in text for word in _ASKS_FOR_CREDENTIALS):
        raise StorageError(f"{place}: {NO_CREDENTIALS}", what="no-credentials") from None
    name = type(error).__name__
    status = _STATUS.search(text)
    number = int(status[1]) if status else 0
    if name in ("PermissionDeniedError", "UnauthenticatedError") or number in (401, 403):
        raise StorageError(
            f"{place}: not permitted ({_reason(error)}); check the credentials, and what they may do there",
            what="not-permitted",
        ) from None
    if any(word in text for word in _TLS):
        found = _TLS_REASON.search(text)
        raise StorageError(
            f"{place}: no secure connection ({printable(found[0]) if found else 'TLS'}); correct the URL, or "
            "let this machine trust the certificate of the store",
            what="no-secure-connection",
        ) from None
    if not known and any(word in text for word in _NO_SUCH_HOST):
        raise StorageError(
            f"{place}: no such host is known; correct the URL, or AWS_ENDPOINT_URL", what="bad-address"
        ) from None
    if "Received redirect without LOCATION" in text:
        raise StorageError(
            f"{place}: the bucket is in another region; set AWS_REGION to it", what="bad-address"
        ) from None
    if "Error parsing Path" in text:
        raise StorageError(
            f"{place}: holds names that lead out of it, or that no file has", what="bad-address"
        ) from None
    if number in LASTING or (400 <= number < 500 and number not in PASSING) or name != "GenericError":
        raise _lasting(place, error) from None


def _lasting(place: str, error: Exception) -> StorageError:
    return StorageError(f"{place}: the store refuses it ({_reason(error)})", what="refused")


def _reason(error: Exception) -> str:
    """Shorten an error: HTTP status and the store's error code, or the start of its first line."""
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
