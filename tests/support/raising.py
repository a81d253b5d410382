"""`pytest.raises` for errors of KinectBench: their codes are checked, not their prose."""

from typing import TypeVar

import pytest

from kinectbench.core.errors import KinectBenchError

Raised = TypeVar("Raised", bound=KinectBenchError)


def raises(kind: type[Raised], code: str, match: str | None = None) -> pytest.RaisesExc[Raised]:
    """The block raises an error of this class and code.

    Args:
        kind: the class.
        code: all of it, such as "settings.bad-url".
        match: of a figure or a name that the line must have, a regular expression.
    """

    def has_code(error: Raised) -> bool:
        assert error.code == code, f"{error.code}: {error}"
        return True

    return pytest.raises(kind, match=match, check=has_code)
