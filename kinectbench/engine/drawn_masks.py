"""What a person's masks were drawn on: masks.json says it, and a mask is applied to that image or refused.

A mask without an entry was drawn on what lies in `build/` when it is first seen, before anything is made
again; without a build, on the frame of its number. A view's number alone says nothing: views change.
"""

import contextlib
import hashlib
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, Self

from kinectbench.core.artefacts.views import MasksFile, ViewsFile
from kinectbench.core.errors import KinectBenchError, SettingsError
from kinectbench.core.sequence import Sequence
from kinectbench.core.storage import replaced_file
from kinectbench.core.untrusted import listed
from kinectbench.engine.artefact import whole_manifest
from kinectbench.engine.locks import locked
from kinectbench.engine.stages import Job
from kinectbench.stages.ingest.sequence_folder import read_sequence
from kinectbench.stages.sample_views.masks import MaskName, first_of, mask_name

UNKNOWN = "nobody knows which image it was drawn on"
# While masks change names each has one of its own: its old name between these.
CARRIED = (".", ".carried")


class Carried(NamedTuple):
    """What became of masks that were to be carried over.

    Attributes:
        moved: (old name, new name) of each that has another name now.
        left: one line for each that could not be carried over.
    """

    moved: tuple[tuple[str, str], ...]
    left: tuple[str, ...]


@dataclass(frozen=True)
class DrawnMasks:
    """The masks that a person drew for a recording.

    Attributes:
        recording: its id.
        folder: where they lie.
        names: what each file's name says.
        entries: by file name, the digest of the image that it was drawn on, of those where that is known.
    """

    recording: str
    folder: Path
    names: Mapping[str, MaskName]
    entries: Mapping[str, str]

    @classmethod
    def of(cls, job: Job) -> Self | None:
        """Those in the folder that benchmark.yaml names, or will once it is told that it does not; or None.

        Raises:
            StorageError: masks.json is damaged.
            SettingsError: a run that renamed masks was killed, and some have no name of a mask.
        """
        folder = job.masks or job.unused_masks
        if folder is None or not folder.is_dir():
            return None
        if lost := sorted(path.name for path in folder.glob("*".join(CARRIED))):
            called = lost[0].removeprefix(CARRIED[0]).removesuffix(CARRIED[1])
            raise SettingsError(
                f"{folder}: --carry-masks was stopped while it renamed {len(lost)} masks; give them their "
                f"names again, such as {called} to {lost[0]}"
            )
        by_frames = job.recording.segment_by == "masks"
        found = ((path.name, mask_name(path.name, plain_of_frame=by_frames)) for path in listed(folder))
        names = {file: name for file, name in sorted(found) if name is not None}
        stored = MasksFile.read_if_there(folder)
        return cls(job.recording.id, folder, names, {} if stored is None else stored.drawn_on)

    def tied_to_build(self, build: Path) -> tuple[Self, tuple[str, ...]]:
        """Write down which images in `build/<recording>/` masks without an entry were drawn on.

        It comes before anything is made again: what lies there is what the person saw.

        Returns:
            The masks with what was written; lines to tell: the frames that those named by views are for.
        """
        new = [file for file in self.names if file not in self.entries]
        manifest = whole_manifest(build / "sequence") if new else None
        if manifest is None:
            return self, ()
        entries, told = dict(self.entries), []
        with contextlib.suppress(KinectBenchError):  # a damaged build says nothing of a mask
            sequence = read_sequence(build / "sequence")
            frames = _frames_of_views(build / "views", manifest.fingerprint)
            for file in new:
                number, of_frame, _ = self.names[file]
                frame = number if of_frame else frames.get(number)
                if frame is not None and frame < len(sequence):
                    entries[file] = image_digest(sequence, frame)
                    told += [] if of_frame else [f"{file} on frame {frame}"]
        if len(entries) > len(self.entries):
            self._write(entries)
        lines = (f"{self.folder}: taken as drawn on views of the build: {first_of(told)}",) if told else ()
        return replace(self, entries=entries), lines

    def check_known(self) -> None:
        """Refuse masks named by views if nobody knows the images that they were drawn on.

        Raises:
            SettingsError: there is one; the line says what to do.
        """
        for file, name in self.names.items():
            if not name.of_frame and file not in self.entries:
                raise SettingsError(
                    f"{self.folder}/{file}: {UNKNOWN}, as the numbers of views change; name it by its frame, "
                    f"frame_<index>{name.kind}.png (views.json has the frames of views)"
                )

    def check_frames(self, sequence: Sequence) -> None:
        """Refuse masks of frames that are other images now.

        Those without an entry get one: no build was there when they were drawn.

        Raises:
            SettingsError: there are some; the line says how to carry them over.
        """
        found, wrong = dict[str, str](), list[str]()
        for file, (number, of_frame, _) in self.names.items():
            if of_frame and number >= len(sequence):
                wrong.append(f"{file} (the last frame is {len(sequence) - 1})")
            elif of_frame:
                found[file] = image_digest(sequence, number)
                wrong += [] if self.entries.get(file, found[file]) == found[file] else [file]
        if wrong:
            raise self._refusal(f"not drawn on what these frames are now: {first_of(wrong)}")
        if found.keys() - self.entries.keys():
            self._write({**self.entries, **found})

    def check_views(self, sequence: Sequence, views: Path) -> None:
        """Refuse masks named by views that are other images than they were drawn on.

        Args:
            sequence: the recording.
            views: the folder of its views, just made.

        Raises:
            SettingsError: there are some; the line says how to carry them over.
        """
        frames, wrong = _frames(views), []
        for file, (number, of_frame, _) in self.names.items():
            frame = frames.get(number)
            if of_frame or (frame is not None and self._is(file, sequence, frame)):
                continue
            now = "no view" if frame is None else f"frame {frame}"
            wrong.append(f"{file} ({number:03d} is {now} now)")
        if wrong:
            raise self._refusal(f"not drawn on what these views are now: {first_of(wrong)}")

    def carry(self, sequence: Sequence) -> Carried:
        """Name each mask by the frame of the recording that is the image it was drawn on."""
        frames: dict[str, int] = {}
        for frame in range(len(sequence)) if self.entries else ():
            frames.setdefault(image_digest(sequence, frame), frame)
        left, wanted = list[str](), dict[str, str]()
        for file, (number, of_frame, kind) in self.names.items():
            stays = of_frame and number < len(sequence) and self._is(file, sequence, number)
            if file not in self.entries:
                left.append(f"{self.folder}/{file}: {UNKNOWN}; look at it, and name it by its frame")
            elif stays or self.entries[file] in frames:
                frame = number if stays else frames[self.entries[file]]
                wanted[file] = f"frame_{frame:06d}{kind}.png"
            else:
                left.append(
                    f"{self.folder}/{file}: drawn on an image that the recording has no more; draw it again"
                )
        moves = {file: new for file, new in wanted.items() if file != new}
        while clashes := self._clashes(moves):
            left += [
                f"{self.folder}/{file}: {moves[file]} is there, too; remove one of them" for file in clashes
            ]
            moves = {file: new for file, new in moves.items() if file not in clashes}
        self._rename(moves)
        return Carried(tuple(moves.items()), tuple(left))

    def _clashes(self, moves: Mapping[str, str]) -> list[str]:
        """Files that would get the name that another has or gets."""
        files = Counter(moves.get(file, file) for file in self.names)
        return [file for file, new in moves.items() if files[new] > 1]

    def _rename(self, moves: Mapping[str, str]) -> None:
        """Give files their new names; one may take the name that another still has."""
        for file in moves:
            (self.folder / file).rename(self.folder / file.join(CARRIED))
        for file, new in moves.items():
            (self.folder / file.join(CARRIED)).rename(self.folder / new)
        self._write({moves.get(file, file): digest for file, digest in self.entries.items()}, moves)

    def _is(self, file: str, sequence: Sequence, frame: int) -> bool:
        return self.entries.get(file) == image_digest(sequence, frame)

    def _write(self, entries: Mapping[str, str], renamed: Mapping[str, str] | None = None) -> None:
        """Write masks.json, without masks that are gone."""
        there = {(renamed or {}).get(file, file) for file in self.names}
        kept = MasksFile.model_validate({file: entries[file] for file in sorted(there & entries.keys())})
        with replaced_file(self.folder / MasksFile.FILE) as temporary:
            temporary.write_text(kept.text(), encoding="utf-8")

    def _refusal(self, what: str) -> SettingsError:
        return SettingsError(
            f"{self.folder}: {what}; `kinectbench segment {self.recording} --carry-masks` names masks by the "
            f"frames that they were drawn on (drawn again since? remove their lines from {MasksFile.FILE})"
        )


