"""Intervals, sign flips, Holm, ranks: against scipy, full enumeration and numbers by hand."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from raising import raises
from scipy import stats
from score_rows import row, table

from kinectbench.core.artefacts.score_figures import AVERAGED
from kinectbench.core.artefacts.score_marks import MISSING_AS_EMPTY, Mark
from kinectbench.core.artefacts.scores import Failure, Hashes, ScoreSettings, ScoreTable
from kinectbench.core.errors import SettingsError, StorageError
from kinectbench.scoring.averages import object_means
from kinectbench.scoring.compare import compare, find_methods, find_scores
from kinectbench.scoring.uncertainty import (
    bootstrap_interval,
    holm,
    sign_flip_ps,
    smallest_p,
    student_interval,
)

RNG = np.random.default_rng(4)


def method(name: str, gain: float, objects: int, categories: tuple[str, ...] = ("chair",)) -> ScoreTable:
    """Two views an object; `gain` above 0.5, a little different for every object."""
    rows = [
        row(category, thing, view, 0.5 + gain * (1 + thing / 10) + view / 100)
        for category in categories
        for thing in range(objects)
        for view in range(2)
    ]
    return table(name, rows)


def test_student_interval_is_that_of_scipy() -> None:
    values = RNG.random((5, 2))
    found = student_interval(values, np.ones(5))
    assert found is not None
    for column in range(2):
        sample = values[:, column]
        expected = stats.t.interval(0.95, 4, sample.mean(), stats.sem(sample))
        np.testing.assert_allclose(found[column], expected, rtol=1e-10)
    assert student_interval(values[:2], np.ones(2)) is None


def test_weighted_student_interval_by_hand() -> None:
    found = student_interval(np.array([[0.2], [0.4], [0.9]]), np.array([1.0, 2.0, 1.0]))
    mean = (0.2 + 0.8 + 0.9) / 4
    deviation = np.sqrt(3 / 2 * ((0.2 - mean) ** 2 + (2 * (0.4 - mean)) ** 2 + (0.9 - mean) ** 2)) / 4
    half = stats.t.ppf(0.975, 2) * deviation
    assert found is not None
    np.testing.assert_allclose(found[0], [mean - half, mean + half])


def test_bootstrap_covers_as_it_says_and_is_stratified() -> None:
    far = [(np.full((4, 1), 0.2), np.ones(4)), (np.full((9, 1), 0.8), np.ones(9))]
    found = bootstrap_interval(far)
    assert found is not None
    np.testing.assert_allclose(found, [[0.5, 0.5]])  # categories are never mixed
    values = RNG.normal(0, 1, (40, 1))
    normal = bootstrap_interval([(values, np.ones(40))])
    assert normal is not None
    deviation = values.std() / np.sqrt(40)
    np.testing.assert_allclose(normal[0], values.mean() + np.array([-1.96, 1.96]) * deviation, atol=0.06)
    again = bootstrap_interval([(values, np.ones(40))])
    assert again is not None and again.tolist() == normal.tolist()
    assert bootstrap_interval([far[0], (np.ones((2, 1)), np.ones(2))]) is None


def sign_flip_p(differences: np.ndarray) -> float:
    (found,) = sign_flip_ps(differences[None])
    return found


@pytest.mark.parametrize("count", [1, 2, 5, 9])
def test_sign_flips_against_all_of_them(count: int) -> None:
    differences = np.round(RNG.normal(0.3, 1, count), 1)  # rounded: with ties
    sums = [abs(float(np.dot(signs, differences))) for signs in product((-1, 1), repeat=count)]
    expected = np.mean(np.array(sums) >= abs(differences.sum()) - 1e-9)
    assert sign_flip_p(differences) == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("count", [2, 3, 24, 31])  # the last is drawn
def test_no_assignment_of_signs_counts_in_both_tails(count: int) -> None:
    """Where the sum is 0, or only rounding away from it, every assignment is as far from it: p = 1."""
    balanced = np.resize([0.1, -0.1], count // 2 * 2)
    assert sign_flip_p(balanced) == 1
    assert sign_flip_p(np.append(balanced, 1e-16)) == 1
    assert sign_flip_p(np.array([0.1, 0.2, -0.3])) == 1  # sums to 3e-17
    # many ties, many sums of 0
    found = sign_flip_ps(np.random.default_rng(5).integers(-2, 3, (9, count)) * np.float64(0.1))
    assert min(found) > 0
    assert max(found) <= 1


def test_sign_flips_of_many_objects() -> None:
    assert sign_flip_p(np.ones(5)) == smallest_p(5) == 0.0625
    assert sign_flip_p(np.ones(40)) == smallest_p(40) == 1 / 1_000_001
    assert sign_flip_p(np.zeros(4)) == 1
    assert sign_flip_p(np.ones(30)) == 2**-29
    # 30 equal differences, 20 positive: a binomial test
    assert sign_flip_p(np.array([1.0] * 20 + [-1.0] * 10)) == pytest.approx(
        stats.binomtest(20, 30).pvalue, rel=1e-9
    )
    sampled = sign_flip_p(np.array([1.0] * 30 + [-1.0] * 20))
    assert sampled == pytest.approx(stats.binomtest(30, 50).pvalue, abs=0.001)


def test_drawn_signs_give_what_all_of_them_give(monkeypatch: pytest.MonkeyPatch) -> None:
    tests = RNG.normal(0.2, 1, (4, 24)) * RNG.random(24)
    tests[3] = 0
    exact = sign_flip_ps(tests)
    monkeypatch.setattr("kinectbench.scoring.uncertainty.MAX_EXACT", 23)
    drawn = sign_flip_ps(tests)
    np.testing.assert_allclose(drawn, exact, atol=0.002)  # four deviations of a million draws
    assert drawn[3] == exact[3] == 1
    # a method more or less in the comparison changes no other p-value
    assert [sign_flip_ps(tests[n : n + 1])[0] for n in range(4)] == drawn


def test_holm_by_hand() -> None:
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.5, 0.6]) == [1.0, 1.0]


def test_a_baseline_keeps_its_name() -> None:
    beside = method("hull", 0.1, 8).model_copy(update={"baseline": True})
    assert compare([method("hull", 0.2, 8), beside]).methods == ("hull", "hull #2")
    with raises(SettingsError, "settings.wrong-value", match=r"scores\.json of each.*scores/baselines"):
        compare([beside])


def test_a_difference_and_its_ranks() -> None:
    found = compare([method("good", 0.2, 8), method("bad", 0.1, 8), method("also bad", 0.1, 8)])
    assert found.ranks == {"chair": {"good": 1, "bad": 2, "also bad": 2}}
    first = found.differences[0]
    assert (first.first, first.second, first.verdict) == ("good", "bad", "good is better (p = 0.023)")
    assert first.p == 2**-7 and first.p_holm == 3 * 2**-7
    assert first.by_object["chair_3"] == pytest.approx(0.13)
    assert first.mean == pytest.approx(0.1 * 1.35)
    assert found.differences[2].verdict == "no difference shown" and not found.notes
    lower = compare([method("good", 0.2, 8), method("bad", 0.1, 8)], metric="ce")
    assert lower.ranks == {"chair": {"good": 1, "bad": 2}}


def test_the_interval_of_a_difference_is_paired() -> None:
    """By hand in a category, where what both share does not widen it; over all by resampled objects."""
    two = ("chair", "table")
    found = compare([method("good", 0.2, 8, two), method("bad", 0.1, 8, two)])
    of_category, _, of_all = found.differences
    sample = np.array([*of_category.by_object.values()])
    assert np.ptp(sample) == pytest.approx(0.07)
    expected = stats.t.interval(0.95, 7, sample.mean(), stats.sem(sample))
    assert of_category.interval == pytest.approx(expected)
    drawn = np.random.default_rng(0).choice(sample, (2, 20_000, 8)).mean(axis=(0, 2))
    assert of_all.interval == pytest.approx(tuple(np.quantile(drawn, [0.025, 0.975])), abs=0.001)
    assert of_all.interval is not None and of_all.interval[0] < of_all.mean < of_all.interval[1]
    few = compare([method("good", 0.2, 2), method("bad", 0.1, 2)])
    assert few.differences[0].interval is None


def test_too_small_to_tell() -> None:
    found = compare([method("good", 0.2, 5), method("bad", 0.1, 5)])
    assert found.ranks == {"chair": {"good": 1, "bad": 1}}
    assert found.differences[0].verdict == "too few objects to tell"
    assert found.notes == (
        "chair: the test set is too small to tell: with 5 objects the smallest possible p is 0.062",
    )


def test_all_is_the_mean_over_categories() -> None:
    two = ("chair", "table")
    found = compare([method("good", 0.2, 4, two), method("bad", 0.1, 4, two)])
    assert list(found.means) == ["chair", "table", "all"]
    assert found.means["all"]["good"] == pytest.approx(found.means["chair"]["good"])
    every = next(d for d in found.differences if d.scope == "all")
    assert every.p == 2**-7 and len(every.by_object) == 8
    assert len(found.notes) == 2  # four objects are too few, eight are not


Spoil = Callable[[ScoreTable], ScoreTable]
REFUSED: dict[str, tuple[Spoil, str]] = {
    "another truth": (
        lambda t: t.model_copy(update={"benchmark_sha256": "b" * 64}),
        "score both against one",
    ),
    "another version": (
        lambda t: t.model_copy(update={"settings": ScoreSettings(protocols=("known",), score_version=2)}),
        "bad: counted by score version 2, upsampling unknown, good by score version 1, .*score both",
    ),
    "another upsampling": (
        lambda t: t.model_copy(update={"settings": ScoreSettings(protocols=("known",), upsampling="other")}),
        "bad: counted by score version 1, upsampling other, good by .*; score both again with one version",
    ),
    "incomplete": (
        lambda t: t.model_copy(update={"complete": False}),
        r"bad: left out, some of its pairs are not scored \(0 failed\).*; fewer than two methods are left",
    ),
    "other pairs": (lambda t: t.model_copy(update={"rows": t.rows[1:]}), "other pairs than good"),
}


@pytest.mark.parametrize("name", list(REFUSED))
def test_refusals(name: str) -> None:
    spoil, message = REFUSED[name]
    with pytest.raises(SettingsError, match=message):
        compare([method("good", 0.2, 3), spoil(method("bad", 0.1, 3))])


def test_one_release_has_one_truth() -> None:
    """Tables that name one benchmark, and state two hashes of one pair's truth, are of two."""

    def scored(name: str, gain: float, truth: str) -> ScoreTable:
        hashes = {"chair_0/000": Hashes(truth=truth * 64, prediction=None)}
        return method(name, gain, 3).model_copy(update={"hashes": hashes})

    assert compare([scored("good", 0.2, "a"), scored("bad", 0.1, "a")]).means
    with raises(SettingsError, "settings.other-scores", match="another truth of chair_0/000 than good"):
        compare([scored("good", 0.2, "a"), scored("bad", 0.1, "b")])


