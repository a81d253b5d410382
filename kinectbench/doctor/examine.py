"""Run all checks of a recording (the command `inspect`), even if its intrinsics are missing or unusable."""

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import RecordingError, printable
from kinectbench.core.trajectory.stamps import typical_period_ns
from kinectbench.doctor.causes import by_cause
from kinectbench.doctor.clocks import check_clock
from kinectbench.doctor.codes import EXPLAINED, check_codes
from kinectbench.doctor.color import check_light
from kinectbench.doctor.delays import check_color_delay, check_color_drift
from kinectbench.doctor.depth import (
    SETTLED_BY_POSES,
    check_depth,
    check_intrinsics,
    check_range,
    depth_quantiles_m,
    range_by_look,
)
from kinectbench.doctor.edges import EdgeFit, check_edges, fit_edges
from kinectbench.doctor.finding import Diagnosis, Finding, gravest_first
from kinectbench.doctor.floor import Ground, check_floor, seen_floor
from kinectbench.doctor.grade import check_grade
from kinectbench.doctor.lengths import LENGTHS
from kinectbench.doctor.probe import Probe, probe_recording
from kinectbench.doctor.still import NO_MOTION, check_still, with_objects_poses
from kinectbench.doctor.trajectory import (
    PoseFit,
    check_trajectory,
    fit_trajectory,
    fits_no_better,
    shows_motion,
)
from kinectbench.settings.models import (
    CameraSettings,
    FusionSettings,
    TrackingSettings,
    TrajectoryMode,
    Vector4,
)
from kinectbench.stages.ingest.readers import open_recording, recordings_inside
from kinectbench.stages.ingest.recording import FileRecording, Recording

# Focal length of a Kinect, as a ratio of the image width.
KINECT_FOCAL_RATIO = 525 / 640
UNKNOWN = {"fx": 1.0, "fy": 1.0, "cx": 0.0, "cy": 0.0}
SAME_UNIT = (
    "the given poses fit by this unit, so that it is theirs, too: give `depth_scale` (units a metre), and "
    "write the poses in metres"
)
# Findings whose advice is a number that depends on the intrinsics; with guessed ones, none is advised.
BY_INTRINSICS = frozenset({"trajectory_delay", LENGTHS})
GUESSED = "give the intrinsics, and inspect again: by guessed ones no number is advised"
# Findings that make depth meaningless: no further check is useful.
HOPELESS = frozenset({"no_depth", "byte_order", "depth_normalised", "depth_sizes"})


def _open_anyhow(
    path: Path, settings: CameraSettings | None, *, follow_links: bool = False
) -> tuple[Recording | None, list[Finding]]:
    """Open a recording; if only its intrinsics prevent that, open it with the intrinsics of a Kinect.

    Returns:
        The recording (None if it cannot be opened), and a list with the finding about a problem, or [].
    """
    try:
        return open_recording(path, settings, follow_links=follow_links), []
    except RecordingError as error:
        complaint = str(error)
    try:
        size = open_recording(path, _with(settings, UNKNOWN), follow_links=follow_links).camera
    except RecordingError:
        return None, [Finding("unreadable", "stops", complaint, str(path))]
    focal = KINECT_FOCAL_RATIO * size.width
    assumed = {"fx": focal, "fy": focal, "cx": (size.width - 1) / 2, "cy": (size.height - 1) / 2}
    finding = Finding(
        "intrinsics", "stops", complaint, str(path), "all else is judged with intrinsics like a Kinect's"
    )
    return open_recording(path, _with(settings, assumed), follow_links=follow_links), [finding]


def _with(settings: CameraSettings | None, values: dict[str, float]) -> CameraSettings:
    values_given = settings.model_dump(exclude_none=True) if settings else {}
    for key in ("width", "height"):
        values_given.pop(key, None)
    return CameraSettings(**{**values_given, **values})


