"""Which recordings the tracker is held against, and with which bars."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tracking_recordings import LONG_FRAMES, OBJECTS, ROUND_FRAMES, long_spec, object_spec, simulated

CABINET, KITCHEN = "tum_fr3_cabinet", "7scenes_redkitchen_000-149"
OURS, DEPTH_ONLY, REFINE = "ours", "ours, depth only", "ours, refine"
SLAM, ODOMETRY = "slam.Model", "odometry"
RIVALS = (SLAM, ODOMETRY)


@dataclass(frozen=True)
class Bar:
    """What a row has to reach.

    Attributes:
        ate_mm: greatest root mean square of the absolute trajectory error.
        share: least share of frames with a pose.
        rpe_mm_per_m: greatest root mean square of the relative error over a metre; None: not asked for.
    """

    ate_mm: float
    share: float
    rpe_mm_per_m: float | None = None


@dataclass(frozen=True)
class Case:
    """One recording, or some of its frames.

    Attributes:
        group: what it is one of.
        name: its own.
        open: gives the recording's folder; simulates it, if need be.
        source: the recording's name; cases that follow each other share what is ingested of it.
        bars: methods of ours with their bars.
        rivals: whether Open3D's trackers run on it too.
        stride: every n-th frame.
        first: no more frames than this.
        warm_up: frames that are tracked before the clock starts.
    """

    group: str
    name: str
    open: Callable[[], Path]
    source: str
    bars: dict[str, Bar | None]
    rivals: bool = True
    stride: int = 1
    first: int | None = None
    warm_up: int | None = None

    @property
    def methods(self) -> tuple[str, ...]:
        """What runs on it, in order."""
        return (*self.bars, *(RIVALS if self.rivals else ()))


ORBIT = {OURS: Bar(3, 0.99, 3), DEPTH_ONLY: Bar(5, 0.99, 3)}
HARDER = {OURS: Bar(6, 0.90)}
# group -> preset, bars
SIMULATED: dict[str, tuple[str, dict[str, Bar]]] = {
    "orbit": ("orbit-v1", ORBIT),
    "stride2": ("stride2-v1", HARDER),
    "stride3": ("stride3-v1", HARDER),
    "blur": ("blur-v1", HARDER),
    "jolt": ("jolt-v1", HARDER),
    "drop": ("drop-v1", HARDER),
    "arc": ("arc-v1", {OURS: Bar(10, 0.99)}),
    # At most five of 700 frames lost.
    "turns": ("turns-v1", {OURS: Bar(10, 0.9928)}),
}
REAL = ("kitchen", "cabinet", "refine")
TIME = "time"
GROUPS = (*SIMULATED, *REAL, TIME)
LONG = "chair1_long"
KITCHEN_STRIDES = (1, 2, 5)
TIMED_FRAMES = (ROUND_FRAMES, 1000, LONG_FRAMES)


def all_cases(cache: Path, data: Path | None, objects: int) -> list[Case]:
    """Every case of the first objects; the real recordings only if their folder is given."""
    return [*_simulated(cache, objects), *(_real(data) if data else ()), *_timed(cache)]


def chosen(cases: Sequence[Case], only: Sequence[str]) -> list[Case]:
    """The cases whose group, name or source is asked for; all if nothing is."""
    return [case for case in cases if not only or {case.group, case.name, case.source} & set(only)]


def _simulated(cache: Path, objects: int) -> list[Case]:
    cases = []
    for group, (preset, bars) in SIMULATED.items():
        for family, seed in OBJECTS[:objects]:
            name = f"{family}{seed}" if group == "orbit" else f"{family}{seed}_{group}"
            opened = partial(simulated, object_spec(family, seed, preset), cache / name)
            cases.append(Case(group, name, opened, name, dict(bars)))
    return cases


def _real(data: Path) -> list[Case]:
    kitchen, cabinet = partial(Path, data, KITCHEN), partial(Path, data, CABINET)
    bars: dict[str, Bar | None] = {OURS: Bar(20, 1.0)}
    return [
        *(Case("kitchen", f"kitchen_{k}", kitchen, KITCHEN, bars, stride=k) for k in KITCHEN_STRIDES),
        Case("cabinet", "cabinet", cabinet, CABINET, {OURS: Bar(30, 0.80)}),
        Case("refine", "cabinet_refine", cabinet, CABINET, {REFINE: None}, rivals=False),
    ]


def _timed(cache: Path) -> list[Case]:
    """A long recording, and its first frames."""
    opened = partial(simulated, long_spec(), cache / LONG)
    only: dict[str, Bar | None] = {OURS: None}
    return [
        Case(TIME, f"{LONG}_{n}", opened, LONG, only, rivals=False, first=n, warm_up=ROUND_FRAMES)
        for n in TIMED_FRAMES
    ]
