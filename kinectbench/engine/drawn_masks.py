"""Check that the user's masks are used on the images they were drawn on, which masks.json records.

masks.json stores digests of these images. The number of a view or frame does not suffice: it may stand for
another image after the next build. A mask without an entry gets one before a build replaces the images in
`build/`: it counts as drawn on these images or, if there is no build yet, on the frame that its name gives.
"""

import contextlib
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, Self

from kinectbench.core import (
    KinectBenchError,
    SettingsError,
    StorageError,
    listed_paths,
    printable,
    replaced_file,
)
from kinectbench.core.artefacts.views import RECORDED, DrawnOn, MasksFile
from kinectbench.core.sequence import Sequence
from kinectbench.engine.artefact import whole_manifest
from kinectbench.engine.drawn_images import Shown, image_digest, picture_digests, views_of, views_shown
from kinectbench.engine.locks import locked
from kinectbench.engine.stages import Job
from kinectbench.stages.ingest.sequence_folder import read_sequence
from kinectbench.stages.sample_views.masks import MaskName, first_of, mask_name
from kinectbench.stages.sample_views.views import picture_digest, pictures_of, read_pictures

UNKNOWN = "nobody knows which image it was drawn on"
OTHERS_DRAWN = (
    "drawn on other pictures than the views of these frames are now, by other poses or another correction"
)
VIEWS_DRAWN = "`segment_by: masks` takes masks of frames as they were recorded, and these were drawn on views"
# Temporary name of a mask that is being renamed: its old name between these two.
CARRIED = (".", ".carried")


class Carried(NamedTuple):
    """The result of renaming masks to the frames they were drawn on.

    Attributes:
        moved: (old name, new name) of each renamed mask.
        left: one line for each mask that could not be renamed.
    """

    moved: tuple[tuple[str, str], ...]
    left: tuple[str, ...]


