"""What can be rebuilt of a truth that is held back: the attack on what `publish --hold-back` shows.

PUBLIC is the part for everybody, TRUTH the part that scores. The views of each held-back object are
registered with each other: the height and the tilt of each camera are public, so a turn about the vertical
is searched, and ICP does the rest. The views then carve one solid. It is scored where the truth is known,
beside what one view gives. TRUTH gives the scores, and the poses of the bound that `publish` states.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
from figures import Figure, arguments, at_most, run, stated

from kinectbench.core.artefacts.targets import Target
from kinectbench.core.artefacts.views import ViewsFile
from kinectbench.core.geometry import (
    Camera,
    Grid,
    invert_rigid,
    rigid,
    rotation_angle_rad,
    rotation_from_quaternion_xyzw,
    transform_points,
)
from kinectbench.core.types import Float64
from kinectbench.core.voxels.pair_file import PairInput, read_input, read_pair
from kinectbench.release.publish.reconstruction_attack import (
    PosedView,
    every_fourth,
    read_posed_view,
    sampled_known_iou,
    solids,
)
from kinectbench.release.release import Release, open_release
from kinectbench.scoring.baselines.inputs import Inputs, up_in_grid
from kinectbench.scoring.baselines.registry import BASELINES

# Those of one view alone, and neither constant nor learnt.
SINGLE = ("partial", "hull", "carved-hull", "mirror", "silhouette")
# A single view's best plus this is what an attack on an isolated object may reach.
MARGIN = 0.02
# Turns about the vertical that are tried, and the distances over which ICP joins points, coarse to fine: of
# the search, and of its best three.
TURNS, KEPT = 16, 3
SEARCH_M, REACHES_M = (0.15, 0.06), (0.05, 0.02)
# Points closer than this are one; of the background those within so many metres count.
COARSE_M, STEP_M = 0.03, 0.012
SCENE_M = 3.0
WAYS = ("object", "scene")


class View:
    """A public view: target, input, image, and its points in a world of its own with the floor at z = 0."""

    def __init__(self, release: Release, target: Target) -> None:
        self.target = target
        self.pair: PairInput = read_input(release.pair_path(target))
        folder = release.folder / "views" / target.recording
        row = next(r for r in ViewsFile.read(folder).views if r.view == target.view)
        assert row.K is not None and row.width is not None and row.height is not None
        K = row.K
        camera = Camera(row.width, row.height, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
        self.image = read_posed_view(folder, target.view, camera, self.pair.T_world_camera)
        points = transform_points(self.image.T_world_camera, camera.backproject(self.image.depth_m))
        valid = self.image.depth_m > 0
        near = valid & (self.image.depth_m < SCENE_M)
        of_object = points[valid & self.image.mask]
        self.clouds = {
            "coarse": _cloud(of_object, COARSE_M),
            "object": _cloud(of_object, STEP_M),
            "scene": _cloud(points[near], COARSE_M),
        }

    def grid(self, T_world_own: Float64) -> Grid:
        """The cube of its pair, where its own world lies in another."""
        return Grid(self.pair_grid.shape, self.pair.voxel_size_m, T_world_own @ self.pair.T_world_grid)

    @property
    def pair_grid(self) -> Grid:
        return Grid((256, 256, 256), self.pair.voxel_size_m, self.pair.T_world_grid)

    def posed(self, T_world_own: Float64) -> PosedView:
        return replace(self.image, T_world_camera=T_world_own @ self.image.T_world_camera)


def _cloud(points: Float64, step_m: float) -> Any:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud = cloud.voxel_down_sample(step_m)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(3 * step_m, 30))
    return cloud


def registered(source: View, target: View) -> dict[str, tuple[Float64, float]]:
    """By each way T_target_source of two views' own worlds, and how well it fits."""
    moved, still = source.clouds["coarse"], target.clouds["coarse"]
    middles = [np.asarray(cloud.get_axis_aligned_bounding_box().get_center()) for cloud in (moved, still)]
    tried = []
    for turn in np.arange(TURNS) * 2 * np.pi / TURNS:
        rotation = rotation_from_quaternion_xyzw([0, 0, np.sin(turn / 2), np.cos(turn / 2)])
        shift = middles[1] - rotation @ middles[0]
        T = _icp(moved, still, rigid(rotation, [*shift[:2], 0.0]), SEARCH_M)
        tried.append((_fit(source, target, T) + _fit(target, source, invert_rigid(T)), T))
    tried.sort(key=lambda found: -found[0])
    best = dict.fromkeys(WAYS, (np.eye(4), -np.inf))
    for _, start in tried[:KEPT]:
        T = _icp(source.clouds["object"], target.clouds["object"], start, REACHES_M)
        for way in WAYS:
            if way == "scene":
                T = _icp(source.clouds["scene"], target.clouds["scene"], T, REACHES_M)
            fit = _fit(source, target, T) + _fit(target, source, invert_rigid(T))
            best[way] = max(best[way], (T, fit), key=lambda found: found[1])
    return best