def test_an_incomplete_method_is_left_out_and_named() -> None:
    """The others are compared as without it: their tests are not corrected for its."""
    both = [method("good", 0.2, 8), method("bad", 0.1, 8)]
    part = method("part", 0.3, 8).model_copy(update={"complete": False})
    found, alone = compare([part, *both]), compare(both)
    assert found.methods == ("good", "bad") and found.differences == alone.differences
    assert found.left_out == ("part",) and not alone.left_out
    assert found.notes[0].startswith("part: left out, some of its pairs are not scored")
    assert found.notes[1:] == alone.notes


def test_a_method_whose_pairs_all_fail_for_one_reason_is_left_out_for_it() -> None:
    """Such as a protocol that does not fit it, which `--missing empty` would not mend."""
    failed = tuple(
        Failure(recording="a", view=f"{i:03}", reason="--protocol camera: of free size") for i in range(2)
    )
    free = method("free", 0.3, 8).model_copy(update={"complete": False, "rows": (), "failures": failed})
    found = compare([free, method("good", 0.2, 8), method("bad", 0.1, 8)])
    assert found.notes[0] == "free: left out, none of its pairs is scored: --protocol camera: of free size"


def in_space(made: ScoreTable, *headings: str) -> ScoreTable:
    """The same figures as of predictions in the camera frame."""
    rows = [
        replace(one, protocol=heading.split("-")[0], part="occluded" if "-" in heading else None)
        for one in made.rows
        for heading in headings
    ]
    settings = ScoreSettings(protocols=tuple(dict.fromkeys(one.protocol for one in rows)))
    return made.model_copy(update={"rows": tuple(rows), "settings": settings})


