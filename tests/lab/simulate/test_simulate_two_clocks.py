"""Colour with a rate of its own: counts and stamps differ, and what is read is paired by time."""

from pathlib import Path

import numpy as np
import pytest
from ingest_writers import color_image, depth_image

from kinectbench.core.geometry import Camera
from kinectbench.lab.simulate.presets import preset_spec
from kinectbench.lab.simulate.simulate import prepare, record_frame
from kinectbench.lab.simulate.writers import RecordedFrame, Rig, formats
from kinectbench.lab.simulate.writers.frame import ColorImage
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.readers import open_recording

CAMERA = Camera(64, 48, 60.0, 61.0, 31.5, 23.5)
SETTINGS = CameraSettings(width=64, height=48, fx=60, fy=61, cx=31.5, cy=23.5)
START_NS = 1_700_000_000_000_000_000
DEPTHS, COLORS = 40, 27


def frames() -> list[RecordedFrame]:
    """Depth at 30 Hz, colour at 20 Hz and 5 ms late; each image is one that its number tells."""
    depth_ns = [START_NS + i * 33_333_000 for i in range(DEPTHS)]
    color_ns = [START_NS + 5_000_000 + j * 50_000_000 for j in range(COLORS)]
    made = []
    for i, stamp_ns in enumerate(depth_ns):
        since = depth_ns[i - 1] if i else 0
        own = tuple(ColorImage(ns, color_image(j)) for j, ns in enumerate(color_ns) if since < ns <= stamp_ns)
        depth_m = (depth_image(i, 1000.0) / 1000).astype(np.float32)
        made.append(RecordedFrame(stamp_ns, depth_m, stamp_ns, color_image(i), np.eye(4), own_colors=own))
    return made


@pytest.mark.parametrize(
    "file_format", ["tum", "redwood", "redwood_zip", "bag_compressed", "ros2_sqlite", "realsense"]
)
def test_a_writer_keeps_two_streams_apart_and_its_reader_pairs_them(file_format: str, tmp_path: Path) -> None:
    out = formats()[file_format].write_new(tmp_path / "r", Rig(CAMERA, CAMERA, True, np.eye(4)), frames())
    recording = open_recording(out, SETTINGS)
    depth_ns, color_ns = recording.recorded_stamps_ns
    written = sum(len(frame.colors) for frame in frames())
    assert (len(recording), len(color_ns)) == (DEPTHS, written) and written < DEPTHS
    paired = [i for i in range(DEPTHS) if recording.frame(i).color is not None]
    apart_ns = np.abs(depth_ns[:, None] - color_ns).min(axis=1)
    # Each colour image has one partner at most, within half a frame of depth.
    assert written - 1 <= len(paired) <= written and apart_ns[paired].max() <= 16_700_000
    assert sum("have no colour frame within 17 ms" in said for said in recording.warnings) == 1


def test_a_simulated_recording_has_both_rates() -> None:
    changes = {
        "object": "chair:seed=1",
        "path": {"frames": 7, "rate_hz": 10},
        "sensor": {"model": "ideal", "width": 40, "height": 30, "color_rate_hz": 20, "color_delay_s": 0.01},
    }
    simulation = prepare(preset_spec("orbit-v1", changes))
    made = [record_frame(simulation, index).frame for index in range(7)]
    color_ns = np.array([color.stamp_ns for frame in made for color in frame.colors])
    assert len(color_ns) == 12 and set(np.diff(color_ns)) == {50_000_000}
    assert color_ns[0] - made[0].stamp_ns == 10_000_000
    # The second is taken when the camera is half-way between the first two depth images.
    first, second = (made[1].colors[k].rgb.astype(float) for k in (0, 1))
    assert np.abs(first - second).mean() > 0.1


def test_without_a_rate_of_its_own_nothing_changes() -> None:
    spec = preset_spec("orbit-v1", {"object": "chair:seed=1"})
    assert "color_rate_hz" not in spec.model_dump()["sensor"]
    frame = RecordedFrame(5, np.zeros((2, 2), np.float32), 7, color_image(1), None)
    assert [(color.stamp_ns, color.jpeg()) for color in frame.colors] == [(7, frame.color_jpeg())]
