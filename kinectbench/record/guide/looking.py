"""Make a coarse reconstruction of the part of the object seen so far, from the guide's keyframes.

This module uses the functions of a build (`fuse`, `find_floor_and_object`, `classify_voxels`, `make_solid`,
`find_frontiers`), with fewer and smaller frames, and larger voxels.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.even_choice import evenly
from kinectbench.core.geometry import OrientedBox, TriangleMesh, decimated, invert_rigid, on_so3
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.compare import has_pose
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float64, Int64
from kinectbench.settings.models import FloorCuts, FusionSettings
from kinectbench.stages.fuse import fuse, observe
from kinectbench.stages.segment.find.hints import floor_hint
from kinectbench.stages.segment.find.object import find_floor_and_object
from kinectbench.stages.segment.judge.frontiers import Frontier, find_frontiers
from kinectbench.stages.segment.solid.evidence import Rules, classify_voxels
from kinectbench.stages.segment.solid.grids import blurred_height_m, floor_layers, object_grid
from kinectbench.stages.segment.solid.solid import SolidShape, make_solid
from kinectbench.stages.track.frame_maps import STORED_PER_M, MapCache, stored_depth
from kinectbench.stages.track.keyframe_graph import KeyframeGraph

# Number of voxels along the object's longest edge: an opening of a twentieth of it is two voxels wide.
VOXELS_ALONG, FINEST_M = 40, 0.006
# How many keyframes are fused at most, spread over the path: 60 take 2 s beside the tracker on one core.
MOST_KEYFRAMES = 60
LEAST_KEYFRAMES = 3
# Triangles that the page draws. 30,000 take 65 ms of software rendering (912x688 pixels, Chromium beside ten
# other processes on two cores), 100,000 take 190 ms, 500,000 take 962 ms. Reducing 500,000 to 30,000 takes
# half a second.
SHOWN_TRIANGLES = 30_000
FUSION, CUTS = FusionSettings(scene_voxel_size_m=0.015), FloorCuts()


@dataclass(frozen=True)
class ObjectLook:
    """A coarse reconstruction of the object from the keyframes so far.

    Attributes:
        T_floor_world: (4, 4), world to frame `floor`: z up, floor at z = 0.
        box: box around the object, floor frame.
        mesh: the object and its surroundings, floor frame.
        frontiers: openings to unseen space, which no keyframe looked into, the largest first.
        unknown_share: volume that no frame saw, though a camera could from the side or from above, as a share
            of the solid's.
        floor_cut_m: surface nearer to the floor than this counts as floor, metres. It is smaller if the
            cameras are near.
    """

    T_floor_world: Float64
    box: OrientedBox
    mesh: TriangleMesh
    frontiers: tuple[Frontier, ...]
    unknown_share: float
    floor_cut_m: float

    def moved(self, T_world_before: Float64 | None) -> "ObjectLook | None":
        """Return this reconstruction in a new world; None if `T_world_before` is None.

        `T_world_before` (4, 4) maps the old world to the new one.
        """
        if T_world_before is None:
            return None
        return replace(self, T_floor_world=on_so3(self.T_floor_world @ invert_rigid(T_world_before)))


class _Depths:
    """The depth images of the keyframes, as the frames of a `Sequence`."""

    def __init__(self, maps: MapCache, keyframes: Int64) -> None:
        self._maps, self._keyframes = maps, keyframes

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        return stored_depth(self._maps[int(self._keyframes[index])][0].depth_m)

    def color_encoded(self, index: int) -> None:
        return None


def look(maps: MapCache, graph: KeyframeGraph, picked_world: Float64 | None = None) -> ObjectLook:
    """Reconstruct the object from the keyframes, and find openings that no keyframe looked into.

    Args:
        maps: calibrated depth maps of the keyframes.
        graph: the keyframes' poses; at least `LEAST_KEYFRAMES`.
        picked_world: (3,) a point on the object; None: the object is what the cameras look at.

    Raises:
        SegmentationError: there is no floor, or no object where the cameras look.
        ShapeError, TrackingError: too little was seen.
    """
    rows = np.flatnonzero(has_pose(graph.T_world))
    rows = rows[evenly(len(rows), MOST_KEYFRAMES)]
    keyframes, poses = np.array(graph.keyframes)[rows], graph.T_world[rows]
    stamps_ns, store = maps.sequence.stamps_ns[keyframes], _Depths(maps, keyframes)
    sequence = Sequence(maps[int(keyframes[0])][0].camera, STORED_PER_M, stamps_ns, False, None, store)
    trajectory = Trajectory(stamps_ns, poses, "tracked")
    hint = floor_hint(sequence, trajectory, None, picked_world)
    scene = fuse(sequence, trajectory, FUSION).mesh
    found = find_floor_and_object(scene, trajectory, None, CUTS, hint)
    voxel_size_m = max(max(found.box.size_m) / VOXELS_ALONG, FINEST_M)
    grid = object_grid(found.box, found.floor, voxel_size_m)
    blurred_m = blurred_height_m(maps.sequence.camera, trajectory, grid)
    rules = Rules(floor_layers(found.floor, CUTS, voxel_size_m), blurred_m=blurred_m)
    seen = observe(sequence, trajectory, range(len(rows)), grid, FUSION)
    evidence = classify_voxels(seen, found.neighbours(grid), rules, roughly=True)
    solid = make_solid(seen, evidence, rules)
    T_floor_world = found.floor.T_floor_world
    frontiers = find_frontiers(solid, evidence, rules.limits, T_floor_world @ grid.T_world_grid)
    mesh = _around(scene, T_floor_world, found.box)
    unknown_share = _unknown_share(solid)
    return ObjectLook(T_floor_world, found.box, mesh, frontiers, unknown_share, found.floor.cut_m(CUTS))


def _unknown_share(shape: SolidShape) -> float:
    unknown = (shape.labels == Label.UNKNOWN) & ~shape.underside
    return int(unknown.sum()) / max(1, int(shape.solid.sum()))


def _around(scene: TriangleMesh, T_floor_world: Float64, box: OrientedBox) -> TriangleMesh:
    """Return the decimated scene around the object's box, out to half its size, in the floor frame."""
    mesh = scene.transformed(T_floor_world)
    near = box.grown(0.5 * max(box.size_m)).contains(mesh.vertices)
    return decimated(mesh.keep_faces(np.asarray(near[mesh.faces].all(axis=1))), SHOWN_TRIANGLES)