def _icp(moved: Any, still: Any, T: Float64, reaches_m: Sequence[float]) -> Float64:
    pipeline = o3d.pipelines.registration
    most = pipeline.ICPConvergenceCriteria(max_iteration=12)
    for reach_m in reaches_m:
        to_plane = pipeline.TransformationEstimationPointToPlane()
        found = pipeline.registration_icp(moved, still, reach_m, T, to_plane, most)
        T = np.asarray(found.transformation)
    return T


def _fit(source: View, target: View, T: Float64) -> float:
    """Share of a view's object points on another's depth, less twice the share that contradicts it."""
    image = target.image
    points = transform_points(
        invert_rigid(image.T_world_camera) @ T, np.asarray(source.clouds["object"].points)
    )
    ahead = points[points[:, 2] > 0.1]
    column, row = np.rint(image.camera.project(ahead)).T.astype(int)
    inside = (column >= 0) & (column < image.camera.width) & (row >= 0) & (row < image.camera.height)
    column, row, z = column[inside], row[inside], ahead[inside, 2]
    depth_m, mask = image.depth_m[row, column], image.mask[row, column]
    on = mask & (depth_m > 0) & (np.abs(z - depth_m) < REACHES_M[-1])
    against = ((depth_m > 0) & (z < depth_m - REACHES_M[-1])) | (~mask & (z < depth_m + REACHES_M[-1]))
    return float((on.sum() - 2.0 * against.sum()) / max(1, len(points)))


Edges = list[tuple[int, int, dict[str, tuple[Float64, float]]]]


def edges_of(views: Sequence[View]) -> Edges:
    """Each two views, registered."""
    return [(i, j, registered(views[j], views[i])) for i, j in combinations(range(len(views)), 2)]


def poses(count: int, all_edges: Edges, way: str) -> list[Float64]:
    """Where each view's own world lies in that of the first, along the best-fitting registrations."""
    edges = [(ways[way][1], i, j, ways[way][0]) for i, j, ways in all_edges]
    found = {0: np.eye(4)}
    while len(found) < count:
        open_edges = [e for e in edges if (e[1] in found) != (e[2] in found)]
        _, i, j, T_ij = max(open_edges, key=lambda edge: edge[0])
        if i in found:
            found[j] = found[i] @ T_ij
        else:
            found[i] = found[j] @ invert_rigid(T_ij)
    return [found[index] for index in range(count)]


def ious(views: Sequence[View], placed: Sequence[Float64], truth: Release) -> Float64:
    """Mean IoU of each way to make a solid of posed views, in each view's own cube."""
    images = [view.posed(T) for view, T in zip(views, placed, strict=True)]
    rows = []
    for view, T in zip(views, placed, strict=True):
        pair = read_pair(truth.folder / view.target.file)
        rows.append([sampled_known_iou(solid, pair) for solid in solids(view.grid(T), images)])
    return np.asarray(np.mean(rows, axis=0))


def single(views: Sequence[View], release: Release, truth: Release) -> dict[str, float]:
    """Mean IoU of what each view gives alone: the baselines, and its own solid."""
    found: dict[str, list[float]] = {}
    for view in views:
        pair = read_pair(truth.folder / view.target.file)
        inputs = Inputs(view.pair, np.nan, up_in_grid(release, view.target, view.pair), None)
        for name in SINGLE:
            solid = every_fourth(BASELINES[name](inputs).astype(bool))
            found.setdefault(name, []).append(sampled_known_iou(solid, pair))
        own = solids(view.pair_grid, [view.image])
        for name, solid in zip(("carved", "hull of depth", "carved hull"), own, strict=True):
            found.setdefault(name, []).append(sampled_known_iou(solid, pair))
    return {name: float(np.mean(values)) for name, values in found.items()}


