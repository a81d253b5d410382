"""Checks of depth (unit, byte order, invalid codes, coverage), and of intrinsics."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.reconstruction import DepthRangePart
from kinectbench.doctor.finding import Finding, Severity
from kinectbench.doctor.probe import Probe
from kinectbench.settings.models import FusionSettings
from kinectbench.stages.fuse.depth_range import depth_range, range_warnings, sample_depth
from kinectbench.stages.ingest.depth_codes import Pattern, find_pattern, float16_m
from kinectbench.stages.ingest.images import advice_on
from kinectbench.stages.ingest.intrinsics import OFF_CENTRE, Intrinsics, ratio_by_centre
from kinectbench.stages.ingest.plausibility import (
    FIND_DEPTH,
    KEEP_SIZE,
    MAX_DAMAGED,
    SEPARATE,
    scale_problem,
    suggested_scale,
)
from kinectbench.stages.ingest.recording import FileRecording

# Range of horizontal fields of view of hand-held cameras, degrees.
NARROWEST_DEG, WIDEST_DEG = 35.0, 110.0
MAX_ASPECT = 1.1
# Plausible range of the median depth, and limit of the 95 % quantile, metres. Public recordings of objects on
# tables, in the right unit, have medians down to 0.21 m (five data sets: 0.21, 0.31, 0.415, 0.42, 0.43 m).
LIKELY_MEDIAN_M = (0.2, 6.0)
LIKELY_FAR_M = 12.0
# Depth as the bits of a float16: nearly all is farther, metres (chosen by hand), and none is infinite.
NEAREST_M, NO_FLOAT16 = 0.1, 0x7C00
# Where depth in mm would show a room, a median nearer than this is unlikely (chosen by hand).
ROOM_UNITS, ROOM_MEDIAN_M, NEAR_MEDIAN_M = 1000.0, (0.9, 2.5), 0.45
# With swapped bytes, neighbouring pixels differ by this factor more; smaller relative differences than the
# second are those of a flat wall, whichever the order (our own bound).
SMOOTHER, SMOOTHEST = 5.0, 1e-4
# A maximum that is this frequent, and this far beyond all other values, is an invalid code.
CODE_SHARE, CODE_BEYOND = 0.003, 1.3
# Raw disparity of a Kinect v1 (11 bits) to 1 / m, by OpenKinect's wiki (Imaging Information); freenect's
# value for no reading; and the disparity of a depth that is infinite.
DISPARITY_SLOPE, DISPARITY_OFFSET, NO_DISPARITY = -0.0030711016, 3.3309495161, 2047
FARTHEST_DISPARITY = -DISPARITY_OFFSET / DISPARITY_SLOPE
DISPARITY_ADVICE = (
    f"write 1000 / ({DISPARITY_SLOPE} * raw + {DISPARITY_OFFSET}) mm, and 0 for {NO_DISPARITY}; or record "
    "with FREENECT_DEPTH_REGISTERED, which is in mm"
)
SWAP_FIRST = "exchange the two bytes of every value; then "
# 8-bit depth has few levels, evenly spaced. A Kinect has as few in a small room, but their spacing grows with
# distance.
FEW_LEVELS, EVEN_LEVELS, LEAST_SPACING = 256, 300, 8
SAMPLE_STEP_PX = 3
# Maxima of images that were divided by their own maximum: of 15 and 16 bits, 255 in the high byte, of floats.
FULL_SCALES, FULL_FLOAT = (32767, 65280, 65535), 1.0
# In the first ratio of the images, of which there are three or more, the maximum is in few pixels (third
# number), in fewer than values up to 5 % below it, and the next value is up to 2 % below. Where depth beyond
# a sensor's range is set to the highest value, that value is the more frequent: noise of a stereo camera has
# 20 times as many pixels beyond a far depth as within 5 % of it. In a recording that was scaled so, the
# maximum is in up to 0.01 % of the pixels, and the next value 1 % below.
SCALED_SHARE, LEAST_SCALED, MOST_AT_FULL, NEXT_BELOW, NEAR_BELOW = 0.9, 3, 0.001, 0.98, 0.95
# Where values end by themselves, few of the highest 5 % are among the highest 1 %; if cut, a fifth.
END_OF_VALUES, MOST_AT_END = 0.99, 0.1
# Highest value of 16 bits.
HIGHEST = 65535
# Findings that a proven fit of the poses excludes: with another scale or intrinsics, the poses would not fit.
SETTLED_BY_POSES = frozenset({"depth_scale", "principal_point", "field_of_view", "aspect", "camera_height"})
VALID_SHARE = 0.35


def check_intrinsics(probe: Probe) -> Iterator[Finding]:
    """Report implausible focal lengths or principal points, and intrinsics of another image size."""
    camera = probe.recording.camera
    shown = f"fx {camera.fx:g}, fy {camera.fy:g}, cx {camera.cx:g}, cy {camera.cy:g}"
    size = f"{camera.width}x{camera.height}"
    advice = "give those of the depth images under `camera:`"
    off = max(abs(camera.cx / camera.width - 0.5), abs(camera.cy / camera.height - 0.5))
    ratio = ratio_by_centre(camera.cx, camera.cy, (camera.width, camera.height))
    if ratio is not None:
        severity: Severity = "stops" if off > OFF_CENTRE else "warning"
        are = "are" if severity == "stops" else "may be"
        what = (
            f"the intrinsics ({shown}) {are} those of {camera.width / ratio:.0f}x{camera.height / ratio:.0f} "
            f"images, but depth is {size}"
        )
        said = Intrinsics(fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy)
        scaled = f"multiply them by {ratio:.3g}: {said.scaled_line(ratio)}"
        yield Finding("intrinsics_resolution", severity, what, probe.where, scaled)
        if severity == "stops":
            return
    if off > OFF_CENTRE:
        what = f"the principal point ({camera.cx:g}, {camera.cy:g}) is far from the middle of {size} images"
        off_if_swapped = max(abs(camera.cy / camera.width - 0.5), abs(camera.cx / camera.height - 0.5))
        swapped = f"; if cx and cy are swapped, `camera: {{cx: {camera.cy:g}, cy: {camera.cx:g}}}`"
        remedy = advice + (swapped if off_if_swapped < OFF_CENTRE else "")
        yield Finding("principal_point", "warning", what, probe.where, remedy)
    view_deg = math.degrees(2 * math.atan(camera.width / (2 * camera.fx)))
    if not NARROWEST_DEG <= view_deg <= WIDEST_DEG:
        what = f"the field of view is {view_deg:.0f} degrees ({shown}, {size})"
        yield Finding("field_of_view", "warning", what, probe.where, advice)
    if not 1 / MAX_ASPECT < camera.fx / camera.fy < MAX_ASPECT:
        what = f"fx and fy differ by more than 10 % ({shown}): pixels are not square"
        yield Finding("aspect", "warning", what, probe.where, advice)


def check_depth(probe: Probe) -> Iterator[Finding]:
    """Report depth that is damaged, of mixed sizes, byte-swapped, of 8 bits, in a wrong unit, or has gaps."""
    yield from _readable(probe)
    if not probe.whole:
        return
    measured = _measured(probe)
    if not len(measured):
        yield Finding(
            "no_depth", "stops", "no pixel of the frames looked at has a depth", probe.where,
            FIND_DEPTH,
        )  # fmt: skip
        return
    swapped = _byte_order(probe)
    yield from swapped
    yield from _levels(probe, measured)
    scaled = _scaled_by_own_maximum(probe)
    codes = scaled or list(_codes(probe, measured))
    yield from codes
    if not (swapped or scaled or any(code.advice.startswith(SWAP_FIRST) for code in codes)):
        yield from _unit(probe, measured)
    yield from _valid(probe)


def depth_quantiles_m(probe: Probe) -> NDArray[np.float64]:
    """Return the 5 %, 50 % and 95 % quantiles (3,) of the measured depth, metres; NaN if there is none."""
    measured = _measured(probe)
    if not len(measured):
        return np.full(3, np.nan)
    return np.asarray(np.quantile(measured, [0.05, 0.5, 0.95]) / probe.recording.depth_scale)


def _measured(probe: Probe) -> NDArray[np.uint16]:
    """Return depths (n,), native units: a sample of the measured pixels of the probe's full-size frames."""
    samples = [frame.depth[::SAMPLE_STEP_PX, ::SAMPLE_STEP_PX] for frame in probe.whole]
    return np.concatenate([np.zeros(0, np.uint16), *(sample[sample > 0] for sample in samples)])


