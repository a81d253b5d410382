"""Letters of groups that cannot be told apart: by hand, and by their definition on drawn tests."""

import time
from itertools import combinations

import numpy as np
import pytest
from score_rows import row, table

from kinectbench.scoring.compare import compare
from kinectbench.scoring.uncertainty import significance_letters


def apart(*pairs: str) -> set[frozenset[str]]:
    return {frozenset(pair) for pair in pairs}


def test_by_hand() -> None:
    assert significance_letters("xyz", apart()) == {"x": "a", "y": "a", "z": "a"}
    assert significance_letters("xyz", apart("xy", "yz", "xz")) == {"x": "a", "y": "b", "z": "c"}
    assert significance_letters("xyz", apart("xz")) == {"x": "a", "y": "ab", "z": "b"}  # not transitive
    # Piepho's (2004) point: a method between others, and one that is like the far ends only
    assert significance_letters("wxyz", apart("wy", "xz")) == {"w": "ab", "x": "ac", "y": "cd", "z": "bd"}
    assert significance_letters("x", ()) == {"x": "a"} and significance_letters("", ()) == {}


@pytest.mark.parametrize("seed", range(30))
def test_two_share_a_letter_if_and_only_if_they_are_alike(seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = [f"m{index}" for index in range(int(rng.integers(1, 10)))]
    different = {frozenset(pair) for pair in combinations(names, 2) if rng.random() < seed / 30}
    found = significance_letters(names, different)
    for one, other in combinations(names, 2):
        assert bool(set(found[one]) & set(found[other])) == (frozenset((one, other)) not in different)
    used = sorted({letter for of in found.values() for letter in of})
    assert used == list("abcdefghijklmnopqrstuvwxyz"[: len(used)]) and "a" in found[names[0]]
    networkx = pytest.importorskip("networkx")
    graph = networkx.Graph()
    graph.add_nodes_from(names)
    graph.add_edges_from(p for p in combinations(names, 2) if frozenset(p) not in different)
    expected = {frozenset(clique) for clique in networkx.find_cliques(graph)}
    assert {frozenset(n for n in names if letter in found[n]) for letter in used} == expected


def test_many_letters_stay_apart() -> None:
    names = [f"m{index}" for index in range(30)]
    found = significance_letters(names, {frozenset(pair) for pair in combinations(names, 2)})
    assert len({*found.values()}) == 30 and found["m25"] == "z" and found["m26"] == "(27)"


def test_more_groups_than_letters_say_anything_of_are_none() -> None:
    """Sixty methods of which the three of each group differ have 3^20 groups."""
    names = [f"m{index}" for index in range(60)]
    different = {frozenset(p) for g in range(0, 60, 3) for p in combinations(names[g : g + 3], 2)}
    started = time.process_time()
    assert significance_letters(names, different) == dict.fromkeys(names, "")
    assert time.process_time() - started < 1
    of_27 = significance_letters(names[:9], {pair for pair in different if pair <= {*names[:9]}})
    assert of_27["m0"].endswith("i") and len({*of_27.values()}) == 9
    far_apart = {frozenset(pair) for pair in combinations(names[:53], 2)}
    assert set(significance_letters(names[:53], far_apart).values()) == {""}
    assert significance_letters(names[:52], {p for p in far_apart if "m52" not in p})["m51"] == "(52)"


def test_a_comparison_that_is_not_transitive() -> None:
    """High and low differ on every object; the middle is like both: better and worse by turns."""
    values = {
        "high": [0.60 + n / 100 for n in range(10)],
        "middle": [0.60 + n / 100 - (0.09 if n % 2 else -0.04) for n in range(10)],
        "low": [0.55 + n / 100 for n in range(10)],
    }
    tables = [
        table(name, [row("chair", n, 0, iou) for n, iou in enumerate(of)]) for name, of in values.items()
    ]
    found = compare(tables)
    assert found.groups == {"chair": {"high": "a", "middle": "ab", "low": "b"}}
    assert found.ranks == {"chair": {"high": 1, "middle": 1, "low": 2}}
    assert found.too_small == {} and found.standings["low"] == "reported"
    for difference in found.differences:
        share = set(found.groups["chair"][difference.first]) & set(found.groups["chair"][difference.second])
        assert bool(share) == (difference.p_holm > 0.05)
    assert compare(tables, metric="ce").groups["chair"]["high"] == "a"  # lower is better
