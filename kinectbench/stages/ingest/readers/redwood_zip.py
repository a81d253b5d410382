"""Scans of the Redwood 3dscan data set (redwood-data.org/3dscan), in their zip archives.

Files in depth/ and rgb/ are named NUMBER-MICROSECONDS; depth is PNG in mm, colour is JPEG. By the data set's
page its PrimeSense cameras have images of 640x480 pixels and fx, fy, cx, cy of 525, 525, 319.5, 239.5; the
archive does not state this. Depth comes every 33.369 ms and colour every 33.516 ms, each with its own
numbers: equal numbers soon have different times.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import ClassVar, NamedTuple, Self

from kinectbench.core import RecordingError
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.image_names import counting_key, stamps_of_names
from kinectbench.stages.ingest.images import DamagedImageError, decode_depth_png, image_header
from kinectbench.stages.ingest.intrinsics import Intrinsics
from kinectbench.stages.ingest.pairing import pair_images
from kinectbench.stages.ingest.readers.archive import Archive, holds
from kinectbench.stages.ingest.readers.folder import DEPTH_SCALE, PRIMESENSE
from kinectbench.stages.ingest.recording import COLOR_DELAY, RawFrame, Recording, first_whole, tried

# Images are named by a number of seven digits and a stamp of twelve in microseconds, such as
# depth/0000002-000000033369.png of scan 00033 of redwood-3dscan; numbers of up to nine digits are accepted.
NAMED = re.compile(rb"(?:depth|rgb)/\d{1,9}-\d{12}\.(?:png|jpg)")
MEMBER = re.compile(r"(?:[^/]+/)?(depth|rgb)/(\d{1,9}-\d{12})\.(?:png|jpg)")


class ZippedFrame(NamedTuple):
    """A frame: stamp of depth in nanoseconds, names of its depth and colour (or None) in the archive."""

    stamp_ns: int
    depth: str
    color: str | None


@dataclass(frozen=True, kw_only=True)
class RedwoodZipRecording(Recording):
    """A scan in its zip archive, which does not contain the trajectory."""

    format: ClassVar[str] = "redwood_zip"
    uses: ClassVar[frozenset[str]] = COLOR_DELAY
    looks_for: ClassVar[str] = "a .zip of Redwood's scans: depth/0000001-000000000000.png and rgb/"
    suffixes: ClassVar[tuple[str, ...]] = (".zip",)

    places: tuple[ZippedFrame, ...]
    archive: Archive = field(compare=False)

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the path is a zip archive with images named as Redwood names them."""
        return holds(path, NAMED)

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """List the images; of each kind only the first undamaged one is unpacked."""
        archive = Archive(path)
        matches = [match for name in archive.names() if (match := MEMBER.fullmatch(name))]
        depth, color = _named(matches, "depth"), _named(matches, "rgb")
        if not depth:
            raise RecordingError(
                f"{path}: holds no depth/ images, only colour; download the scan again", what="no-depth"
            )
        stems = [[stem for stem, _ in names] for names in (depth, color)]
        partners, color_ns = pair_images(*stems, delay_s=settings.color_delay_s, where=str(path))
        stamps_ns = stamps_of_names(stems[0])
        frames = zip(stamps_ns, depth, partners.of_depth, strict=True)
        places = tuple(
            ZippedFrame(stamp_ns, name, None if partner is None else color[partner][1])
            for stamp_ns, (_, name), partner in sorted(frames, key=lambda frame: frame[0])
        )
        size_px = _first_size(archive, [place.depth for place in places])
        if size_px is None:
            count = tried(len(places))
            raise RecordingError(
                f"{path}: none of the {count} depth images is usable; copy it again", what="no-frame"
            )
        usual = size_px == (PRIMESENSE.width, PRIMESENSE.height)
        intrinsics = (PRIMESENSE if usual else Intrinsics()).overridden_by(settings)
        return cls(
            path=path,
            places=places,
            archive=archive,
            camera=intrinsics.camera(size_px, path),
            depth_scale=intrinsics.depth_scale or DEPTH_SCALE,
            color_registered=_first_size(archive, [p.color for p in places if p.color]) == size_px,
            recorded=(tuple(stamps_ns), color_ns),
            warnings=partners.warnings,
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


def _named(matches: list[re.Match[str]], folder: str) -> list[tuple[str, str]]:
    """List the images of a folder as (stem, full name), in numeric order."""
    # Not as paths: two hundred thousand of them would take two seconds.
    names = [(match[2], match[0]) for match in matches if match[1] == folder]
    return sorted(names, key=lambda name: (counting_key(name[0]), name[1]))


def _first_size(archive: Archive, names: list[str]) -> tuple[int, int] | None:
    """Return width and height in pixels of the first undamaged image; None if there is none."""
    try:
        return first_whole(lambda name: image_header(archive.read(name), name)[1:], names)
    except DamagedImageError:
        return None
