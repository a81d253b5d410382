"""Protocols: which voxels of a pair count, and which protocols a release's pairs allow."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from kinectbench.core.artefacts.score_figures import IN_SPACE
from kinectbench.core.errors import SettingsError
from kinectbench.core.voxels.npz import UNREADABLE
from kinectbench.core.voxels.pair_file import pair_keys
from kinectbench.release.release import Release, Target

# Of the codes by which voxels are counted (see kernels.py).
KNOWN, SEEN = 2, 4
CODES = range(8)
SOLID = "full"


@dataclass(frozen=True)
class Protocol:
    """A mask over the voxels of a pair; others are not counted.

    Attributes:
        known: only voxels whose truth is known.
        hidden: only voxels that the input view did not see.
        distrusts: the grid of the pair file whose cells do not count as known; None: no grid.
        truth: the grid of the pair file that predictions are compared with.
    """

    known: bool = True
    hidden: bool = False
    distrusts: str | None = None
    truth: str = SOLID

    @cached_property
    def looked_at(self) -> tuple[int, ...]:
        """The codes of the voxels that it would count if all were known."""
        return tuple(code for code in CODES if not (self.hidden and code & SEEN))

    @cached_property
    def codes(self) -> tuple[int, ...]:
        """The codes of the voxels that it counts."""
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
# Without a request those of the solid truth are scored.
USUAL = tuple(name for name, of in PROTOCOLS.items() if of.truth == SOLID)
# The paper's: they count every voxel, and every pair weighs the same.
EVERY_VOXEL = tuple(name for name, of in PROTOCOLS.items() if not of.known)


def further_grids(protocols: Sequence[str]) -> tuple[str, ...]:
    """Grids of a pair file that some protocols need in addition to the common ones."""
    grids = [grid for name in protocols for grid in (PROTOCOLS[name].distrusts, PROTOCOLS[name].truth)]
    return tuple(dict.fromkeys(grid for grid in grids if grid not in (None, SOLID)))


def check_protocols(protocols: Sequence[str] | None) -> None:
    """Refuse unknown protocols; an empty list stands for the usual ones that the pairs allow.

    Raises:
        SettingsError: one that is not.
    """
    names = (*PROTOCOLS, *IN_SPACE)
    unknown = [name for name in protocols or () if name not in names]
    if unknown:
        raise SettingsError(f"no protocol '{', '.join(unknown)}': choose among {', '.join(names)}")


def protocols_of(release: Release, asked: Sequence[str] | None) -> tuple[str, ...]:
    """The protocols of a release: those requested, else the usual ones that its pairs allow.

    The pairs of a recording are made at once, so the first of each tells which grids they have.

    Raises:
        SettingsError: one is not known, or the pairs lack the grid that it needs.
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
    """The keys of a published pair file; none if damaged, which counting reports."""
    try:
        return pair_keys(release.pair_content(target))
    except UNREADABLE:
        return ()
