"""A real cabinet on a bare floor: the bars of benchmarks/, as tests."""

import os
from pathlib import Path

import cabinet
import pytest
from builds import built
from figures import missed
from slow import slow

from kinectbench.engine.stages import Job

DATA = os.environ.get("KINECTBENCH_DATA")
pytestmark = [
    pytest.mark.skipif(not DATA, reason="KINECTBENCH_DATA does not name a folder of real recordings"),
    pytest.mark.xdist_group("real_cabinet"),
]


@pytest.fixture(scope="session")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cabinet")


@pytest.fixture(scope="session", params=[12, slow(cabinet.VIEWS)])
def job(request: pytest.FixtureRequest, root: Path) -> Job:
    """The cabinet, built from its folder, with some views or all."""
    settings = cabinet.cabinet_settings(Path(DATA or "."))
    some = settings.model_copy(update={"views": settings.views.model_copy(update={"count": request.param})})
    return built(some, root / f"{request.param} views", workers=1)[0]


def test_the_frame_that_disagrees_is_left_out(job: Job) -> None:
    assert missed(cabinet.tracking_figures(job)) == []


def test_one_object_alone_on_the_floor_of_the_world(job: Job) -> None:
    assert missed(cabinet.object_figures(job)) == []


def test_flat_faces(job: Job) -> None:
    assert missed(cabinet.face_figures(job)) == []


def test_every_view_becomes_a_pair(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cabinet, "VIEWS", job.settings.views.count)
    assert missed(cabinet.pair_figures(job)) == []


@pytest.mark.slow  # test_real_ingest.py: what is read of the bag is the same, and all else follows from it
def test_a_bag_gives_the_same_bytes(root: Path) -> None:
    settings, file = cabinet.cabinet_settings(Path(DATA or ".")), root / "cabinet.bag"
    cabinet.wrap(Path(settings.recordings[0].path), file)
    with_bag = cabinet.with_bag(settings, file)
    folder, bag = built(with_bag, root / f"{cabinet.VIEWS} views", workers=1)
    assert missed(cabinet.compare(folder.build, bag.build)) == []
