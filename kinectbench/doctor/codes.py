"""Find the scale or encoding of depth with which given poses fit the depth."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera
from kinectbench.core.types import Float32, Float64
from kinectbench.doctor.depth import (
    DISPARITY_ADVICE,
    DISPARITY_OFFSET,
    DISPARITY_SLOPE,
    FARTHEST_DISPARITY,
    depth_quantiles_m,
    is_likely,
    stored_pattern,
)
from kinectbench.doctor.finding import Finding
from kinectbench.doctor.fit import FramePair, disagreements, frames_of
from kinectbench.doctor.lengths import STEP
from kinectbench.doctor.probe import Probe
from kinectbench.doctor.trajectory import (
    HOPELESS,
    LEAST_PAIRS,
    PoseFit,
    fit_trajectory,
    fits_no_better,
    posed_pairs,
)
from kinectbench.stages.ingest.depth_codes import ROTATED_SCALES, float16_m, ray_lengths, unrotated
from kinectbench.stages.ingest.plausibility import COMMON_SCALES
from kinectbench.stages.ingest.recording import FileRecording

UInt16 = NDArray[np.uint16]
# Common near and far planes of renderers, metres, chosen by hand; and the 16-bit value of the far plane.
NEAR_FAR_M = ((0.1, 10.0), (0.1, 100.0), (0.01, 10.0), (0.01, 100.0), (0.05, 20.0), (0.02, 5.0), (0.5, 20.0))
DEEPEST = 65535
# Another encoding is reported only if it lowers the residual to this ratio. Measured: decoding distances
# along the ray lowers it to 0.25 to 0.6 (5 recordings); decoding plain depth that way at least doubles it (2
# recordings).
BETTER = 0.75
# Findings that another encoding explains, because they come from wrong depth.
EXPLAINED = frozenset({"depth_scale", "invalid_code", "depth_8_bit"})


@dataclass(frozen=True)
class Code:
    """A scale or encoding of 16-bit depth.

    Attributes:
        name: the name of the finding that reports it.
        words: what the values mean, for the finding's text.
        advice: the setting to write, or how to export the depth.
        metres: function from (values (height, width) uint16, 0 = none; camera) to depth in metres.
    """

    name: str
    words: str
    advice: str
    metres: Callable[[UInt16, Camera], NDArray[np.floating]]


def check_codes(probe: Probe, poses: PoseFit | None) -> Iterator[Finding]:
    """Report another scale or encoding of depth with which the given poses fit.

    Nothing is tried without given poses, or if `depth_code` is set. Otherwise the candidates are:
    - for float depth, only distance along the ray, because the probe no longer has the original values;
    - if the poses fit as they are: distance along the ray; and other scales, if the poses fit no better than
      a static camera, or fit best at the limit of the search of `lengths`;
    - else all scales and encodings; rotated bits come before plain scales if nearly all values are multiples
      of 8.
    If the poses fit as they are, a candidate must fit clearly better. If the images are not files, as in a
    bag, only scales are candidates.

    `poses` is the fit of the given poses to the depth as it is read; None: no poses, or too few to judge.
    """
    recording = probe.recording
    if recording.given_trajectory is None:
        return
    if isinstance(recording, FileRecording) and recording.depth_code != "plain":
        return
    # Poses that fit unchanged depth determine the scale, but distance along the ray differs only a little.
    as_given = poses is not None and poses.fits and poses.convention.changes == 0
    if recording.float_scale is not None:
        codes = [*_along_the_ray(probe)]
    elif as_given and poses is not None:
        far_off = fits_no_better(poses) or poses.lengths.at_limit
        codes = [*(_other_scale(probe) if far_off else ()), *_along_the_ray(probe)]
    else:
        codes = [*_codes(probe)]
        # A plain scale of 8 times the units fits rotated depth, too, but for the farthest.
        rotated = [*_rotated()] if stored_pattern(probe).found else []
        codes = rotated if any(_fit(probe, code) is not None for code in rotated) else codes
    fits = [(code, fit) for code in codes if (fit := _fit(probe, code)) is not None]
    if as_given and poses is not None:
        fits = [each for each in fits if each[1].residual_m < BETTER * poses.residual_m]
    if not fits:
        return
    code, fit = min(fits, key=lambda each: each[1].best)
    what = f"the given poses fit if depth is {code.words}: they leave {1000 * fit.residual_m:.1f} mm"
    if as_given and poses is not None:  # residuals at different scales cannot be compared
        what += f", and {1000 * poses.residual_m:.1f} mm as it is read"
    yield Finding(code.name, "stops", what, probe.where, code.advice)


def _codes(probe: Probe) -> Iterator[Code]:
    yield from _other_scale(probe)
    if not isinstance(probe.recording, FileRecording):
        return
    yield from _rotated()
    yield Code(
        "depth_code", "the bits of a float16", "`camera: {depth_code: float16}`", lambda d, _: float16_m(d)
    )
    yield Code("depth_code", "a Kinect's raw disparity", DISPARITY_ADVICE, lambda d, _: _of_disparity_m(d))
    yield from _along_the_ray(probe)
    for near_m, far_m in NEAR_FAR_M:
        yield Code(
            "depth_code",
            f"a z-buffer between {near_m:g} and {far_m:g} m",
            "write metres as 16-bit mm or .npy: z = n f / (f - b (f - n)), b = value / 65535, "
            f"n = {near_m:g}, f = {far_m:g}",
            _z_buffer(near_m, far_m),
        )


def _rotated() -> Iterator[Code]:
    for scale in ROTATED_SCALES:
        written = f"`camera: {{depth_code: rotated, depth_scale: {scale:g}}}`"
        yield Code(
            "depth_code",
            f"stored with rotated bits, {scale:g} units a metre",
            written,
            _scaled(scale, unrotated),
        )


def _other_scale(probe: Probe) -> Iterator[Code]:
    solved = solve_scale(probe)
    if solved is None:
        return
    present = probe.recording.depth_scale
    _, median_m, far_m = depth_quantiles_m(probe).tolist()
    advice = f"`camera: {{depth_scale: {solved.units:g}}}`"
    if is_likely(median_m, far_m):  # the poses may be in another unit instead
        advice = (
            f"if {present:g} is right, multiply the poses' positions by {solved.factor:.3g}; else {advice}"
        )
    yield Code("depth_scale", f"{solved.units:g} units a metre", advice, _scaled(solved.units))


def _along_the_ray(probe: Probe) -> Iterator[Code]:
    if not isinstance(probe.recording, FileRecording):
        return
    along = _scaled(probe.recording.depth_scale)
    yield Code(
        "depth_code",
        "the distance along the ray, not along the axis",
        "`camera: {depth_code: ray_distance}`",
        lambda d, camera: along(d, camera) / ray_lengths(camera),
    )


def _scaled(
    scale: float, decode: Callable[[UInt16], UInt16] = lambda depth: depth
) -> Callable[[UInt16, Camera], Float32]:
    return lambda depth, _: decode(depth).astype(np.float32) / np.float32(scale)


def _of_disparity_m(raw: UInt16) -> NDArray[np.floating]:
    """Return the depth, metres, of a Kinect v1's raw disparity of any shape; 0 where it has none."""
    read = (raw > 0) & (raw < FARTHEST_DISPARITY)
    return np.where(read, 1 / (DISPARITY_OFFSET + DISPARITY_SLOPE * np.where(read, raw, 0)), 0.0)