def test_a_line_says_under_which_protocol_methods_of_both_kinds_can_stand() -> None:
    grid = method("cells", 0.2, 3)
    grid = grid.model_copy(update={"settings": ScoreSettings(protocols=("known",), upsampling="half-pixel")})
    mesh = in_space(method("mesh", 0.1, 3), "camera", "camera-occluded", "aligned")
    words = (
        "mesh: not scored under 'known': mesh in the camera frame and cells in cells can stand under 'camera'"
        ": `kinectbench score PREDICTIONS --protocol camera --out FOLDER` of cells, then compare with "
        "`--protocol camera`"
    )
    with raises(SettingsError, "settings.other-scores", match=re.escape(words)):
        compare([grid, mesh])
    free = in_space(method("free", 0.1, 3), "aligned")
    with raises(SettingsError, "settings.other-scores", match="can stand under 'aligned'"):
        compare([grid, mesh, free])
    again = in_space(method("cells", 0.2, 3), "camera", "camera-occluded")
    words = "all are under camera, camera-occluded: compare with `--protocol camera`"
    with raises(SettingsError, "settings.other-scores", match=words):
        compare([again, mesh])
    assert compare([again, mesh], protocol="camera").means["chair"]["mesh"] == pytest.approx(0.615)


def test_a_line_says_which_metrics_all_methods_have() -> None:
    mesh = in_space(method("mesh", 0.1, 3), "camera")
    rows = tuple(replace(one, iou=None, precision=None, chamfer_l1_m=0.1) for one in mesh.rows)
    tables = [mesh.model_copy(update={"rows": rows, "method": name}) for name in ("mesh", "points")]
    words = (
        "mesh, points: no 'iou' under 'camera'; all have ce, recall, f1, chamfer_l1_m: name one by --metric"
    )
    with raises(SettingsError, "settings.other-scores", match=words):
        compare(tables, protocol="camera")
    assert compare(tables, "chamfer_l1_m", "camera").means["chair"] == {"mesh": 0.1, "points": 0.1}


