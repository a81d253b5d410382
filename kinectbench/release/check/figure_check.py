"""Check facts that a release states twice: benchmark.json, quality.json, views.json, lineage.json, floors.

In early releases, without `benchmark_sha256_version` in benchmark.json, the wording of these facts differs,
so only frames and floors are checked.
"""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress

import numpy as np
from pydantic import ValidationError

from kinectbench.core import ReleaseError, StorageError, printable
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, UNSPECIFIED, RecordingInfo, ReleaseInfo
from kinectbench.core.artefacts.object import FloorFile, QualityFile
from kinectbench.core.artefacts.provenance import LINEAGE_JSON, Lineage, LineageRecording
from kinectbench.core.artefacts.views import ViewsFile
from kinectbench.core.geometry import ORTHONORMAL_TOLERANCE, is_rigid
from kinectbench.release.contents import Contents
from kinectbench.release.publish.attribution import reasons_against_distribution
from kinectbench.release.publish.gate import ALLOWED, REJECTED, WITHHELD
from kinectbench.release.triage.rules import beyond_limits, of_object
from kinectbench.settings.publishing import GateSettings

GATE_KEY = re.compile(r".*publish\.gate\.(\w+)", re.DOTALL)
# Limits of `publish.gate` on what quality.json states.
OF_QUALITY = ("min_estimated_iou", "max_unknown_share", "max_doubts")
# Settings that hold for all pairs.
OF_PAIRS = ("framing", "partial_rule")


def own_problems(metadata: ReleaseInfo) -> Iterator[str]:
    """Yield a message for each contradiction within benchmark.json.

    It is also a fault if benchmark.json states the quality of a recording whose truth is held back.
    """
    of_pairs = metadata.settings.pairs
    for key in OF_PAIRS:
        value, stated = getattr(of_pairs, key), getattr(metadata, key)
        if value is not None and value != stated:
            yield f"{BENCHMARK_JSON}: settings.pairs.{key} '{value}' where {key} is '{stated}'"
    terms = metadata.distribution
    reasons = reasons_against_distribution(metadata.recordings)
    if terms is not None and (terms.reasons != reasons or terms.allowed is bool(reasons)):
        yield f"{BENCHMARK_JSON}: distribution is not as licence and source of its recordings have it"
    if metadata.held_back and metadata.public_benchmark_sha256:
        yield f"{BENCHMARK_JSON}: is both the public part and the private part"
    if metadata.private_benchmark_sha256 and not metadata.held_back:
        yield f"{BENCHMARK_JSON}: names a private part, but holds nothing back"
    if metadata.isolated and not (metadata.held_back or metadata.public_benchmark_sha256):
        yield f"{BENCHMARK_JSON}: isolates recordings, but holds nothing back"
    for name, info in metadata.recordings.items():
        if metadata.hides(name) and info.quality.json_value():
            yield f"{BENCHMARK_JSON}: holds the quality of {printable(name)}, which is held back"
    for row in metadata.settings.recordings or ():
        published = metadata.recordings.get(str(row.get("id")))
        for key in _other_keys(row, published, metadata) if published else ():
            where = f"settings.recordings of {printable(str(row['id']))}"
            yield f"{BENCHMARK_JSON}: {where} has another {key} than recordings"


