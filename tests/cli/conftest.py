"""What the tests of commands share."""

from pathlib import Path

import pytest
from command_lines import ONE
from small_benchmark import copied


@pytest.fixture
def one(small: Path, tmp_path: Path) -> Path:
    """A copy of the chair's recording and of all that was built from it."""
    root = copied(small, tmp_path / "one", "recordings/chair", "build/chair")
    (root / "benchmark.yaml").write_text(ONE)
    return root
