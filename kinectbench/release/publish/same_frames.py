"""Find recordings that are declared twice under two ids, which could put test data into the training data."""

import heapq
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from kinectbench.core import ReleaseError
from kinectbench.core.artefacts.manifest import SourceFile, Sources
from kinectbench.settings.models import BenchmarkSettings, RecordingSettings

# Two recordings hold the same frames if at least this share of the smaller one's bytes is in equal files.
# Single files, such as empty frames or intrinsics, are equal in many recordings. Chosen by hand.
SAME_SHARE = 0.5
# This many files of each recording, those with the smallest hashes, are looked up in all other recordings. If
# two recordings share half of the smaller one's files, none is found in one of 65,000 cases (2^-16).
LOOKED_FOR = 16
# Words of the warning on two recordings.
TWICE = "hold the same frames and count as two objects"


def _same_frames(
    settings: BenchmarkSettings, build: Path, recordings: Sequence[str]
) -> Iterator[tuple[RecordingSettings, RecordingSettings]]:
    """Yield every two recordings that have the same frames but name different objects.

    If their boxes, picks or masks differ, they do select different objects, and are not yielded.

    Args:
        settings: the benchmark's settings.
        build: the folder with a subfolder for each recording; one without sources.json (imported pairs) is
            skipped.
        recordings: ids of recordings.
    """
    by_id = settings.by_id()
    chosen_by = {name: _chosen_by(by_id[name]) for name in recordings}
    holders = defaultdict[tuple[str, str], list[str]](list)
    for name in recordings:
        for digest in _looked_for(_files(build / name)):
            holders[digest, chosen_by[name]].append(name)
    order, found = {name: place for place, name in enumerate(recordings)}, set[tuple[int, int]]()
    for name in recordings:
        files = _files(build / name)
        near = {other for file in files.values() for other in holders.get((file.sha256, chosen_by[name]), ())}
        for other in near - {name}:
            a, b = sorted((order[name], order[other]))
            others = by_id[other].object_name != by_id[name].object_name
            if others and (a, b) not in found and _shared(files, _files(build / other)) >= SAME_SHARE:
                found.add((a, b))
    for a, b in sorted(found):
        yield by_id[recordings[a]], by_id[recordings[b]]


def refuse_same_frames(settings: BenchmarkSettings, build: Path, recordings: Sequence[str]) -> list[str]:
    """Return a line for every two recordings that have the same frames but name different objects.

    Raises:
        ReleaseError: two such recordings are in different splits.
    """
    lines = []
    for first, second in _same_frames(settings, build, recordings):
        if first.split != second.split:
            raise ReleaseError(
                f"{first.id} ({first.split}) and {second.id} ({second.split}) hold the same frames, so that "
                f"what is tested was learnt from: leave one out, or say `object: {first.object_name}` and "
                f"`split: {first.split}` of both",
                what="object-in-two-splits",
            )
        lines.append(
            f"{first.id} and {second.id} {TWICE}: leave one out, or say `object: {first.object_name}` of both"
        )
    return lines


def _files(folder: Path) -> Mapping[str, SourceFile]:
    """Return {name: size and hash} of a recording's files from sources.json; {} if it is missing."""
    sources = Sources.read_if_there(folder)
    return {} if sources is None else sources.files


def _looked_for(files: Mapping[str, SourceFile]) -> list[str]:
    """Return the `LOOKED_FOR` smallest hashes of a recording's large files, to look up in other recordings.

    A file is large if it has at least the mean size, so that it is an image or the bag.
    """
    mean = sum(file.size for file in files.values()) / max(1, len(files))
    return heapq.nsmallest(LOOKED_FOR, {file.sha256 for file in files.values() if file.size >= mean})


def _shared(files: Mapping[str, SourceFile], others: Mapping[str, SourceFile]) -> float:
    """Return what share of the smaller recording's bytes is in files that both recordings have."""
    sizes, others_sizes = ({file.sha256: file.size for file in each.values()} for each in (files, others))
    equal = sum(size for digest, size in sizes.items() if digest in others_sizes)
    return equal / max(1, min(sum(sizes.values()), sum(others_sizes.values())))


def _chosen_by(recording: RecordingSettings) -> str:
    """Return as text the settings by which a recording selects its object in the frames."""
    mask_object = recording.camera.mask_object if recording.camera else None
    return repr((recording.box, recording.pick, recording.masks, recording.segment_by, mask_object))