def inspect(
    path: Path,
    settings: CameraSettings | None = None,
    *,
    mode: TrajectoryMode | None = None,
    fusion: FusionSettings | None = None,
    own_pixels: bool = False,
    follow_links: bool = False,
    plane_world: Vector4 | None = None,
    boxed: bool = False,
    tracking: TrackingSettings | None = None,
    step: Callable[[str], None] = lambda _: None,
) -> tuple[Diagnosis, Probe | None]:
    """Run all checks of a recording, and return its diagnosis.

    Args:
        path: the recording's folder or file.
        settings: settings of its camera, as under `camera:` in benchmark.yaml.
        mode: the trajectory mode of benchmark.yaml; "ignore": the given trajectory is not used.
        fusion: settings of the depth range; None: the defaults.
        own_pixels: whether benchmark.yaml has `segment_by`, so that the object is found by its own pixels: no
            floor is needed, and the camera may be static.
        follow_links: whether symbolic links in the recording are followed, as set in benchmark.yaml.
        plane_world: (4,) the plane that the object stands on, from benchmark.yaml; None: not set.
        boxed: whether benchmark.yaml has a box around the object: no floor is needed.
        tracking: settings to grade a given trajectory as a build does; None: the trajectory is not graded.
        step: is called with the name of each step, before it.

    Returns:
        The diagnosis, and the probe (None if the recording cannot be opened).
    """
    step("reading frames")
    recording, findings = _open_anyhow(path, settings, follow_links=follow_links)
    if recording is None:
        return Diagnosis({"path": str(path), "format": None}, gravest_first(findings)), None
    is_needed, refined = plane_world is None and not boxed, mode == "refine"
    ground = Ground(recording, plane_world, is_needed, refined)
    if mode == "ignore":
        recording = replace(recording, given_trajectory=None, trajectory_error="")
    probe = probe_recording(recording)
    findings += [Finding("reader", "warning", text, str(path)) for text in recording.warnings]
    findings += _inside(path, recording)
    early = [*check_clock(probe), *check_depth(probe)]
    guessed = any(finding.name == "intrinsics" for finding in findings)
    if not guessed:
        early += check_intrinsics(probe)
    findings += early
    facts = _facts(probe)
    if probe.frames and not HOPELESS & {finding.name for finding in early}:
        step("comparing frames, colour and poses")
        more, findings = _examined(probe, ground, findings, fusion, own_pixels=own_pixels)
        facts |= more
        # Unusable poses, or poses of a still camera, are not graded.
        hopeless = any(finding.severity == "stops" or finding.name in NO_MOTION for finding in findings)
        if recording.given_trajectory is not None and tracking is not None and not hopeless:
            step("grading the given poses")
            findings += [_by_own_pixels(probe)] if own_pixels else check_grade(probe, tracking, mode)
    if guessed:
        findings = [replace(f, advice=GUESSED) if f.name in BY_INTRINSICS else f for f in findings]
    return Diagnosis(facts, gravest_first(findings)), probe


def _inside(path: Path, recording: Recording) -> Iterator[Finding]:
    """Report other recordings inside a recording's folder, whose frames are not read."""
    read = recording.folders if isinstance(recording, FileRecording) else set()
    with suppress(OSError):  # a folder that cannot be read stops the reader, too
        inside = recordings_inside(path, read)
        if inside:
            first, kind = inside[0]
            more = f" and {len(inside) - 1} more" if len(inside) > 1 else ""
            where = printable(first.relative_to(path).as_posix(), 200)
            what = f"another recording lies inside: {where} ({kind}){more}"
            advice = "none of its frames is read here; give it a `path:` of its own"
            yield Finding("recording_inside", "note", what, str(path), advice)


def _by_own_pixels(probe: Probe) -> Finding:
    what = "how good the given poses are is not said here: a build grades them by the object's own pixels"
    return Finding("trajectory_ungraded", "note", what, probe.where)


def _examined(
    probe: Probe, ground: Ground, findings: list[Finding], fusion: FusionSettings | None, *, own_pixels: bool
) -> tuple[dict[str, object], list[Finding]]:
    """Run the checks that need valid depth; return their facts for the diagnosis, and all findings.

    The earlier `findings` are included. Left out are findings that well-fitting poses exclude, and findings
    that another one explains; with `own_pixels`, also those about the floor and a static camera. If depth has
    another scale or encoding (`check_codes`), the other checks are not run, and there are no facts.
    """
    # Poses of a static camera fit equally well in every convention, so they prove nothing.
    still, edges, poses = [*check_still(probe)], fit_edges(probe), fit_trajectory(probe)
    if poses is not None and shows_motion(poses):
        # Poses of a turning object fit what stands around it no better than none at all.
        turns = fits_no_better(poses)
        still = with_objects_poses(still) if turns else [f for f in still if f.name not in NO_MOTION]
    stands = any(finding.name in NO_MOTION for finding in still)
    poses = None if stands else poses
    code = [] if stands else list(check_codes(probe, poses))
    if code:
        # All other checks would use wrong depth.
        kept = [finding for finding in findings if finding.name not in EXPLAINED]
        return {}, [*kept, *code]
    depth_range = range_by_look(probe, None if poses is None else poses.T_world_camera, fusion)
    floor = seen_floor(probe, ground, poses, depth_range.max_depth_m)
    late = [*_late(probe, edges, poses), *check_range(probe, depth_range)]
    if not own_pixels:
        late += [*check_floor(probe, floor, ground), *still]
    if poses is not None and poses.proven:
        # A build refuses implausible depth, even if the poses are in the same unit.
        findings, late = (
            [f for f in each if f.name not in SETTLED_BY_POSES or f.severity == "stops"]
            for each in (findings, late)
        )
        findings = [replace(f, advice=SAME_UNIT) if f.name == "depth_scale" else f for f in findings]
    # Poses cannot fit wrong depth or a moving object, so only that cause is reported.
    explained = any(f.severity == "stops" or f.name == "doubled_frames" for f in findings)
    if any(f.name == "depth_scale" for f in findings):
        late = [f for f in late if f.name != "far_depth"]
    findings += [
        finding
        for finding in late
        if not (explained and finding.name == "trajectory_wrong")
        and not (stands and finding.severity != "stops" and finding.name.startswith(("arc", "trajectory")))
    ]
    facts = _late_facts(edges, poses, floor.heights_m)
    if poses is not None:
        facts |= {name: getattr(depth_range, name) for name in ("max_depth_m", "beyond_share")}
    return facts, by_cause(findings, probe.recording, edges, poses)


