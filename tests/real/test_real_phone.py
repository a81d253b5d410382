"""A phone held over boards on a floor, 76 degrees down: a floor is found, and a box leads to pairs."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builds import built

from kinectbench.core.artefacts.object import CandidatesFile
from kinectbench.core.artefacts.views import PairsFile
from kinectbench.engine.parallel import build
from kinectbench.engine.stages import SUGGEST, Job
from kinectbench.settings.models import BenchmarkSettings
from kinectbench.stages.segment.object_model import read_object

DATA = os.environ.get("KINECTBENCH_DATA")
pytestmark = [
    pytest.mark.skipif(not DATA, reason="KINECTBENCH_DATA does not name a folder of real recordings"),
    pytest.mark.xdist_group("real_phone"),
]
# Of the printed board with its pattern, as it can be measured by the boxes around it: an A4 sheet on wood.
LONG_M, WIDE_M = 0.30, 0.21


def settings_of(**of_recording: Any) -> BenchmarkSettings:
    path = str((Path(DATA or ".") / "phone_looking_down").resolve())
    recording = {"id": "boards", "path": path, "category": "board"} | of_recording
    return BenchmarkSettings.model_validate(
        {"name": "phone", "recordings": [recording], "views": {"count": 4}}
    )


@pytest.fixture(scope="module")
def suggested(tmp_path_factory: pytest.TempPathFactory) -> Job:
    """As far as the boxes that `kinectbench segment --suggest` lists."""
    settings = settings_of()
    job = Job(settings, settings.recordings[0], tmp_path_factory.mktemp("phone"))
    (outcome,) = build([job], SUGGEST.name)
    assert outcome.error is None
    return job


def test_the_floor_is_below_the_boards_and_level_by_gravity(suggested: Job) -> None:
    listed = CandidatesFile.read(suggested.build / SUGGEST.folder)
    assert listed.floor_found and listed.candidates
    # ARKit's world has y up.
    assert listed.T_floor_world is not None
    assert listed.T_floor_world[2, :3] == pytest.approx([0, 1, 0], abs=0.02)
    for each in listed.candidates:
        assert abs(each.box.center_m[2] - each.box.size_m[2] / 2) < 0.03


def test_the_largest_board_comes_to_pairs_by_a_box_that_is_suggested(suggested: Job) -> None:
    listed = CandidatesFile.read(suggested.build / SUGGEST.folder)
    sizes_m = [sorted(each.box.size_m[:2], reverse=True) for each in listed.candidates]
    off_m = [float(np.abs(np.subtract(size, (LONG_M, WIDE_M))).max()) for size in sizes_m]
    best = listed.candidates[int(np.argmin(off_m))].box
    assert min(off_m) < 0.06
    (job,) = built(settings_of(box=best.json_value()), suggested.root, workers=1)
    pairs = PairsFile.read(job.build / "pairs")
    assert len(pairs.pairs) >= 1
    model = read_object(job.build / "object")
    assert model.floor.found
    # A board as thick as a finger at most, and flat on the floor.
    assert 0.005 < model.shape.mesh.vertices[:, 1].max() - model.shape.mesh.vertices[:, 1].min() < 0.05
