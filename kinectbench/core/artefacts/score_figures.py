"""The values in scores.json: metrics, their context, rows of pairs, and averages.

Each metric is declared once, as a field of `VoxelMetrics` or `SurfaceMetrics`, with its meaning, unit, range,
and whether more is better. Rows, averages, the JSON schema and the page's tables are made from these fields.

A dataclass takes fields from its last base first, which determines the order of the keys in the file.
"""

from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, JsonValue
from pydantic.dataclasses import dataclass
from pydantic.fields import FieldInfo

from kinectbench.core.artefacts.stored import optional

IN_UNIT_RANGE: dict[str, JsonValue] = {"minimum": 0, "maximum": 1}
SHARE: dict[str, JsonValue] = {**IN_UNIT_RANGE, "better": "higher"}
UnitRange = Annotated[float, Field(json_schema_extra=IN_UNIT_RANGE)]
# How what has no inside can be made solid.
CLOSINGS = ("winding", "poisson")
Closing = Annotated[str | None, Field(json_schema_extra={"enum": [*CLOSINGS, None]})]
OptionalUnitRange = Annotated[float | None, Field(json_schema_extra=IN_UNIT_RANGE)]

# Protocols of predictions in the camera frame.
IN_SPACE = ("camera", "aligned")
# The part of a shape in a row: all, seen by the view, or the rest.
ShapePart = Literal["whole", "visible", "occluded"]
# Rows and averages are dataclasses: of a hundred thousand rows, models would take twice the memory.
FINITE = ConfigDict(allow_inf_nan=False)


def _share(heading: str | None, meaning: str) -> Any:
    """Declare a metric in [0, 1] where higher is better; without a heading, the page does not show it."""
    return Field(None, title=heading, description=meaning, json_schema_extra=SHARE)


def _loss(heading: str | None, meaning: str, unit: str) -> Any:
    """Declare a metric >= 0 in `unit`, without upper bound, where lower values are better; see `_share`."""
    extra: dict[str, JsonValue] = {"minimum": 0, "unit": unit, "better": "lower"}
    return Field(None, title=heading, description=meaning, json_schema_extra=extra)


@dataclass(frozen=True, config=FINITE)
class VoxelMetrics:
    """Metrics of voxels; precision, recall, F1 and IoU are computed at the row's threshold."""

    iou: float | None = _share("IoU", "intersection over union")
    ce: float | None = _loss("CE", "mean cross-entropy", "nats a voxel")
    precision: float | None = _share("precision", "share of the predicted voxels that are occupied")
    recall: float | None = _share("recall", "share of the occupied voxels that are predicted")
    f1: float | None = _share("F1", "harmonic mean of precision and recall")


@dataclass(frozen=True, config=FINITE)
class SurfaceMetrics:
    """Metrics of surfaces; None for a metric that was not requested, or that the row's protocol lacks.

    Predicted grids are binarised at the row's threshold; predictions in the camera frame have no threshold.
    """

    chamfer_mm: float | None = _loss(
        "Chamfer, mm", "mean of the mean distances from each surface to the other", "mm"
    )
    f_score_1pct: float | None = _share("F-score 1 %", "F-score at 1 % of the diagonal of the shape's box")
    f_score_2pct: float | None = _share(None, "F-score at 2 % of the diagonal of the shape's box")
    f_score_10mm: float | None = _share(None, "F-score at 10 mm")
    f_score_20mm: float | None = _share(None, "F-score at 20 mm")
    surface_dice: float | None = _share(
        "surface Dice", "share of both surfaces within 2 sigma of the truth's surface of each other"
    )
    normal_consistency: float | None = _share(
        "normals", "mean |cosine| between the normals of nearest cells, both ways"
    )
    chamfer_l1_m: float | None = _loss(
        "Chamfer L1, m", "half of the mean distances both ways; of predictions in the camera frame", "m"
    )
    chamfer_l2_m2: float | None = _loss(
        None, "half of the mean squared distances both ways; of predictions in the camera frame", "m^2"
    )
    f_score_5mm: float | None = _share(None, "F-score at 5 mm; of predictions in the camera frame")
    f_score_5pct: float | None = _share(
        None, "F-score at 5 % of the diagonal of the shape's box; of predictions in the camera frame"
    )


