"""Versions of what a result was computed with, whichever distribution brought it."""

from importlib.metadata import PackageNotFoundError

import numpy as np
import pytest

from kinectbench.core import extras


@pytest.mark.parametrize("installed", ["open3d", "open3d-cpu"])
def test_open3d_has_a_version_under_either_name(monkeypatch: pytest.MonkeyPatch, installed: str) -> None:
    def version(name: str) -> str:
        if name != installed:
            raise PackageNotFoundError(name)
        return "0.20.0"

    monkeypatch.setattr(extras, "version", version)
    assert extras.package_version("open3d") == "0.20.0"


def test_a_package_that_is_installed_and_one_that_is_not() -> None:
    assert extras.package_version("numpy") == np.__version__
    assert extras.package_version("kinectbench-no-such-package") is None
