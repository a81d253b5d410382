"""The same frames in every container that is read give the same pairs, byte for byte."""

from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

import cv2
import numpy as np
import pytest
from analytic_scenes import box, depth_of, plane, ring
from numpy.typing import NDArray
from read_pictures import decoded_picture
from typed import present

from kinectbench.core.artefacts.sequence import CameraFile
from kinectbench.core.geometry import Camera, Grid, OrientedBox, TriangleMesh, rigid
from kinectbench.core.geometry.mesh import BOX_FACES
from kinectbench.core.sequence import Sequence
from kinectbench.core.voxels.known_cells import known_grid
from kinectbench.core.voxels.pair_file import pair_bytes
from kinectbench.lab.simulate.writers import RecordedFrame, Rig, formats
from kinectbench.settings.models import CameraSettings, PairSettings
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence
from kinectbench.stages.pairs import FullShape, make_pair
from kinectbench.stages.sample_views.alignment import ViewAlignment
from kinectbench.stages.sample_views.view_fit import ViewFit
from kinectbench.stages.sample_views.views import View

FRAMES = 5
CAMERA = Camera(160, 120, 131.25, 131.5, 79.5, 59.25)
CRATE = OrientedBox((0.0, 0.0, 0.2), (0.5, 0.4, 0.4))
START_NS, STEP_NS = 1_400_000_000 * 10**9, 200_000_000
WITHOUT_POSES = ("realsense", "realsense_old", "klg", "redwood_zip", "azure_kinect")
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
    """Frames of a crate, whose depth is whole millimetres; a view of it, and the pair of that view."""

    frames: list[Stored]
    view: View
    shape: FullShape
    pair: bytes


@pytest.fixture(scope="module")
def source() -> Source:
    half = np.array(CRATE.size_m) / 2
    middle = np.array(CRATE.center_m)
    surface = box(tuple(middle - half), tuple(middle + half))
    poses = ring(FRAMES, 1.2, (0, 0, 0.2), (0.5,))
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    frames = []
    for i, T in enumerate(poses):
        depth_m = depth_of([surface, plane((0, 0, 1), 0.0)], CAMERA, T)
        # YCB's tenths of a millimetre in 16 bits end at 6.55 m.
        mm = np.rint(np.where(depth_m < 6.5, depth_m, 0) * 1000).astype(np.uint16)
        bgr = np.dstack([u, v, np.full_like(u, 40 * i)]).astype(np.uint8)
        jpeg = cv2.imencode(".jpg", bgr)[1].tobytes()
        rgb = np.ascontiguousarray(decoded_picture(jpeg, 1)[..., ::-1])
        stamp_ns = START_NS + i * STEP_NS
        frames.append(Stored(stamp_ns, mm / np.float32(1000), stamp_ns, rgb, T, jpeg=jpeg))
    mask = depth_of([surface], CAMERA, poses[2]) > 0
    fit = ViewFit(int(mask.sum()), 1.0, 0.0, 0.0, 1.0, 0.0)
    view = View("000", 2, frames[2].stamp_ns, "random", ViewAlignment(poses[2], 0.0, 0.0), mask, fit)
    mesh = TriangleMesh(CRATE.corners_floor(), BOX_FACES)
    grid = Grid((40, 40, 24), 0.05, rigid(np.eye(3), [-1.0, -1.0, -0.4]))
    known = known_grid(grid, np.ones(grid.shape, bool))
    grids = (known, known)
    shape = FullShape(mesh, mesh.volume_m3, grids, grids, grids, 0.001)
    made = make_pair(view, _in_memory(frames), shape, PairSettings())
    assert made.pair is not None and made.pair.partial.any()
    return Source(frames, view, shape, pair_bytes(made.pair))


def wrapped(source: Source, name: str, root: Path) -> Sequence:
    path = formats()[name].write_new(root / "recording", Rig(CAMERA, CAMERA, True, np.eye(4)), source.frames)
    c = CAMERA
    settings = CameraSettings(width=c.width, height=c.height, fx=c.fx, fy=c.fy, cx=c.cx, cy=c.cy)
    write_sequence(open_recording(path, settings), root / "sequence")
    return read_sequence(root / "sequence")


@pytest.mark.parametrize("name", formats())
def test_every_container_gives_the_same_pairs(source: Source, name: str, tmp_path: Path) -> None:
    sequence = wrapped(source, name, tmp_path)
    assert len(sequence) == FRAMES and sequence.camera == CAMERA
    # By this, `publish` finds that two files hold the same frames.
    assert CameraFile.read(tmp_path / "sequence").depth_sketch == depth_sketch(source.frames)
    for i, frame in enumerate(source.frames):
        np.testing.assert_array_equal(sequence.depth_m(i), frame.depth_m)
        rgb = sequence.color_rgb(i)
        assert rgb is not None or name == "stray"
        if rgb is not None and name != "stray":  # a video
            np.testing.assert_array_equal(rgb, frame.color_rgb)
    given = sequence.given_trajectory
    assert (given is None) == (name in WITHOUT_POSES)
    if given is not None:
        poses = [present(frame.T_world_camera) for frame in source.frames]
        np.testing.assert_allclose(given.T_world_camera, poses, rtol=0, atol=POSE_TOLERANCE)
    # By one trajectory and one object: all that a pair takes from its recording are the depth and the camera.
    made = make_pair(source.view, sequence, source.shape, PairSettings())
    assert made.pair is not None and pair_bytes(made.pair) == source.pair


def depth_sketch(frames: list[Stored]) -> tuple[str, ...]:
    depths_mm = (np.rint(1000 * frame.depth_m).astype(np.int32) for frame in frames)
    return tuple(sorted(blake2b(depth.tobytes(), digest_size=8).hexdigest() for depth in depths_mm))


@dataclass(frozen=True)
class _Frames:
    frames: list[Stored]

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        return self.frames[index].depth_native(1000.0)

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        return None


def _in_memory(frames: list[Stored]) -> Sequence:
    stamps_ns = np.array([frame.stamp_ns for frame in frames], np.int64)
    return Sequence(CAMERA, 1000.0, stamps_ns, False, None, _Frames(frames))