def test_unknown_names_are_refused() -> None:
    tables = [method("good", 0.2, 3), method("bad", 0.1, 3)]
    with raises(SettingsError, "settings.wrong-value", match="'iuo'"):
        compare(tables, metric="iuo")
    with raises(SettingsError, "settings.other-scores", match="'paper'"):
        compare(tables, protocol="paper")
    with raises(SettingsError, "settings.other-scores", match="'chamfer_mm'"):
        compare(tables, metric="chamfer_mm")
    with raises(SettingsError, "settings.wrong-value", match="at least two"):
        compare(tables[:1])


def test_scores_are_read_back(tmp_path: Path) -> None:
    made = method("good", 0.2, 3)
    made.write(tmp_path / "good")
    made.model_copy(update={"method": "bad"}).write(tmp_path / "bad")
    assert find_scores([tmp_path]) == [tmp_path / name / "scores.json" for name in ("bad", "good")]
    assert ScoreTable.read(tmp_path / "good") == made
    content = json.loads((tmp_path / "good" / "scores.json").read_text())
    for key in ("notes", "extremes", "hashes"):
        del content[key]
    for one in content["rows"]:
        for key in [
            key for key in one if key.startswith(("f_score", "chamfer", "surface", "normal", "cell", "ceil"))
        ]:
            del one[key]
    (tmp_path / "old.json").write_text(json.dumps(content))
    assert ScoreTable.read_file(tmp_path / "old.json").rows == made.rows  # older files stay readable
    for text in ("", "[]", "{}", '{"rows": 3}', json.dumps(content | {"rows": [{"iou": "1"}]})):
        (tmp_path / "wrong.json").write_text(text)
        with raises(StorageError, "storage.damaged", match=r"wrong\.json"):
            ScoreTable.read_file(tmp_path / "wrong.json")
    made.write(tmp_path)  # by itself into the folder of all
    with pytest.raises(SettingsError, match=r"json has the scores of one method.*name .*/bad .*/good"):
        find_methods([tmp_path])
    assert len(find_methods([tmp_path / "bad", tmp_path / "good"])) == 2
    (tmp_path / "empty").mkdir()
    with raises(SettingsError, "settings.no-file"):
        find_scores([tmp_path / "empty"])


def test_means_of_objects() -> None:
    rows = [row("chair", 0, 0, 0.2), row("chair", 0, 1, 0.4), row("chair", 1, 0, 0.9)]
    means = object_means(rows)
    here = means["known"]["chair"]
    np.testing.assert_allclose(here.values[:, AVERAGED.index("iou")], [0.3, 0.9])
    assert np.isnan(here.values[:, AVERAGED.index("chamfer_mm")]).all()


def test_what_qualifies_the_figures_of_a_method_is_said() -> None:
    guessed = Mark(kind=MISSING_AS_EMPTY, words="6 of 12 missing, scored as empty")
    tables = [method("net", 0.1, 6), method("half", 0.0, 6).model_copy(update={"marks": (guessed,)})]
    notes = compare(tables).notes
    assert "half: 6 of 12 missing, scored as empty" in notes
    assert not any(note.startswith("net:") for note in notes)