def _z_buffer(near_m: float, far_m: float) -> Callable[[UInt16, Camera], NDArray[np.floating]]:
    """Return a function (values, camera) -> metres for a z-buffer, whose values are linear in 1 / z."""
    return lambda depth, _: np.where(
        depth > 0, near_m * far_m / (far_m - depth / DEEPEST * (far_m - near_m)), 0.0
    )


def _fit(probe: Probe, code: Code) -> PoseFit | None:
    """Fit the given poses to the depth decoded by this encoding.

    The result is None if the decoded depth is implausible for a room, a frame differs in size from the
    recording's camera, too few pairs of frames can be compared, or the fit does not confirm the encoding
    (`PoseFit.proven`).
    """
    scale, camera = probe.recording.depth_scale, probe.small_camera
    shape = (camera.height, camera.width)
    frames = []
    for frame in probe.frames:
        if frame.depth_m.shape != shape:
            return None
        native = np.rint(frame.depth_m * np.float32(scale)).astype(np.uint16)
        frames.append(replace(frame, depth_m=code.metres(native, camera).astype(np.float32)))
    measured = np.concatenate([frame.depth_m[frame.depth_m > 0] for frame in frames])
    if not len(measured) or not is_likely(*np.quantile(measured, [0.5, 0.95]).tolist()):
        return None
    fit = fit_trajectory(replace(probe, frames=tuple(frames)))
    return fit if fit is not None and fit.proven else None


