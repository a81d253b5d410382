"""reference.json beside an object: how it compares with meshes that somebody else measured or modelled."""

from collections.abc import Sequence
from pathlib import PurePosixPath
from typing import Any, ClassVar, Literal, Self

from pydantic import Field

from kinectbench.core.artefacts.object import Triple
from kinectbench.core.artefacts.stored import DegreesInFile, Matrix4, ScaledPart, Stored, StoredPart, optional

MESH = "name of the mesh's file"
MESH_PATH = "path of the mesh, as given; of an absolute one the last folder and the file name"
REFUSED = "why the mesh is taken for another object's; null: it fits"
F_5MM = "F-score at 5 mm over measured surface and free space"
F_10MM = "F-score at 10 mm over measured surface and free space"
ITSELF = "true: the mesh is this truth itself, so that figures compare it with itself; missing: it is not"
IOU = "IoU of the solids, where the truth is known; null: the mesh is open"


class RunnerUpPart(ScaledPart):
    """The second-best pose of the reference mesh, after the chosen one."""

    residual_m: float = Field(alias="residual_m", description="its residual, metres")
    turn_rad: DegreesInFile = Field(description="angle from the chosen pose to it, degrees")
    axis_floor: Triple = Field(description="axis of that turn, unit vector, floor frame")
    fits_as_well: bool = Field(description="whether measurements cannot distinguish the two")


class DirectionPart(StoredPart):
    """Distances from the measured surface to the reference mesh, over faces that point one way."""

    share: float = Field(description="share of the measured surface that faces this way")
    mean_m: float | None = Field(description="mean signed distance, > 0: the truth is too far out; metres")
    absolute_m: float | None = Field(description="mean absolute distance, metres")


class DirectionsPart(StoredPart):
    """Distances to the reference mesh for faces that point up or down (within 45 degrees) or sideways."""

    up: DirectionPart = Field(description="distances of faces that look up")
    down: DirectionPart = Field(description="distances of faces that look down")
    side: DirectionPart = Field(description="distances of other faces")


class ReferenceInfo(StoredPart):
    """What a release says of a recording's reference."""

    reference: str = Field(description=MESH)
    sha256: str = Field(description="SHA-256 of its bytes")
    refused: str | None = Field(description=REFUSED)
    f_score_5mm: float | None = optional(F_5MM)
    f_score_10mm: float | None = optional(F_10MM)
    iou: float | None = optional(IOU)
    itself: Literal[True] | None = optional(ITSELF)


class ComparedMesh(StoredPart):
    """The comparison of an object with one mesh: pose, scores, and distances of the surfaces."""

    reference: str = Field(description=MESH_PATH)
    sha256: str = Field(description="SHA-256 of its bytes")
    refused: str | None = Field(description=REFUSED)
    itself: Literal[True] | None = optional(ITSELF)
    closed: bool = Field(description="whether every edge has two faces")
    T_world_reference: Matrix4 | None = optional(
        "(4, 4), metres: from the reference to the trajectory's world; null: not searched"
    )
    residual_m: float | None = optional(
        "mean distance both ways where the object was measured, each cut at 5 % of the diagonal; metres"
    )
    scale: float | None = optional("factor by which the mesh would fit best")
    mirrored_m: float | None = optional("`residual_m` of its mirror image")
    mirror_fits_as_well: Literal[True] | None = optional(
        "true: measurements cannot distinguish the mesh from its mirror image; missing: they can"
    )
    runner_up: RunnerUpPart | None = optional("next best pose, with less than three times the residual")
    symmetric_axis_floor: Triple | None = optional(
        "axis of its rotational symmetry, unit vector, floor frame; null: it has none"
    )
    f_score_5mm: float | None = optional(F_5MM)
    f_score_10mm: float | None = optional(F_10MM)
    iou: float | None = optional(IOU)
    whole_iou: float | None = optional("IoU including unknown voxels")
    directions: DirectionsPart | None = optional("distances of the measured surface, by direction")

    @property
    def info(self) -> ReferenceInfo:
        """The part of the comparison that a release publishes, with the mesh's file name only."""
        keys = [key for key in ReferenceInfo.model_fields if key != "itself" or self.itself]
        values = {key: getattr(self, key) for key in keys}
        # A release does not say where its maker keeps the mesh.
        return ReferenceInfo(**(values | {"reference": PurePosixPath(self.reference).name}))


class ReferenceFile(Stored, ComparedMesh):
    """build/<recording>/reference.json: the comparison with the mesh accepted last, and `others`.

    Without an accepted mesh, the first comparison is with a mesh that is the truth itself, or was refused.
    """

    FILE: ClassVar[str] = "reference.json"
    ADVICE: ClassVar[str] = "`kinectbench compare-truth` makes it again"

    format_version: Literal[1] = Field(1, description="version of this file's format")
    object_fingerprint: str = Field(description="fingerprint of the object that was compared")
    others: tuple[ComparedMesh, ...] = Field(
        (), description="other meshes compared with this object: accepted first, then the newest first"
    )

    @property
    def all(self) -> tuple[ComparedMesh, ...]:
        """All comparisons; the one at the top level of the file comes first."""
        return (self, *self.others)

    @classmethod
    def of(cls, compared: Sequence[ComparedMesh], object_fingerprint: str) -> Self:
        """Make the file from comparisons of one object with meshes, the latest first.

        The latest accepted one comes to the top level of the file, the others into `others`.
        """
        first, *others = sorted(compared, key=lambda each: (each.refused is not None, bool(each.itself)))
        values = given(first) | {"object_fingerprint": object_fingerprint}
        return cls(**(values | {"others": tuple(others)} if others else values))

    def with_new(self, new: ComparedMesh) -> Self:
        """Return the file with another comparison, which replaces an earlier one of the same mesh."""
        earlier = [
            ComparedMesh(**{key: value for key, value in given(each).items() if key not in OF_FILE})
            for each in self.all
            if each.sha256 != new.sha256
        ]
        return type(self).of([new, *earlier], self.object_fingerprint)


# What only the whole file has.
OF_FILE = ReferenceFile.model_fields.keys() - ComparedMesh.model_fields.keys()


def given(part: ComparedMesh) -> dict[str, Any]:
    """Return the fields of a comparison that were set when it was made, without those left at defaults."""
    return {key: getattr(part, key) for key in part.model_fields_set}