def stored_pattern(probe: Probe) -> Pattern:
    """Return whether the values of depth appear to have rotated bits; only plain files are judged."""
    recording = probe.recording
    plain = isinstance(recording, FileRecording) and recording.depth_code == "plain"
    is_stored = plain and recording.float_scale is None
    return find_pattern(frame.depth for frame in probe.whole if is_stored)


def is_likely(median_m: float, far_m: float) -> bool:
    """Return whether a median and a 95 % quantile of depth, metres, are plausible for a room."""
    return LIKELY_MEDIAN_M[0] <= median_m <= LIKELY_MEDIAN_M[1] and far_m <= LIKELY_FAR_M


def _readable(probe: Probe) -> Iterator[Finding]:
    count = probe.looked_at
    # A build leaves out damaged frames and frames of another kind if there are few.
    few = len(probe.refused) + len(probe.damaged) < MAX_DAMAGED * count
    severity: Severity = "warning" if few else "stops"
    if probe.refused:
        what = f"{len(probe.refused)} of {count} frames looked at are of another kind: {probe.refused[0]}"
        yield Finding("depth_format", severity, what, probe.where, advice_on(probe.refused[0]))
    if probe.damaged:
        what = f"{len(probe.damaged)} of {count} frames looked at are damaged; the first: {probe.damaged[0]}"
        yield Finding("damaged_frames", severity, what, probe.where, advice_on(probe.damaged[0]))
    step = probe.depth_step_px
    small = {(frame.depth_m.shape[0] * step, frame.depth_m.shape[1] * step) for frame in probe.frames}
    sizes = {frame.depth.shape for frame in probe.whole}
    if len(sizes) > 1 or len(small) > 1:
        known = sizes if len(sizes) > 1 else small
        shown = " and ".join(f"{width}x{height}" for height, width in sorted(known))
        what = f"depth images are {shown}: {KEEP_SIZE}"
        yield Finding("depth_sizes", "stops", what, probe.where, SEPARATE)