def any_in_space(protocols: Iterable[str]) -> bool:
    """Whether any of the protocols scores predictions in the camera frame, which have no thresholds."""
    return any(protocol in IN_SPACE for protocol in protocols)


def fields_of(kind: type) -> dict[str, FieldInfo]:
    """Return {name: pydantic field} of a pydantic dataclass, in the order of its file."""
    fields: dict[str, FieldInfo] = vars(kind)["__pydantic_fields__"]
    return fields


VOXEL_METRICS = tuple(fields_of(VoxelMetrics))
SURFACE_METRICS = tuple(fields_of(SurfaceMetrics))
METRICS = (*VOXEL_METRICS, *SURFACE_METRICS)
# Metrics in [0, 1], higher is better; for all others lower is better.
SHARES = frozenset(
    name
    for kind in (VoxelMetrics, SurfaceMetrics)
    for name, field in fields_of(kind).items()
    if field.json_schema_extra == SHARE
)


@dataclass(frozen=True, config=FINITE)
class Context:
    """Values needed to interpret the metrics of a pair, or their averages."""

    base_rate_ce: Annotated[float | None, Field(json_schema_extra={"minimum": 0})] = optional(
        "cross-entropy of the category's base-rate constant, nats a voxel"
    )
    coverage_voxels: OptionalUnitRange = optional("share of the 256^3 voxels that the protocol counts")
    coverage_shape: OptionalUnitRange = optional("share of the shape's voxels that the protocol counts")


@dataclass(frozen=True, config=FINITE)
class ScoredPair:
    """The pair of a row, and how it was scored."""

    recording: str = Field(description="id of the recording")
    object: str = Field(description="the thing recorded")
    view: str = Field(description="zero-padded index", json_schema_extra={"pattern": "^[0-9]{3,6}$"})
    category: str = Field(description='such as "chair"')
    protocol: str = Field(
        description="which voxels are counted",
        json_schema_extra={
            "enum": ["paper", "known", "occluded", "measured", "known-unsaid", "shell", "camera", "aligned"]
        },
    )
    threshold: UnitRange = Field(description="value above which a voxel is predicted occupied")


@dataclass(frozen=True, config=FINITE)
class Resolution:
    """The resolution of a prediction, and the best IoU that it allows."""

    cells: int = Field(
        default=256,
        description="prediction's cells per side; 0: missing, scored as empty",
        json_schema_extra={"minimum": 0, "maximum": 512},
    )
    ceiling_iou: UnitRange = Field(
        default=1.0, description="IoU of the truth with itself, reduced to `cells` and enlarged again"
    )


@dataclass(frozen=True, config=FINITE)
class Unknown:
    """The share of a pair's true shape that is unknown; it does not depend on the protocol."""

    unknown_share: OptionalUnitRange = optional("unknown share of the true shape")


@dataclass(frozen=True, config=FINITE)
class Alignment:
    """How a prediction was registered to the truth before it was scored; docs/scoring-in-space.md."""

    kind: str = Field(
        description="what the registration could change: t shift, s scale, R rotation",
        json_schema_extra={"enum": ["t", "t+s", "R+t+s"]},
    )
    scale: Annotated[float, Field(json_schema_extra={"minimum": 0})] = Field(
        description="factor by which the prediction was enlarged"
    )
    rotation_deg: Annotated[float, Field(json_schema_extra={"minimum": 0, "maximum": 180})] = Field(
        description="angle by which it was turned, degrees"
    )
    translation_m: Annotated[float, Field(json_schema_extra={"minimum": 0})] = Field(
        description="length by which the middle of its surface was shifted, metres"
    )
    ok: bool = Field(description="whether the registration converged; the row counts all the same")


