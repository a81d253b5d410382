"""The command line: parses options, calls the other packages, prints results. It holds no algorithms."""

import sys
from types import TracebackType


def _say_stopped(kind: type[BaseException], error: BaseException, where: TracebackType | None) -> None:
    """Print one line, without where, if Ctrl-C comes before `main` handles it, while modules are imported."""
    if issubclass(kind, KeyboardInterrupt):
        error, where = KeyboardInterrupt("stopped; run the same command again"), None
    sys.__excepthook__(kind, error, where)


sys.excepthook = _say_stopped
