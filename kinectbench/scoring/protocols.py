"""The protocols: which voxels of a pair each one counts, and which of them the pairs of a release allow."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from kinectbench.core import SettingsError
from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.artefacts.score_figures import IN_SPACE
from kinectbench.core.voxels.npz import UNREADABLE
from kinectbench.core.voxels.pair_file import pair_keys
from kinectbench.core.voxels.resample import HALF_PIXEL
from kinectbench.release.release import Release, Target

# Bits of the codes by which voxels are counted (see kernels.py).
KNOWN, SEEN = 2, 4
CODES = range(8)
SOLID = "full"


@dataclass(frozen=True)
class Protocol:
    """A protocol: which voxels of a pair are counted, and against which truth.

    Attributes:
        known: count only voxels whose truth is known.
        hidden: count only voxels that the input view did not see.
        distrusts: name of a grid of the pair file whose cells do not count as known; None for no such grid.
        truth: name of the grid of the pair file that predictions are compared with.
    """

    known: bool = True
    hidden: bool = False
    distrusts: str | None = None
    truth: str = SOLID

    @cached_property
    def looked_at(self) -> tuple[int, ...]:
        """The codes (1 occupied + 2 known + 4 seen) that the protocol would count if it ignored "known"."""
        return tuple(code for code in CODES if not (self.hidden and code & SEEN))

    @cached_property
    def codes(self) -> tuple[int, ...]:
        """The codes (1 occupied + 2 known + 4 seen) of the voxels that the protocol counts."""
        return tuple(code for code in self.looked_at if code & KNOWN or not self.known)


PROTOCOLS = {
    "paper": Protocol(known=False),
    "known": Protocol(),
    "occluded": Protocol(hidden=True),
    "measured": Protocol(distrusts="interior"),
    "known-unsaid": Protocol(distrusts="said"),
    "shell": Protocol(known=False, truth="shell"),
}
PRIMARY = "known"
# By default the protocols with the solid truth are scored.
USUAL = tuple(name for name, of in PROTOCOLS.items() if of.truth == SOLID)
# Protocols as in the paper: every voxel counts, and every pair weighs the same.
EVERY_VOXEL = tuple(name for name, of in PROTOCOLS.items() if not of.known)


def further_grids(protocols: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the grids of a pair file that protocols need beside `full`, `known` and `seen`."""
    grids = [grid for name in protocols for grid in (PROTOCOLS[name].distrusts, PROTOCOLS[name].truth)]
    return tuple(dict.fromkeys(grid for grid in grids if grid not in (None, SOLID)))


def check_protocols(protocols: Sequence[str] | None) -> None:
    """Refuse unknown protocols; None or an empty list means the usual protocols.

    Raises:
        SettingsError: a protocol is not known.
    """
    names = (*PROTOCOLS, *IN_SPACE)
    unknown = [name for name in protocols or () if name not in names]
    if unknown:
        raise SettingsError(f"no protocol '{', '.join(unknown)}': choose among {', '.join(names)}")


def protocols_of(release: Release, asked: Sequence[str] | None) -> tuple[str, ...]:
    """Return the requested protocols; by default, all that the pairs of a release allow, except `shell`.

    All pairs of a recording have the same grids, so only the first pair of each recording is read.

    Raises:
        SettingsError: a protocol is not known, is `camera` or `aligned`, or needs a grid that the pairs lack.
        ReleaseError: a pair file is missing or changed.
    """
    check_protocols(asked)
    if in_camera := [name for name in asked or () if name not in PROTOCOLS]:
        raise SettingsError(
            f"--protocol {', '.join(in_camera)}: for predictions in the camera frame, which their "
            "method.json declares ('frame': 'camera'); choose among " + ", ".join(PROTOCOLS)
        )
    names = tuple(asked or USUAL)
    lacking: dict[str, Target] = {}
    if needed := further_grids(names):
        first = {t.recording: t for t in reversed(release.targets) if t.split in ("test", "validation")}
        for target in first.values():
            keys = _keys(release, target)
            lacking |= {grid: target for grid in needed if grid not in keys}
    for name in asked or ():
        if without := lacking.get(PROTOCOLS[name].distrusts or ""):
            raise SettingsError(
                f"--protocol {name}: the pairs of {without.recording} do not say by what they are known (no "
                f"'{PROTOCOLS[name].distrusts}'); leave it out, or build and publish the recordings again: "
                "synthetic and imported pairs do not have it"
            )
    return tuple(name for name in names if PROTOCOLS[name].distrusts not in lacking)


def _keys(release: Release, target: Target) -> tuple[str, ...]:
    """Return the keys of a published pair file; () if it is damaged, as counting will report that."""
    try:
        return pair_keys(release.pair_content(target))
    except UNREADABLE:
        return ()


def space_alone(
    protocols: Sequence[str] | None, upsampling: str, close: str | None = None
) -> tuple[str, ...]:
    """Return the requested protocols if they are `camera`, `aligned` or both; else ().

    Raises:
        SettingsError: `camera` or `aligned` is combined with other protocols, or with another upsampling than
            half-pixel; or `close` is given, which does not apply to predictions in grids.
    """
    if close is not None:
        raise SettingsError(
            f"--close {close}: only of meshes and points whose method.json has 'frame': 'camera'"
        )
    asked = tuple(name for name in IN_SPACE if name in (protocols or ()))
    if others := [name for name in protocols or () if asked and name not in asked]:
        raise SettingsError(
            f"--protocol {', '.join(asked)} and {', '.join(others)}: surfaces in space and cells have tables "
            "of their own; score twice, each with a folder --out"
        )
    if asked and upsampling != HALF_PIXEL:
        raise SettingsError(f"--upsampling {upsampling}: under {', '.join(asked)} it is {HALF_PIXEL}")
    return asked


def protocols_in_space(asked: Sequence[str] | None, declared: MethodFile) -> tuple[str, ...]:
    """Return the requested protocols for predictions in the camera frame; by default all that apply.

    Raises:
        SettingsError: the requested protocols do not fit these predictions (`unfit`).
    """
    if reason := unfit(asked, declared):
        raise SettingsError(reason)
    if declared.scale == "metric":
        return tuple(name for name in IN_SPACE if name in (asked or IN_SPACE))
    return ("aligned",)


def unfit(asked: Sequence[str] | None, declared: MethodFile) -> str | None:
    """Return why the requested protocols do not fit a method's predictions in the camera frame; else None.

    They do not fit if one of them is a protocol of the pairs' grid, or if `camera` is requested but the scale
    of the predictions is unknown.
    """
    if other := [name for name in asked or () if name not in IN_SPACE]:
        return (
            f"--protocol {', '.join(other)}: {declared.name} predicts in the camera frame, which is scored "
            f"under {', '.join(IN_SPACE)}"
        )
    if declared.scale == "free" and asked and "camera" in asked:
        return (
            f"--protocol camera: the predictions of {declared.name} are of free size ('scale' in "
            f"{MethodFile.FILE}); score them under aligned"
        )
    return None
