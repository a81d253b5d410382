"""Join findings that one cause explains to one finding, so that no other cause is blamed."""

from collections.abc import Sequence
from dataclasses import replace

from kinectbench.core.trajectory.pose_convention import PoseConvention
from kinectbench.doctor.edges import EdgeFit
from kinectbench.doctor.finding import Finding
from kinectbench.doctor.pose_delay import FitsMoved
from kinectbench.doctor.trajectory import PoseFit
from kinectbench.stages.ingest.pairing import NamesDiffer
from kinectbench.stages.ingest.recording import Recording

# Findings on poses that do not fit the depth: because its frames are in a wrong order, or its images turned.
OF_FLOOR = frozenset({"no_floor", "floor_doubtful"})
OF_ORDER = frozenset({"trajectory_wrong", "trajectory_delay"})
OF_TURNED = frozenset({"trajectory_reading", "mirrored_images"})
# {how colour is turned against depth, a key of `edges.FLIPS`: how the poses read the images then}
IMAGES_READ = {
    "mirrored left to right": "mirrored",
    "mirrored top to bottom": "y_up",
    "turned upside down": "turned",
}


def by_cause(
    findings: Sequence[Finding], recording: Recording, edges: EdgeFit | None, poses: PoseFit | None
) -> list[Finding]:
    """Return the findings, with one instead of several that wrong names or turned depth images explain."""
    return _by_turned_depth(_by_clock(_by_names(list(findings), recording)), edges, poses)


def _by_names(findings: list[Finding], recording: Recording) -> list[Finding]:
    """Join if names of depth and colour differ, and the given poses do not fit the depth in their order."""
    differ = [line for line in recording.warnings if isinstance(line, NamesDiffer)]
    if not differ or not any(finding.name in OF_ORDER for finding in findings):
        return findings
    what = f"{differ[0]}; in the order of these names the given poses do not fit the depth"
    advice = "give the images of a frame one name"
    one = Finding("names_differ", "stops", what, str(recording.path), advice)
    explained = {"time_jump", "color_unpaired", *OF_FLOOR, *OF_ORDER}
    return [one, *(f for f in findings if f.what not in differ and f.name not in explained)]


def _by_clock(findings: list[Finding]) -> list[Finding]:
    """Join if the given poses fit the depth in no convention, and do when they are moved in time."""
    late = [replace(finding, severity="stops") for finding in findings if isinstance(finding, FitsMoved)]
    if not late or not any(finding.name == "trajectory_wrong" for finding in findings):
        return findings
    return [*late, *(finding for finding in findings if finding.name not in OF_ORDER)]


def _by_turned_depth(findings: list[Finding], edges: EdgeFit | None, poses: PoseFit | None) -> list[Finding]:
    """Join if depth is mirrored or turned against colour, and the given poses fit it if it is turned back."""
    turned = [finding for finding in findings if finding.name == "color_mirrored"]
    if not turned or edges is None or poses is None or not poses.fits:
        return findings
    if poses.convention != PoseConvention(images=IMAGES_READ[edges.flip]):
        return findings
    what = f"{turned[0].what}, and the given poses do not fit the depth so: depth is the one to correct"
    one = replace(turned[0], severity="stops", what=what, advice="turn or mirror its images back")
    explained = {*OF_FLOOR, *OF_TURNED}
    return [one, *(f for f in findings if f not in turned and f.name not in explained)]
