"""The best and the worst pairs of each method."""

from collections.abc import Sequence
from dataclasses import dataclass

from kinectbench.report.score_model import ScoreTable
from kinectbench.report.tables import shown

SHOWN = 3


@dataclass(frozen=True)
class NamedPair:
    """A pair and its IoU as text."""

    name: str
    iou: str


@dataclass(frozen=True)
class Extremes:
    """The pairs of highest and lowest IoU of one method, the most extreme first."""

    method: str
    best: tuple[NamedPair, ...]
    worst: tuple[NamedPair, ...]


def extremes(tables: Sequence[ScoreTable], protocol: str) -> tuple[Extremes, ...]:
    """Three pairs of each kind under one protocol, for every method that has rows but added baselines."""
    found = []
    for table in tables:
        if table.baseline:
            continue
        scored = [(row.iou, row.pair) for row in table.pairs(protocol) if row.iou is not None]
        rising = [NamedPair(pair, shown(iou)) for iou, pair in sorted(scored)]
        if rising:
            best = tuple(reversed(rising[-SHOWN:]))
            found.append(Extremes(table.method, best, tuple(rising[:SHOWN])))
    return tuple(found)
