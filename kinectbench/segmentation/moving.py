"""What moved while the camera walked: depth nearer than the fused scene, in front of everything."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera, TriangleMesh
from kinectbench.geometry.depth_noise import depth_sigma_m
from kinectbench.segmentation.floor import Floor
from kinectbench.segmentation.render import DepthRenderer
from kinectbench.sequence import Sequence
from kinectbench.tracking.trajectory import Trajectory

JUDGED_FRAMES = 40
COLUMNS = 160
NEARER_M = 0.1
NEARER_SIGMAS = 5.0
MOVING_SHARE = 0.02
# Speckle and the edges of things are thinner than this many of the pixels looked at.
THICK_PX = 3


@dataclass(frozen=True)
class Moving:
    """Frames that show something which the others do not.

    Attributes:
        judged: how many frames were looked at, evenly spread.
        frames: those of them in which something stands before the scene, ascending.
        largest_share: the largest share of an image's pixels that it takes.
    """

    judged: int
    frames: tuple[int, ...]
    largest_share: float


def moving_frames(sequence: Sequence, trajectory: Trajectory, scene: TriangleMesh, floor: Floor) -> Moving:
    """Find frames with something that moved: at least 2 % of the pixels nearer than the scene (own rule).

    A pixel is nearer by more than max(5 sigma, 0.1 m), more than 0.1 m above the floor (which is measured
    badly far away, where it is seen at a grazing angle), and in a patch three of the pixels looked at
    wide. What moves leaves no surface in the fused scene, because other frames saw through it.

    Args:
        sequence: the recording.
        trajectory: its poses.
        scene: the fused surface, world frame.
        floor: its floor.
    """
    import cv2

    good = trajectory.good_frames
    judged = good[np.unique(np.linspace(0, len(good) - 1, min(len(good), JUDGED_FRAMES)).astype(int))]
    step_px = max(1, round(sequence.camera.width / COLUMNS))
    camera = _coarse(sequence.camera, step_px)
    renderer = DepthRenderer(scene)
    shares = []
    for frame in map(int, judged):
        measured_m = sequence.depth_m(frame)[::step_px, ::step_px]
        T_world_camera = trajectory.T_world_camera[frame]
        heights_m = floor.heights_m(measured_m, camera, T_world_camera)
        scene_m = renderer.depth_m(camera, T_world_camera)
        least_m = np.maximum(NEARER_SIGMAS * depth_sigma_m(scene_m), NEARER_M)
        nearer = (measured_m > 0) & (scene_m > 0) & (scene_m - measured_m > least_m)
        nearer &= heights_m > NEARER_M
        opened = cv2.morphologyEx(
            nearer.astype(np.uint8), cv2.MORPH_OPEN, np.ones((THICK_PX, THICK_PX), np.uint8)
        )
        shares.append(float(opened.mean()))
    found: NDArray[np.int64] = judged[np.array(shares) > MOVING_SHARE]
    return Moving(len(judged), tuple(found.tolist()), max(shares))


def _coarse(camera: Camera, step_px: int) -> Camera:
    """The camera of an image of which every `step_px`-th pixel is kept."""
    return Camera(
        -(-camera.width // step_px),
        -(-camera.height // step_px),
        camera.fx / step_px,
        camera.fy / step_px,
        camera.cx / step_px,
        camera.cy / step_px,
    )
