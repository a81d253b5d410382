"""Plain folders: `depth/` and `color/` images with a file of intrinsics, as Open3D and Redwood use them."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import ClassVar, Self

from kinectbench.core import listed_paths, printable
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.trajectory_file import read_given, trajectory_from_matrices
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.depth_files import (
    SUFFIXES,
    decode_depth_file,
    is_measured,
    kind_of,
    packed_channels,
    units_a_metre,
)
from kinectbench.stages.ingest.image_names import NUMBER_AND_STAMP, several_series, stamps_of_names
from kinectbench.stages.ingest.images import (
    FLOAT_SCALE,
    DamagedImageError,
    OddImageError,
    decode_color_bgr,
    is_depth_png,
)
from kinectbench.stages.ingest.intrinsics import (
    Intrinsics,
    gives_intrinsics,
    read_color_calibration,
    said_warnings,
)
from kinectbench.stages.ingest.intrinsics_files import (
    JSON_FILES,
    MATRIX_FILES,
    camera_file,
    find_intrinsics,
    named_like_intrinsics,
    passed_over,
)
from kinectbench.stages.ingest.known_names import (
    clashing,
    first_named,
    in_any_case,
    in_order,
    misnamed,
    visible,
)
from kinectbench.stages.ingest.pairing import pair_images
from kinectbench.stages.ingest.readers.folder_images import (
    COLOR_FOLDERS,
    LEAST_IMAGES,
    NamedImages,
    color_images,
    depth_images,
    folder_of_both,
    other_depth,
    unread_color,
    unread_depth,
)
from kinectbench.stages.ingest.readers.phone_images import ConfidenceRecording, confidence_beside
from kinectbench.stages.ingest.readers.pose_files import (
    POSE_FILES,
    POSE_FOLDERS,
    named_poses,
    pose_file,
    pose_folder,
    read_pose_file,
    read_pose_folder,
    with_y_down,
)
from kinectbench.stages.ingest.readers.redwood_log import read_log, starts_like_a_log
from kinectbench.stages.ingest.recording import (
    COLOR_DELAY,
    FrameFiles,
    first_color_size,
    first_depth_size,
    first_whole,
    read_image_file,
    unmatched_masks,
    with_masks,
)

DEPTH_SCALE = 1000.0
# What makes the folder a recording of TUM's layout, and folders that are read if they are there.
ALSO_READ = ("depth.txt", "masks", "confidence")
NAMED_FILES = (*JSON_FILES, *MATRIX_FILES, "trajectory.txt", "trajectory.log", *POSE_FILES, *POSE_FOLDERS)
# The PrimeSense camera of Redwood's scans, by the data set's documents.
PRIMESENSE = Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5)


@dataclass(frozen=True)
class DepthFormat:
    """How the depth files of a folder are to be read; by default, they are 16-bit PNG.

    Attributes:
        depth_scale: units per metre to which float depth is converted; None: depth is not float.
        float_scale: units per metre of the stored floats; None: depth is not float.
        channels: the 8-bit channels with the high and the low byte; None: one channel.
        kind: the type of the values and an example file, as in `FileRecording`.
        warnings: lines for the user.
    """

    depth_scale: float | None = None
    float_scale: float | None = None
    channels: tuple[int, int] | None = None
    kind: tuple[str, Path] | None = None
    warnings: tuple[str, ...] = ()

    @classmethod
    def of(cls, files: Sequence[FrameFiles], given: float | None) -> "DepthFormat":
        """Determine the format from the first undamaged depth image, preferably one that is not empty.

        Args:
            files: the frames.
            given: units per metre of stored floats; None: judged by the values.
        """
        for empty_too in (False, True):
            with suppress(DamagedImageError):
                return first_whole(partial(cls._of, given, empty_too), [frame.depth for frame in files])
        return cls()

    @classmethod
    def _of(cls, given: float | None, empty_too: bool, file: Path) -> "DepthFormat":
        data = read_image_file(file)
        channels = packed_channels(data, str(file))
        if channels is not None:
            high, low = (("blue", "green", "red")[channel] for channel in channels)
            warning = (
                f"{file}: depth is read from two 8-bit channels: its high byte is {high}, its low one {low}"
            )
            return cls(channels=channels, warnings=(warning,))
        if file.suffix.lower() == ".png":
            if not (empty_too or is_depth_png(data) or decode_color_bgr(data, str(file)).any()):
                raise OddImageError(f"{file}: is empty")
            return cls()
        depth = decode_depth_file(data, str(file))
        if not (empty_too or is_measured(depth).any()):
            raise OddImageError(f"{file}: is empty")
        units, kind = units_a_metre(depth), (kind_of(depth), file)
        if units is None:
            return cls(kind=kind)
        warning = f"{file}: its floats are taken for millimetres; if not, give `depth_scale` (units a metre)"
        mm = given is None and units != 1
        return cls(FLOAT_SCALE, given or units, kind=kind, warnings=(warning,) if mm else ())


class FolderRecording(ConfidenceRecording):
    """A folder with `depth/`, optionally `color/` (or rgb/, image/), intrinsics, and optionally a trajectory.

    If file names contain stamps, these are the frames' stamps, and pair colour with depth. Without stamps,
    the number in a name, or else the position in the list, counts as seconds.
    """

    format: ClassVar[str] = "folder"
    uses: ClassVar[frozenset[str]] = COLOR_DELAY | {"min_confidence"}
    looks_for: ClassVar[str] = (
        "a folder with depth/*.png, .npy, .npz or .tiff (and color/, masks/, confidence/, "
        "intrinsics.json, trajectory.log or pose/), or with 000000-depth.png beside 000000-color.jpg"
    )
    verified: ClassVar[str] = "folders and trajectories that Open3D reads the same"

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder has depth images, in its subfolder depth/ or next to colour images.

        A few images in Depth/, DEPTH/ and so on do not suffice without a folder of colour or intrinsics.
        """
        depth = in_any_case(path, "depth")
        if depth.is_dir():
            images = listed_paths(depth, wanted=lambda name: Path(name).suffix.lower() in SUFFIXES)
            others = in_order(path, (*COLOR_FOLDERS, *JSON_FILES, *MATRIX_FILES))
            sure = depth.name == "depth" or any(other.exists() for other in others)
            least = 1 if sure else LEAST_IMAGES
            return len(list(islice(images, least))) == least
        return folder_of_both(path) is not None

    @classmethod
    def files_beside(cls, path: Path) -> tuple[Path, ...]:
        """Return the file of intrinsics that NICE-SLAM's scenes share, if the folder has none; else ()."""
        file = camera_file(path)
        return () if file is None or file.parent == path else (file,)

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """List the images, pair them by times or numbers in their names, and read camera and trajectory."""
        depth = depth_images(path)
        files, recorded, paired = pair_files(depth, color_images(path), settings, path)
        files = with_masks(files, path)
        stamps_ns = list(recorded[0])
        size_px = first_depth_size(files)
        confidence, full_confidence, of_confidence = confidence_beside(
            path, files, size_px, settings.min_confidence
        )
        said, json_file = find_intrinsics(path, settings, DEPTH_SCALE)
        if json_file is None and said == Intrinsics() and not gives_intrinsics(settings):
            said = _usual_intrinsics(path, depth.stems, size_px)
        intrinsics = said.overridden_by(settings)
        registered = intrinsics.color_registered
        stored = DepthFormat.of(files, settings.depth_scale)
        trajectory, warnings, error = read_given(
            lambda: _read_trajectory(path, stamps_ns, files, depth.stems)
        )
        if trajectory is not None and intrinsics.y_up:
            trajectory, note = with_y_down(trajectory, path)
            warnings = [*warnings, note]
        return cls(
            path=path,
            places=files,
            camera=intrinsics.camera(size_px, path, named_like_intrinsics),
            depth_scale=stored.depth_scale or intrinsics.depth_scale or DEPTH_SCALE,
            float_scale=stored.float_scale,
            channels=stored.channels,
            kind=stored.kind,
            color_registered=first_color_size(files) == size_px if registered is None else registered,
            color_calibration=read_color_calibration(json_file) if json_file else None,
            recorded=recorded,
            confidence=confidence,
            min_confidence=settings.min_confidence,
            full_confidence=full_confidence,
            given_trajectory=trajectory,
            trajectory_error=error,
            warnings=(
                *unread_depth(path, depth),
                *other_depth(path),
                *(() if any(file.color for file in files) else unread_color(path)),
                *paired,
                *_said_series(path, several_series(depth.stems)),
                *stored.warnings,
                *(f"{path}: {line}" for line in misnamed(path, ALSO_READ)),
                *(f"{path}: {line}" for line in clashing(path, ("depth", *COLOR_FOLDERS, *NAMED_FILES))),
                *said_warnings(path, said, settings),
                *warnings,
                *unmatched_masks(path, files),
                *of_confidence,
            ),
        )


