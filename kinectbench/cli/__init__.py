"""The command line: parses options, calls the other packages, prints results. It holds no algorithms."""

import sys
from types import TracebackType


def _say_stopped(kind: type[BaseException], error: BaseException, where: TracebackType | None) -> None:
    """Print one line if Ctrl-C comes before `main` handles it, while modules are imported."""
    if issubclass(kind, KeyboardInterrupt):
        sys.stderr.write("error: stopped; run the same command again\n")
    else:
        sys.__excepthook__(kind, error, where)


sys.excepthook = _say_stopped
