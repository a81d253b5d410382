"""The same frames in every container that is read give the same pairs, byte for byte."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from chair_model import Chair
from chair_model import chair as make_chair
from numpy.typing import NDArray

from kinectbench.config import CameraSettings, PairSettings, SegmentationSettings, ViewSettings
from kinectbench.ingest.registry import open_recording
from kinectbench.ingest.sequence_folder import read_sequence, write_sequence
from kinectbench.pairs import make_pair
from kinectbench.sequence import Sequence
from kinectbench.simulate.writers import SUFFIXES, WRITERS, RecordedFrame, Rig
from kinectbench.views import View, sample_views
from kinectbench.voxels.pair_file import pair_bytes

pytestmark = pytest.mark.xdist_group("chair_model")
FRAMES = 8
WITHOUT_POSES = ("realsense", "realsense_old", "klg")
# Poses are text with nine decimals, float32, or what is left of a matrix that was made a quaternion.
POSE_TOLERANCE = 2e-7


@dataclass(frozen=True)
class Stored(RecordedFrame):
    """A frame whose colour is handed on as it was encoded."""

    jpeg: bytes = b""

    def color_jpeg(self) -> bytes:
        return self.jpeg


@dataclass(frozen=True)
class Source:
    """Frames whose depth is whole millimetres, the rig, and views of them with the object they are of."""

    chair: Chair
    frames: list[Stored]
    rig: Rig
    views: list[View]


@pytest.fixture(scope="module")
def source() -> Source:
    chair = make_chair()
    sequence, camera = chair.recorded.sequence, chair.recorded.sequence.camera
    frames = []
    for i in range(FRAMES):
        mm = np.rint(sequence.depth_m(i) * 1000).astype(np.uint16)
        rgb = sequence.color_rgb(i)
        assert rgb is not None
        jpeg = cv2.imencode(".jpg", rgb[..., ::-1])[1].tobytes()
        decoded = np.ascontiguousarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), 1)[..., ::-1])
        stamp_ns, T = int(sequence.stamps_ns[i]), chair.trajectory.T_world_camera[i]
        frames.append(Stored(stamp_ns, mm / np.float32(1000), stamp_ns, decoded, T, None, jpeg))
    few = replace(chair.trajectory, T_world_camera=_first(chair.trajectory.T_world_camera))
    views = sample_views(
        sequence, few, chair.model, ViewSettings(count=2), SegmentationSettings(), PairSettings()
    )
    return Source(chair, frames, Rig(camera, camera, True, np.eye(4)), views.views)


def _first(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    kept = poses.copy()
    kept[FRAMES:] = np.nan
    return kept


def wrapped(source: Source, name: str, root: Path) -> Sequence:
    path = root / f"recording{SUFFIXES.get(name, '')}"  # type: ignore[call-overload]
    if name not in SUFFIXES:
        path.mkdir()
    WRITERS[name](path, source.rig, source.frames)  # type: ignore[index]
    c = source.rig.depth
    settings = CameraSettings(width=c.width, height=c.height, fx=c.fx, fy=c.fy, cx=c.cx, cy=c.cy)
    write_sequence(open_recording(path, settings), root / "sequence")
    return read_sequence(root / "sequence")


@pytest.mark.parametrize("name", WRITERS)
def test_every_container_gives_the_same_pairs(source: Source, name: str, tmp_path: Path) -> None:
    sequence = wrapped(source, name, tmp_path)
    assert len(sequence) == FRAMES and sequence.camera == source.rig.depth
    for i, frame in enumerate(source.frames):
        np.testing.assert_array_equal(sequence.depth_m(i), frame.depth_m)
        rgb = sequence.color_rgb(i)
        assert rgb is not None or name == "stray"
        if rgb is not None and name != "stray":  # a video
            np.testing.assert_array_equal(rgb, frame.color_rgb)
    given = sequence.given_trajectory
    assert (given is None) == (name in WITHOUT_POSES)
    if given is not None:
        poses = [frame.T_world_camera for frame in source.frames]
        np.testing.assert_allclose(given.T_world_camera, poses, rtol=0, atol=POSE_TOLERANCE)
    # By one trajectory and one object: all that a pair takes from its recording are the depth and the camera.
    for view in source.views:
        direct = make_pair(view, _in_memory(source), source.chair.model, PairSettings())
        again = make_pair(view, sequence, source.chair.model, PairSettings())
        assert direct.pair is not None and again.pair is not None
        assert pair_bytes(again.pair) == pair_bytes(direct.pair)


@dataclass(frozen=True)
class _Frames:
    frames: list[Stored]

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        return self.frames[index].depth_native(1000.0)

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        return None


def _in_memory(source: Source) -> Sequence:
    return replace(source.chair.recorded.sequence, depth_scale=1000.0, frames=_Frames(source.frames))
