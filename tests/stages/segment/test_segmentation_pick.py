"""A pixel that a person picked says what the object is, where the cameras look at something else."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from analytic_scenes import box, plane, ring, scene_of
from raising import raises
from small_benchmark import Run
from small_runs import make_small

from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import invert_rigid, transform_points
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float64
from kinectbench.engine.stages import STAGES, SUGGEST, Job
from kinectbench.settings.file import load_benchmark
from kinectbench.settings.models import FusionSettings, SegmentationSettings
from kinectbench.stages.fuse import fuse
from kinectbench.stages.segment.find.gravity import floor_hint
from kinectbench.stages.segment.find.object import find_floor_and_object
from kinectbench.stages.segment.find.picked import picked_point


@pytest.fixture(scope="module")
def beside() -> tuple[Sequence, Trajectory]:
    """A box where the cameras look, and a lower one 40 cm beside it."""
    things = [box((-0.15, -0.1, 0), (0.15, 0.1, 0.3)), box((0.3, -0.1, 0), (0.5, 0.1, 0.2))]
    return scene_of([*things, plane((0, 0, 1), 0.0)], ring(16, 1.2, (0, 0, 0.15), (0.4, 0.8)))


def pixel_of(sequence: Sequence, T_world_camera: Float64, point: tuple[float, ...]) -> tuple[int, int]:
    at = transform_points(invert_rigid(T_world_camera), np.array(point))
    u, v = np.rint(sequence.camera.project(at)).astype(int)
    return int(u), int(v)


def test_what_was_picked_is_the_object(beside: tuple[Sequence, Trajectory]) -> None:
    """A pixel on the top of the lower box: it is found in place of what the cameras look at."""
    sequence, trajectory = beside
    mesh = fuse(sequence, trajectory, FusionSettings(max_depth_m=1.7)).mesh
    pixel = pixel_of(sequence, trajectory.T_world_camera[3], (0.4, 0, 0.2))
    picked = picked_point(sequence, trajectory, 3, pixel)
    assert np.allclose(picked, (0.4, 0, 0.2), rtol=0, atol=0.01)
    for point, size_m in ((None, [0.3, 0.2, 0.3]), (picked, [0.2, 0.2, 0.2])):
        hint = floor_hint(sequence, trajectory, None, point)
        found = find_floor_and_object(mesh, trajectory, None, SegmentationSettings(), hint)
        assert np.allclose(found.box.size_m, size_m, rtol=0, atol=0.04)


def test_a_pixel_that_shows_nothing_is_one_line(beside: tuple[Sequence, Trajectory]) -> None:
    sequence, trajectory = beside
    with raises(SegmentationError, "segmentation.bad-pick", "frame 16 has no pose"):
        picked_point(sequence, trajectory, 16, (10, 10))
    with raises(SegmentationError, "segmentation.bad-pick", "no depth within 20 pixels of"):
        picked_point(sequence, trajectory, 0, (5000, 10))


def test_init_writes_what_was_clicked(command: Callable[..., Run], tmp_path: Path) -> None:
    """`pick.json` beside the frames becomes `pick`; without it the settings of `segment` are as before."""
    make_small(tmp_path, ("chair",))
    plain = [line for line in stage_lines(tmp_path) if "pick" in line]
    assert plain == []
    (tmp_path / "recordings/chair/pick.json").write_text('{"frame": 4, "pixel": [160, 120]}')
    assert command(tmp_path, "init", "recordings", "--force").status == 0
    assert "pick: {frame: 4, pixel: [160, 120]}" in (tmp_path / "recordings/benchmark.yaml").read_text()
    assert any("160" in line for line in stage_lines(tmp_path / "recordings"))
    file = tmp_path / "recordings/chair/pick.json"
    far, padded = '{"frame": 0, "pixel": [1000000000000000000000, 0]}', "{" + " " * 10_000 + '"frame": 4, '
    for wrong in ('{"frame": -4}', far, padded + '"pixel": [1, 1]}', '{"frame": ' + "9" * 5000 + "}"):
        file.write_text(wrong)
        assert command(tmp_path, "init", "recordings", "--force").status == 0
        assert "    pick:" not in (tmp_path / "recordings/benchmark.yaml").read_text()
    file.unlink()
    os.mkfifo(file)  # nobody writes to it
    assert command(tmp_path, "init", "recordings", "--force").status == 0


def stage_lines(root: Path) -> list[str]:
    """The settings of `segment` and `suggest`, as their artefacts store them."""
    settings = load_benchmark(root / "benchmark.yaml")
    job = Job(settings, settings.recordings[0], root)
    stages = [SUGGEST, *(stage for stage in STAGES if stage.name == "segment")]
    return [f"{key}: {value}" for stage in stages for key, value in stage.settings(job).items()]
