"""Tables of very many rows: the rows lie beside scores.json, come back as they were, and are not believed."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
from pydantic import ValidationError
from pydantic_core import InitErrorDetails
from raising import raises
from score_rows import row, table
from small_benchmark import Run

from kinectbench.core.artefacts import score_columns, scores
from kinectbench.core.artefacts.score_columns import MOST_BYTES, MOST_ROWS, MOST_ROWS_IN_SPACE, ROWS_NPZ
from kinectbench.core.artefacts.scores import NO_FACTS, ScoreTable
from kinectbench.core.errors import StorageError
from kinectbench.core.storage import canonical_json, sha256_file, sha256_text
from kinectbench.core.voxels.npz import load_arrays, npz_bytes
from kinectbench.release.release import Release

Command = Callable[..., Run]
CURVE = tuple(k / 17 for k in range(17))


@pytest.fixture
def many(monkeypatch: pytest.MonkeyPatch) -> ScoreTable:
    """Ten rows where five are many; with all that a row may lack."""
    monkeypatch.setattr(score_columns, "ROWS_IN_JSON", 5)
    rows = [replace(row("stühle", n, n % 2, n / 10), iou_by_threshold=CURVE) for n in range(9)]
    return table("net", [*rows, row("chair", 9, 0, None)])


def test_many_rows_lie_beside_the_table(many: ScoreTable, tmp_path: Path) -> None:
    many.write(tmp_path)
    content = json.loads((tmp_path / "scores.json").read_text())
    assert content["rows"] == [] and content["rows_file"]["rows"] == 10
    assert content["rows_file"]["sha256"] == sha256_file(tmp_path / ROWS_NPZ)
    found = ScoreTable.read(tmp_path)
    assert found.rows == many.rows and found.rows_file is None
    assert found.facts_sha256() == many.facts_sha256()
    assert all(type(of.cells) is int for of in found.rows)
    assert (tmp_path / "scores.csv").read_text() == many.csv()
    few = many.model_copy(update={"rows": many.rows[:5]})
    few.write(tmp_path)  # where the other one lies
    assert not (tmp_path / ROWS_NPZ).exists() and ScoreTable.read(tmp_path).rows == few.rows
    assert "rows_file" not in json.loads((tmp_path / "scores.json").read_text())


@pytest.mark.parametrize("count", [5, 10])
def test_a_table_of_another_name_leaves_the_rows_of_the_one_beside_it(
    many: ScoreTable, count: int, tmp_path: Path
) -> None:
    many.write(tmp_path)
    other = many.model_copy(update={"rows": many.rows[:count]})
    other.write(tmp_path, "other.json")
    assert ScoreTable.read(tmp_path).rows == many.rows
    assert ScoreTable.read_file(tmp_path / "other.json").rows == other.rows


def test_a_table_of_another_name_keeps_many_rows_beside_it(many: ScoreTable, tmp_path: Path) -> None:
    (tmp_path / ROWS_NPZ).write_bytes(b"of the same table, as another zlib wrote them")
    many.write(tmp_path, "other.json")
    assert json.loads((tmp_path / "other.json").read_text())["rows"] == []
    assert ScoreTable.read_file(tmp_path / "other.json").rows == many.rows


def test_where_scores_json_has_rows_another_table_with_many_is_refused(
    many: ScoreTable, tmp_path: Path
) -> None:
    many.write(tmp_path)
    (tmp_path / "other.json").write_bytes(b"as it was")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with raises(StorageError, "storage.other-content", match="folder of its own"):
        many.model_copy(update={"rows": many.rows[:9]}).write(tmp_path, "other.json")
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_until_it_is_replaced_a_table_keeps_its_rows(
    many: ScoreTable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    many.write(tmp_path)

    def full(path: Path) -> NoReturn:
        raise StorageError(f"{path}: the disk is full", what="no-room")

    monkeypatch.setattr(scores, "replaced_file", full)
    with raises(StorageError, "storage.no-room"):
        many.model_copy(update={"rows": many.rows[:5]}).write(tmp_path)
    assert ScoreTable.read(tmp_path).rows == many.rows


@pytest.mark.parametrize("count", [0, 1, 10])
def test_facts_are_hashed_as_one_text_would_be(many: ScoreTable, count: int) -> None:
    """Row by row, with the digest that files of earlier versions hold."""
    some = many.model_copy(update={"rows": many.rows[:count]})
    content = some.json_value()
    whole = canonical_json({key: content[key] for key in sorted(content) if key not in NO_FACTS})
    assert some.facts_sha256() == sha256_text(whole)


WRONG: dict[str, tuple[Callable[[dict[str, np.ndarray]], object], str]] = {
    "a column is missing": (lambda of: of.pop("iou"), "holds no 'iou'|'iou'"),
    "fewer rows": (lambda of: of.update(iou=of["iou"][:-1]), r"'iou' is float64 \(9,\), wanted \(10,\)"),
    "another type": (lambda of: of.update(ce=of["ce"].astype(np.float32)), "'ce' is float32"),
    "another shape": (lambda of: of.update(iou_by_threshold=np.zeros((10, 3))), "'iou_by_threshold' is"),
    "a text that is not listed": (lambda of: of["object"].fill(99), "'object' names texts that are not in"),
    "no texts": (lambda of: of.update(view_words=np.zeros(3)), "'view_words' is no list of texts"),
    "bytes of no width": (
        lambda of: of.update(in_space_words=np.zeros((10, 0), np.uint8)),
        "'in_space_words' is no list of texts",
    ),
    "infinity": (lambda of: of["iou"].fill(np.inf), "'iou': Input should be a finite number"),
    "a gap": (lambda of: of["threshold"].fill(np.nan), "'threshold': Input should be a valid number"),
    "half a cell": (lambda of: of["cells"].fill(0.5), "'cells': Input should be a valid integer"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_columns_are_told(many: ScoreTable, tmp_path: Path, name: str) -> None:
    change, words = WRONG[name]
    many.write(tmp_path)
    arrays = load_arrays(tmp_path / ROWS_NPZ)
    change(arrays)
    (tmp_path / ROWS_NPZ).write_bytes(npz_bytes(arrays))
    with raises(StorageError, "storage.damaged", match=r"scores\.json"):
        ScoreTable.read(tmp_path)
    stranger(tmp_path, sha256=sha256_file(tmp_path / ROWS_NPZ))
    with raises(StorageError, "storage.damaged", match=words) as error:
        ScoreTable.read(tmp_path)
    assert "\n" not in str(error.value) and str(error.value).startswith(
        f"{tmp_path / ROWS_NPZ}: not the rows"
    )


def test_a_check_of_a_row_is_told_in_its_own_words(
    many: ScoreTable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without pydantic's "Value error, "."""

    def refused(*_: object) -> NoReturn:
        said: InitErrorDetails = {
            "type": "value_error",
            "loc": ("iou",),
            "input": 2,
            "ctx": {"error": ValueError("too good")},
        }
        raise ValidationError.from_exception_data("ScoreRow", [said])

    many.write(tmp_path)
    monkeypatch.setattr(score_columns, "_rows", refused)
    with raises(StorageError, "storage.damaged", match=r"\('iou': too good\)"):
        ScoreTable.read(tmp_path)