def pair_files(
    depth: NamedImages, color: NamedImages, settings: CameraSettings, path: Path
) -> tuple[tuple[FrameFiles, ...], tuple[tuple[int, ...], tuple[int, ...]], tuple[str, ...]]:
    """Pair two lists of images by their names into frames, which have no masks yet.

    Both lists are in numeric order; that of colour may be empty.

    Returns:
        The frames sorted by stamp; the stamps of depth and of colour in the order of the lists, for
            `Recording.recorded`; and warnings.

    Raises:
        RecordingError: the names allow no pairing.
    """
    partners, color_ns = pair_images(
        depth.stems, color.stems, delay_s=settings.color_delay_s, where=str(path)
    )
    stamps_ns = stamps_of_names(depth.stems)
    of_depth = [None if j is None else color.files[j] for j in partners.of_depth]
    order = sorted(range(len(depth.files)), key=stamps_ns.__getitem__)
    files = tuple(FrameFiles(stamps_ns[i], depth.files[i], of_depth[i]) for i in order)
    return files, (tuple(stamps_ns), color_ns), partners.warnings


def _said_series(path: Path, firsts: Sequence[str]) -> tuple[str, ...]:
    """Return a warning on names of several cameras or recordings in one folder; () if they are of one."""
    if not firsts:
        return ()
    line = f"the names of depth are {len(firsts)} series, which begin with {printable(', '.join(firsts))}"
    return (f"{path}: {line}: if they are of several cameras or recordings, give each its own folder",)


