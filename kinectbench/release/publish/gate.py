"""Whether a recording is good enough to be published: what was built says so, or a person decides.

Limits are `publish.gate` of benchmark.yaml. `recordings[].review` accepts or rejects one recording with a
reason, and `publish --allow-poor` lets all pass; a release says of each whether its limits were passed over.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.sequence import CameraFile
from kinectbench.core.artefacts.trajectory import GRADES, TrajectoryHealth
from kinectbench.settings.models import BenchmarkSettings, RecordingSettings
from kinectbench.settings.publishing import GateSettings

ALLOWED = "--allow-poor"
REJECTED = "rejected by review: "
ADVICE = "; mend it, or accept it: `review` of the recording in benchmark.yaml, or `--allow-poor`"
# What is said in place of figures and a person's reason, which tell of a truth that is held back.
NOT_TOLD = "why is held back, as its truth is"
# Where no recording can be published, the reasons of so many are named.
SHOWN_REASONS = 4
# Of a doubt, which advises after it.
SHOWN_OF_DOUBT = ";"


def first_lines(lines: Sequence[str]) -> str:
    """Lines as one, after semicolons: the first few, and a count of the others."""
    more = [f"and {len(lines) - SHOWN_REASONS} more"] if len(lines) > SHOWN_REASONS else []
    return "; ".join([*lines[:SHOWN_REASONS], *more])


def left_out_line(name: str, why: str) -> str:
    """How the card says that a recording is left out; advice may follow."""
    return f"{name} is left out: {why}"


def poor_line(name: str, limits: Sequence[str], why: str) -> str:
    """How the card says that a recording is published though it does not keep some limits."""
    return f"{name} is published all the same ({why}): {'; '.join(limits)}"


@dataclass(frozen=True)
class Gate:
    """What becomes of some recordings.

    Attributes:
        published: ids, in the order given.
        poor: of these, id -> limits that it does not keep, and why it is published all the same.
        refused: id -> limits that it does not keep.
        rejected: id -> a person's reason to leave it out.
    """

    published: tuple[str, ...]
    poor: Mapping[str, tuple[tuple[str, ...], str]]
    refused: Mapping[str, tuple[str, ...]]
    rejected: Mapping[str, str]

    @property
    def left_out(self) -> dict[str, str]:
        """Id -> why it is not in the release, in a line."""
        return {name: "; ".join(limits) for name, limits in self.refused.items()} | {
            name: f"{REJECTED}{reason}" for name, reason in self.rejected.items()
        }

    def for_everybody(self, hidden: Collection[str]) -> "Gate":
        """The same without the figures and reasons of some recordings, whose truth is held back."""
        poor = {name: ((NOT_TOLD,), NOT_TOLD) if name in hidden else it for name, it in self.poor.items()}
        refused = {name: (NOT_TOLD,) if name in hidden else it for name, it in self.refused.items()}
        rejected = {name: NOT_TOLD if name in hidden else it for name, it in self.rejected.items()}
        return replace(self, poor=poor, refused=refused, rejected=rejected)

    def first_reasons(self) -> str:
        """Why none is in the release: the first few with reasons, a count of the others, and what to do."""
        lines = [left_out_line(name, why) for name, why in self.left_out.items()]
        return first_lines(lines) + (ADVICE if self.refused else "")

    def reasons(self) -> Iterator[str]:
        """Why each of those that are not in the release is not, a line each."""
        for name, why in self.left_out.items():
            yield f"{left_out_line(name, why)}{ADVICE if name in self.refused else ''}"

    def lines(self) -> Iterator[str]:
        """What the card says: how many are left out, why, and which are published though they are poor."""
        if count := len(self.left_out):
            yield f"{count} recording{' is' if count == 1 else 's are'} left out of this release"
        yield from self.reasons()
        for name, (limits, why) in self.poor.items():
            yield poor_line(name, limits, why)


def gate(settings: BenchmarkSettings, build: Path, recordings: Sequence[str], allow_poor: bool) -> Gate:
    """Decide which of some built recordings are published.

    Args:
        settings: the benchmark's: limits, and what people decided.
        build: holds a folder per recording.
        recordings: ids.
        allow_poor: whether those that do not keep the limits pass, too.

    Raises:
        StorageError: a built file is damaged.
    """
    by_id = settings.by_id()
    published, poor = list[str](), dict[str, tuple[tuple[str, ...], str]]()
    refused, rejected = dict[str, tuple[str, ...]](), dict[str, str]()
    for name in recordings:
        review = by_id[name].review
        if review is not None and review.decision == "reject":
            rejected[name] = review.reason
            continue
        limits = tuple(_beyond(settings.publish.gate, build / name))
        why = _why_all_the_same(by_id[name], allow_poor)
        if limits and why is None:
            refused[name] = limits
            continue
        published.append(name)
        if limits and why is not None:
            poor[name] = limits, why
    return Gate(tuple(published), poor, refused, rejected)


def _why_all_the_same(recording: RecordingSettings, allow_poor: bool) -> str | None:
    if recording.review is not None:
        return f"accepted by review: {recording.review.reason}"
    return ALLOWED if allow_poor else None


def _beyond(limits: GateSettings, folder: Path) -> Iterator[str]:
    """The limits that a built recording does not keep, with its figures; what is not known breaks none."""
    quality = QualityFile.read(folder / "object")
    health = TrajectoryHealth.read_if_there(folder / "trajectory")
    grade = None if health is None else health.grade
    # The poses' errors that an estimate counts are those of the trajectory: is that not good, less is sure.
    doubtful = grade == "not good" and quality.estimated_iou_low is not None
    value = quality.estimated_iou_low if doubtful else quality.estimated_iou
    if value is not None and value < limits.min_estimated_iou:
        what = (
            "lower end of the estimated IoU, as the trajectory is not good," if doubtful else "estimated IoU"
        )
        yield f"{what} {value:.2f}, less than publish.gate.min_estimated_iou: {limits.min_estimated_iou:g}"
    if grade is not None and GRADES.index(grade) < GRADES.index(limits.min_grade):
        yield f"the trajectory is {grade}, below publish.gate.min_grade: {limits.min_grade}"
    unknown = quality.unknown_share
    if unknown is not None and unknown > limits.max_unknown_share:
        yield (
            f"{unknown:.0%} of the solid is unknown, more than publish.gate.max_unknown_share: "
            f"{limits.max_unknown_share:g}"
        )
    head = CameraFile.read_if_there(folder / "sequence")
    doubts = (*(() if head is None else head.doubts), *quality.known_doubts)
    if len(doubts) > limits.max_doubts:
        first = doubts[0].split(SHOWN_OF_DOUBT, 1)[0]
        count = f"{len(doubts)} doubt{'s' * (len(doubts) > 1)} of the object, its floor or its size"
        yield f"{first} ({count}, more than publish.gate.max_doubts: {limits.max_doubts})"