def stranger(folder: Path, **rows_file: object) -> None:
    """Change what scores.json says of its rows."""
    content = json.loads((folder / "scores.json").read_text())
    content["rows_file"] |= rows_file
    (folder / "scores.json").write_text(json.dumps(content))


def test_what_a_stranger_may_say_is_bounded(many: ScoreTable, tmp_path: Path) -> None:
    many.write(tmp_path)
    for rows, words in ((MOST_ROWS + 1, "less than or equal to 500000"), (9, r"wanted \(9,\)")):
        stranger(tmp_path, rows=rows)
        with raises(StorageError, "storage.damaged", match=words):
            ScoreTable.read(tmp_path)
    (tmp_path / ROWS_NPZ).unlink()
    with raises(StorageError, "storage.damaged", match=r"rows\.npz"):
        ScoreTable.read(tmp_path)
    both = many.json_value() | {"rows_file": {"rows": 10, "sha256": "0" * 64}}
    (tmp_path / "both.json").write_text(json.dumps(both))
    with raises(StorageError, "storage.damaged", match="'rows' and 'rows_file'"):
        ScoreTable.read_file(tmp_path / "both.json")


def test_commands_score_and_read_them(
    command: Command, release: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Baselines are not added: all of them at once would take gigabytes."""
    monkeypatch.setattr(score_columns, "ROWS_IN_JSON", 5)
    for target in release.split("test"):
        for name, value in (("full", 1), ("none", 0)):
            path = tmp_path / name / target.recording / f"{target.view}.npy"
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, np.full((2, 2, 2), value, bool))
    words = ("--benchmark", str(release.folder), "--no-surface")
    for name in ("full", "none"):
        made = command(tmp_path, "score", name, *words, "--out", f"scores/{name}")
        line = (
            "baselines: note: none beside more than 5 rows; `kinectbench baseline NAME` writes one to be "
            "scored"
        )
        assert made.status == 0 and line in made.err, made
        assert (tmp_path / "scores" / name / ROWS_NPZ).is_file()
        assert not (tmp_path / "scores" / name / "baselines").exists()
    compared = command(tmp_path, "compare", "scores")
    assert compared.status == 0 and "full - none" in compared.out
    again = command(tmp_path, "score", "full", *words[:2], "--recheck", "scores/full/scores.json")
    assert again.status == 0 and again.out.startswith("scores/full/scores.json: verified"), again
    assert command(tmp_path, "report", *words[:2]).status == 0


def test_what_is_said_in_space_is_stored_in_a_byte_a_character(many: ScoreTable, tmp_path: Path) -> None:
    rows = tuple(replace(of, part="whole", silhouette=1 / (n + 3)) for n, of in enumerate(many.rows))
    many.model_copy(update={"rows": rows}).write(tmp_path)
    arrays = load_arrays(tmp_path / ROWS_NPZ)
    words = arrays["in_space_words"]
    assert words.dtype == np.uint8 and words.shape[0] == len(rows)
    assert ScoreTable.read(tmp_path).rows == rows
    texts = [bytes(word).rstrip(b"\0").decode() for word in words]
    assert max(map(len, texts)) == words.shape[1]
    arrays["in_space_words"] = np.array(texts)  # as earlier versions wrote it
    (tmp_path / ROWS_NPZ).write_bytes(npz_bytes(arrays))
    stranger(tmp_path, sha256=sha256_file(tmp_path / ROWS_NPZ))
    assert ScoreTable.read(tmp_path).rows == rows


def test_as_many_rows_in_space_as_are_scored_can_be_read() -> None:
    """Beside their 360 bytes of figures 1,440 of JSON; a row of ten votes has 1,020."""
    assert MOST_ROWS_IN_SPACE * (360 + 1440) <= MOST_BYTES


def test_a_hundred_thousand_pairs_fit() -> None:
    """Under all five protocols. `benchmarks/speed/score_many.py` measures what that takes."""
    assert MOST_ROWS == 100_000 * 5
