"""Fusion beside Open3D's VoxelBlockGrid: the same frames in turns, CPU time of all threads."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from figures import Figure, at_least, stated
from fusion_scans import SETTINGS, VOXEL_M, at_object_scale, object_figures
from numpy.typing import NDArray
from tracking_recordings import true_poses

from kinectbench.core.geometry import TriangleMesh, invert_rigid
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float64
from kinectbench.lab.simulate.truth import Truth
from kinectbench.stages.fuse.blocks import BlockVolume, empty_volume, unique_blocks
from kinectbench.stages.fuse.integrate import BATCH_FRAMES, DepthFrame, integrate
from kinectbench.stages.fuse.mesh import color_vertices, extract_mesh
from kinectbench.stages.fuse.reconstruction import usable_depth_m
from kinectbench.stages.fuse.visible_blocks import blocks_near_surface

STRIDE = 5
DEPTH_BAR, COLOR_BAR = 8.0, 4.0
# As its examples have it.
RIVAL_BLOCK_VOXELS = 16
TRUNCATION_VOXELS = SETTINGS.truncation_voxels


class VoxelBlockGrid:
    """Open3D's integration as its own examples do it; half a pixel is added, without which it is biased."""

    def __init__(self, sequence: Sequence, *, with_color: bool) -> None:
        import open3d as o3d

        self._o3d, self._with_color = o3d, with_color
        K = sequence.camera.K
        self._K_blocks = o3d.core.Tensor.from_numpy(K.copy())
        K[:2, 2] += 0.5
        self._K = o3d.core.Tensor.from_numpy(K)
        names = ("tsdf", "weight", "color") if with_color else ("tsdf", "weight")
        sizes = ((1), (1), (3)) if with_color else ((1), (1))
        self._grid: Any = o3d.t.geometry.VoxelBlockGrid(
            names, (o3d.core.float32,) * len(names), sizes, VOXEL_M, RIVAL_BLOCK_VOXELS, 8000
        )

    def integrate(
        self, depth_m: NDArray[np.float32], color: NDArray[np.float32] | None, T_world_camera: Float64
    ) -> None:
        """Fuse a frame, colour in [0, 1]."""
        tensor, image = self._o3d.core.Tensor.from_numpy, self._o3d.t.geometry.Image
        depth, extrinsic = image(tensor(depth_m[..., None])), tensor(invert_rigid(T_world_camera))
        ranges = (1.0, SETTINGS.max_depth_m, TRUNCATION_VOXELS)
        blocks = self._grid.compute_unique_block_coordinates(depth, self._K_blocks, extrinsic, *ranges)
        if color is None:
            self._grid.integrate(blocks, depth, self._K, extrinsic, *ranges)
        else:
            self._grid.integrate(blocks, depth, image(tensor(color)), self._K, self._K, extrinsic, *ranges)

    def mesh(self) -> TriangleMesh:
        """What it extracts with its own threshold of three frames."""
        mesh = self._grid.extract_triangle_mesh(weight_threshold=3.0)
        faces = mesh.triangle.indices.numpy().astype(np.int32)
        return TriangleMesh(mesh.vertex.positions.numpy().astype(np.float64), faces)


@dataclass
class Clock:
    """CPU seconds of each rival, summed up."""

    spent_s: dict[str, float] = field(default_factory=dict)

    def run(self, name: str, work: Callable[[], Any]) -> Any:
        """Do some work on a rival's account."""
        started = time.process_time()
        result = work()
        self.spent_s[name] = self.spent_s.get(name, 0.0) + time.process_time() - started
        return result

    def ratio(self, rival: str, *ours: str) -> float:
        """How many times our time a rival takes."""
        return self.spent_s[rival] / sum(self.spent_s[name] for name in ours)


