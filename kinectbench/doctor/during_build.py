"""Use the doctor during a build: refuse unusable recordings, report clock offsets, explain failures."""

from collections.abc import Iterator
from functools import cached_property

from kinectbench.core import RecordingError
from kinectbench.doctor.causes import by_cause
from kinectbench.doctor.clocks import check_partners
from kinectbench.doctor.codes import check_codes
from kinectbench.doctor.delays import check_color_delay, check_color_drift
from kinectbench.doctor.depth import check_depth, check_intrinsics
from kinectbench.doctor.edges import check_edges, fit_edges
from kinectbench.doctor.finding import Finding
from kinectbench.doctor.lengths import LENGTHS, check_lengths
from kinectbench.doctor.pose_delay import check_trajectory_delay
from kinectbench.doctor.probe import Probe, ProbeBuilder, frames_to_read, probe_recording
from kinectbench.doctor.still import check_still, with_objects_poses
from kinectbench.doctor.trajectory import PoseFit, check_trajectory, fit_trajectory, fits_no_better
from kinectbench.stages.ingest.recording import RawFrame, Recording

# Findings that make everything built with the poses wrong, if they stop.
POSES = frozenset(
    {"trajectory_scale", "trajectory_reading", "trajectory_wrong", "trajectory_time_unit", "names_differ"}
    | {"color_mirrored"}
)
IN_CAMERA = " (under `camera:` in benchmark.yaml)"
# Findings that ingest itself does not detect; `track` judges the poses, over all frames.
CHECKED = frozenset({"byte_order", "depth_normalised", "invalid_code", "intrinsics_resolution"})
# Findings that depth scale or intrinsics are wrong: the object's size and shape would be, whatever tracks it.
OF_CAMERA = frozenset({LENGTHS, "intrinsics_resolution", "principal_point", "field_of_view", "aspect"})


def refuse_hopeless(recording: Recording) -> None:
    """Refuse a recording if a fault in all of its frames would make the build fail or its result wrong.

    Raises:
        RecordingError: the depth has swapped bytes, or was scaled image by image; over 2 % of it is a code
            for missing depth that is read as depth; or the intrinsics are of another image size.
    """
    probe = probe_recording(recording, few=True)
    for finding in (*check_depth(probe), *check_intrinsics(probe)):
        if finding.severity == "stops" and finding.name in CHECKED:
            raise RecordingError(
                f"{finding.where}: {finding.what}; {finding.advice} (`kinectbench inspect` says more)",
                what="implausible",
            )


def likely_cause(recording: Recording) -> tuple[str, bool]:
    """Explain a failed build by a fault of the poses, the intrinsics, or the scale or encoding of depth.

    A recording is not refused before the build because of a suspicious depth scale: it may just show a small
    object.

    Returns:
        The explanation, one line ("" if none of these faults is likely), and whether the poses prove it:
            depth alone only shows that a scale is unlikely. Implausible intrinsics count as proven if poses
            are given and do not fit.
    """
    probe = probe_recording(recording)
    by_depth = [each for each in check_depth(probe) if each.name == "depth_scale"]
    fit = fit_trajectory(probe)
    for each in check_codes(probe, fit):
        suspicion = "the depth's scale may be wrong" if each.name == "depth_scale" else "depth may be coded"
        return f"{each.where}: {suspicion}: {each.what}; {each.advice}{IN_CAMERA}", True
    for each in _of_intrinsics(probe, fit):
        said = f"{each.where}: {each.what}; {each.advice}"
        return (
            (said, False) if fit is None else (f"{said}; tracking without the poses does not mend it", True)
        )
    edges = fit_edges(probe)
    of_poses = by_cause([*check_edges(probe, edges), *check_trajectory(probe, fit)], recording, edges, fit)
    for each in of_poses:
        if each.name in POSES and each.severity == "stops":
            return f"{each.where}: {each.what}; {each.advice}", True
    if not by_depth or (fit is not None and fit.proven):
        return "", False
    proven = next((each for each in of_poses if each.name == "depth_scale"), None)
    each = proven or by_depth[0]
    said = f"{each.where}: the depth's scale may be wrong: {each.what}; {each.advice}{IN_CAMERA}"
    return said, proven is not None


def _of_intrinsics(probe: Probe, fit: PoseFit | None) -> list[Finding]:
    """Return findings of implausible intrinsics; none if the poses prove these right."""
    return [] if fit is not None and fit.proven else list(check_intrinsics(probe))


class OffsetWatch:
    """Finds clock offsets from the frames that ingest reads anyway, so that none is read twice."""

    def __init__(self, recording: Recording, *, intrinsics_stated: bool = False) -> None:
        """Prepare to collect the frames that `inspect` would read.

        Args:
            recording: the recording.
            intrinsics_stated: whether the user states the intrinsics: then unlikely ones are no fault.
        """
        self._recording, self._stated = recording, intrinsics_stated
        self._gathering = ProbeBuilder(recording, frames_to_read(len(recording)), whole=0)

    def wants(self, index: int) -> bool:
        """Return whether `inspect` would read this frame."""
        return index in self._gathering.indices

    def see(self, index: int, frame: RawFrame) -> None:
        """Add a frame as it was read from the recording; it is ignored unless `wants` it."""
        self._gathering.take(index, frame)

    def warnings(self) -> list[str]:
        """Return one line, with its setting, for each clock offset, camera fault and turning object."""
        reported = (finding for finding in self._findings if finding.severity == "warning")
        return [
            f"{finding.where}: {finding.what}; {finding.advice}"
            for finding in reported
            if finding.name in {"color_drift", "turntable", *OF_CAMERA} or "delay_s" in finding.advice
        ]

    def camera_faults(self) -> list[str]:
        """Return the warnings about depth_scale and intrinsics, without paths, to be put into releases."""
        faults = {LENGTHS} if self._stated else OF_CAMERA
        return [f"{each.what}; {each.advice}" for each in self._findings if each.name in faults]

    @cached_property
    def _findings(self) -> tuple[Finding, ...]:
        return tuple(self._examined())

    def _examined(self) -> Iterator[Finding]:
        probe = self._gathering.probe()
        given = self._recording.given_trajectory
        yield from check_partners(probe)
        yield from list(check_color_drift(probe)) or check_color_delay(probe)
        fit = fit_trajectory(probe)
        yield from _of_intrinsics(probe, fit)
        if fit is not None and fits_no_better(fit):
            yield from with_objects_poses([each for each in check_still(probe) if each.name == "turntable"])
        # Poses in another convention fit at no delay; `track` reports the convention, over all frames.
        if fit is not None and given is not None and not fit.convention.changes:
            late = list(check_trajectory_delay(probe, given, fit.convention, fit.pairs))
            yield from late or check_lengths(probe, fit.lengths)
