"""Scans of the Redwood 3dscan data set (redwood-data.org/3dscan) in the zip archives they come in.

depth/ and rgb/NUMBER-MICROSECONDS, depth in mm as PNG, colour as JPEG; by the data set's own page its
PrimeSense cameras make 640x480 images with 525, 525, 319.5, 239.5, which the archive does not say.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import ClassVar, NamedTuple, Self

from kinectbench.core.errors import RecordingError
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.images import DamagedImageError, decode_depth_png, image_header
from kinectbench.stages.ingest.intrinsics import Intrinsics
from kinectbench.stages.ingest.readers.archive import Archive, holds
from kinectbench.stages.ingest.readers.folder import (
    DEPTH_SCALE,
    PRIMESENSE,
    counting_key,
    frame_key,
    stamps_of_names,
)
from kinectbench.stages.ingest.recording import RawFrame, Recording, first_whole, tried

# Its images are named by a count of seven digits and a stamp of twelve in microseconds, as in
# depth/0000002-000000033369.png of scan 00033 of redwood-3dscan; a count of up to nine is read.
NAMED = re.compile(rb"(?:depth|rgb)/\d{1,9}-\d{12}\.(?:png|jpg)")
MEMBER = re.compile(r"(?:[^/]+/)?(depth|rgb)/(\d{1,9}-\d{12})\.(?:png|jpg)")


class ZippedFrame(NamedTuple):
    """The members of a frame: stamp of depth in nanoseconds, names of depth and of colour (or None)."""

    stamp_ns: int
    depth: str
    color: str | None


@dataclass(frozen=True, kw_only=True)
class RedwoodZipRecording(Recording):
    """A scan in its zip archive; its trajectory is not in it.

    Attributes:
        archive: gives the images.
    """

    format: ClassVar[str] = "redwood_zip"
    looks_for: ClassVar[str] = "a .zip of Redwood's scans: depth/0000001-000000000000.png and rgb/"
    suffixes: ClassVar[tuple[str, ...]] = (".zip",)

    places: tuple[ZippedFrame, ...]
    archive: Archive = field(compare=False)

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether it is a zip archive that holds images named as Redwood's are."""
        return holds(path, NAMED)

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """List the images; nothing is unpacked but the first of each kind."""
        archive = Archive(path)
        found = [match for name in archive.names() if (match := MEMBER.fullmatch(name))]
        # Names as (stem, whole): paths of two hundred thousand would take two seconds.
        depth = [(match[2], match[0]) for match in found if match[1] == "depth"]
        depth.sort(key=lambda name: (counting_key(name[0]), name[1]))
        if not depth:
            raise RecordingError(f"{path}: holds no depth/ images, only colour; download the scan again")
        color = {frame_key(match[2]): match[0] for match in found if match[1] == "rgb"}
        stamps_ns = stamps_of_names([stem for stem, _ in depth])
        frames = zip(stamps_ns, depth, strict=True)
        places = tuple(
            ZippedFrame(stamp_ns, name, color.get(frame_key(stem)))
            for stamp_ns, (stem, name) in sorted(frames, key=lambda frame: frame[0])
        )
        alone = sum(place.color is None for place in places)
        warnings = [f"{path}: {alone} of {len(places)} depth images have no colour"] if alone else []
        size_px = _first_size(archive, [place.depth for place in places])
        if size_px is None:
            count = tried(len(places))
            raise RecordingError(f"{path}: none of the {count} depth images is usable; copy it again")
        usual = size_px == (PRIMESENSE.width, PRIMESENSE.height)
        intrinsics = (PRIMESENSE if usual else Intrinsics()).overridden_by(settings)
        return cls(
            path=path,
            places=places,
            archive=archive,
            camera=intrinsics.camera(size_px, path),
            depth_scale=intrinsics.depth_scale or DEPTH_SCALE,
            color_registered=_first_size(archive, [p.color for p in places if p.color]) == size_px,
            warnings=tuple(warnings),
        )

    def frame(self, index: int) -> RawFrame:
        """Read the images of a frame."""
        place = self.places[index]
        name = f"{self.path}: {place.depth}"
        depth = decode_depth_png(self.archive.read(place.depth), name)
        color = None
        if place.color is not None:
            color = PurePosixPath(place.color).suffix, self.archive.read(place.color)
        return RawFrame(name, place.stamp_ns, depth, color)


def _first_size(archive: Archive, names: list[str]) -> tuple[int, int] | None:
    """Width and height in pixels of the first image that is whole, or None."""
    try:
        return first_whole(lambda name: image_header(archive.read(name), name)[1:], names)
    except DamagedImageError:
        return None
