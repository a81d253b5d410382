"""The summary of a run on one recording: a row of the table at the end of a build."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Self, TypeVar

from kinectbench.core import KinectBenchError, failure_word
from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.reconstruction import ReconstructionFile
from kinectbench.core.artefacts.sequence import CameraFile
from kinectbench.core.artefacts.stored import Stored
from kinectbench.core.artefacts.trajectory import TrajectoryHealth
from kinectbench.core.artefacts.views import PairsFile, ViewsFile
from kinectbench.core.medians import known_median
from kinectbench.engine.pipeline import FOLDERS, Outcome
from kinectbench.engine.pipeline import RecordingSummary as RecordingSummary
from kinectbench.engine.stages import Job

# Values of health.json and quality.json that have the same names in the table.
OF_POSES = ("source", "grade", "verdict", "recommended")
OF_OBJECT = (
    *("repeatability_iou", "estimated_iou", "estimated_iou_low", "estimated_iou_high"),
    *("estimated_iou_reasons", "rests_on_word", "frontiers"),
)
File = TypeVar("File", bound=Stored)
# Views to name in one line.
MOST_NAMED = 3


@dataclass(frozen=True)
class BuiltRecording:
    """The outcome of one recording; its summary is read from the files of the build on request.

    Attributes:
        recording: id of the recording.
        error: why the recording failed; None if it did not.
        made: names of the stages that the run made.
        read: reads the summary.
        code: code of the error, as in docs/errors.md.
    """

    recording: str
    error: str | None
    made: tuple[str, ...]
    read: Callable[[], RecordingSummary]
    code: str | None = None

    @classmethod
    def of(cls, row: RecordingSummary) -> Self:
        """Return a recording whose summary is already read."""
        return cls(row.recording, row.error, row.made, lambda: row, row.code)

    @cached_property
    def summary(self) -> RecordingSummary:
        """The summary of the recording, read at the first use."""
        return self.read()


def summary(job: Job, outcome: Outcome) -> RecordingSummary:
    """Return the summary of a recording, from the stages that the run made or found up to date."""
    if outcome.row is not None:
        return outcome.row
    stages = (*outcome.made, *outcome.current)

    def read(stage: str, model: type[File]) -> File | None:
        """Read a file of a stage; None if it is missing or unreadable."""
        try:
            return model.read(job.build / FOLDERS[stage]) if stage in stages else None
        except KinectBenchError:
            return None

    sequence, health = read("ingest", CameraFile), read("track", TrajectoryHealth)
    quality, views = read("segment", QualityFile), read("sample-views", ViewsFile)
    # If there are figures of the object, they replace those of the scene.
    scene = None if quality else read("fuse", ReconstructionFile)
    pairs = read("pairs", PairsFile)
    rows = pairs.pairs if pairs else ()
    return RecordingSummary(
        recording=job.recording.id,
        frames=sequence.frames if sequence else None,
        damaged=sequence.damaged if sequence else None,
        left_out=tuple(row.frame for row in health.rejected) if health else None,
        lost=len(health.lost) if health else None,
        **{key: getattr(health, key, None) for key in OF_POSES},
        **{key: getattr(quality, key, None) for key in OF_OBJECT},
        views=len(views.views) if views else None,
        pairs=len(rows) if pairs else None,
        refused=len(pairs.refused) + (len(views.refused) if views else 0) if pairs else None,
        containment=_rounded(known_median(row.containment for row in rows)),
        residual_m=_rounded(known_median(row.residual_m for row in rows)),
        warnings=tuple(
            line for part in (sequence, health, scene, quality, views) if part for line in part.warnings
        )
        + _without_pair(job, pairs)
        + outcome.warnings,
        first=_to_do_first(sequence, health, quality, views),
        status=_status(outcome),
        error=outcome.error,
        code=outcome.code,
        made=outcome.made,
        current=outcome.current,
    )


def _status(outcome: Outcome) -> str:
    if outcome.error:
        return failure_word(outcome.code)
    return f"{outcome.seconds:.1f} s" if outcome.made else "up to date"


def _without_pair(job: Job, pairs: PairsFile | None) -> tuple[str, ...]:
    """Return a warning that names views without a pair, if the user's masks may be the cause; else ()."""
    refused = pairs.refused if pairs and job.masks else ()
    if not refused:
        return ()
    named = [f"{row.view} of frame {row.frame} ({row.reason})" for row in refused[:MOST_NAMED]]
    more = [f"and {len(refused) - MOST_NAMED} more in pairs.json"] if len(refused) > MOST_NAMED else []
    count = f"{len(refused)} view{'s' * (len(refused) != 1)}"
    return (f"no pair of {count}: look at their masks in {job.masks}: {', '.join([*named, *more])}",)


def _to_do_first(
    sequence: CameraFile | None,
    health: TrajectoryHealth | None,
    quality: QualityFile | None,
    views: ViewsFile | None,
) -> str | None:
    """Return the warning to deal with first; None if there are no warnings.

    Causes come before effects. The order is: units and intrinsics, poses, floor and choice of the object,
    unseen parts, all other warnings.
    """
    of_object = quality.warnings if quality else ()
    poses = (line for line in of_object if health is not None and health.verdict in line)
    ranked = (
        *(sequence.doubts if sequence else ()),
        *(poses if health is not None and health.grade == "not good" else ()),
        *(quality.measurement_warnings if quality else ()),
        *(quality.advice if quality else ()),
        *of_object,
        *(line for part in (health, sequence, views) if part for line in part.warnings),
    )
    return next(iter(ranked), None)


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 9)
