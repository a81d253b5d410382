"""Triage of a benchmark: decide on each recording, and find two recordings of one object under two names."""

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

import numpy as np

from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.triage import DECISIONS, SameObject, TriageFile, TriageRow
from kinectbench.core.types import Float64
from kinectbench.release.triage.rules import Judged, judged
from kinectbench.release.triage.same_object import same_objects
from kinectbench.settings.models import BenchmarkSettings, RecordingSettings


def triage(settings: BenchmarkSettings, build: Path, built: Collection[str]) -> TriageFile:
    """Sort the recordings of a benchmark into accept, look and reject, by the rules that `publish` applies.

    Args:
        settings: the benchmark's settings, with limits and the user's reviews.
        build: the folder with a subfolder for each recording.
        built: ids of recordings whose pairs are built.

    Raises:
        StorageError: a built file is damaged.
    """
    qualities = {name: QualityFile.read(build / name / "object") for name in sorted(built)}
    rows = [_row(each, settings, qualities.get(each.recording.id)) for each in judged(settings, build, built)]
    rows.sort(key=_severity)
    wanted = {row.recording for row in rows if row.decision != "reject"}
    sizes_m = {
        name: size for name, of in qualities.items() if name in wanted and (size := _size_m(of)) is not None
    }
    return TriageFile(
        format_version=1, rows=tuple(rows), same_object=tuple(_same(settings.recordings, build, sizes_m))
    )


def _row(each: Judged, settings: BenchmarkSettings, quality: QualityFile | None) -> TriageRow:
    recording = each.recording
    category = settings.categories.get(recording.category)
    of_category = category is not None and "underside" in category.model_fields_set
    failure = () if each.failure is None else (each.failure,)
    return TriageRow(
        recording=recording.id,
        object=recording.object_name,
        split=recording.split,
        decision=each.decision,
        reasons=(*failure, *each.limits, *each.look),
        review=recording.review.reason if recording.review else None,
        estimated_iou=quality.estimated_iou if quality else None,
        estimated_iou_low=quality.estimated_iou_low if quality else None,
        estimated_known_iou=quality.estimated_known_iou if quality else None,
        underside=settings.underside_of(recording),
        underside_by="recording" if recording.underside else "category" if of_category else None,
        incomplete=each.incomplete,
        built=quality is not None,
    )


def _severity(row: TriageRow) -> tuple[int, float, int, str]:
    """Return the key that sorts rows by worst decision, lowest `estimated_iou_low`, most reasons, then id.

    Among rows with the same decision, those without an estimate come first.
    """
    low = row.estimated_iou_low
    return DECISIONS.index(row.decision), -1.0 if low is None else low, -len(row.reasons), row.recording


def _size_m(quality: QualityFile) -> Float64 | None:
    """Return (3,) longer side, shorter side and height of the object, metres; None if not known."""
    if quality.box is None:
        return None
    x, y, z = quality.box.size_m
    return np.array([max(x, y), min(x, y), z])


def _same(
    recordings: Sequence[RecordingSettings], build: Path, sizes_m: dict[str, Float64]
) -> Iterator[SameObject]:
    """Yield pairs of recordings with one shape but two object names, those in different splits first."""
    by_id = {each.id: each for each in recordings}
    pairs = []
    names = {name: by_id[name].object_name for name in sizes_m}
    for a, b, value in same_objects({name: build / name / "object" for name in sizes_m}, sizes_m, names):
        first, second = by_id[a], by_id[b]
        write = f"object: {first.object_name}"
        if first.split != second.split:
            write += f", split: {first.split}"
        pairs.append(
            SameObject(
                recordings=(a, b),
                agreement=round(value, 3),
                splits=(first.split, second.split),
                write=write,
            )
        )
    yield from sorted(pairs, key=lambda pair: (pair.splits[0] == pair.splits[1], -pair.agreement))