def _byte_order(probe: Probe) -> list[Finding]:
    """Detect swapped bytes of 16-bit depth: images that are much smoother with their bytes swapped back."""
    as_is = np.mean([_roughness(frame.depth[::4]) for frame in probe.whole])
    exchanged = np.mean([_roughness(frame.depth[::4].byteswap()) for frame in probe.whole])
    if not as_is > SMOOTHER * exchanged:
        return []
    what = "the two bytes of every depth value are exchanged (little-endian data in a big-endian image)"
    advice = "write the depth again as 16-bit PNG by a library, or exchange the bytes"
    return [Finding("byte_order", "stops", what, probe.where, advice)]


def _roughness(depth: NDArray[np.uint16]) -> float:
    """Return the mean absolute difference of horizontal neighbours, divided by the median, plus 0.0001."""
    left, right = depth[:, :-1].astype(np.float64), depth[:, 1:].astype(np.float64)
    # The highest value often marks missing depth.
    both = (left > 0) & (right > 0) & (left < HIGHEST) & (right < HIGHEST)
    if not both.any():
        return 0.0
    return float(np.abs(left - right)[both].mean() / np.median(left[both])) + SMOOTHEST


def _levels(probe: Probe, measured: NDArray[np.uint16]) -> Iterator[Finding]:
    levels = np.unique(measured)
    spacing = float(np.diff(levels).min()) if len(levels) > 1 else 1.0
    # A flat scene has few levels, too, but one unit apart.
    coarse = spacing >= LEAST_SPACING or levels[-1] < FEW_LEVELS
    even = coarse and (float(levels[-1]) - float(levels[0])) / spacing <= EVEN_LEVELS
    if even and len(levels) <= FEW_LEVELS and len(measured) > 100 * len(levels):
        what = f"depth has only {len(levels)} different values: it went through 8 bits, as a picture of depth"
        yield Finding("depth_8_bit", "stops", what, probe.where, "export the raw 16-bit depth")