@dataclass(frozen=True, config=FINITE)
class Hypotheses:
    """How several predictions of one view are combined in one row."""

    k: Annotated[int, Field(json_schema_extra={"minimum": 2})] = Field(description="number of predictions")
    of: str = Field(
        description="best: the prediction of least Chamfer distance; mean: mean of each figure",
        json_schema_extra={"enum": ["best", "mean"]},
    )


@dataclass(frozen=True, config=FINITE)
class Ceiling:
    """The scores of a perfect prediction, limited by the truth's uncertainty; docs/scoring-in-space.md."""

    chamfer_l1_m: float | None = _loss(None, "expected `chamfer_l1_m` of a perfect prediction", "m")
    chamfer_l2_m2: float | None = _loss(None, "expected `chamfer_l2_m2` of a perfect prediction", "m^2")
    f_score_5mm: float | None = _share(None, "expected `f_score_5mm` of a perfect prediction")
    f_score_10mm: float | None = _share(None, "expected `f_score_10mm` of a perfect prediction")
    f_score_20mm: float | None = _share(None, "expected `f_score_20mm` of a perfect prediction")
    f_score_1pct: float | None = _share(None, "expected `f_score_1pct` of a perfect prediction")
    f_score_2pct: float | None = _share(None, "expected `f_score_2pct` of a perfect prediction")
    f_score_5pct: float | None = _share(None, "expected `f_score_5pct` of a perfect prediction")
    iou: float | None = _share(
        None, "expected `iou` of a perfect prediction, from the part's known volume and surface"
    )


@dataclass(frozen=True, config=FINITE)
class AsPapers:
    """Figures by the constants of other papers' code; docs/scoring-in-space.md lists the differences."""

    octmae_chamfer_l1_mm: float | None = _loss(
        "CD-L1 as OctMAE, mm", "half the sum of the mean distances both ways", "mm"
    )
    octmae_chamfer_l2_mm2: float | None = _loss(
        None, "half the sum of the mean squared distances both ways", "mm^2"
    )
    octmae_f_5mm: float | None = _share(None, "F-score at 5 mm")
    octmae_f_10mm: float | None = _share("F 10 mm as OctMAE", "F-score at 10 mm")
    octmae_f_20mm: float | None = _share(None, "F-score at 20 mm")
    octmae_f_30mm: float | None = _share(None, "F-score at 30 mm")
    pcn_chamfer_l1: float | None = _loss(
        "CD-L1 as PCN",
        "half the sum of the mean distances both ways, in diagonals of the truth's box, x 1000",
        "1",
    )
    pcn_chamfer_l2: float | None = _loss(
        None, "sum of the mean squared distances both ways, in diagonals of the truth's box, x 1000", "1"
    )
    pcn_f: float | None = _share("F as PCN", "F-score at 0.01 diagonals of the truth's box")
    sds_chamfer_l1_mm: float | None = _loss(
        "CD-L1 as SDS, mm", "half the sum of the mean distances both ways", "mm"
    )
    sds_chamfer_l2_mm2: float | None = _loss(None, "sum of the mean squared distances both ways", "mm^2")
    sds_emd_mm: float | None = _loss(
        "EMD as SDS, mm", "earth mover's distance, where the truth is an open mesh", "mm"
    )


@dataclass(frozen=True, config=FINITE)
class Calibration:
    """How often the truth is solid where a share of several predictions is; docs/scoring-in-space.md."""

    error: UnitRange = Field(description="expected calibration error: mean of |said - true| over the cells")
    cells: tuple[int, ...] = Field(
        description="number of known cells, by tenth of the share of predictions that call them solid; cells "
        "that none calls solid are left out",
        json_schema_extra={"minItems": 10, "maxItems": 10},
    )
    said: tuple[float | None, ...] = Field(
        description="mean share of predictions that call these cells solid, by tenth",
        json_schema_extra={"minItems": 10, "maxItems": 10},
    )
    true: tuple[float | None, ...] = Field(
        description="share of these cells that are solid in the truth, by tenth",
        json_schema_extra={"minItems": 10, "maxItems": 10},
    )


