"""Fixtures of the report's tests."""

from pathlib import Path

import pytest
from report_fake_build import write_build

from kinectbench.settings.models import BenchmarkSettings


@pytest.fixture(scope="session")
def settings() -> BenchmarkSettings:
    recordings = [
        {"id": "chair_01", "path": "recordings/chair_01", "category": "chair", "object": "red_chair"},
        {"id": "table_01", "path": "recordings/table_01", "category": "table"},
        {"id": "bench_01", "path": "recordings/bench_01", "category": "bench"},
    ]
    return BenchmarkSettings.model_validate(
        {"name": "furniture", "license": "CC-BY-4.0", "recordings": recordings}
    )


@pytest.fixture(scope="session")
def build(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Read-only: shared by all tests."""
    folder = tmp_path_factory.mktemp("build")
    write_build(folder, n_pairs=3)
    return folder