def look_at_masks(job: Job, *, used: bool) -> tuple[str, ...]:
    """Tie masks to the images in the recording's build, before anything is made again; lines to tell.

    Args:
        job: the recording.
        used: whether views are to be sampled with them.

    Raises:
        SettingsError: they are to be used, and nobody knows which images they were drawn on.
    """
    drawn = DrawnMasks.of(job)
    if drawn is None:
        return ()
    drawn, lines = drawn.tied_to_build(job.build)
    if used and job.masks is not None:
        drawn.check_known()
    return lines


def carry_masks(job: Job) -> Carried:
    """Name the masks of a recording, whose sequence is current, by the frames that they were drawn on."""
    with locked(job.build):
        drawn = DrawnMasks.of(job)
        return Carried((), ()) if drawn is None else drawn.carry(read_sequence(job.build / "sequence"))


def image_digest(sequence: Sequence, frame: int) -> str:
    """SHA-256 of a frame's image: the size and every pixel of its depth, in native units, as recorded."""
    depth = sequence.frames.depth_native(frame)
    return hashlib.sha256(f"{depth.shape}".encode() + depth.astype("<u2").tobytes()).hexdigest()


def _frames_of_views(views: Path, sequence: str) -> Mapping[int, int]:
    """The frames of views by the views' numbers, if they are of the sequence with that fingerprint."""
    manifest = whole_manifest(views)
    return {} if manifest is None or manifest.inputs.get("ingest") != sequence else _frames(views)


def _frames(views: Path) -> Mapping[int, int]:
    rows = ViewsFile.read(views).views
    return {int(row.view): row.frame for row in rows if row.frame is not None}
