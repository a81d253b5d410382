"""Fixtures that several rooms' tests share."""

from pathlib import Path

import pytest
from synthetic_release import publish_synthetic

from kinectbench.release.release import Release, open_release


@pytest.fixture(scope="session")
def release(tmp_path_factory: pytest.TempPathFactory) -> Release:
    """A published release of simple shapes, not to be changed."""
    root: Path = tmp_path_factory.mktemp("synthetic")
    return open_release(publish_synthetic(root).folder)