# Units per metre that are tried: those of metres to those of 0.01 mm.
SMALLEST, LARGEST = 1.0, 100000.0
# Besides the common ones: 0.5 mm, the RealSense L515's 0.25 mm, 65535 / 10 m (Replica's rendered depth), and
# 0.125 mm.
KNOWN_SCALES = (*COMMON_SCALES, 2000.0, 4000.0, 6553.5, 8000.0)
# A solved scale this near to a known one is rounded to it: the search's last step is 0.5 %, and the pixels of
# the small depth images leave about 1 %.
NEAR_KNOWN, LAST_STEP = 1.02, 1.005
# Another scale is offered only if it lowers the disagreement to this ratio. Measured: 0.99 or more remains
# for six recordings with correct scales, 0.60 with a scale 1.25 times too small, 0.38 to 0.46 with one 2 to
# 6.5 times too small.
CLEARLY = 0.75


@dataclass(frozen=True)
class SolvedScale:
    """The depth scale with which given poses fit the depth best.

    Attributes:
        units: units per metre: a known scale if one is within 2 %, else rounded to three significant digits.
        factor: `units` / those of the recording; positions of poses multiplied by it fit as well.
    """

    units: float
    factor: float


def solve_scale(probe: Probe) -> SolvedScale | None:
    """Find the depth scale with which the unchanged poses disagree least with the depth.

    Scales from 1 to 100000 units per metre are tried in steps of 5 %, if they make the depth plausible for a
    room; then scales near the best one in steps of 0.5 %. The result is None if there are too few poses to
    judge, or if no scale fits clearly better than the recording's.
    """
    posed = posed_pairs(probe)
    if posed is None:
        return None
    poses, pairs = posed
    present = probe.recording.depth_scale
    _, median_m, far_m = depth_quantiles_m(probe).tolist()
    reach = round(math.log(LARGEST / SMALLEST) / math.log(STEP))
    factors = STEP ** np.arange(-reach, reach + 1.0)
    inside = (factors * present >= SMALLEST) & (factors * present <= LARGEST)
    likely = [is_likely(median_m / factor, far_m / factor) for factor in factors.tolist()]
    factors = factors[inside & likely]
    if not len(factors):
        return None
    table = _table(factors, pairs, poses)
    fitting = table.min(axis=0) < HOPELESS
    if fitting.sum() < LEAST_PAIRS:
        return None
    usable = [pair for pair, fits in zip(pairs, fitting, strict=True) if fits]
    rough = float(factors[table[:, fitting].mean(axis=1).argmin()])
    steps = math.ceil(math.log(STEP) / math.log(LAST_STEP))
    fine = rough * LAST_STEP ** np.arange(-steps, steps + 1.0)
    costs = _table(np.append(fine, 1.0), usable, poses).mean(axis=1)
    best = int(costs[:-1].argmin())
    if costs[best] > CLEARLY * costs[-1]:
        return None
    units = _rounded(present * float(fine[best]))
    return SolvedScale(units, units / present)


def _table(factors: Float64, pairs: tuple[FramePair, ...] | list[FramePair], poses: Float64) -> Float64:
    """Return the disagreement in each pair at each multiple of the depth scale: (factors, pairs).

    The factors are applied to the positions of the poses instead of the scale, which gives the same result,
    because the disagreement is relative to the depth.
    """
    paired = np.full_like(poses, np.nan)
    paired[frames_of(pairs)] = poses[frames_of(pairs)]
    longer = np.repeat(paired[None], len(factors), axis=0)
    longer[..., :3, 3] *= factors[:, None, None]
    return disagreements(pairs, longer)


def _rounded(units: float) -> float:
    known = min(KNOWN_SCALES, key=lambda each: abs(math.log(each / units)))
    return known if 1 / NEAR_KNOWN <= units / known <= NEAR_KNOWN else float(f"{units:.3g}")
