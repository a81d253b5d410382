"""Decide which recordings are published: by the user's review if there is one, else by the rules of triage.

In benchmark.yaml, `review` of a recording accepts or rejects it, with a reason. `publish --allow-poor`
accepts every built recording. A release states the outcome for each recording, with the reason.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from kinectbench.core.artefacts.benchmark import Flow, RecordingInfo
from kinectbench.release.publish.same_frames import refuse_same_frames
from kinectbench.release.triage.rules import NOT_BUILT, Judged, judged
from kinectbench.settings.models import BenchmarkSettings, RecordingSettings

ALLOWED = "--allow-poor"
REJECTED = "rejected by review: "
ADVICE = "; mend it, or accept it: `review` of the recording in benchmark.yaml, or `--allow-poor`"
# Replaces figures and a person's reason that would reveal held-back truth.
WITHHELD = "why is held back, as its truth is"
# If no recording can be published, at most this many reasons are shown.
SHOWN_REASONS = 4
WITHOUT_PAIR = "not a single view passed the checks of the pairs"
OF_ONE_OBJECT = "with --isolate one view of its object is published, or it has no pair"


def first_lines(lines: Sequence[str]) -> str:
    """Return the first few lines joined by semicolons, and the number of further lines."""
    more = [f"and {len(lines) - SHOWN_REASONS} more"] if len(lines) > SHOWN_REASONS else []
    return "; ".join([*lines[:SHOWN_REASONS], *more])


def left_out_line(name: str, why: str) -> str:
    """Return the card's line about a left-out recording; a caller may append advice."""
    return f"{name} is left out: {why}"


def poor_line(name: str, limits: Sequence[str], why: str) -> str:
    """Return the card's line about a published recording that violates some limits."""
    return f"{name} is published all the same ({why}): {'; '.join(limits)}"


def look_line(name: str, look: Sequence[str]) -> str:
    """Return the card's line about a published recording that somebody should review."""
    return f"{name} is published, and a person should look at it: {'; '.join(look)}"


def gate_lines(
    reasons: Iterable[str], poor: Mapping[str, tuple[Sequence[str], str]], look: Mapping[str, Sequence[str]]
) -> Iterator[str]:
    """Yield the card's lines on recordings that are left out, poor, or to review.

    Args:
        reasons: a line for each recording that is left out.
        poor: {published id: (limits that it violates, why it is published nevertheless)}.
        look: {published id: reasons for a review that is still missing}.
    """
    left_out = [*reasons]
    if left_out:
        are = " is" if len(left_out) == 1 else "s are"
        yield f"{len(left_out)} recording{are} left out of this release"
    yield from left_out
    for name, (limits, why) in poor.items():
        yield poor_line(name, limits, why)
    for name, why_look in look.items():
        yield look_line(name, why_look)


@dataclass(frozen=True)
class Gate:
    """The decision on each of a benchmark's recordings: published or left out, and why.

    Attributes:
        published: ids of recordings that passed, in the given order; those in `left_out` are not published.
        poor: {published id: (limits that it violates, why it is published nevertheless)}.
        refused: {id: limits that it violates}.
        rejected: {id: the user's reason to leave it out}.
        failed: {id: why its build failed}.
        look: {published id: reasons for a review that is still missing}.
        not_built: number of the benchmark's recordings that are not built, or not requested.
        without_pair: ids of recordings that passed but have no pair.
        of_one_object: ids left out by `--isolate`, because another recording of the same object was chosen,
            or because they have no pair.
        twice: a line for each pair of published recordings with the same frames.
    """

    published: tuple[str, ...]
    poor: Mapping[str, tuple[tuple[str, ...], str]]
    refused: Mapping[str, tuple[str, ...]]
    rejected: Mapping[str, str]
    failed: Mapping[str, str] = field(default_factory=dict)
    look: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    not_built: int = 0
    without_pair: tuple[str, ...] = ()
    of_one_object: tuple[str, ...] = ()
    twice: tuple[str, ...] = ()

    @property
    def left_out(self) -> dict[str, str]:
        """The left-out recordings: {id: why it is not in the release, one line}."""
        return {
            **{name: "; ".join(limits) for name, limits in self.refused.items()},
            **{name: f"{REJECTED}{reason}" for name, reason in self.rejected.items()},
            **self.failed,
            **dict.fromkeys(self.without_pair, WITHOUT_PAIR),
            **dict.fromkeys(self.of_one_object, OF_ONE_OBJECT),
        }

    @property
    def flow(self) -> Flow:
        """The number of recordings tried, and the number with each outcome."""
        in_release = set(self.published) - set(self.left_out)
        return Flow(
            tried=len(in_release) + len(self.left_out) + self.not_built,
            not_built=self.not_built,
            failed=len(self.failed),
            rejected=len(self.rejected),
            below_limits=len(self.refused),
            without_pair=len(self.without_pair),
            of_one_object=len(self.of_one_object),
            published=len(in_release),
            poor=len(in_release & self.poor.keys()),
            look=len(in_release & self.look.keys()),
        )

    def for_everybody(self, hidden: Collection[str]) -> "Gate":
        """Return a copy for the public release, in which no reason reveals held-back truth.

        Args:
            hidden: ids of recordings with held-back truth; `WITHHELD` replaces all their violated limits and
                reasons.
        """
        poor = {name: ((WITHHELD,), WITHHELD) if name in hidden else it for name, it in self.poor.items()}
        refused = {name: (WITHHELD,) if name in hidden else it for name, it in self.refused.items()}
        rejected = {name: WITHHELD if name in hidden else it for name, it in self.rejected.items()}
        failed = {name: WITHHELD if name in hidden else it for name, it in self.failed.items()}
        look = {name: (WITHHELD,) if name in hidden else it for name, it in self.look.items()}
        return replace(self, poor=poor, refused=refused, rejected=rejected, failed=failed, look=look)

    def said(self, say: Callable[[str], str]) -> "Gate":
        """Return a copy in which the function `say` has rewritten each line of `failed` and `look`."""
        failed = {name: say(why) for name, why in self.failed.items()}
        look = {name: tuple(map(say, lines)) for name, lines in self.look.items()}
        return replace(self, failed=failed, look=look)

    def with_pairs(self, made: Collection[str]) -> "Gate":
        """Return a copy that leaves out, as `without_pair`, the recordings that are not in `made`."""
        without = tuple(name for name in self.published if name not in made)
        poor = {name: lines for name, lines in self.poor.items() if name in made}
        look = {name: lines for name, lines in self.look.items() if name in made}
        return replace(self, without_pair=without, poor=poor, look=look)

    def first_reasons(self) -> str:
        """Return the first reasons why recordings are left out, and the number of others, in one line."""
        lines = [left_out_line(name, why) for name, why in self.left_out.items()]
        return first_lines(lines) + (ADVICE if self.refused else "")

    def reasons(self) -> Iterator[str]:
        """Yield a line for each recording that is not in the release, with the reason."""
        for name, why in self.left_out.items():
            yield f"{left_out_line(name, why)}{ADVICE if name in self.refused else ''}"

    def lines(self) -> Iterator[str]:
        """Yield the card's lines on recordings that are left out, poor, to review, or published twice."""
        yield from gate_lines(self.reasons(), self.poor, self.look)
        yield from self.twice

    def noted(self, name: str, info: RecordingInfo) -> RecordingInfo:
        """Return a recording's entry in benchmark.json with its violated limits and reasons for a review."""
        changes = dict[str, object]()
        if name in self.poor:
            changes["poor"], changes["accepted"] = self.poor[name]
        if name in self.look:
            changes["look"] = self.look[name]
        return info.model_copy(update=changes)