def gate_problems(metadata: ReleaseInfo) -> Iterator[str]:
    """Yield a message for each recording that benchmark.json wrongly states as poor, accepted or left out.

    The expected state is computed from the recording's quality and the limits in `settings.publish.gate`. A
    recording that violates a limit but is published is poor, and accepted for a stated reason. Limits on
    trajectory grades and camera warnings are not checked, because a release does not contain these. Wrong
    counts in the key `flow` of benchmark.json give a message, too, and so do reasons for a review that follow
    from the quality and are not in `look`.
    """
    try:
        limits = GateSettings.model_validate((metadata.settings.publish or {}).get("gate", {}))
    except ValidationError:
        yield f"{BENCHMARK_JSON}: settings.publish.gate has keys or values that no setting has"
        return
    reviews = {str(row.get("id")): row.get("review") for row in metadata.settings.recordings or ()}
    for name, info in metadata.recordings.items():
        where = f"{BENCHMARK_JSON}: recordings.{printable(name)}"
        if bool(info.poor) != (info.accepted is not None):
            yield f"{where}: 'poor' and 'accepted' go together"
        if metadata.hides(name):
            if set(info.poor) - {WITHHELD} or info.accepted not in (None, WITHHELD):
                yield f"{where}: 'poor' or 'accepted' tells why, which is held back"
            continue
        if info.accepted not in (None, ALLOWED) and not _reviewed(reviews.get(name), "accept"):
            yield f"{where}: 'accepted' is by no review of the settings, nor {ALLOWED}"
        yield from (f"{where}: {fault}" for fault in _poor_problems(info, limits))
        if metadata.of_this_version and not info.poor and not reviews.get(name):
            absent = [line for line in of_object(info.quality) if line not in info.look]
            yield from (f"{where}: 'look' does not have '{printable(line, 200)}'" for line in absent)
    if (flow := metadata.flow) is not None:
        published, left_out = len(metadata.recordings), len(metadata.left_out or {})
        look = sum(bool(info.look) for info in metadata.recordings.values())
        poor = sum(bool(info.poor) for info in metadata.recordings.values())
        counted = (flow.tried, flow.published, flow.left_out - flow.not_built, flow.look, flow.poor)
        if counted != (len(reviews), published, left_out, look, poor):
            yield f"{BENCHMARK_JSON}: flow has other counts than recordings, left_out and settings.recordings"
    for name, why in (metadata.left_out or {}).items():
        where = f"{BENCHMARK_JSON}: left_out.{printable(name)}"
        if name in metadata.recordings or name not in reviews:
            yield f"{where}: is not of the settings, or is published"
        elif why.startswith(REJECTED) and not _reviewed(reviews[name], "reject"):
            yield f"{where}: is rejected by no review of the settings"


def _reviewed(review: object, decision: str) -> bool:
    return isinstance(review, dict) and review.get("decision") == decision


def _poor_problems(info: RecordingInfo, limits: GateSettings) -> Iterator[str]:
    """Yield a message for each limit that is violated but not in `poor`, or is in `poor` but not violated."""
    low, least = info.quality.trusted_iou[1], limits.min_estimated_iou
    stated, broken = _gate_keys(info.poor), _gate_keys(beyond_limits(limits, info.quality, None, None))
    # If the trajectory is not good, the limit applies to the interval's lower end, so either value may break
    # it. Warnings of the camera are not in a release.
    may = broken | {"max_doubts"} | ({"min_estimated_iou"} if low is not None and low < least else set())
    for key in OF_QUALITY:
        if key in stated - may:
            yield f"'poor' names publish.gate.{key}, which its quality keeps"
        elif key in broken - stated:
            yield f"'poor' does not name publish.gate.{key}, which its quality does not keep"


def _gate_keys(lines: Iterable[str]) -> set[str]:
    """Return the limit that each line names last."""
    return {found[1] for found in map(GATE_KEY.match, lines) if found}


def _other_keys(row: Mapping[str, object], info: RecordingInfo, metadata: ReleaseInfo) -> Iterator[str]:
    """Yield each key whose value differs between `row` and `info`; null in `row` stands for the default.

    `row` is the recording's settings and `info` its entry in `recordings`; both are in benchmark.json.
    """
    defaults = {
        "object": row["id"],
        "license": metadata.license,
        "source": metadata.settings.source or UNSPECIFIED,
    }
    for key in ("category", "split", *defaults):
        wanted = row.get(key)
        if key in row and (defaults.get(key) if wanted is None else wanted) != getattr(info, key):
            yield key
    undersides = row.get("underside"), info.quality.underside
    if None not in undersides and undersides[0] != undersides[1]:
        yield "underside"