@dataclass(frozen=True)
class DrawnMasks:
    """The masks that the user drew for a recording.

    Attributes:
        recording: id of the recording.
        folder: folder of the masks.
        names: {file name: its parsed name} of all files that are masks by their names.
        entries: the image that each mask was drawn on, if known, by file name.
        of_recorded: whether the masks were drawn on frames as recorded, not on pictures of views.
    """

    recording: str
    folder: Path
    names: Mapping[str, MaskName]
    entries: Mapping[str, DrawnOn]
    of_recorded: bool = False

    @classmethod
    def of(cls, job: Job) -> Self | None:
        """Read the masks in the folder that benchmark.yaml names or in the default one; None if it is absent.

        Raises:
            StorageError: masks.json is damaged.
            SettingsError: a run was killed while it renamed masks, and some have no valid name.
        """
        folder = job.masks or job.unused_masks
        if folder is None or not folder.is_dir():
            return None
        if lost := sorted(path.name for path in folder.glob("*".join(CARRIED))):
            called = lost[0].removeprefix(CARRIED[0]).removesuffix(CARRIED[1])
            raise SettingsError(
                f"{folder}: --carry-masks was stopped while it renamed {len(lost)} masks; give them their "
                f"names again, such as {called} to {lost[0]}",
                what="stale-masks",
            )
        by_frames = job.recording.segment_by == "masks"
        named = ((path.name, mask_name(path.name, plain_of_frame=by_frames)) for path in listed_paths(folder))
        names = {file: name for file, name in sorted(named) if name is not None}
        stored = MasksFile.read_if_there(folder)
        return cls(job.recording.id, folder, names, {} if stored is None else stored.drawn_on, by_frames)

    def bound_to_build(self, build: Path) -> tuple[Self, tuple[str, ...]]:
        """Record that new masks were drawn on the present images and pictures of `build/<recording>/`.

        This runs before anything is made again, because the user drew on the existing pictures.

        Returns:
            The masks with the new entries, and lines to print: the frames assumed for masks named by views.
        """
        new = [file for file in self.names if file not in self.entries]
        manifest = whole_manifest(build / "sequence") if new else None
        if manifest is None:
            return self, ()
        entries, seen = dict[str, DrawnOn](), list[str]()
        with contextlib.suppress(KinectBenchError):  # a damaged build has no images
            sequence = read_sequence(build / "sequence")
            shown = views_of(build / "views", manifest.fingerprint)
            for file in new:
                number, of_frame, _ = self.names[file]
                view = shown.get((number, of_frame))
                frame = view.frame if view else number if of_frame else None
                if frame is not None and frame < len(sequence):
                    picture = RECORDED if self.of_recorded else self._picture(build / "views", view)
                    entries[file] = DrawnOn(image=image_digest(sequence, frame), picture=picture)
                    seen += [] if of_frame else [f"{file} on frame {frame}"]
        lines = (f"{self.folder}: taken as drawn on views of the build: {first_of(seen)}",) if seen else ()
        return self._with(entries), lines

    @staticmethod
    def _picture(views: Path, view: Shown | None) -> str | None:
        """Return the digest of a view's pictures in a build; None if they are missing or damaged."""
        with contextlib.suppress(StorageError):
            return None if view is None else picture_digest(read_pictures(views, view.name))
        return None

    def check_known(self) -> None:
        """Refuse masks that are named by views and whose image is not recorded in masks.json.

        Raises:
            SettingsError: there is such a mask; the line says what to do.
        """
        for file, name in self.names.items():
            if not name.of_frame and file not in self.entries:
                raise SettingsError(
                    f"{self.folder}/{file}: {UNKNOWN}, as the numbers of views change; name it by its frame, "
                    f"frame_<index>{name.kind}.png (views.json has the frames of views)",
                    what="stale-masks",
                )

    def check_numbers(self, frames: int) -> None:
        """Refuse masks of frame numbers that the recording does not have.

        Raises:
            SettingsError: there are such masks; the line names them.
        """
        beyond = [file for file, name in self.names.items() if name.of_frame and name.number >= frames]
        if not beyond:
            return
        what = f"the recording has frames 0 to {frames - 1}, and no frame of {first_of(beyond)}"
        if any(file in self.entries for file in beyond):
            raise self._refusal(what)
        raise SettingsError(
            f"{self.folder}: {what}: name these masks by their frames, or remove them", what="stale-masks"
        )

    def check_frames(self, sequence: Sequence) -> Self:
        """Refuse masks of frames that are missing or have other depth; return the masks with new entries.

        If `of_recorded`, also refuse masks drawn on pictures that differ from the recorded frames. Masks
        without an entry get one: there was no build when they were drawn.

        Raises:
            SettingsError: there are such masks; the line says what to do.
        """
        entries, wrong = dict[str, DrawnOn](), list[str]()
        for file, (number, of_frame, _) in self.names.items():
            if of_frame and number >= len(sequence):
                wrong.append(f"{file} (the last frame is {len(sequence) - 1})")
            elif of_frame and file not in self.entries:
                entries[file] = DrawnOn(image=image_digest(sequence, number))
            elif of_frame and not self._is(file, sequence, number):
                wrong.append(file)
        if wrong:
            raise self._refusal(f"not drawn on what these frames are now: {first_of(wrong)}")
        drawn = self._with(entries)
        if not self.of_recorded:
            return drawn
        frames = {file: (name.number, RECORDED) for file, name in self.names.items()}
        return drawn._check_pictures(
            sequence, frames, VIEWS_DRAWN, "look at each mask on the recording's own image"
        )

    def check_views(self, sequence: Sequence, views: Path) -> Self:
        """Refuse masks drawn on other frames or pictures than the views have; return them with new entries.

        Masks drawn on recorded frames (`of_recorded`) are not checked here. A mask named by a frame is
        compared with the view that shows this frame, if any. If masks.json has no digest of a mask's picture
        yet, the digest of the view's picture is recorded.

        Raises:
            SettingsError: there are such masks; the line says what to do.
        """
        if self.of_recorded:
            return self
        shown, wrong = views_shown(views), list[str]()
        for file, (number, of_frame, _) in self.names.items():
            view = shown.get((number, of_frame))
            if of_frame or (view is not None and self._is(file, sequence, view.frame)):
                continue
            now = "no view" if view is None else f"frame {view.frame}"
            wrong.append(f"{file} ({number:03d} is {now} now)")
        if wrong:
            raise self._refusal(f"not drawn on what these views are now: {first_of(wrong)}")
        frames = dict[str, tuple[int, str]]()
        for file, name in self.names.items():
            if view := shown.get((name.number, name.of_frame)):  # otherwise no view shows its frame
                frames[file] = view.frame, self._picture_now(file, sequence, views, view)
        again = f"`kinectbench sample-views {self.recording} --set recordings.{self.recording}.masks=null`"
        look = f"{again} makes the views without masks: look at each mask on its view there"
        return self._check_pictures(sequence, frames, OTHERS_DRAWN, look)

    def _picture_now(self, file: str, sequence: Sequence, views: Path, view: Shown) -> str:
        """Return the digest of a view's pictures, or the recorded digest if colour has only lost metadata."""
        pictures, known = read_pictures(views, view.name), self.entries[file].picture
        return known if known in picture_digests(pictures, sequence, view.frame) else picture_digest(pictures)

    def _check_pictures(
        self, sequence: Sequence, frames: Mapping[str, tuple[int, str]], drawn: str, look: str
    ) -> Self:
        """Refuse masks drawn on other pictures than `frames` says; record the picture where none is recorded.

        `frames` is {mask: (frame, digest of its pictures now)}; `drawn` and `look` are parts of the error.
        """
        entries, other = dict[str, DrawnOn](), list[str]()
        for file, (frame, now) in frames.items():
            image, was = self.entries[file].image, self.entries[file].picture
            if was is None:
                entries[file] = DrawnOn(image=image, picture=now)
            elif was != now and not (  # pictures of an uncorrected view equal the recorded frame
                RECORDED in (was, now)
                and {was, now} & picture_digests(pictures_of(sequence, frame), sequence, frame)
            ):
                other.append(file)
        if other:
            raise SettingsError(
                f"{self.folder}: {drawn}: {first_of(other)}; {look}, draw it again where it does not fit, "
                f"and remove its entry from {MasksFile.FILE}",
                what="stale-masks",
            )
        return self._with(entries)

    def carry(self, sequence: Sequence) -> Carried:
        """Rename each mask to the frame whose image it was drawn on."""
        frames: dict[str, int] = {}
        for frame in range(len(sequence)) if self.entries else ():
            frames.setdefault(image_digest(sequence, frame), frame)
        left, wanted = list[str](), dict[str, str]()
        for file, (number, of_frame, kind) in self.names.items():
            stays = of_frame and number < len(sequence) and self._is(file, sequence, number)
            if file not in self.entries:
                left.append(f"{self.folder}/{file}: {UNKNOWN}; look at it, and name it by its frame")
            elif stays or self.entries[file].image in frames:
                frame = number if stays else frames[self.entries[file].image]
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
        """Return the masks (old names) whose new name another mask has or is about to get."""
        files = Counter(moves.get(file, file) for file in self.names)
        return [file for file, new in moves.items() if files[new] > 1]

    def _rename(self, moves: Mapping[str, str]) -> None:
        """Rename files, given as {old name: new name}; a new name may be another file's old name."""
        for file in moves:
            (self.folder / file).rename(self.folder / file.join(CARRIED))
        for file, new in moves.items():
            (self.folder / file.join(CARRIED)).rename(self.folder / new)
        if moves or self.entries:
            self._write({moves.get(file, file): on for file, on in self.entries.items()}, moves)

    def _is(self, file: str, sequence: Sequence, frame: int) -> bool:
        on = self.entries.get(file)
        return on is not None and on.image == image_digest(sequence, frame)

    def _with(self, new_entries: Mapping[str, DrawnOn]) -> Self:
        """Return a copy with additional entries; masks.json is written if there are any."""
        if not new_entries:
            return self
        entries = {**self.entries, **new_entries}
        self._write(entries)
        return replace(self, entries=entries)

    def _write(self, entries: Mapping[str, DrawnOn], renamed: Mapping[str, str] | None = None) -> None:
        """Write masks.json with the entries of existing masks; `renamed` maps their old to new names."""
        present = {(renamed or {}).get(file, file) for file in self.names}
        kept = MasksFile.of({file: entries[file] for file in sorted(present & entries.keys())})
        with replaced_file(self.folder / MasksFile.FILE) as temporary:
            temporary.write_text(kept.text(), encoding="utf-8")

    def _refusal(self, what: str) -> SettingsError:
        return SettingsError(
            f"{self.folder}: {what}; `kinectbench segment {self.recording} --carry-masks` names masks by the "
            f"frames that they were drawn on (drawn again since? remove their entries from {MasksFile.FILE})",
            what="stale-masks",
        )


