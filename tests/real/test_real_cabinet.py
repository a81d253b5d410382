"""A real cabinet on a bare floor, as a folder and as a bag: the bars of benchmarks/, as tests."""

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
def jobs(tmp_path_factory: pytest.TempPathFactory) -> list[Job]:
    """The cabinet from its folder and from a bag of the same frames, both built."""
    root = tmp_path_factory.mktemp("cabinet")
    settings = cabinet.cabinet_settings(Path(DATA or "."))
    bag = root / "cabinet.bag"
    bag_equals_folder.wrap(Path(settings.recordings[0].path), bag)
    return built(bag_equals_folder.with_bag(settings, bag), root, workers=1)


def test_the_frame_that_disagrees_is_left_out(jobs: list[Job]) -> None:
    assert missed(cabinet.tracking_figures(jobs[0])) == []


def test_one_object_alone_on_the_floor_of_the_world(jobs: list[Job]) -> None:
    assert missed(cabinet.object_figures(jobs[0])) == []


def test_flat_faces(jobs: list[Job]) -> None:
    assert missed(cabinet.face_figures(jobs[0])) == []


def test_fifty_views_and_pairs(jobs: list[Job]) -> None:
    assert missed(cabinet.pair_figures(jobs[0])) == []


def test_a_bag_gives_the_same_bytes(jobs: list[Job]) -> None:
    folder, bag = jobs
    assert missed(bag_equals_folder.compare(folder.build, bag.build)) == []
