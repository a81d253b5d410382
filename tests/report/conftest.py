"""Fixtures of the report's tests."""

from pathlib import Path

import pytest
from report_fake_build import SETTINGS, write_build

from kinectbench.settings.models import BenchmarkSettings


@pytest.fixture(scope="session")
def settings() -> BenchmarkSettings:
    return SETTINGS


@pytest.fixture(scope="session")
def build(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Read-only: shared by all tests."""
    folder = tmp_path_factory.mktemp("build")
    write_build(folder, n_pairs=3)
    return folder
