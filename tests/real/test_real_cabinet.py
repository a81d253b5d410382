"""A real cabinet on a bare floor: the bars of benchmarks/, as tests."""

import os
from pathlib import Path

import bag_equals_folder
import cabinet
import pytest
from builds import built
from figures import missed

from kinectbench.engine.stages import Job

DATA = os.environ.get("KINECTBENCH_DATA")
pytestmark = [
    pytest.mark.skipif(not DATA, reason="KINECTBENCH_DATA does not name a folder of real recordings"),
    pytest.mark.xdist_group("real_cabinet"),
]


@pytest.fixture(scope="session")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cabinet")


@pytest.fixture(scope="session")
def job(root: Path) -> Job:
    """The cabinet, built from its folder."""
    return built(cabinet.cabinet_settings(Path(DATA or ".")), root, workers=1)[0]


def test_the_frame_that_disagrees_is_left_out(job: Job) -> None:
    assert missed(cabinet.tracking_figures(job)) == []


def test_one_object_alone_on_the_floor_of_the_world(job: Job) -> None:
    assert missed(cabinet.object_figures(job)) == []


def test_flat_faces(job: Job) -> None:
    assert missed(cabinet.face_figures(job)) == []


def test_fifty_views_and_pairs(job: Job) -> None:
    assert missed(cabinet.pair_figures(job)) == []


@pytest.mark.slow  # test_real_ingest.py: what is read of the bag is the same, and all else follows from it
def test_a_bag_gives_the_same_bytes(job: Job, root: Path) -> None:
    settings, file = cabinet.cabinet_settings(Path(DATA or ".")), root / "cabinet.bag"
    bag_equals_folder.wrap(Path(job.recording.path), file)
    folder, bag = built(bag_equals_folder.with_bag(settings, file), root, workers=1)
    assert missed(bag_equals_folder.compare(folder.build, bag.build)) == []
