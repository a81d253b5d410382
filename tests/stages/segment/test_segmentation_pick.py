"""A pixel that a person picked says what the object is, where the cameras look at something else."""

import os
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from analytic_scenes import box, plane, ring, scene_of, sequence_of
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
from kinectbench.stages.segment.find.candidates import find_candidates
from kinectbench.stages.segment.find.given import GivenObject, PickedPoint, picked_point
from kinectbench.stages.segment.find.hints import floor_hint
from kinectbench.stages.segment.find.object import find_floor_and_object
from kinectbench.stages.segment.segment import segment


@pytest.fixture(scope="module")
def beside() -> tuple[Sequence, Trajectory]:
    """A box where the cameras look, and a lower one 40 cm beside it."""
    things = [box((-0.15, -0.1, 0), (0.15, 0.1, 0.3)), box((0.3, -0.1, 0), (0.5, 0.1, 0.2))]
    return scene_of([*things, plane((0, 0, 1), 0.0)], ring(16, 1.2, (0, 0, 0.15), (0.4, 0.8)))


@pytest.fixture(scope="module")
def walled() -> tuple[Sequence, Trajectory]:
    """A box, and a wall that cameras see behind it."""
    things = [box((-0.15, -0.1, 0), (0.15, 0.1, 0.3)), plane((0, -1, 0), -1.4), plane((0, 0, 1), 0.0)]
    return scene_of(things, ring(16, 1.2, (0, 0, 0.15), (0.4, 0.8)))


def pixel_of(sequence: Sequence, T_world_camera: Float64, point: tuple[float, ...]) -> tuple[int, int]:
    at = transform_points(invert_rigid(T_world_camera), np.array(point))
    u, v = np.rint(sequence.camera.project(at)).astype(int)
    return int(u), int(v)


def test_what_was_picked_is_the_object(beside: tuple[Sequence, Trajectory]) -> None:
    """A pixel on the top of the lower box: it is found in place of what the cameras look at."""
    sequence, trajectory = beside
    mesh = fuse(sequence, trajectory, FusionSettings(max_depth_m=1.7)).mesh
    pixel = pixel_of(sequence, trajectory.T_world_camera[3], (0.4, 0, 0.2))
    picked = picked_point(sequence, trajectory, 3, pixel).point_world
    assert np.allclose(picked, (0.4, 0, 0.2), rtol=0, atol=0.01)
    # The number is that of the recording, in which a damaged frame came before it.
    damaged = replace(sequence, recorded=(0, *range(2, 17)))
    again = picked_point(damaged, trajectory, 4, pixel)
    assert again.frame == 4 and np.array_equal(again.point_world, picked)
    for point, size_m in ((None, [0.3, 0.2, 0.3]), (picked, [0.2, 0.2, 0.2])):
        hint = floor_hint(sequence, trajectory, None, point)
        found = find_floor_and_object(mesh, trajectory, None, SegmentationSettings(), hint)
        assert np.allclose(found.box.size_m, size_m, rtol=0, atol=0.04)


def test_a_pixel_that_shows_nothing_is_one_line(beside: tuple[Sequence, Trajectory]) -> None:
    sequence, trajectory = beside
    lost = replace(trajectory, T_world_camera=trajectory.T_world_camera.copy())
    lost.T_world_camera[2] = np.nan
    damaged = replace(sequence, recorded=(0, 1, 2, *range(4, 17)))
    dark = sequence_of([np.zeros((240, 320), np.float32)] * 16)
    for shown, poses, frame, pixel, words in (
        (
            sequence,
            trajectory,
            16,
            (10, 10),
            r"pick: {frame: 16, pixel: \[10, 10\]}: there is no whole frame 16: the last one is 15;",
        ),
        (sequence, trajectory, 0, (320, 10), r"pixel: \[320, 10\]}: depth has 320 x 240 pixels"),
        (sequence, trajectory, 0, (10, 240), r"\[10, 240\]}: depth has 320 x 240"),
        (sequence, lost, 2, (10, 10), "frame 2 has no pose; pick one of another frame, or remove `pick`"),
        (damaged, trajectory, 3, (10, 10), "frame 3 is damaged, and was left out; pick one of another frame"),
        (damaged, trajectory, 17, (10, 10), "there is no whole frame 17: the last one is 16;"),
        (dark, trajectory, 0, (10, 10), r"\[10, 10\]}: there is no depth within 20 pixels of it"),
    ):
        with raises(SegmentationError, "segmentation.bad-pick", words):
            picked_point(shown, poses, frame, pixel)


@pytest.mark.parametrize("point", [(-0.3, 0, 0), (0, -0.9, 0), (0, 1.4, 0.3)], ids=str)
def test_what_stands_beside_a_picked_pixel_is_not_taken(
    walled: tuple[Sequence, Trajectory], point: tuple[float, ...]
) -> None:
    """The floor near the box, the floor far away, and a wall too far to be fused: one line says so."""
    sequence, trajectory = walled
    fusion = FusionSettings(max_depth_m=1.7)
    mesh = fuse(sequence, trajectory, fusion).mesh
    picked = pick_of(sequence, trajectory, point)
    value = rf"{{frame: {picked.frame}, pixel: \[[0-9, ]+\]}}"
    words = rf"pick: {value}: it shows the floor .* beside .*, or remove `pick`"
    with raises(SegmentationError, "segmentation.bad-pick", words):
        segment(sequence, trajectory, mesh, SegmentationSettings(), fusion, GivenObject(picked=picked))
    hint = floor_hint(sequence, trajectory, None, picked.point_world)
    listed = find_candidates(mesh, trajectory, SegmentationSettings(), hint).candidates
    assert listed and not any(each.automatic for each in listed)


def pick_of(sequence: Sequence, trajectory: Trajectory, point: tuple[float, ...]) -> PickedPoint:
    """The first pixel that shows a point."""
    for frame, T_world_camera in enumerate(trajectory.T_world_camera):
        u, v = pixel_of(sequence, T_world_camera, point)
        if 0 <= u < 320 and 0 <= v < 240:
            picked = picked_point(sequence, trajectory, frame, (u, v))
            if np.allclose(picked.point_world, point, rtol=0, atol=0.02):
                return picked
    raise AssertionError(f"no frame shows {point}")


def test_init_asks_no_recording_of_one_file_for_a_click(command: Callable[..., Run], tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()
    with zipfile.ZipFile(tmp_path / "recordings/scan.zip", "w") as packed:
        packed.writestr("depth/0000001-000000000000.png", b"")
        packed.writestr("rgb/0000001-000000000000.jpg", b"")
    assert command(tmp_path, "init", "recordings").status == 0
    written = (tmp_path / "recordings/benchmark.yaml").read_text()
    assert "scan.zip" in written and "pick.json" not in written


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
        (tmp_path / "recordings/benchmark.yaml").unlink()
        assert command(tmp_path, "init", "recordings", "--force").status == 0
        written = (tmp_path / "recordings/benchmark.yaml").read_text()
        assert "    pick:" not in written and "pick.json beside it holds no click" in written
    file.unlink()
    os.mkfifo(file)  # nobody writes to it
    assert command(tmp_path, "init", "recordings", "--force").status == 0


def stage_lines(root: Path) -> list[str]:
    """The settings of `segment` and `suggest`, as their artefacts store them."""
    settings = load_benchmark(root / "benchmark.yaml")
    job = Job(settings, settings.recordings[0], root)
    stages = [SUGGEST, *(stage for stage in STAGES if stage.name == "segment")]
    return [f"{key}: {value}" for stage in stages for key, value in stage.settings(job).items()]
