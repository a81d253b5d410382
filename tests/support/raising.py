"""`pytest.raises` for errors of KinectBench: their codes are checked, not their prose."""

import re
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from kinectbench.core.errors import KinectBenchError


@contextmanager
def raises(
    kind: type[KinectBenchError], code: str, match: str = ""
) -> Iterator[pytest.ExceptionInfo[KinectBenchError]]:
    """The block raises an error of this class and code.

    Args:
        kind: the class.
        code: all of it, such as "settings.bad-url".
        match: of a figure or a name that the line must have, a regular expression.
    """
    with pytest.raises(kind) as found:
        yield found
    assert found.value.code == code, f"{found.value.code}: {found.value}"
    assert re.search(match, str(found.value)), str(found.value)
