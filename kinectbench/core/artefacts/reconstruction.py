"""reconstruction.json of `build/<recording>/reconstruction/`: the depth range of the fusion, and warnings.

mesh.ply beside it is binary PLY (`core.geometry.mesh`); volume.npz belongs to the stage `fuse`.
"""

from typing import ClassVar, Literal

from pydantic import Field

from kinectbench.core.artefacts.stored import Stored, StoredPart


class DepthRangePart(StoredPart):
    """The largest depth that is fused into the scene, the reason, and the share of depth beyond it."""

    max_depth_m: float = Field(description="largest depth fused, metres")
    chosen_by: Literal["recording", "setting"] = Field(
        description="setting: benchmark.yaml has fusion.max_depth_m"
    )
    looked_at_m: float | None = Field(
        description="distance from the cameras to what they look at, along their axes, metres; null: neither "
        "poses nor depth show it"
    )
    reach_m: float | None = Field(
        description="largest depth it may extend to: the far side of a ball around it that fills the view, "
        "metres"
    )
    beyond_share: float = Field(description="share of depth beyond max_depth_m")
    missed_share: float = Field(
        description="share of depth in the middle of the images beyond max_depth_m, but within reach_m"
    )


class ReconstructionFile(Stored):
    """reconstruction.json: the depth range and the warnings of the fused scene."""

    FILE: ClassVar[str] = "reconstruction.json"

    format_version: Literal[1] = Field(1, description="version of this file's format")
    depth_range: DepthRangePart = Field(description="depth range that was fused")
    warnings: tuple[str, ...] = Field((), description="what people should know, one line each")