def _late(probe: Probe, edges: EdgeFit | None, poses: PoseFit | None) -> Iterator[Finding]:
    """Yield findings about colour, clock offsets and given poses, from the fits of edges and poses."""
    of_color = list(check_edges(probe, edges))
    yield from of_color
    # Unregistered colour gives no delay by edges.
    if not any(finding.severity == "warning" for finding in of_color):
        drift = list(check_color_drift(probe))
        yield from drift or check_color_delay(probe)
    yield from check_trajectory(probe, poses)
    yield from check_light(probe)


def _facts(probe: Probe) -> dict[str, object]:
    recording = probe.recording
    depth_ns, color_ns = recording.recorded_stamps_ns
    period_ns = 0 if probe.counts_frames else typical_period_ns(depth_ns)
    stamps_ns = recording.stamps_ns
    duration_s = float(stamps_ns[-1] - stamps_ns[0]) / 1e9 if period_ns else None
    near_m, median_m, far_m = depth_quantiles_m(probe).tolist()
    depth_m = {"p05": _rounded(near_m, 3), "median": _rounded(median_m, 3), "p95": _rounded(far_m, 3)}
    shares = [float((frame.depth_m > 0).mean()) for frame in probe.frames]
    colors = [frame.bgr.shape for frame in probe.whole if frame.bgr is not None]
    given = recording.given_trajectory
    return {
        "path": str(recording.path),
        "format": recording.format,
        "frames": len(recording),
        "frames_looked_at": probe.looked_at,
        "frames_usable": None if probe.looked_at == len(probe.frames) else len(probe.frames),
        "color_images": len(color_ns) or None,
        "rate_hz": _rounded(1e9 / period_ns, 2) if period_ns else None,
        "duration_s": None if duration_s is None else _rounded(duration_s, 3),
        "camera": asdict(recording.camera),
        "color_size_px": [colors[0][1], colors[0][0]] if colors else None,
        "color_registered": recording.color_registered,
        "color_calibrated": recording.color_calibration is not None,
        "depth_scale": recording.depth_scale,
        "depth_m": depth_m if math.isfinite(median_m) else None,
        "valid_share": _rounded(float(np.median(shares)), 3) if shares else None,
        "poses": None if given is None else len(given.stamps_ns),
    }


def _late_facts(
    edges: EdgeFit | None, poses: PoseFit | None, heights_m: NDArray[np.float64]
) -> dict[str, object]:
    seen = heights_m[np.isfinite(heights_m)]
    facts: dict[str, object] = {
        "floor_seen_in": f"{len(seen)} of {len(heights_m)} frames",
        "camera_height_m": _rounded(float(np.median(seen)), 2) if len(seen) else None,
        "color_registration": edges.registration if edges else "unclear",
        "color_shift_px": edges.shift_px.tolist() if edges and edges.clear else None,
    }
    if poses is not None:
        facts |= {
            "poses_read_as": poses.convention.text(),
            "pose_residual_mm": _rounded(1000 * poses.residual_m, 2),
            "pose_disagreement": _rounded(poses.best, 3),
            "arc_deg": None if poses.arc_rad is None else round(math.degrees(poses.arc_rad)),
        }
    return facts


def _rounded(value: float, digits: int) -> float | None:
    return round(value, digits) if math.isfinite(value) else None
