"""Ranks of the methods on a page, tied where a test over objects cannot tell them apart."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from kinectbench.errors import SettingsError
from kinectbench.scoring.compare import ALL, Comparison, compare
from kinectbench.scoring.read import read_scores
from kinectbench.scoring.table import ScoreTable


@dataclass(frozen=True)
class Ranking:
    """Ranks by mean IoU over all categories.

    Attributes:
        of: {protocol: {index of the score file: rank}}; incomplete methods have none.
        notes: one line each.
    """

    of: Mapping[str, Mapping[int, int]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def rank(paths: Sequence[Path], protocols: Sequence[str]) -> Ranking:
    """Rank methods by a paired test over objects (see `compare`).

    Args:
        paths: scores.json files of one truth; a rank is given to those that are complete. Baselines that
            were added have none: more comparisons would only make methods harder to tell apart.
        protocols: under which to rank.
    """
    tables: dict[int, ScoreTable] = {}
    for index, path in enumerate(paths):
        try:
            table = read_scores(path)
        except SettingsError:  # the page shows what can be read of it
            continue
        if table.complete and not table.baseline:
            tables[index] = table
    if len(tables) < 2 or not any(table.rows for table in tables.values()):
        return Ranking()
    found: dict[str, dict[int, int]] = {}
    notes: list[str] = []
    for protocol in protocols:
        try:
            compared = compare([*tables.values()], protocol=protocol)
        except SettingsError as error:
            notes.append(f"no ranks under {protocol}: {error}")
            continue
        scope = ALL if ALL in compared.ranks else next(iter(compared.ranks))
        found[protocol] = dict(zip(tables, _in_order(compared, scope), strict=True))
        notes += [note for note in compared.notes if note not in notes]
    return Ranking(found, tuple(notes))


def _in_order(compared: Comparison, scope: str) -> list[int]:
    return [compared.ranks[scope][name] for name in compared.methods]