def _codes(probe: Probe, measured: NDArray[np.uint16]) -> Iterator[Finding]:
    """Detect a value that marks missing depth: the highest, if it is frequent and far above all others.

    Raw disparity may have its bytes exchanged, as in NYU Depth V2, which `_byte_order` takes for noise.
    """
    for values, first in ((measured, ""), (measured.byteswap(), SWAP_FIRST)):
        below = values[values < NO_DISPARITY]
        share = 1 - len(below) / len(values)
        if share > CODE_SHARE and values.max() == NO_DISPARITY and _is_disparity(below):
            what = (
                f"{share:.1%} of the measured pixels are {NO_DISPARITY}, by which freenect marks no reading "
            )
            what += "in raw disparity, and no other value is above what raw disparity has: depth is not in mm"
            yield Finding("invalid_code", "stops", what, probe.where, f"{first}{DISPARITY_ADVICE}")
            return
    highest = int(measured.max())
    below = measured[measured < highest]
    share = 1 - len(below) / len(measured)
    if share > CODE_SHARE and len(below) and highest > CODE_BEYOND * float(np.quantile(below, 0.999)):
        what = f"{share:.1%} of the measured pixels are {highest}: that means none, but is read as depth"
        severity: Severity = "stops" if share > 0.02 else "warning"
        yield Finding("invalid_code", severity, what, probe.where, "write 0 there")


def _is_disparity(values: NDArray[np.uint16]) -> bool:
    return len(values) > 0 and float(np.quantile(values, 0.999)) < FARTHEST_DISPARITY


def _scaled_by_own_maximum(probe: Probe) -> list[Finding]:
    """Detect images that were each divided by their own maximum: all reach full scale, in a few pixels."""
    images = [frame.depth for frame in probe.whole if frame.depth.any()]
    scale, of_floats = probe.recording.depth_scale, probe.recording.float_scale
    full = (FULL_FLOAT * scale / of_floats,) if of_floats else FULL_SCALES
    highest = max((int(image.max()) for image in images), default=0)
    if len(images) < LEAST_SCALED or highest not in full:
        return []
    scaled = [image for image in images if image.max() == highest and _tapers(image, highest)]
    if len(scaled) < SCALED_SHARE * len(images):
        return []
    what = (
        f"each image was scaled by its own maximum, so depth has no unit (the highest value is {highest} in "
        f"{len(scaled)} of {len(images)} images looked at)"
    )
    return [Finding("depth_normalised", "stops", what, probe.where, "export raw depth")]


def _tapers(image: NDArray[np.uint16], highest: int) -> bool:
    """Whether an image's maximum is the end of its values, neither a code nor a limit of the sensor."""
    near = image[(image > NEAR_BELOW * highest) & (image < highest)]
    at_full, at_end = (int((image >= share * highest).sum()) for share in (1, END_OF_VALUES))
    few = at_full <= min(len(near), max(MOST_AT_FULL * image.size, 1))
    thins_out = at_end < MOST_AT_END * len(near)
    return bool(few and thins_out and near.max(initial=0) >= NEXT_BELOW * highest)


