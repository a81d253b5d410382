"""One recording under two ids: what is tested must not be what was learnt from."""

import heapq
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from kinectbench.core.artefacts.manifest import SourceFile, Sources
from kinectbench.core.errors import ReleaseError
from kinectbench.settings.models import BenchmarkSettings, RecordingSettings

# Two recordings hold the same frames if files of this share of the smaller one's bytes are equal: a frame
# without depth, or the intrinsics, are equal in many. Chosen by hand.
SAME_SHARE = 0.5
# Files by which recordings are found that are compared, those with the smallest hashes: if half of the files
# are equal, all of them differ in one of 65,000 cases (2^-16).
COMPARED_BY = 16


@dataclass(frozen=True)
class SameFrames:
    """Two entries of benchmark.yaml that choose the same object in the same frames, under two names."""

    first: RecordingSettings
    second: RecordingSettings


def same_frames(settings: BenchmarkSettings, build: Path, recordings: Sequence[str]) -> Iterator[SameFrames]:
    """Recordings of different objects with the same frames, each with the first of its kind.

    Entries that choose by different boxes, clicks or masks are different objects of one recording.

    Args:
        settings: the benchmark's.
        build: holds a folder per recording; one without sources.json, as of imported pairs, is passed over.
        recordings: ids.
    """
    by_id, holder_of = settings.by_id(), dict[str, str]()
    for name in recordings:
        files = _files(build / name)
        signature = _signature(files)
        for earlier in dict.fromkeys(holder_of[digest] for digest in signature if digest in holder_of):
            first, second = by_id[earlier], by_id[name]
            if first.object_name == second.object_name or _chosen_by(first) != _chosen_by(second):
                continue
            if _shared(_files(build / earlier), files) >= SAME_SHARE:
                yield SameFrames(first, second)
                break
        for digest in signature:
            holder_of.setdefault(digest, name)


def refuse_same_frames(settings: BenchmarkSettings, build: Path, recordings: Sequence[str]) -> list[str]:
    """Lines about recordings that count twice.

    Raises:
        ReleaseError: two ids of one recording are in different splits.
    """
    lines = []
    for same in same_frames(settings, build, recordings):
        first, second = same.first, same.second
        if first.split != second.split:
            raise ReleaseError(
                f"{first.id} ({first.split}) and {second.id} ({second.split}) hold the same frames, so that "
                f"what is tested was learnt from: leave one out, or say `object: {first.object_name}` and "
                f"`split: {first.split}` of both",
                what="object-in-two-splits",
            )
        lines.append(
            f"{first.id} and {second.id} hold the same frames and count as two objects: leave one out, or "
            f"say `object: {first.object_name}` of both"
        )
    return lines


def _files(folder: Path) -> Mapping[str, SourceFile]:
    """Files of a recording; none if nothing was noted of them."""
    sources = Sources.read_if_there(folder)
    return {} if sources is None else sources.files


def _signature(files: Mapping[str, SourceFile]) -> list[str]:
    """The smallest hashes of its files that are no smaller than the mean: of pictures, or the bag."""
    mean = sum(file.size for file in files.values()) / max(1, len(files))
    return heapq.nsmallest(COMPARED_BY, {file.sha256 for file in files.values() if file.size >= mean})


def _shared(files: Mapping[str, SourceFile], others: Mapping[str, SourceFile]) -> float:
    """The share of equal files, by their bytes, of the smaller recording."""
    sizes, others_sizes = ({file.sha256: file.size for file in each.values()} for each in (files, others))
    equal = sum(size for digest, size in sizes.items() if digest in others_sizes)
    return equal / max(1, min(sum(sizes.values()), sum(others_sizes.values())))


def _chosen_by(recording: RecordingSettings) -> tuple[object, ...]:
    """How an entry chooses its object in the frames."""
    return recording.box, recording.pick, recording.masks
