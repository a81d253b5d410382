"""Cases that only `make test-all` runs: others of the same test guard the same promise in `make test`."""

from collections.abc import Iterable

import pytest


def first(count: int, values: Iterable[object]) -> list[object]:
    """A column of `parametrize`: `make test` runs the first so many of it, `make test-all` all."""
    return [value if place < count else slow(value) for place, value in enumerate(values)]


def slow(*values: object) -> object:
    """A row of `parametrize` that is run by `make test-all` alone."""
    return pytest.param(*values, marks=pytest.mark.slow)