def speed_figures(sequence: Sequence, truth: Truth) -> list[Figure]:
    """Fuse every fifth frame in a 2 m cube at 5 mm; images are in memory for all.

    Ours counts the search for blocks, which the rival does too, and, with colour, colouring the vertices
    from frames that are read and decoded for it. Each voxel of ours gets free-space votes from every frame
    that sees it; the rival visits only the blocks where a frame has a surface.
    """
    cube = at_object_scale(sequence, truth)
    T_world_camera = true_poses(sequence)
    frames = range(0, len(sequence), STRIDE)
    depths_m = [usable_depth_m(cube, index, SETTINGS) for index in frames]
    truncation_m = TRUNCATION_VOXELS * VOXEL_M
    found = [
        blocks_near_surface(depth_m, sequence.camera, T_world_camera[index], truncation_m, VOXEL_M)
        for depth_m, index in zip(depths_m, frames, strict=True)
    ]
    volume = empty_volume(unique_blocks(np.concatenate(found).astype(np.int64)), VOXEL_M, np.eye(4))
    plain, colored = (VoxelBlockGrid(sequence, with_color=with_color) for with_color in (False, True))
    clock = Clock()
    posed = [DepthFrame(d, T_world_camera[i], 0.0, 0.0) for d, i in zip(depths_m, frames, strict=True)]
    _warm_up(sequence, volume, posed[0], truncation_m)
    for start in range(0, len(posed), BATCH_FRAMES):
        batch = posed[start : start + BATCH_FRAMES]
        colors = [_color(sequence, index) for index in frames[start : start + BATCH_FRAMES]]

        def ours(batch: list[DepthFrame] = batch) -> None:
            for f in batch:
                blocks_near_surface(f.depth_m, sequence.camera, f.T_world_camera, truncation_m, VOXEL_M)
            integrate(volume, batch, sequence.camera, truncation_m)

        clock.run("ours", ours)
        clock.run("rival", lambda b=batch: [plain.integrate(f.depth_m, None, f.T_world_camera) for f in b])
        clock.run("rival, colour", lambda b=batch, c=colors: [
            colored.integrate(f.depth_m, color, f.T_world_camera) for f, color in zip(b, c, strict=True)
        ])  # fmt: skip
    mesh = extract_mesh(volume, min_weight=1e-3)
    clock.run("our colour", lambda: color_vertices(mesh, sequence, _trajectory(sequence, STRIDE)))
    errors = {"ours": object_figures(mesh, truth), "VoxelBlockGrid": object_figures(plain.mesh(), truth)}
    return [
        stated("frames", len(depths_m)),
        *(stated(f"{name}, CPU ms a frame", 1000 * s / len(depths_m)) for name, s in clock.spent_s.items()),
        at_least("VoxelBlockGrid / ours, depth only", clock.ratio("rival", "ours"), DEPTH_BAR),
        at_least("VoxelBlockGrid / ours, with colour",
                 clock.ratio("rival, colour", "ours", "our colour"), COLOR_BAR),
        *(stated(f"{name}: F at 5 mm, mean error mm",
               [e.visible.scores[0].f, 1000 * e.visible.accuracy.mean_m if e.visible.accuracy else None])
          for name, e in errors.items()),
    ]  # fmt: skip


def _warm_up(sequence: Sequence, volume: BlockVolume, frame: DepthFrame, truncation_m: float) -> None:
    """What is compiled or set up at a first call is none of the clock's business."""
    warm_up = empty_volume(volume.blocks, VOXEL_M, np.eye(4))
    integrate(warm_up, [frame], sequence.camera, truncation_m)
    color_vertices(extract_mesh(warm_up, 0.0), sequence, _trajectory(sequence, STRIDE * 100))
    for color in (None, _color(sequence, 0)):
        VoxelBlockGrid(sequence, with_color=color is not None).integrate(
            frame.depth_m, color, frame.T_world_camera
        )


def _color(sequence: Sequence, index: int) -> NDArray[np.float32]:
    """Colour in [0, 1]."""
    color_rgb = sequence.color_rgb(index)
    assert color_rgb is not None
    return color_rgb.astype(np.float32) / 255


def _trajectory(sequence: Sequence, stride: int) -> Trajectory:
    """True poses of every n-th frame."""
    poses = true_poses(sequence)
    poses[np.arange(len(poses)) % stride > 0] = np.nan
    return Trajectory(sequence.stamps_ns, poses, "trust")
