"""The truth of a chair of boxes, and a perfect build of it."""

import pytest
from known_builds import Known, known_build, make_truth

from kinectbench.lab.simulate.truth import Truth


@pytest.fixture(scope="session")
def truth(tmp_path_factory: pytest.TempPathFactory) -> Truth:
    return make_truth(tmp_path_factory.mktemp("evaluate") / "chair.truth")


@pytest.fixture(scope="session")
def perfect(truth: Truth) -> Known:
    return known_build(truth)
