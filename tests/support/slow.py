"""Cases that only `make test-all` runs: others of the same test guard the same promise in `make test`."""

import pytest


def slow(*values: object) -> object:
    """A row of `parametrize` that is run by `make test-all` alone."""
    return pytest.param(*values, marks=pytest.mark.slow)
