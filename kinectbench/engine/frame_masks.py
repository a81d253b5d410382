"""Masks for all frames of a recording: by the user, by the recording itself, or found on a turntable."""

from pathlib import Path

from kinectbench.core import SegmentationError
from kinectbench.core.own_pixels import Masks, whole
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Bools
from kinectbench.core.upright import upright_masks
from kinectbench.settings.models import SegmentBy, Vector4
from kinectbench.stages.sample_views.masks import mask_name
from kinectbench.stages.sample_views.views import read_masks
from kinectbench.stages.segment.find.moving import plane_below, turntable_masks


def frame_masks(sequence: Sequence, by: SegmentBy | None, folder: Path | None) -> Masks | None:
    """Return the masks that define the object, as a function from frame index to mask; None if `by` is None.

    Args:
        sequence: the recording.
        by: the source of the masks; None: no masks.
        folder: folder of the user's masks of frames; None: use the recording's own masks.

    Raises:
        SegmentationError: there are no masks, the user's masks cannot be used, or nothing turns.
    """
    if by is None:
        return None
    if by == "turntable":
        return turntable_masks(sequence)
    if folder is not None:
        return upright_masks(sequence, _of_folder(folder, sequence))
    if sequence.masks is None:
        raise SegmentationError(
            "`segment_by: masks` asks for masks, but the recording brings none: put one PNG per frame "
            "(0 = not the object), named by the frame such as frame_000012.png, into a folder, and name that "
            "folder as `masks` in benchmark.yaml",
            what="no-masks",
        )
    return sequence.masks


def plane_given(
    sequence: Sequence, trajectory: Trajectory, by: SegmentBy | None, floor: Vector4 | None
) -> Vector4 | None:
    """Return the plane below the object: `floor` if given, else the turntable's plane, if one is found.

    The plane is (a, b, c, d) in the world frame; None if there is neither.
    """
    if by != "turntable" or floor is not None:
        return floor
    plane_world = plane_below(whole(sequence), trajectory)
    if plane_world is None:
        return None
    a, b, c, d = (float(value) for value in plane_world)
    return a, b, c, d


def _of_folder(folder: Path, sequence: Sequence) -> Masks:
    """Read the user's masks `frame_<index>.png` or `<index>.png`; the index counts from 0, as in frames.json.

    Raises:
        SegmentationError: no file is named by a frame of the recording, two files are named by one frame, or
            a name says that the mask only adds to another mask or takes from it. The returned function raises
            it if a mask is damaged or has another size.
    """
    given = read_masks(folder)
    names: dict[int, str] = {}
    for name in given.names:
        named = mask_name(name, plain_of_frame=True)
        if named is None:
            continue
        if named.kind:
            raise SegmentationError(
                f"{folder}/{name}: with `segment_by: masks` a mask is all of the object in a frame, so that "
                f"nothing can be added or taken away; name the whole mask {name.replace(named.kind, '')}",
                what="bad-mask",
            )
        if (before := names.setdefault(named.number, name)) != name:
            raise SegmentationError(
                f"{folder}: {before} and {name} are masks of one frame; remove the one that is wrong",
                what="bad-mask",
            )
    last = len(sequence) - 1
    if not any(number <= last for number in names):
        raise SegmentationError(
            f"{folder}: holds no mask of a frame; for `segment_by: masks`, name the mask of each frame by "
            f"the frame's number, frame_000000.png to frame_{last:06d}.png",
            what="no-masks",
        )

    def mask(index: int) -> Bools | None:
        """Return the mask of a frame: (height, width) bool; None if the frame has no mask."""
        if index not in names:
            return None
        own, size = given.read(names[index]), (sequence.camera.height, sequence.camera.width)
        if own.shape != size:
            raise SegmentationError(
                f"{folder}/{names[index]}: the mask is {own.shape[1]}x{own.shape[0]}, the depth image "
                f"{size[1]}x{size[0]}; draw it in depth pixels",
                what="mask-size",
            )
        return own

    return mask