def _usual_intrinsics(path: Path, stems: Sequence[str], size_px: tuple[int, int]) -> Intrinsics:
    """Return Redwood's intrinsics if names and size are as in Redwood's scans, else empty intrinsics."""
    if not (NUMBER_AND_STAMP.fullmatch(stems[0]) and size_px == (PRIMESENSE.width, PRIMESENSE.height)):
        return Intrinsics()
    note = f"{path}: has no intrinsics; those of Redwood's PrimeSense camera are taken"
    return replace(PRIMESENSE, notes=(note,))


def _read_trajectory(
    path: Path, stamps_ns: list[int], files: Sequence[FrameFiles], stems: Sequence[str]
) -> tuple[GivenTrajectory | None, list[str]]:
    beside = visible(path, "*.log", "*.freiburg", "*.json", "*.txt")
    logs = sorted(file for file in beside if file.suffix.lower() == ".log" and starts_like_a_log(file))
    file = first_named(path, ("trajectory.txt", "trajectory.log")) or (logs[0] if len(logs) == 1 else None)
    names = (*(log.name for log in logs), *POSE_FILES)
    if file is not None and file.suffix.lower() == ".log":
        matrices = read_log(file, len(stamps_ns))
        trajectory, warnings = trajectory_from_matrices(stamps_ns, matrices, str(file))
        return trajectory, [*warnings, *passed_over(file, names)]
    if pose_folder(path) and file is None:
        return read_pose_folder(path, files)
    in_one = file or pose_file(path, beside)
    if in_one is None:
        return named_poses(path, beside, stamps_ns, stems)
    trajectory, warnings = read_pose_file(in_one, stamps_ns, stems)
    return trajectory, [*warnings, *passed_over(in_one, names)]
