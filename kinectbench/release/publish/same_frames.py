"""Find recordings that are declared twice under two ids, which could put test data into the training data.

Both files and depth images are compared, so that a bag and an image folder of the same frames are found.
"""

import heapq
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from kinectbench.core import ReleaseError
from kinectbench.core.artefacts.manifest import Sources
from kinectbench.core.artefacts.sequence import SKETCH_DIGESTS, CameraFile
from kinectbench.settings.models import BenchmarkSettings, RecordingSettings

# Two recordings hold the same frames if they share this part of the smaller one's bytes (by equal files) or
# of its depth images. Many recordings share single files, such as intrinsics. Chosen by hand.
SAME_SHARE = 0.5
# Number of files of each recording, those with the smallest hashes, that are looked up in all others. If two
# recordings share half of the smaller one's files, they are missed in one of 65,000 cases (2^-16).
LOOKED_FOR = 16
# Fewer digests of depth images tell little of their share. Of recordings of 3,000 and 60 frames some 20 are
# compared; of 3,000 and 30, in one of seven cases fewer than these (200 random draws).
LEAST_COMPARED = 8
# Words of the warning on two recordings.
TWICE = "hold the same frames and count as two objects"


def _same_frames(
    settings: BenchmarkSettings, build: Path, recordings: Sequence[str]
) -> Iterator[tuple[RecordingSettings, RecordingSettings]]:
    """Yield pairs of recordings that have the same frames but name different objects.

    Recordings with different boxes, floors, picks or masks select different objects, and are not yielded.

    Args:
        settings: the benchmark's settings.
        build: the folder with a subfolder for each recording; one without sources.json and sequence (imported
            pairs) is skipped.
        recordings: ids of recordings.
    """
    by_id = settings.by_id()
    chosen_by = {name: _chosen_by(by_id[name]) for name in recordings}
    holders = defaultdict[tuple[str, str], list[str]](list)
    for name in recordings:
        for digest in _Contents.read(build / name).looked_for():
            holders[digest, chosen_by[name]].append(name)
    order, found = {name: place for place, name in enumerate(recordings)}, set[tuple[int, int]]()
    for name in recordings:
        own = _Contents.read(build / name)
        digests = own.file_sizes.keys() | own.depth_sketch
        near = {other for digest in digests for other in holders.get((digest, chosen_by[name]), ())}
        for other in near - {name}:
            a, b = sorted((order[name], order[other]))
            others = by_id[other].object_name != by_id[name].object_name
            if others and (a, b) not in found and _same(own, _Contents.read(build / other)):
                found.add((a, b))
    for a, b in sorted(found):
        yield by_id[recordings[a]], by_id[recordings[b]]


def refuse_same_frames(settings: BenchmarkSettings, build: Path, recordings: Sequence[str]) -> list[str]:
    """Return a line for each pair of recordings that have the same frames but name different objects.

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


@dataclass(frozen=True)
class _Contents:
    """Hashes of a recording's files and depth images.

    Attributes:
        file_sizes: {SHA-256 of a file: its bytes}; {} without sources.json.
        depth_sketch: the smallest digests of its depth images; empty in builds of early versions.
    """

    file_sizes: Mapping[str, int]
    depth_sketch: frozenset[str]

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read the contents of the recording that is built in `folder`."""
        sources, head = Sources.read_if_there(folder), CameraFile.read_if_there(folder / "sequence")
        files = {} if sources is None else sources.files
        sizes = {file.sha256: file.size for file in files.values()}
        return cls(sizes, frozenset(() if head is None else head.depth_sketch))

    def looked_for(self) -> list[str]:
        """Return the digests to look up in other recordings: the smallest of large files, and the sketch.

        A file is large if it has at least the mean size, so that it is an image or the bag.
        """
        mean = sum(self.file_sizes.values()) / max(1, len(self.file_sizes))
        large = (digest for digest, size in self.file_sizes.items() if size >= mean)
        return [*heapq.nsmallest(LOOKED_FOR, large), *self.depth_sketch]


def _same(one: _Contents, other: _Contents) -> bool:
    sizes, others = one.file_sizes, other.file_sizes
    equal = sum(size for digest, size in sizes.items() if digest in others)
    in_files = equal / max(1, min(sum(sizes.values()), sum(others.values())))
    return max(in_files, _shared_depth(one.depth_sketch, other.depth_sketch)) >= SAME_SHARE


def _shared_depth(one: Set[str], other: Set[str]) -> float:
    """Estimate from two sketches which share of the smaller recording's depth images both have.

    Up to its largest digest, a full sketch has all digests of its recording (k minimum values: Beyer et al.,
    On Synopses for Distinct-Value Estimation Under Multiset Operations, SIGMOD 2007).
    """
    complete_to = min((max(each) for each in (one, other) if len(each) >= SKETCH_DIGESTS), default="g")
    a, b = ({digest for digest in each if digest <= complete_to} for each in (one, other))
    fewest = min(len(a), len(b))
    return len(a & b) / fewest if fewest >= min(LEAST_COMPARED, len(one), len(other)) > 0 else 0.0


def _chosen_by(recording: RecordingSettings) -> str:
    """Return as text the settings by which a recording selects its object in the frames."""
    more = recording.segment_by, recording.camera.mask_object if recording.camera else None
    return repr((recording.box, recording.floor, recording.pick, recording.masks, *more))