def _unit(probe: Probe, measured: NDArray[np.uint16]) -> Iterator[Finding]:
    scale = probe.recording.depth_scale
    median, far = (float(each) for each in np.quantile(measured, [0.5, 0.95]))
    # Millimetres of a room, read in the smaller unit of TUM, would look like an object on a table.
    room = scale > ROOM_UNITS and ROOM_MEDIAN_M[0] <= median / ROOM_UNITS <= ROOM_MEDIAN_M[1]
    if is_likely(median / scale, far / scale) and not (room and median / scale < NEAR_MEDIAN_M):
        return
    better = suggested_scale(median)
    problem = scale_problem(median, scale)
    severity: Severity = "stops" if problem else "warning"
    what = problem or (
        f"half of the depth is nearer than {median / scale:.3g} m and 95 % nearer than {far / scale:.3g} m "
        f"at {scale:g} units per metre, which is unlikely"
    )
    advice = "find out its unit, and give `depth_scale` (units a metre)"
    pattern = stored_pattern(probe)
    if pattern.found:
        units = pattern.likelier_units
        written = f"`depth_code: rotated, depth_scale: {units:g}`"
        advice = (
            f"nearly every value is a multiple of 8: if the bits are rotated, {written}, by which the median "
            f"would be {pattern.median / units:.2f} m, which nothing here proves"
        )
        yield Finding("depth_scale", severity, what, probe.where, advice)
        return
    # Some cameras record objects on a table from such a small distance.
    offers = probe.recording.float_scale is None and not math.isclose(better, scale)
    if offers and (median / scale > LIKELY_MEDIAN_M[0] or severity == "stops"):
        at_units = f"at {better:g} the median would be {median / better:.2f} m"
        nearest_m, median_m, far_m = np.quantile(float16_m(measured), [0.05, 0.5, 0.95]).tolist()
        stored = isinstance(probe.recording, FileRecording) and probe.recording.depth_code == "plain"
        if stored and nearest_m > NEAREST_M and is_likely(median_m, far_m) and measured.max() < NO_FLOAT16:
            at_units += f", as the bits of a float16 (of CO3D: `depth_code: float16`) {median_m:.2f} m"
        advice += f"; {at_units}, which nothing here proves"
    yield Finding("depth_scale", severity, what, probe.where, advice)


def _valid(probe: Probe) -> Iterator[Finding]:
    shares = np.array([(frame.depth_m > 0).mean() for frame in probe.frames])
    empty = int((shares == 0).sum())
    if empty:
        yield Finding("empty_depth", "warning", f"{empty} depth images are empty", probe.where)
    if np.median(shares) < VALID_SHARE:
        what = f"only {np.median(shares):.0%} of the pixels have a depth"
        advice = "sun, black or shining surfaces, or a camera too near: record again where it sees more"
        yield Finding("little_depth", "warning", what, probe.where, advice)


def range_by_look(
    probe: Probe, T_world_camera: NDArray[np.float64] | None, fusion: FusionSettings | None
) -> DepthRangePart:
    """Return the depth range that a build would fuse, and the share of depth beyond it.

    The range follows from the depth of the sampled frames and from the point that their cameras look at.

    Args:
        probe: the probe of the recording.
        T_world_camera: (n, 4, 4), poses of the probe's frames that have one; None: only depth is used.
        fusion: the settings of benchmark.yaml; None: the defaults.
    """
    poses = np.zeros((0, 4, 4)) if T_world_camera is None else T_world_camera
    sampled = sample_depth(frame.depth_m[::2, ::2] for frame in probe.frames)
    return depth_range(probe.recording.camera, poses, sampled, fusion or FusionSettings())


def check_range(probe: Probe, chosen: DepthRangePart) -> Iterator[Finding]:
    """Report depth that may show the object, but that a build would not fuse because it is too far."""
    for line in range_warnings(chosen):
        what, _, advice = line.rpartition("; ")
        yield Finding("far_depth", "warning", what, probe.where, advice)