def gate(settings: BenchmarkSettings, build: Path, recordings: Sequence[str], allow_poor: bool) -> Gate:
    """Decide which recordings of a benchmark are published.

    `recordings` are the built ones; with `allow_poor`, those that violate limits are published, too.

    Raises:
        ReleaseError: the same frames would be published under two ids in different splits.
        StorageError: a built file is damaged.
    """
    passed = _decided(judged(settings, build, recordings), recordings, allow_poor)
    return replace(passed, twice=tuple(refuse_same_frames(settings, build, passed.published)))


def would_be_left_out(settings: BenchmarkSettings, build: Path, pairs: Mapping[str, int]) -> dict[str, str]:
    """Return {id: why `publish` would leave it out, one line with advice} of built recordings.

    Args:
        settings: the benchmark's settings, with limits and reviews; other recordings are not looked at.
        build: the folder with a subfolder for each recording.
        pairs: {id of a built recording: its number of pairs}.

    Raises:
        StorageError: a built file is damaged.
    """
    chosen = tuple(each for each in settings.recordings if each.id in pairs)
    rows = judged(settings.model_copy(update={"recordings": chosen}), build, pairs, by_limits_alone=True)
    with_pairs = [name for name, count in pairs.items() if count]
    found = _decided(rows, tuple(pairs), allow_poor=False).with_pairs(with_pairs)
    return {name: f"{why}{ADVICE if name in found.refused else ''}" for name, why in found.left_out.items()}


def _decided(rows: Iterable[Judged], recordings: Sequence[str], allow_poor: bool) -> Gate:
    """Return the decision on judged recordings; published ones keep the order of `recordings`."""
    published, poor = list[str](), dict[str, tuple[tuple[str, ...], str]]()
    failed, refused, rejected = dict[str, str](), dict[str, tuple[str, ...]](), dict[str, str]()
    look, not_built = dict[str, tuple[str, ...]](), 0
    for each in rows:
        name, review = each.recording.id, each.recording.review
        why = _why_all_the_same(each.recording, allow_poor)
        if review is not None and review.decision == "reject":
            rejected[name] = review.reason
        elif each.failure == NOT_BUILT:
            not_built += 1
        elif each.failure is not None:
            failed[name] = each.failure
        elif each.limits and why is None:
            refused[name] = each.limits
        else:
            published.append(name)
            if each.limits and why is not None:
                poor[name] = each.limits, why
            elif each.decision == "look":
                look[name] = each.look
    ordered = tuple(name for name in recordings if name in published)
    return Gate(ordered, poor, refused, rejected, failed, look, not_built)


def _why_all_the_same(recording: RecordingSettings, allow_poor: bool) -> str | None:
    if recording.review is not None:
        return f"accepted by review: {recording.review.reason}"
    return ALLOWED if allow_poor else None
