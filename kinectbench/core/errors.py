"""Every error a user can meet. Only `kinectbench.cli.main` turns one into a line and an exit status."""


class KinectBenchError(Exception):
    """Base of all errors with a one-line message: what, where, what to do. The data cannot be used.

    Several arguments are as many lines.
    """

    exit_status = 1

    def __str__(self) -> str:
        return "\n".join(self.lines)

    @property
    def lines(self) -> tuple[str, ...]:
        """What is to be told, one line each."""
        return tuple(map(str, self.args))


class SettingsError(KinectBenchError):
    """Wrong settings, in benchmark.yaml or on the command line."""

    exit_status = 2


class RecordingError(KinectBenchError):
    """A recording cannot be read, or is not what it says."""


class TrackingError(KinectBenchError):
    """No usable trajectory."""


class SegmentationError(KinectBenchError):
    """No floor, no object, or an impossible box or mask."""


class ShapeError(KinectBenchError):
    """No solid shape can be made from the recording."""


class PairError(KinectBenchError):
    """A pair or a grid file cannot be made or read."""


class PredictionError(KinectBenchError):
    """A submitted prediction is missing or unacceptable."""


class ReleaseError(KinectBenchError):
    """A published benchmark is damaged or incomplete."""


class StorageError(KinectBenchError):
    """An artefact cannot be written or read: disk full, read-only, or in use."""


class ClusterError(KinectBenchError):
    """A cluster cannot be reached or used any more; what was done on it is kept."""


def internal_error(error: BaseException) -> str:
    """One line about an error that nobody foresaw; for some there is advice."""
    text = " ".join(str(error).split())
    if isinstance(error, UnicodeEncodeError) and error.encoding.startswith("utf"):
        return f"{error.object[:80]!a}: a name that is not UTF-8; rename the file or folder"
    if isinstance(error, UnicodeEncodeError):
        return (
            f"{error.object[:80]!a}: cannot be a file's name where the locale's encoding is "
            f"{error.encoding}; set LC_ALL=C.UTF-8"
        )
    return f"internal error: {type(error).__name__}: {text}; KINECTBENCH_DEBUG=1 shows where"