@dataclass(frozen=True, config=FINITE)
class InSpace:
    """Values that only rows of the protocols `camera` and `aligned` have."""

    part: ShapePart | None = optional("part of the shape scored, under `camera` and `aligned`")
    alignment: Alignment | None = optional("registration, under `aligned`")
    hypotheses: Hypotheses | None = optional("several predictions in one row; null: the first or only one")
    solid: bool | None = optional("whether the prediction has an inside: closed mesh, voxels or distances")
    predicted_unknown_share: OptionalUnitRange = optional(
        "share of the predicted surface left out in unknown space"
    )
    surface_unknown_share: OptionalUnitRange = optional(
        "share of the part's true surface left out as unknown"
    )
    cut: OptionalUnitRange = optional("share of the true known shape outside the method's volume")
    silhouette: OptionalUnitRange = optional("share of the predicted surface outside the view's mask")
    ceiling: Ceiling | None = optional("best figures that surface_sigma_m allows; null where it is 0")
    as_papers: AsPapers | None = optional("figures as in other papers, of the whole under `camera`")
    closed: Closing = optional("how the prediction was made solid (`--close`); null: it was not")
    calibration: Calibration | None = optional("calibration of several predictions, in rows of their mean")


@dataclass(frozen=True, config=FINITE)
class ByThreshold:
    """The IoU of a pair at every threshold, not only the chosen one; scores.csv leaves it out."""

    iou_by_threshold: Annotated[
        tuple[float, ...] | None,
        Field(
            json_schema_extra={"minItems": 17, "maxItems": 17, "items": {"type": "number", **IN_UNIT_RANGE}}
        ),
    ] = optional("IoU at thresholds k / 20, k = 2 to 18; null: all unknown")


@dataclass(frozen=True, config=FINITE)
class ScoreRow(InSpace, ByThreshold, Unknown, SurfaceMetrics, Resolution, Context, VoxelMetrics, ScoredPair):
    """One pair under one protocol; metrics are null if all its voxels are unknown there."""

    @property
    def pair(self) -> str:
        """The name of the pair, `<recording>/<view>`."""
        return f"{self.recording}/{self.view}"

    @property
    def heading(self) -> str:
        """The name of the group that the row is averaged in: protocol and variant.

        Examples are `known`, `camera`, `camera-occluded`, `aligned-t+s` and `camera-best-of-5`.
        """
        words = [self.protocol]
        if self.alignment is not None:
            words.append(self.alignment.kind)
        if self.part not in (None, "whole"):
            words.append(str(self.part))
        if self.hypotheses is not None:
            words.append(f"{self.hypotheses.of}-of-{self.hypotheses.k}")
        return "-".join(words)

    @property
    def in_space(self) -> bool:
        """Whether the row scores a prediction in the camera frame, which has no threshold."""
        return self.protocol in IN_SPACE

    @property
    def counts(self) -> bool:
        """Whether the row has metrics; without them, all its voxels are unknown under the protocol."""
        return self.iou is not None or self.chamfer_l1_m is not None


@dataclass(frozen=True, config=FINITE)
class Averages(Context, SurfaceMetrics, VoxelMetrics):
    """Means of values over rows; a value that one of the rows lacks is None."""

    ceiling_iou: OptionalUnitRange = optional("mean of the rows' ceilings")

    def __getitem__(self, key: str) -> Any:
        """Look up a value by its key in the file, such as "iou"."""
        return getattr(self, key)


AVERAGED = tuple(fields_of(Averages))