def quality_problems(name: str, text: str, info: RecordingInfo) -> Iterator[str]:
    """Yield a message if a recording's quality.json, except its key `method`, differs from benchmark.json."""
    stated, own = (
        {key: value for key, value in quality.json_value().items() if key != "method"}
        for quality in (QualityFile.parse(text, name), info.quality)
    )
    other = sorted(key for key in stated.keys() | own.keys() if stated.get(key) != own.get(key))
    if other:
        yield f"{name}: another {printable(', '.join(other), 200)} than in {BENCHMARK_JSON}"


def refused_problems(views: ViewsFile, info: RecordingInfo) -> Iterator[str]:
    """Yield a message if views.json and benchmark.json disagree on the number of refused frames and views."""
    refused = len(views.refused) + sum(row.pair is False for row in views.views)
    if refused != info.refused:
        yield f"{refused} frames and views refused where {BENCHMARK_JSON} has {info.refused}"


def lineage_problems(lineage: Lineage, metadata: ReleaseInfo) -> Iterator[str]:
    """Yield a message for each version, licence, source or stage setting that differs from benchmark.json."""
    if lineage.package_version != metadata.package_version:
        yield f"another package_version than in {BENCHMARK_JSON}"
    settings = metadata.settings.json_value()
    of_recordings = {str(row.get("id")): row for row in metadata.settings.recordings or ()}
    for name, recording in lineage.recordings.items():
        info = metadata.recordings.get(name)
        for key in ("license", "source") if info else ():
            if getattr(recording, key) != getattr(info, key):
                yield f"another {key} of {printable(name)} than in {BENCHMARK_JSON}"
        for stage, made in recording.stages.items():
            for key, value in made.settings.items():
                section = settings.get(key)
                own = of_recordings.get(name, {})
                other = list[str]()
                if isinstance(value, dict) and isinstance(section, dict):
                    other = [f"{key}.{k}" for k in value.keys() & section.keys() if value[k] != section[k]]
                elif key in own and _given(own[key]) != _given(value):
                    other = [key]
                for setting in sorted(other):
                    said = printable(f"{setting} of stage {stage} of {name}", 200)
                    yield f"another {said} than the settings in {BENCHMARK_JSON}"


def _given(value: object) -> object:
    """Return a setting without null keys: lineage.json may lack newer keys, whose default is null."""
    return {k: v for k, v in value.items() if v is not None} if isinstance(value, dict) else value


def lineage_rows(contents: Contents, whole: Collection[str]) -> Mapping[str, LineageRecording]:
    """Return the recordings of lineage.json; {} if it is not in `whole`, or damaged."""
    with suppress(ReleaseError, StorageError):  # reported as not of its schema
        if LINEAGE_JSON in whole:
            return Lineage.parse(contents.text(LINEAGE_JSON), LINEAGE_JSON).recordings
    return {}


def frame_problems(views: ViewsFile, lineage: LineageRecording | None) -> Iterator[str]:
    """Yield a message for each view whose frame or timestamp in views.json differs from lineage.json."""
    rows = {row.view: row for row in views.views}
    for view in (lineage.views if lineage else None) or ():
        row = rows.get(view.view)
        if row is not None and (row.frame, row.stamp_ns) != (view.frame, view.stamp_ns):
            yield f"another frame or stamp of {printable(view.view)} than in {LINEAGE_JSON}"


def floor_problems(contents: Contents, metadata: ReleaseInfo, whole: Collection[str]) -> Iterator[str]:
    """Yield a message for each floor.json whose `plane_world` is not the plane z = 0 of its floor frame.

    Only files in `whole` are read: those whose bytes are the published ones.
    """
    for name in metadata.recordings:
        file = f"objects/{name}/{FloorFile.FILE}"
        with suppress(ReleaseError, StorageError):  # reported as not of its schema
            floor = FloorFile.parse(contents.text(file), file) if file in whole else None
            if floor is None or not is_rigid(floor.T_floor_world):
                continue
            if not np.allclose(floor.T_floor_world[2], floor.plane_world, atol=ORTHONORMAL_TOLERANCE):
                yield f"{file}: plane_world is not z = 0 of T_floor_world"
