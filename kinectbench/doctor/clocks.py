"""Checks of time stamps: frame rate, dropped and doubled frames, jumps, resets, unpaired colour."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.trajectory.association import pairing_tolerance_ns
from kinectbench.core.trajectory.stamps import (
    NS_PER_S,
    StampFaults,
    find_doubled,
    find_stamp_faults,
    typical_period_ns,
)
from kinectbench.doctor.finding import Finding, Severity, camera_line
from kinectbench.doctor.probe import Probe
from kinectbench.stages.ingest.plausibility import MIN_FRAMES, RECORD_MORE
from kinectbench.stages.segment.judge.coverage_report import MIN_FRAMES as ENOUGH_FRAMES

# Steps that differ by more than this from whole periods are uneven; steps of several whole periods mean
# missing frames.
OFF_PERIOD = 0.2
EVEN_SHARE = 0.8
DROPPED_SHARE = 0.02
DOUBLED_SHARE = 0.01
PAIRED_SHARE = 0.9
# If at least this share of images is paired, the clocks agree, and the other images were lost.
MOSTLY_PAIRED_SHARE = 0.5
SLOWER = "record again at a rate that the computer keeps up with; gaps make tracking harder"


def check_clock(probe: Probe) -> Iterator[Finding]:
    """Report faults of depth's and colour's stamps, too few frames, repeated depth images, missing colour.

    If the recording has fewer than three frames, only their number is reported.
    """
    recording = probe.recording
    if len(recording) < MIN_FRAMES:
        yield Finding(
            "too_few_frames",
            "stops",
            f"{len(recording)} frames; at least {MIN_FRAMES} are needed",
            probe.where,
            RECORD_MORE,
        )
        return
    yield from _few(probe)
    streams = zip(("depth", "colour"), recording.recorded_stamps_ns, strict=True)
    for stream, stamps_ns in streams:
        if len(stamps_ns) > 2:
            yield from _stream(probe, stream, stamps_ns)
    yield from _doubled(probe)
    yield from check_partners(probe)


def _few(probe: Probe) -> Iterator[Finding]:
    """Warn if the recording has so few frames that a build would warn, too."""
    frames = len(probe.recording)
    if frames < ENOUGH_FRAMES:
        what = f"{frames} frames only: too few to show an object from its sides, and to average the noise"
        advice = f"record {ENOUGH_FRAMES} frames at least, better some hundred, all around the object"
        yield Finding("few_frames", "warning", what, probe.where, advice)


def _stream(probe: Probe, stream: str, stamps_ns: NDArray[np.int64]) -> Iterator[Finding]:
    faults = find_stamp_faults(stamps_ns)
    where = f"{probe.where}: {stream}"
    yield from _order(faults, stream, where)
    if faults.resets:
        return
    ordered_ns = np.unique(stamps_ns)
    period_ns = typical_period_ns(ordered_ns)
    steps = np.diff(ordered_ns)
    forward = steps[(steps > 0) & (steps < max(10 * period_ns, NS_PER_S))]
    if not period_ns or not len(forward):
        return
    periods = forward / period_ns
    even = np.abs(periods - np.rint(periods)) <= OFF_PERIOD
    if even.mean() < EVEN_SHARE:
        what = (
            f"{stream} comes at uneven steps of {forward.min() / 1e6:.0f} to "
            f"{forward.max() / 1e6:.0f} ms, as keyframes do"
        )
        yield Finding("uneven_rate", "note", what, where)
        return
    dropped = int((np.rint(periods) - 1).sum())
    share = dropped / (dropped + len(ordered_ns))
    if share > 0:
        many = share > DROPPED_SHARE
        pattern = np.rint(periods).astype(int)
        every = f", one after every {_regular(pattern)} frames" if _regular(pattern) else ""
        what = f"{dropped} {stream} frames are missing ({share:.1%}){every}"
        yield Finding("dropped_frames", "warning" if many else "note", what, where, SLOWER if many else "")


def _regular(periods: NDArray[np.int64]) -> int:
    """Return the number of frames between missing frames if it is nearly constant, else 0.

    Args:
        periods: (n,) steps between consecutive frames, in frame periods; 2 where one frame is missing.
    """
    gaps = np.diff(np.flatnonzero(periods == 2))
    return int(gaps[0]) if len(gaps) > 3 and (gaps == gaps[0]).mean() > 0.9 else 0


def _order(faults: StampFaults, stream: str, where: str) -> Iterator[Finding]:
    if faults.repeated:
        what = f"{faults.repeated} {stream} frames repeat the stamp of the frame before"
        yield Finding("repeated_stamps", "warning", what, where, "they are left out; check the recorder")
    if faults.backwards:
        what = f"time runs backwards before {faults.backwards} {stream} frames"
        advice = "frames are put in the order of their stamps; check that this is how they were taken"
        yield Finding("time_backwards", "warning", what, where, advice)
    if faults.resets:
        what = f"the clock of {stream} restarts before frame {faults.resets[0]}"
        advice = (
            "cut the recording there: both parts are mixed when they are put in the order of their stamps"
        )
        yield Finding("clock_reset", "stops", what, where, advice)
    if faults.jumps:
        what = f"the time of {stream} jumps ahead before frame {faults.jumps[0]} ({len(faults.jumps)} jumps)"
        yield Finding("time_jump", "warning", what, where, "if it is two recordings in one, cut it there")


def _doubled(probe: Probe) -> Iterator[Finding]:
    frames = probe.frames
    doubled = [
        frames[i]
        for i in find_doubled([frame.digest for frame in frames])
        if frames[i].index == frames[i - 1].index + 1 and frames[i].depth_m.any()
    ]
    if doubled:
        share = len(doubled) / max(len(frames), 1)
        what = (
            f"{len(doubled)} of the {len(frames)} depth images looked at are those of the frame before, "
            f"such as frame {doubled[0].index}"
        )
        advice = "the driver delivered them twice: record at the camera's own rate, or remove them"
        severity: Severity = "warning" if share > DOUBLED_SHARE else "note"
        yield Finding("doubled_frames", severity, what, probe.where, advice)


def check_partners(probe: Probe) -> Iterator[Finding]:
    """Report missing colour: none at all, or none near in time for over a tenth of the depth frames."""
    depth_ns, color_ns = probe.recording.recorded_stamps_ns
    without = [frame.index for frame in probe.frames if frame.gray is None]
    share = 1 - len(without) / max(len(probe.frames), 1)
    if not len(color_ns):
        if without:
            what = f"{len(without)} of the {len(probe.frames)} frames looked at have no colour image"
            name, what = ("color_unpaired", what) if share else ("no_color", "there is no colour")
            yield Finding(name, "note", what, probe.where)
        return
    if share >= PAIRED_SHARE:
        return
    apart_s = (int(np.median(color_ns)) - int(np.median(depth_ns))) / 1e9 - probe.recording.color_delay_s
    within_ms = pairing_tolerance_ns(depth_ns, color_ns) / 1e6
    what = (
        f"{len(without)} of the {len(probe.frames)} frames looked at have no colour within {within_ms:.0f} ms"
    )
    delay_ns = round(probe.recording.color_delay_s * NS_PER_S)
    if depth_ns.min() > color_ns.max() - delay_ns or color_ns.min() - delay_ns > depth_ns.max():
        what += f"; the clocks of colour and depth are {apart_s:.3f} s apart"
    line = camera_line("color_delay_s", probe.recording.color_delay_s + apart_s)
    advice = f"if both show the same time, {line}; what is then left is found by motion"
    if share >= MOSTLY_PAIRED_SHARE:
        advice = "images were lost, or one stream ended before the other: those frames have no colour"
    yield Finding("color_unpaired", "warning", what, probe.where, advice)
