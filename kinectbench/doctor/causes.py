"""Join findings that one cause explains to one finding, so that no other cause is blamed."""

from dataclasses import replace

from kinectbench.doctor.finding import Finding
from kinectbench.stages.ingest.pairing import NAMES_DIFFER

# Findings on poses that do not fit the depth: because its frames are in a wrong order, or its images turned.
OF_FLOOR = frozenset({"no_floor", "floor_doubtful"})
OF_ORDER = frozenset({"trajectory_wrong", "trajectory_delay"})
OF_TURNED = frozenset({"trajectory_wrong", "trajectory_reading", "mirrored_images"})


def by_cause(findings: list[Finding]) -> list[Finding]:
    """Return the findings, with one instead of several that wrong names or turned depth images explain."""
    return _by_turned_depth(_by_names(findings))


def _by_names(findings: list[Finding]) -> list[Finding]:
    """Join if names of depth and colour differ, and the given poses do not fit the depth in their order."""
    differ = [finding for finding in findings if finding.name == "reader" and NAMES_DIFFER in finding.what]
    if not differ or not any(finding.name in OF_ORDER for finding in findings):
        return findings
    first, *_, last = differ[0].what.split("; ")
    what = f"{first}; {last}; in the order of these names the given poses do not fit the depth"
    one = Finding("names_differ", "stops", what, differ[0].where, "give the images of a frame one name")
    explained = {"time_jump", "color_unpaired", *OF_FLOOR, *OF_ORDER}
    return [one, *(f for f in findings if f not in differ and f.name not in explained)]


def _by_turned_depth(findings: list[Finding]) -> list[Finding]:
    """Join if depth is mirrored or turned against colour, and the given poses do not fit it so.

    Poses that fit the depth prove that colour is the one that is turned.
    """
    turned = [finding for finding in findings if finding.name == "color_mirrored"]
    if not turned or not any(finding.name in OF_TURNED for finding in findings):
        return findings
    what = f"{turned[0].what}, and the given poses do not fit the depth so: depth is the one to correct"
    one = replace(turned[0], severity="stops", what=what, advice="turn or mirror its images back")
    explained = {*OF_FLOOR, *OF_TURNED}
    return [one, *(f for f in findings if f not in turned and f.name not in explained)]