def errors(views: Sequence[View], placed: Sequence[Float64], truth: Release) -> tuple[float, float]:
    """Medians over the views: by how many degrees and mm a pose is off that of the first."""
    true = [read_pair(truth.folder / view.target.file).T_world_camera for view in views]
    at = [T @ view.image.T_world_camera for view, T in zip(views, placed, strict=True)]
    off = [
        invert_rigid(invert_rigid(true[0]) @ t) @ invert_rigid(at[0]) @ a
        for t, a in zip(true[1:], at[1:], strict=True)
    ]
    angles = [float(np.degrees(rotation_angle_rad(T[:3, :3]))) for T in off]
    shifts = [1000 * float(np.linalg.norm(T[:3, 3])) for T in off]
    return (float(np.median(angles)), float(np.median(shifts))) if off else (0.0, 0.0)


def true_poses(views: Sequence[View], truth: Release) -> list[Float64]:
    """Where each view's own world lies in the recording's, by the part that scores."""
    return [
        read_pair(truth.folder / view.target.file).T_world_camera @ invert_rigid(view.image.T_world_camera)
        for view in views
    ]


def attacked(name: str, views: Sequence[View], release: Release, truth: Release) -> Iterator[Figure]:
    """The figures of one object."""
    # A whole view, with its background and its floor, is what any attack is held against.
    alone = single([View(truth, view.target) for view in views], truth, truth)
    plain = max(SINGLE, key=lambda each: alone[each])
    yield stated(f"{name}: best baseline ({plain}), IoU", alone[plain])
    best = max(alone, key=lambda each: alone[each])
    yield stated(f"{name}: one view alone, best way ({best}), IoU", alone[best])
    found: dict[str, float] = {"one view": max(single(views, release, truth).values())}
    yield stated(f"{name}: public, one view alone, best way, IoU", found["one view"])
    one_recording = len({view.target.recording for view in views}) == 1
    if len(views) > 1:
        edges = edges_of(views)
        for way in WAYS:
            placed = poses(len(views), edges, way)
            found[way] = float(ious(views, placed, truth).max())
            if one_recording:
                angle, shift = errors(views, placed, truth)
                yield stated(f"{name}: ICP of the {way}, poses off, degrees and mm", [angle, shift])
            yield stated(f"{name}: ICP of the {way}, {len(views)} views, IoU", found[way])
        if one_recording:
            bound = float(ious(views, true_poses(views, truth), truth).max())
            yield stated(f"{name}: true poses, the bound, IoU", bound)
    strongest = max(found, key=lambda each: found[each])
    gain = found[strongest] - alone[best]
    words = f"{name}: strongest attack ({strongest}), IoU above one view"
    isolated = all(release.metadata.isolates(view.target.recording) for view in views)
    yield at_most(words, gain, MARGIN) if isolated else stated(words, gain)


def measured(public: Path, private: Path, most: int) -> Iterator[Figure]:
    """The figures of every held-back object."""
    release, truth = open_release(public), open_release(private)
    objects: dict[str, list[Target]] = {}
    for target in release.targets:
        if release.metadata.hides(target.recording):
            objects.setdefault(target.object, []).append(target)
    for name, targets in objects.items():
        yield from attacked(name, [View(release, target) for target in targets[:most]], release, truth)


def main() -> None:
    """Attack what is public."""
    parser: argparse.ArgumentParser = arguments(__doc__)
    parser.add_argument("public", type=Path, help="benchmark/, published with --hold-back")
    parser.add_argument("truth", type=Path, help="benchmark-private/")
    parser.add_argument("--views", type=int, default=12, help="of an object at most (default: 12)")
    options = parser.parse_args()
    run(options, lambda: list(measured(options.public, options.truth, options.views)))


if __name__ == "__main__":
    main()
