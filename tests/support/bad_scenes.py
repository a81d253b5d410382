"""Small analytic recordings with something wrong in them: a box on a floor, seen by 160 x 120 pixels."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from analytic_scenes import CAMERA, Surface, box, depth_of, plane, ring, sequence_of, trajectory_of
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera, OrientedBox, TriangleMesh
from kinectbench.core.sequence import Sequence
from kinectbench.core.types import Float64
from kinectbench.settings.models import FusionSettings, PairSettings, SegmentationSettings, ViewSettings
from kinectbench.stages.fuse import fuse
from kinectbench.stages.sample_views.views import Views, sample_views
from kinectbench.stages.segment.find.candidates import Candidates, find_candidates
from kinectbench.stages.segment.find.given import GivenObject
from kinectbench.stages.segment.find.hints import floor_hint
from kinectbench.stages.segment.find.object import Segmentation, find_floor_and_object
from kinectbench.stages.segment.judge.coverage_report import CoverageReport, coverage_report
from kinectbench.stages.segment.object_model import ObjectModel
from kinectbench.stages.segment.segment import segment
from kinectbench.stages.segment.solid.grids import object_grid
from kinectbench.stages.track import Trajectory

SMALL = Camera(160, 120, 131.25, 131.25, 79.5, 59.5)
FUSION = FusionSettings(voxel_size_m=0.01, scene_voxel_size_m=0.02)
SEGMENTATION = SegmentationSettings()
# Resolves gaps of a finger's breadth.
FINE: dict[str, Any] = {"camera": CAMERA, "fusion": FusionSettings(voxel_size_m=0.01, max_depth_m=2.2)}
FLOOR = plane((0, 0, 1), 0.0)
OBJECT = box((-0.2, -0.15, 0.0), (0.2, 0.15, 0.5))
AROUND = ring(24, 1.4, (0.0, 0.0, 0.25), (0.4, 0.7))


@dataclass(frozen=True)
class Recorded:
    """A recording and the surface fused from it."""

    sequence: Sequence
    trajectory: Trajectory
    scene: TriangleMesh

    def segment(self, given: OrientedBox | None = None, plane_world: Float64 | None = None) -> Segmentation:
        hint = floor_hint(
            self.sequence, self.trajectory, None if plane_world is None else plane_world.tolist()
        )
        return find_floor_and_object(self.scene, self.trajectory, given, SEGMENTATION, hint)

    def suggest(self) -> Candidates:
        hint = floor_hint(self.sequence, self.trajectory)
        return find_candidates(self.scene, self.trajectory, SEGMENTATION, hint)

    def coverage_report(self, given: OrientedBox | None = None) -> CoverageReport:
        return self.coverage_report_of(self.segment(given), given is not None)

    def coverage_report_of(
        self, chosen: Segmentation, given: bool = False, max_depth_m: float = 3.0, range_is_set: bool = True
    ) -> CoverageReport:
        assert FUSION.voxel_size_m is not None
        grid = object_grid(chosen.box, chosen.floor, FUSION.voxel_size_m, given=given)
        seen = (self.sequence, self.trajectory, self.scene, chosen, grid, max_depth_m)
        return coverage_report(*seen, range_is_set=range_is_set)

    def model(
        self,
        given: OrientedBox | None = None,
        fusion: FusionSettings = FUSION,
        floor: tuple[float, float, float, float] | None = None,
    ) -> ObjectModel:
        parts = (self.sequence, self.trajectory, self.scene)
        return segment(*parts, SEGMENTATION, fusion, GivenObject(given, floor))

    def views(self, model: ObjectModel) -> Views:
        settings = (ViewSettings(min_pixels=50), SEGMENTATION, PairSettings())
        return sample_views(self.sequence, self.trajectory, model, *settings)


def recorded(
    surfaces: list[Surface],
    poses: NDArray[np.float64] = AROUND,
    passing: dict[int, list[Surface]] | None = None,
    camera: Camera = SMALL,
    fusion: FusionSettings = FUSION,
) -> Recorded:
    """Record surfaces, with more of them in some frames, and fuse the frames."""
    depths_m = [
        depth_of([*surfaces, *(passing or {}).get(k, [])], camera, pose) for k, pose in enumerate(poses)
    ]
    sequence, trajectory = sequence_of(depths_m, camera, poses), trajectory_of(poses)
    return Recorded(sequence, trajectory, fuse(sequence, trajectory, fusion).mesh)


def table_of(low: tuple[float, float, float], high: tuple[float, float, float]) -> list[Surface]:
    """A table that fills a box: a top of 60 mm, and a panel below its edge at the largest x."""
    return [
        box((low[0], low[1], high[2] - 0.06), high),
        box((high[0] - 0.06, low[1], low[2]), high),
    ]
