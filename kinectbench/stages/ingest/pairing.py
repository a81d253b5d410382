"""Pair colour with depth images: by nearest time if they have stamps, else by name.

All readers of two streams use this. An image without partner stays alone, and a warning counts such images.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from kinectbench.core import RecordingError, printable
from kinectbench.core.trajectory.association import associate, pairing_tolerance_ns
from kinectbench.core.trajectory.stamps import NS_PER_S
from kinectbench.stages.ingest.image_names import counting_key, frame_key, frame_numbers, times_of_names

# From this share of depth on, misplaced names are taken for such, and not for lost frames (chosen by hand).
MUCH_UNLIKE = 0.25


class NamesDiffer(str):
    """A warning that images of one frame have different names in the two streams, not that some are lost."""

    __slots__ = ()


@dataclass(frozen=True)
class Partners:
    """The colour image of each depth image.

    Attributes:
        of_depth: for each depth image, the index of its colour image; None if it has none. An index occurs at
            most once.
        warnings: on depth images without a colour image, and on pairing by mere order.
    """

    of_depth: tuple[int | None, ...]
    warnings: tuple[str, ...] = ()


def pair_by_time(depth_ns: Sequence[int], color_ns: Sequence[int], *, delay_s: float, where: str) -> Partners:
    """Pair images whose stamps are at most `pairing_tolerance_ns` apart: about half a frame, up to 20 ms.

    Args:
        depth_ns: stamps of depth, nanoseconds, strictly increasing.
        color_ns: stamps of colour, nanoseconds, strictly increasing.
        delay_s: delay of colour's stamps, from the settings, seconds; it is subtracted from them.
        where: file or topic, for warnings.
    """
    delay_ns = round(delay_s * NS_PER_S)
    on_clock_ns = [stamp_ns - delay_ns for stamp_ns in color_ns]
    tolerance_ns = pairing_tolerance_ns(depth_ns, on_clock_ns)
    partners = associate(depth_ns, on_clock_ns, tolerance_ns)
    how = f"frame within {tolerance_ns / 1e6:.0f} ms"
    return Partners(tuple(partners), _lone(partners, len(color_ns), how, where))


def pair_images(
    depth: Sequence[str], color: Sequence[str], *, delay_s: float, where: str
) -> tuple[Partners, tuple[int, ...]]:
    """Pair two streams of images by their names alone.

    They are paired by time if the names of both streams contain stamps. Otherwise they are paired by name if
    any names agree, else by the frame numbers in the names if any agree, else by order if both streams have
    the same number of images. Names are without suffix: of depth in any order, of colour in numeric order.
    The delay is subtracted from colour's stamps.

    Returns:
        The partners; and, if paired by time, the stamps in the names of colour, nanoseconds, else ().

    Raises:
        RecordingError: the names allow no pairing.
    """
    depth_ns, color_ns = times_of_names(depth), times_of_names(color)
    if depth_ns is not None and color_ns is not None:
        partners = _by_times(depth_ns, color_ns, delay_s, where)
        return replace(partners, warnings=_hinted(partners.warnings, depth, color)), tuple(color_ns)
    return _by_names(depth, color, where), ()


def _lone(partners: Sequence[int | None], colors: int, how: str, where: str) -> tuple[str, ...]:
    """Return a warning with the number of depth frames without colour; () if 0, or without any colour."""
    alone = sum(partner is None for partner in partners)
    line = f"{where}: {alone} of {len(partners)} depth frames have no colour {how}"
    return (line,) if colors and alone else ()


def _by_times(depth_ns: Sequence[int], color_ns: Sequence[int], delay_s: float, where: str) -> Partners:
    """Pair as `pair_by_time` does, but with stamps in any order."""
    depth_order, color_order = (
        sorted(range(len(stamps_ns)), key=stamps_ns.__getitem__) for stamps_ns in (depth_ns, color_ns)
    )
    pairs = pair_by_time(
        [depth_ns[i] for i in depth_order], [color_ns[j] for j in color_order], delay_s=delay_s, where=where
    )
    partners: list[int | None] = [None] * len(depth_ns)
    for i, j in zip(depth_order, pairs.of_depth, strict=True):
        partners[i] = None if j is None else color_order[j]
    return Partners(tuple(partners), pairs.warnings)


def _by_names(depth: Sequence[str], color: Sequence[str], where: str) -> Partners:
    by_name = _same([frame_key(stem) for stem in depth], [frame_key(stem) for stem in color])
    if not color or any(partner is not None for partner in by_name):
        lone = _lone(by_name, len(color), "of their name", where)
        return Partners(by_name, _hinted(lone, depth, color, _apart(depth, color)))
    depth_numbers, color_numbers = frame_numbers(depth), frame_numbers(color)
    if depth_numbers is not None and color_numbers is not None:
        by_number = _same(depth_numbers, color_numbers)
        if any(partner is not None for partner in by_number):
            lone = _lone(by_number, len(color), "of their number", where)
            return Partners(by_number, _hinted(lone, depth, color, _apart(depth, color)))
    if len(color) != len(depth):
        raise RecordingError(
            f"{where}: {len(depth)} depth and {len(color)} colour images, and no names agree: give images of "
            "one frame the same name, or name all by their time stamps in seconds, such as 12.033367.png",
            what="unpaired",
        )
    message = (
        f"{where}: no names of depth and colour agree: their {len(depth)} images each are paired in their "
        "order; give images of one frame the same name, or name all by their time stamps in seconds"
    )
    return Partners(tuple(range(len(color))), (message,))


def _same(depth: Sequence[object], color: Sequence[object]) -> tuple[int | None, ...]:
    """Return for each depth key the index of the colour image with this key, None if none is left.

    A colour image is paired with the first depth image of its key only.
    """
    index = {key: place for place, key in enumerate(color)}
    return tuple(index.pop(key, None) for key in depth)


def _hinted(
    warnings: Sequence[str], depth: Sequence[str], color: Sequence[str], apart: str = ""
) -> tuple[str, ...]:
    """Return warnings on lone depth with a hint on names without partner in both streams, if half agree.

    They are `NamesDiffer` if many lone names of depth lie outside those of colour, and as many lone ones of
    colour between those of depth. Streams without one name or number in common are not meant to have any.
    Other warnings also have the hint `apart`.
    """
    keys = [[frame_key(stem) for stem in stems] for stems in (depth, color)]
    if not set(keys[0]) & set(keys[1]):
        keys = [[str(number) for number in frame_numbers(stems) or ()] for stems in (depth, color)]
    lone = [
        [(stem, counting_key(key)) for stem, key in zip(stems, own, strict=False) if key not in others]
        for stems, own, others in ((depth, keys[0], set(keys[1])), (color, keys[1], set(keys[0])))
    ]
    of_depth, of_color = map(len, lone)
    if not (of_depth and of_color) or 2 * of_depth > len(depth):
        return tuple(f"{line}{apart}" for line in warnings)
    (depth_name, _), (color_name, _) = lone[0][0], lone[1][0]
    hint = (
        f"; {of_color} colour images have no depth of their name, such as {printable(color_name)} "
        f"({printable(depth_name)} is depth without colour)"
    )
    spans = [sorted(map(counting_key, own)) for own in keys]
    inside = [
        [span[0] <= key <= span[-1] for _, key in own] for own, span in zip(lone, spans[::-1], strict=True)
    ]
    many = MUCH_UNLIKE * len(depth) <= of_depth <= of_color
    if many and not any(inside[0]) and all(inside[1]):
        return tuple(NamesDiffer(f"{line}{hint}") for line in warnings)
    return tuple(f"{line}{apart}{hint}" for line in warnings)


def _apart(depth: Sequence[str], color: Sequence[str]) -> str:
    """Return a hint for a warning if two streams have different numbers; "" if not, or without numbers."""
    depth_numbers, color_numbers = frame_numbers(depth), frame_numbers(color)
    if depth_numbers is None or color_numbers is None:
        return ""
    if (min(depth_numbers), max(depth_numbers)) == (min(color_numbers), max(color_numbers)):
        return ""
    first, second = (f"{min(numbers)} to {max(numbers)}" for numbers in (depth_numbers, color_numbers))
    return (
        f"; depth is numbered {first}, colour {second}: if each stream counts its own frames, equal numbers "
        "are not of one time: name the images by their time stamps in seconds"
    )
