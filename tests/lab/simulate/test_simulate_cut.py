"""Recordings that were cut off: what is whole is read, and one line says what is not."""

from pathlib import Path

import numpy as np
import pytest
from ingest_writers import every_frame
from raising import raises
from written_frames import BAGS, FOLDERS, SCALE, START_NS, STEP_NS, digests, frame, pose, read, write

from kinectbench.core.errors import RecordingError
from kinectbench.core.geometry import Camera
from kinectbench.lab.simulate.writers import RecordedFrame, Rig, cut, formats
from kinectbench.stages.ingest.images import DamagedImageError
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import RawFrame
from kinectbench.stages.ingest.sequence_folder import write_sequence


@pytest.mark.parametrize("name", FOLDERS)
@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.99])
def test_a_cut_folder_has_a_damaged_last_depth_image(tmp_path: Path, name: str, share: float) -> None:
    made = [frame(i) for i in range(21)]
    out = write(tmp_path / "r", name, made)
    before, sizes = digests(out), {f: f.stat().st_size for f in out.rglob("*") if f.is_file()}
    cut(out, share)
    recording = open_recording(out)
    found = list(every_frame(recording))
    assert len(found) == 21
    for raw, one in zip(found[: 20 if share else 21], made, strict=False):
        assert isinstance(raw, RawFrame)
        np.testing.assert_array_equal(raw.depth, one.depth_native(SCALE[name]))
    changed = [file for file, digest in digests(out).items() if digest != before[file]]
    assert len(changed) == (1 if share else 0)
    if share:
        file = out / changed[0]
        assert file.stat().st_size == round(sizes[file] * (1 - share))
        assert isinstance(found[-1], DamagedImageError)
        assert str(found[-1]).startswith(f"{file}: ")
        assert "\n" not in str(found[-1])
        # One of 21 frames may be left out.
        assert write_sequence(recording, tmp_path / "s") == [f"frame left out: {found[-1]}"]


@pytest.mark.parametrize("name", FOLDERS)
def test_a_short_recording_that_is_cut_gives_one_line(tmp_path: Path, name: str) -> None:
    out = write(tmp_path / "r", name, [frame(i) for i in range(5)])
    cut(out, 0.5)
    with raises(RecordingError, "recording.too-many-damaged", match=r"\(1.*5") as caught:
        write_sequence(open_recording(out), tmp_path / "s")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", BAGS)
def test_the_whole_chunks_of_a_cut_bag_are_saved(tmp_path: Path, name: str) -> None:
    rng = np.random.default_rng(5)  # noise does not compress, so that there are several chunks
    camera = Camera(160, 120, 131.25, 131.25, 79.5, 59.5)
    made = [
        RecordedFrame(
            START_NS + i * STEP_NS,
            rng.integers(1000, 3000, (120, 160)).astype(np.float32) / np.float32(1000),
            START_NS + i * STEP_NS,
            np.full((120, 160, 3), i, np.uint8),
            pose(i),
        )
        for i in range(90)
    ]
    out = tmp_path / "r.bag"
    formats()[name].write(out, Rig(camera, camera, True, np.eye(4)), made)
    whole = out.read_bytes()
    cut(out, 0.4)
    assert out.read_bytes() == whole[: round(0.6 * len(whole))]
    recording = open_recording(out)
    assert "is cut off or has no index" in recording.warnings[0]
    found = read(recording)
    assert 20 <= len(found) <= 54
    assert recording.given_trajectory is not None
    for raw, one in zip(found, made, strict=False):
        assert raw.stamp_ns == one.stamp_ns
        np.testing.assert_array_equal(raw.depth, one.depth_native(1000))
    cut(out, 0.9999)
    with raises(RecordingError, "recording.malformed", match="nothing") as caught:
        open_recording(out)
    assert "\n" not in str(caught.value)


def test_what_has_no_depth_image_is_not_cut(tmp_path: Path) -> None:
    with raises(RecordingError, "recording.no-depth"):
        cut(write(tmp_path / "r", "tum", []), 0.5)
