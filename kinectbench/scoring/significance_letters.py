"""Groups of methods that cannot be distinguished, as letters: a compact letter display.

Of three methods, the first and the last may differ significantly while the middle one differs from neither.
Ranks cannot express that, but letters can: two methods share a letter if, and only if, they do not differ
significantly.

Source: Piepho, An algorithm for a letter-based representation of all-pairwise comparisons, J. Comput. Graph.
Stat. 13 (2004); here the groups are all maximal cliques, so the display is correct by construction.
"""

from collections.abc import Collection, Iterator, Sequence
from itertools import islice
from string import ascii_lowercase

# With more groups, letters say less than the list of differences; n methods can have 3^(n / 3) groups (J. W.
# Moon, L. Moser, On cliques in graphs, 1965).
MOST_GROUPS = 2 * len(ascii_lowercase)


def significance_letters(names: Sequence[str], apart: Collection[frozenset[str]]) -> dict[str, str]:
    """Return the letters of each method; the best method has an `a`.

    Args:
        names: the methods, the best first, without repetition.
        apart: pairs of methods that differ significantly.

    Returns:
        {name: its letters, such as "ab"}; two methods share a letter if, and only if, the pair is not in
        `apart`. If this takes more than `MOST_GROUPS` letters, all are "".
    """
    place = {name: index for index, name in enumerate(names)}
    indistinct = {
        name: {other for other in names if other != name and frozenset((name, other)) not in apart}
        for name in names
    }
    cliques = list(islice(_maximal_cliques(indistinct), MOST_GROUPS + 1))
    by_name = dict.fromkeys(names, "")
    if len(cliques) > MOST_GROUPS:
        return by_name
    groups = sorted(sorted(place[name] for name in group) for group in cliques)
    for index, group in enumerate(groups):
        for member in group:
            by_name[names[member]] += _letter(index)
    return by_name


def _maximal_cliques(neighbours: dict[str, set[str]]) -> Iterator[set[str]]:
    """Yield all maximal cliques: sets of pairwise neighbours to which no node can be added.

    Source: Bron and Kerbosch, Commun. ACM 16 (1973), with Tomita's choice of the pivot.
    """
    waiting: list[tuple[set[str], set[str], set[str]]] = [(set(), set(neighbours), set())]
    while waiting:
        clique, candidates, done = waiting.pop()
        if not candidates and not done:
            yield clique
            continue
        pivot = max(candidates | done, key=lambda node: len(neighbours[node] & candidates))
        for node in sorted(candidates - neighbours[pivot]):
            waiting.append((clique | {node}, candidates & neighbours[node], done & neighbours[node]))
            candidates, done = candidates - {node}, done | {node}


def _letter(index: int) -> str:
    """Return a, b, … z, then (27), (28), …; the brackets separate the letters of a method."""
    return ascii_lowercase[index] if index < len(ascii_lowercase) else f"({index + 1})"