def look_at_masks(job: Job, *, used: bool) -> tuple[str, ...]:
    """Record which images the user's masks were drawn on; call this before a build replaces these images.

    Args:
        job: the recording.
        used: whether views will be sampled with the masks.

    Returns:
        Lines to print: which images are assumed for masks, and which files are not used because of their
        names.

    Raises:
        StorageError: masks.json is damaged or cannot be written.
        SettingsError: masks are in use, but the image of one is unknown; or as in `DrawnMasks.of`.
    """
    drawn = DrawnMasks.of(job)
    if drawn is None:
        return ()
    drawn, lines = drawn.bound_to_build(job.build)
    if used and job.masks is not None:
        drawn.check_known()
        lines += _unnamed(drawn)
    return lines


def _unnamed(drawn: DrawnMasks) -> tuple[str, ...]:
    """Return a line about PNG files not used because their names give no frame or view; () if none."""
    pngs = (path.name for path in listed_paths(drawn.folder) if path.suffix.lower() == ".png")
    others = sorted(name for name in pngs if name not in drawn.names and not name.startswith("."))
    if not others:
        return ()
    shown = first_of([printable(name) for name in others])
    advice = "name the mask of a frame by its number, from 0, such as frame_000012.png"
    return (f"{drawn.folder}: not used, as their names name no frame: {shown}; {advice}",)


def check_mask_numbers(job: Job) -> None:
    """Refuse masks of frames that a recording does not have; its sequence must be up to date.

    Raises:
        SettingsError: there are such masks; or as in `DrawnMasks.of`.
        StorageError: masks.json or the sequence is damaged.
    """
    drawn = DrawnMasks.of(job)
    if drawn is not None and any(name.of_frame for name in drawn.names.values()):
        drawn.check_numbers(len(read_sequence(job.build / "sequence")))


def carry_masks(job: Job) -> Carried:
    """Rename a recording's masks to the frames they were drawn on; its sequence must be up to date."""
    with locked(job.build):
        drawn = DrawnMasks.of(job)
        return Carried((), ()) if drawn is None else drawn.carry(read_sequence(job.build / "sequence"))
