"""Tables that can be believed: what does not follow from the rows is refused, what is special is marked,
and only predictions that were scored again make a table verified.
"""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raising import raises
from slow import slow
from small_benchmark import Run

import kinectbench
from kinectbench.core.artefacts.score_figures import VOXEL_METRICS
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.errors import SettingsError, StorageError
from kinectbench.engine.artefact import VERSIONS
from kinectbench.release.release import Release
from kinectbench.scoring.base_rates import BASELINE_NAMES
from kinectbench.scoring.baselines.registry import BASELINES
from kinectbench.scoring.caveats import marks_of
from kinectbench.scoring.compare import compare
from kinectbench.scoring.read_table import read_table
from kinectbench.scoring.recheck import recheck
from kinectbench.scoring.score import score, score_methods

Command = Callable[..., Run]
CELLS = 16


def grid(name: str) -> np.ndarray:
    """A prediction of a pair, another for each."""
    rng = np.random.default_rng([ord(letter) for letter in name])
    return np.asarray(rng.random((CELLS,) * 3), np.float32)


def write(release: Release, folder: Path, without: tuple[str, ...] = ()) -> Path:
    """Predictions of test and validation, of all pairs whose name does not begin with one of `without`."""
    for target in release.targets:
        if not target.name.startswith(without or ("-",)):
            path = folder / target.recording / f"{target.view}.npy"
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, grid(target.name))
    return folder


def scored_in_memory(release: Release, without: tuple[str, ...] = (), **options: Any) -> ScoreTable:
    """The same by `Scorer`."""
    scorer = kinectbench.Scorer(release.folder, surface=False, **options)
    for split in ("validation", "test") if "thresholds_file" not in options else ("test",):
        for target in release.split(split):
            if not target.name.startswith(without or ("-",)):
                scorer.update(target.name, grid(target.name))
    return scorer.result()


