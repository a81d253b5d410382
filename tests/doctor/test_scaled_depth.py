"""Depth that was scaled image by image has no unit; codes and limits of sensors only look like it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from ingest_writers import depth_image, png, write_folder
from numpy.typing import NDArray
from raising import raises
from small_benchmark import Run

from kinectbench.core.errors import RecordingError
from kinectbench.doctor import inspect
from kinectbench.doctor.during_build import refuse_hopeless
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.readers import open_recording

Depth = NDArray[np.uint16]
WORDS = "each image was scaled by its own maximum, so depth has no unit"


def recorded(folder: Path, change: Callable[[Depth, int], NDArray[np.generic]]) -> Path:
    """Six images of a slanted wall, 1 to 1.4 m away, changed each by itself."""
    write_folder(folder, [str(i) for i in range(6)])
    for i in range(6):
        depth = change(depth_image(i, 1000.0), i)
        (folder / f"depth/{i}.png").write_bytes(png(depth.astype(np.uint16)))
    return folder


def by_maximum(full: int) -> Callable[[Depth, int], NDArray[np.generic]]:
    return lambda depth, i: depth / depth.max() * full


def check_refused(folder: Path) -> None:
    diagnosis, _ = inspect(folder)
    names = [found.name for found in diagnosis.findings]
    assert "depth_normalised" in names and diagnosis.stops and "depth_scale" not in names
    with raises(RecordingError, "recording.implausible", match=f"{WORDS}.*export raw depth"):
        refuse_hopeless(open_recording(folder))


@pytest.mark.parametrize("full", [32767, 65535])
def test_images_that_were_scaled_by_their_own_maximum(full: int, tmp_path: Path) -> None:
    check_refused(recorded(tmp_path / "r", by_maximum(full)))


def test_floats_that_were_scaled_by_their_own_maximum(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    for i in range(4):
        depth = depth_image(i, 1000.0)
        (folder / f"depth/{i}.png").unlink()
        np.save(folder / f"depth/{i}.npy", (depth / depth.max()).astype(np.float32))
    check_refused(folder)


def test_metres_that_were_cut_at_one_are_depth(tmp_path: Path) -> None:
    """Values do not thin out towards the cut, as they do towards the end of a scene."""
    folder = write_folder(tmp_path / "r")
    for i in range(4):
        metres = 0.8 * depth_image(i, 1000.0) / 1000 + np.random.default_rng(i).normal(0, 0.002, (48, 64))
        metres[5, 5] = 1.0
        (folder / f"depth/{i}.png").unlink()
        np.save(folder / f"depth/{i}.npy", np.where(metres > 1, 0, metres).astype(np.float32))
    diagnosis, probe = inspect(folder)
    assert probe is not None and max(frame.depth.max() for frame in probe.whole) == 5000
    assert "depth_normalised" not in {found.name for found in diagnosis.findings}


def test_a_build_refuses_them_in_the_same_words(tmp_path: Path, command: Callable[..., Run]) -> None:
    recorded(tmp_path / "r", by_maximum(32767))
    yaml = "name: x\nrecordings: [{id: a, path: r, category: chair, camera: {depth_scale: 20000}}]\n"
    (tmp_path / "benchmark.yaml").write_text(yaml)
    for stage in ("ingest", "build"):
        said = command(tmp_path, stage, "--jobs", "1")
        assert said.status == 1 and WORDS in said.err


def marked(depth: Depth, i: int) -> NDArray[np.generic]:
    depth[20, 20:22] = 65535
    return depth


def far_plane(depth: Depth, i: int) -> NDArray[np.generic]:
    """Farther than 13.1 m at 5000 units per metre, in a tenth of the image, beside depth just below it."""
    return np.asarray(np.minimum(depth * 52.0, 65535))


def stereo_noise(depth: Depth, i: int) -> NDArray[np.generic]:
    """Disparities near zero, of which some are clamped, as those of RealSense cameras are."""
    disparity = np.random.default_rng(i).uniform(0, 0.15, 60)
    depth[30, :60] = np.minimum(1000 / np.maximum(disparity, 1e-6), 65535)
    return depth


def some_scaled(depth: Depth, i: int) -> NDArray[np.generic]:
    return np.asarray(depth / depth.max() * (65535 if i % 2 else 60000))


@pytest.mark.parametrize("change", [marked, far_plane, stereo_noise, some_scaled, by_maximum(8191)])
def test_codes_and_limits_of_sensors_are_none(
    change: Callable[[Depth, int], NDArray[np.generic]], tmp_path: Path
) -> None:
    folder = recorded(tmp_path / "r", change)
    assert "depth_normalised" not in {found.name for found in inspect(folder)[0].findings}


def test_millimetres_of_a_room_in_a_smaller_unit_get_a_warning(tmp_path: Path) -> None:
    """At 5000 units per metre a wall at 1 to 1.4 m would be an object at 0.2 to 0.28 m."""
    folder = recorded(tmp_path / "r", lambda depth, i: depth)
    for scale, count in ((5000.0, 1), (1000.0, 0)):
        findings = inspect(folder, CameraSettings(depth_scale=scale))[0].findings
        assert [each.name for each in findings].count("depth_scale") == count
