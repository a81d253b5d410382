"""The result of one recording: a row of the table at the end of a build."""

from pydantic import Field, field_serializer

from kinectbench.core.artefacts.object import INTERVAL_HIGH, INTERVAL_LOW, FrontierPart
from kinectbench.core.artefacts.stored import StoredPart


class RecordingSummary(StoredPart):
    """The result of one recording; a figure is null unless its stage is up to date."""

    recording: str = Field(description="id of the recording")
    frames: int | None = Field(description="number of frames")
    damaged: int | None = Field(None, description="number of further frames that could not be read")
    left_out: tuple[int, ...] | None = Field(description="frames whose depth disagrees with their given pose")
    lost: int | None = Field(description="number of other frames without a pose")
    source: str | None = Field(description="source of the poses: trust, refine or tracked")
    grade: str | None = Field(description="quality of the poses for ground truth, in a word")
    verdict: str | None = Field(description="quality of the poses for ground truth, in a sentence")
    recommended: str | None = Field(description="recommended value of the setting `trajectory`")
    repeatability_iou: float | None = Field(description="IoU of the solids made of odd and of even frames")
    estimated_iou: float | None = Field(description="estimate of the solid's IoU to the unknown truth")
    estimated_iou_low: float | None = Field(description=INTERVAL_LOW)
    estimated_iou_high: float | None = Field(description=INTERVAL_HIGH)
    estimated_iou_reasons: tuple[str, ...] | None = Field(description="what widens that interval")
    rests_on_word: str | None = Field(
        None, description="a warning if much of the solid rests on the user's `underside: closed`"
    )
    frontiers: tuple[FrontierPart, ...] | None = Field(description="openings that nobody looked into")
    views: int | None = Field(description="number of views")
    pairs: int | None = Field(description="number of pairs")
    refused: int | None = Field(description="number of frames refused as views, and of views without a pair")
    containment: float | None = Field(description="share of the partial in the shape, median over the pairs")
    residual_m: float | None = Field(
        alias="residual_mm", description="distance of the points from the shape, median over the pairs, mm"
    )
    warnings: tuple[str, ...] = Field(description="warnings of all stages, one line each")
    first: str | None = Field(None, description="the warning to deal with first")
    left_out_of_release: str | None = Field(None, description="why `publish` would leave the recording out")
    status: str = Field(description="failed, in use, up to date, or the seconds it took")
    error: str | None = Field(description="why the recording failed")
    code: str | None = Field(description="code of this error")
    made: tuple[str, ...] = Field(description="stages that this run made")
    current: tuple[str, ...] = Field(description="stages that were up to date")

    @field_serializer("residual_m")
    def _millimetres(self, residual_m: float | None) -> float | None:
        # Hardly rounded here, because the value is rounded when it is shown.
        return None if residual_m is None else round(1000 * residual_m, 6)