@pytest.fixture(scope="module")
def net(release: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Predictions, and what was scored of them."""
    root = tmp_path_factory.mktemp("believed")
    write(release, root / "net")
    score_methods(release, root / "net", root / "scores", surface=False)
    return root


def changed(net: Path, out: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """A scores.json that somebody edited."""
    content = json.loads((net / "scores" / "scores.json").read_text())
    change(content)
    out.write_text(json.dumps(content), encoding="utf-8")
    return out


def test_what_was_written_is_read_back_equal(net: Path) -> None:
    path = net / "scores" / "scores.json"
    assert read_table(path).text() == path.read_text()


FORGED: dict[str, Callable[[dict[str, Any]], None]] = {
    "overall": lambda of: of["overall"]["known"].update(iou=0.99),
    "category": lambda of: of["by_category"]["paper"]["chair"].update(ce=0.01),
    "surface": lambda of: of["overall"]["known"].update(chamfer_mm=1.0),
    "interval": lambda of: of["by_category"]["known"]["chair"]["intervals"].update(iou=[0.8, 0.9]),
    "counts": lambda of: of["overall"]["known"].update(objects=30),
    "added category": lambda of: of["by_category"]["known"].update(lamp={"iou": 0.9}),
    "curve": lambda of: of["iou_by_threshold"]["known"]["chair"].__setitem__(3, 0.9),
    "extremes": lambda of: of["extremes"]["known"]["best"][0].update(iou=0.99),
    "unknown": lambda of: of["truth_unknown_share"].update(red_chair=0.0),
    "left out": lambda of: of["all_unknown_pairs"]["known"].append("chair_01/000"),
    "row": lambda of: of["rows"][0].update(iou=0.99),
    "row and its curve": lambda of: of["rows"][0].update(iou=0.99, iou_by_threshold=[0.99] * 17),
    "row twice": lambda of: of["rows"].append(of["rows"][0]),
    "row taken away": lambda of: of["rows"].pop(0),
    "no rows": lambda of: of.update(rows=[]),
    "threshold": lambda of: of["thresholds"].update(chair=0.85),
    "complete": lambda of: of["failures"].append({"recording": "a", "view": "000", "reason": "b"}),
}


@pytest.mark.parametrize("name", list(FORGED))
def test_what_does_not_follow_from_the_rows_is_refused(net: Path, tmp_path: Path, name: str) -> None:
    path = changed(net, tmp_path / "scores.json", FORGED[name])
    with raises(StorageError, "storage.damaged", match=r"scores\.json") as caught:
        read_table(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["overall", "row taken away"])
@pytest.mark.parametrize("way", ["report", "compare", "recheck"])
def test_every_command_refuses_it(
    net: Path, release: Release, command: Command, tmp_path: Path, name: str, way: str
) -> None:
    path = changed(net, tmp_path / "forged.json", FORGED[name])
    good = str(net / "scores" / "scores.json")
    arguments = {
        "report": ["report", "--benchmark", str(release.folder), "--scores", str(path), "--out", "x.html"],
        "compare": ["compare", good, str(path)],
        "recheck": ["score", "--recheck", str(path), str(net), "--benchmark", str(release.folder)],
    }[way]
    done = command(tmp_path, *arguments)
    assert done.status == 1 and done.err.count("error:") == 1 and "forged.json" in done.err


def test_rounding_is_no_difference_and_what_is_not_stated_is_computed(net: Path, tmp_path: Path) -> None:
    whole = read_table(net / "scores" / "scores.json")

    def less(of: dict[str, Any]) -> None:
        of["overall"]["known"]["iou"] *= 1 + 1e-13
        for key in ("by_category", "extremes", "marks", "notes", "all_unknown_pairs"):
            del of[key]

    assert read_table(changed(net, tmp_path / "scores.json", less)).text() == whole.text()


def older(of: dict[str, Any]) -> None:
    """As score version 3 wrote it."""
    for row in of["rows"]:
        del row["iou_by_threshold"]
    for key in (
        *("threshold_source_by_category", "threshold_objects", "validation", "missing_as_empty"),
        *("marks", "verified"),
    ):
        of.pop(key, None)
    of["settings"]["score_version"] = 3


def test_tables_of_older_versions_stay_readable(net: Path, tmp_path: Path) -> None:
    path = changed(net, tmp_path / "scores.json", older)
    found, now = read_table(path), read_table(net / "scores" / "scores.json")
    assert found.overall == now.overall and found.iou_by_threshold == now.iou_by_threshold
    assert [mark.words for mark in found.marks] == [f"score version 3, now {VERSIONS['score']}"]

    def and_forged(of: dict[str, Any]) -> None:
        older(of)
        of["iou_by_threshold"]["known"]["chair"] = [0.9] * 17

    with raises(StorageError, "storage.damaged", match="through"):
        read_table(changed(net, path, and_forged))


def test_pairs_that_are_left_out_are_those_of_every_method(net: Path, tmp_path: Path) -> None:
    """Of tables whose rows say less: newer ones are refused when they are read."""

    def cut(of: dict[str, Any]) -> None:
        older(of)
        for key in ("by_category", "overall", "extremes", "iou_by_threshold", "all_unknown_pairs", "notes"):
            del of[key]
        nothing = dict.fromkeys(("iou", "ce", "precision", "recall", "f1"))
        of["rows"] = [row | nothing if row["view"] == "000" else row for row in of["rows"]]
        of["method"] = "cut"

    whole = read_table(changed(net, tmp_path / "whole.json", older))
    with raises(SettingsError, "settings.other-scores"):
        compare([whole, read_table(changed(net, tmp_path / "cut.json", cut))])


def test_a_recheck_verifies(net: Path, release: Release, command: Command, tmp_path: Path) -> None:
    path = changed(net, tmp_path / "scores.json", lambda of: None)
    assert read_table(path).standing == "reported"
    done = command(
        tmp_path, "score", "--recheck", str(path), str(net / "net"), "--benchmark", str(release.folder)
    )
    assert done.status == 0, done.err
    table = read_table(path)
    assert table.verified is not None and table.standing in done.out
    assert table.standing == f"verified {table.verified.date}, kinectbench {kinectbench.__version__}"
    assert not (tmp_path / "scores").exists()
    edits: tuple[Callable[[dict[str, Any]], object], ...] = (
        lambda of: of["rows"][0].update(ce=0.5),
        lambda of: of.update(method="other"),
        lambda of: of["hashes"]["chair_01/000"].update(prediction="blake3:" + "0" * 64),
        lambda of: of["settings"].update(missing="empty"),
        lambda of: of["verified"].update(table_sha256="0" * 64),
    )
    for edit in edits:
        content = json.loads(path.read_text())
        edit(content)
        del content["by_category"], content["overall"]
        (tmp_path / "edited.json").write_text(json.dumps(content))
        assert read_table(tmp_path / "edited.json").standing == "reported"


RECHECKED: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "a better row": (
        lambda of: [row.update(ce=row["ce"] / 2) for row in of["rows"]],
        "chair_01/000 under known: 'ce' states",
    ),
    "a pair declared unknown": (
        lambda of: [
            row.update(dict.fromkeys(VOXEL_METRICS), iou_by_threshold=None, coverage_shape=0.0)
            for row in of["rows"]
            if row["protocol"] != "paper" and (row["recording"], row["view"]) == ("chair_01", "000")
        ],
        "chair_01/000 under known: 'iou' states nothing, but it is",
    ),
    "another base rate": (lambda of: of["base_rate"]["chair"].update(value=0.5), "'base_rate.chair.value'"),
    "other predictions": (
        lambda of: of["hashes"]["chair_01/001"].update(prediction="blake3:" + "1" * 64),
        "chair_01/001: another file than the one that was scored",
    ),
    "a pair less": (
        lambda of: of.update(
            rows=[row for row in of["rows"] if row["recording"] != "chair_01"],
            hashes={name: found for name, found in of["hashes"].items() if not name.startswith("chair_01/")},
        ),
        "chair_01/000 under known: not in the table",
    ),
}


@pytest.mark.parametrize("name", list(RECHECKED))
def test_a_consistent_forgery_is_found_by_a_recheck(
    net: Path, release: Release, tmp_path: Path, name: str
) -> None:
    edit, words = RECHECKED[name]

    def forge(of: dict[str, Any]) -> None:
        edit(of)
        for key in ("by_category", "overall", "extremes", "iou_by_threshold", "all_unknown_pairs"):
            del of[key]
        of["truth_unknown_share"] = {}

    path = changed(net, tmp_path / "scores.json", forge)
    before = path.read_bytes()
    assert read_table(path).standing == "reported"
    differences = recheck(release, path, net / "net")
    assert any(line.startswith(words) for line in differences), differences
    assert path.read_bytes() == before


def test_a_recheck_holds_name_and_warnings_against_the_predictions(
    net: Path, release: Release, tmp_path: Path
) -> None:
    method = {"name": "net", "benchmark_sha256": "0" * 64}  # of another release: a warning
    predictions = Path(shutil.copytree(net / "net", tmp_path / "net"))
    (predictions / "method.json").write_text(json.dumps(method))
    score(release, predictions, method="net").write(tmp_path)
    path = tmp_path / "scores.json"
    whole = json.loads(path.read_text())
    for change, words in (
        ({"warnings": []}, "'warnings' does not have: method.json: the predictions are for another release"),
        ({"method": "better"}, "'method' states 'better'; the predictions are of 'net'"),
    ):
        path.write_text(json.dumps(whole | change))
        assert [line[: len(words)] for line in recheck(release, path, predictions)] == [words]
    path.write_text(json.dumps(whole))
    assert recheck(release, path, predictions) == []


def as_if_from_a_file(of: dict[str, Any]) -> None:
    """All that a table says of thresholds that were read from a file."""
    source = "file:" + "0" * 64
    pairs = {f"{row['recording']}/{row['view']}" for row in of["rows"]}
    of.update(
        threshold_source=source,
        threshold_source_by_category=dict.fromkeys(of["thresholds"], source),
        threshold_objects=["elsewhere"],
        validation=None,
        hashes={name: found for name, found in of["hashes"].items() if name in pairs},
    )


def test_what_cannot_be_rechecked_is_one_line(
    net: Path, release: Release, command: Command, tmp_path: Path
) -> None:
    path = changed(net, tmp_path / "scores.json", lambda of: None)
    before = changed(net, tmp_path / "older.json", older)
    other = changed(net, tmp_path / "other.json", lambda of: of.update(benchmark_sha256="0" * 64))
    from_file = changed(net, tmp_path / "file.json", as_if_from_a_file)
    rest = [str(net / "net"), "--benchmark", str(release.folder)]
    for arguments, words in (
        ([str(path), "--benchmark", str(release.folder)], "name the folder of the predictions"),
        ([str(path), *rest, "--method", "a"], "--method: not with --recheck"),
        ([str(path), *rest, "--shard", "1/3"], "--shard: not with --recheck"),
        ([str(path), *rest, "--cluster", "local:2"], "--cluster: not with --recheck"),
        ([str(path), *rest, "--missing", "error", "--no-surface"], "--missing, --no-surface: not with"),
        ([str(path), *rest, "--upsampling", "half-pixel"], "--upsampling: not with --recheck"),
        ([str(before), *rest], "counted by score version 3"),
        ([str(other), *rest], "scored against benchmark 000000000000"),
        ([str(from_file), *rest], "give it: --thresholds"),
        ([str(tmp_path / "none.json"), *rest], "no such file"),
    ):
        done = command(tmp_path, "score", "--recheck", *arguments)
        assert done.status not in (0, 3) and words in done.err and done.err.count("error:") == 1, done.err


def words_of(table: ScoreTable) -> list[str]:
    assert table.marks == marks_of(table)
    return [mark.words for mark in table.marks]


def without_hashes(table: ScoreTable) -> dict[str, Any]:
    content = table.json_value()
    assert content.pop("hashes").keys() == table.hashes.keys()
    return content


CASES: dict[str, tuple[tuple[str, ...], dict[str, Any], list[str]]] = {
    "all": ((), {}, []),
    "missing as empty": (("chair_01/001",), {"missing": "empty"}, ["1 of 4 missing, scored as empty"]),
    "a part of validation": (("val_chair",), {}, ["VALIDATION"]),
    "a part of validation, rest empty": (("val_chair",), {"missing": "empty"}, ["VALIDATION"]),
    "a test pair missing": (("chair_02",), {}, []),
    "no validation": (("chair_03", "table_02"), {}, ["thresholds fixed at 0.5"]),
    "a baseline's name": ((), {"method": "hull"}, []),
}


# Each joins or repeats what two of the others have.
FURTHER = {"a part of validation, rest empty", "a test pair missing"}


@pytest.mark.parametrize("name", [slow(name) if name in FURTHER else name for name in CASES])
def test_scorer_and_score_agree_to_the_byte(release: Release, tmp_path: Path, name: str) -> None:
    without, options, expected = CASES[name]
    validation = release.split("validation")
    if expected == ["VALIDATION"]:  # all but the first of the validation split
        without, kept = (validation[0].name,), len(validation) - 1
        expected = [f"{kept} of {len(validation)} validation pairs predicted"]
    elif name == "no validation":
        without = tuple(target.name for target in validation)
        assert without
    options = {"method": "net"} | options
    by_files = score(release, write(release, tmp_path, without), surface=False, **options)
    in_memory = scored_in_memory(release, without, **options)
    assert json.dumps(without_hashes(in_memory)) == json.dumps(without_hashes(by_files))
    found = [
        words
        for words in words_of(by_files)
        if not words.startswith("threshold pooled over other categories")
    ]
    assert found == expected
    by_files.write(tmp_path / "out")
    assert read_table(tmp_path / "out" / "scores.json").text() == by_files.text()


@pytest.mark.parametrize(
    ("objects", "mark"),
    [({}, ["thresholds from a file that names no objects"]), ({"objects": ["elsewhere"]}, [])],
)
def test_thresholds_of_a_file_without_objects_are_marked(
    release: Release, tmp_path: Path, objects: dict[str, Any], mark: list[str]
) -> None:
    path = tmp_path / "thresholds.json"
    path.write_text(json.dumps({"thresholds": {"chair": 0.4, "table": 0.5}} | objects))
    table = score(
        release, write(release, tmp_path / "net"), method="net", surface=False, thresholds_file=path
    )
    assert words_of(table) == mark and bool(table.warnings) == bool(mark)
    again = scored_in_memory(release, method="net", thresholds_file=path)
    assert json.dumps(without_hashes(again)) == json.dumps(without_hashes(table))


def test_baselines_are_known_by_their_names() -> None:
    assert tuple(BASELINES) == BASELINE_NAMES


def test_a_category_without_validation_is_marked(release: Release, tmp_path: Path) -> None:
    targets = tuple(t for t in release.targets if (t.split, t.category) != ("validation", "table"))
    part = Release(release.folder, targets, release.metadata)
    table = score(part, write(part, tmp_path), method="net", surface=False)
    assert table.threshold_source == "validation"
    assert table.threshold_source_by_category == {"chair": "validation", "table": "pooled"}
    value = table.thresholds["chair"]
    assert words_of(table) == [f"threshold pooled over other categories, {value:g}: table"]
    only = Release(release.folder, tuple(t for t in targets if t.category == "table" or t.split == "test"),
                   release.metadata)  # fmt: skip
    assert score(only, tmp_path, method="net", surface=False).threshold_source == "fixed"
