"""All errors that a user can meet. Only `kinectbench.cli.main` turns an error into a line and an exit status.

`scripts/error_codes.py` lists the codes of all errors.
"""

import errno
from collections.abc import Mapping

from kinectbench.core.untrusted import printable

# About a name of a file or folder that the file system refuses.
TOO_LONG = "longer than a file's name can be here: choose a shorter one"


class KinectBenchError(Exception):
    """Base of all errors. A message states the fault, its location and the remedy in one line.

    Each argument is printed as a line of its own; most errors have a single one.

    Attributes:
        kind: first half of the error's code `<kind>.<what>`; each class has one.
        what: second half of the code; the class's own value unless an error gives another.
    """

    exit_status = 1
    kind = "run"
    what = "failed"

    def __init__(self, *lines: object, what: str = "") -> None:
        super().__init__(*lines)
        if what:
            self.what = what

    @property
    def code(self) -> str:
        """The error's code `<kind>.<what>`, which stays the same if messages are reworded."""
        return f"{self.kind}.{self.what}"

    def __str__(self) -> str:
        return "\n".join(self.lines)

    @property
    def lines(self) -> tuple[str, ...]:
        """The lines to print."""
        return tuple(map(str, self.args))


class SettingsError(KinectBenchError):
    """Wrong settings, in benchmark.yaml or on the command line."""

    exit_status = 2
    kind, what = "settings", "wrong-value"


class RecordingError(KinectBenchError):
    """A recording is unreadable or malformed."""

    kind, what = "recording", "malformed"


class IntrinsicsError(RecordingError):
    """The intrinsics of a recording cannot be used."""

    what = "bad-intrinsics"


class GivenPosesError(RecordingError):
    """A pose or a file of poses of a recording cannot be used."""

    what = "bad-poses"


class CaptureError(KinectBenchError):
    """A camera is not connected, or delivers no more frames."""


class TrackingError(KinectBenchError):
    """No usable trajectory could be found."""

    kind, what = "tracking", "no-trajectory"


class SegmentationError(KinectBenchError):
    """No floor or no object was found, or a box or mask is impossible."""

    kind, what = "segmentation", "no-object"


class ShapeError(KinectBenchError):
    """No solid shape can be made from the recording."""

    kind, what = "shape", "no-solid"


class PairError(KinectBenchError):
    """A pair or a grid file cannot be made or read."""

    kind, what = "pair", "malformed"


class PredictionError(KinectBenchError):
    """A submitted prediction is missing or unacceptable."""

    kind, what = "prediction", "malformed"


class ReleaseError(KinectBenchError):
    """A published benchmark is damaged or incomplete."""

    kind, what = "release", "damaged"


class StorageError(KinectBenchError):
    """An artefact cannot be written or read: disk full, read-only, or in use."""

    kind, what = "storage", "damaged"


class ClusterError(KinectBenchError):
    """A cluster became unreachable or unusable; finished work is kept."""

    kind, what = "cluster", "task-failed"


# The code without a Python exception: a process was killed, or hangs.
KILLED = "run.process-killed"
IN_USE = StorageError(what="in-use").code


def failure_word(code: str | None) -> str:
    """Return how a recording with an error of this code ended, as tables state it: failed, or in use."""
    return "in use" if code == IN_USE else "failed"


def error_code(error: BaseException) -> str:
    """Return an error's code; `run.no-memory` or `run.internal-error` if it is no KinectBenchError."""
    if isinstance(error, KinectBenchError):
        return error.code
    return "run.no-memory" if isinstance(error, MemoryError) else "run.internal-error"


def internal_error(error: BaseException) -> str:
    """Describe an unforeseen error in one line, with advice if an encoding or a long name caused it."""
    text = " ".join(str(error).split())
    if isinstance(error, UnicodeEncodeError) and error.encoding.startswith("utf"):
        return f"{error.object[:80]!a}: a name that is not UTF-8; rename the file or folder"
    if isinstance(error, UnicodeEncodeError):
        return (
            f"{error.object[:80]!a}: cannot be a file's name where the locale's encoding is "
            f"{error.encoding}; set LC_ALL=C.UTF-8"
        )
    if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
        where = "" if error.filename is None else f"{printable(str(error.filename), 80)}: "
        return f"{where}{TOO_LONG}"
    return f"internal error: {type(error).__name__}: {text}; KINECTBENCH_DEBUG=1 shows where"


def pydantic_message(error: Mapping[str, object]) -> str:
    """Return a pydantic error's message, without the prefix "Value error, " of this project's own checks."""
    return str(error["msg"]).removeprefix("Value error, ")
