"""Recordings in other files: they count as if they stood in benchmark.yaml; errors name their place."""

import csv
import io
import os
from pathlib import Path
from typing import Any

import pyarrow
import pytest
from pyarrow import parquet
from raising import raises
from stores import s3, s3_server

from kinectbench.core.errors import SettingsError
from kinectbench.core.store.store import Store
from kinectbench.settings import recording_table
from kinectbench.settings.file import load_benchmark
from kinectbench.settings.models import BenchmarkSettings

__all__ = ["s3", "s3_server"]  # fixtures
HEAD = "name: rooms\nlicense: CC0-1.0\n"
OWN = "recordings:\n  - {id: own, path: own, category: chair}\n"
ONE = "recordings:\n  - {id: %s, path: rec/%s, category: table}\n"
WANTED = (
    "wanted a list with at least one entry, each a text: names of YAML files with `recordings:`, or of "
    "tables, .csv or .parquet"
)
ONLY = "an included file holds `recordings:` and nothing else, a list as in benchmark.yaml; accepted are"
OPEN = "a quote that is opened there is not closed"
CSV_TEXT = (
    "id,path,category,split,camera.fx,camera.swap_red_blue,floor.plane_world,box.center_m,box.size_m,license\n"
    '007,rec/7,chair,train,525,TRUE,"[0, 0, 1, -0.5]",,,\n'
    "\n"
    '8,"rec/a, b",table,,,,,"[0, 0, 0.4]","[1, 1, 0.8]","CC BY\n4.0"\n'
)
SAME_AS_CSV = """\
recordings:
  - id: '007'
    path: rec/7
    category: chair
    split: train
    camera: {fx: 525, swap_red_blue: true}
    floor: {plane_world: [0, 0, 1, -0.5]}
  - id: '8'
    path: rec/a, b
    category: table
    box: {center_m: [0, 0, 0.4], size_m: [1, 1, 0.8]}
    license: "CC BY 4.0"
"""


def loaded(folder: Path, files: dict[str, str | bytes], overrides: tuple[str, ...] = ()) -> BenchmarkSettings:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return load_benchmark(folder / "benchmark.yaml", overrides)


def complaint(folder: Path, files: dict[str, str | bytes], overrides: tuple[str, ...] = ()) -> str:
    with pytest.raises(SettingsError) as caught:
        loaded(folder, files, overrides)
    return str(caught.value).replace(f"{folder}/", "").replace(str(folder), "HERE")


def main(include: str, rest: str = "") -> dict[str, str | bytes]:
    return {"benchmark.yaml": f"{HEAD}include: {include}\n{rest}"}


def test_included_recordings_stand_behind_its_own_sorted_by_file(tmp_path: Path) -> None:
    files = main('["rooms/*.yaml", last.yaml]', OWN)
    files |= {f"rooms/{name}.yaml": ONE % (name, name) for name in ("b", "a", "c")}
    files |= {"rooms/.hidden.yaml": "no", "rooms/notes.txt": "no", "last.yaml": ONE % ("a0", "a0")}
    found = loaded(tmp_path, files, ("recordings.b.camera.fx=500.0",))
    assert [recording.id for recording in found.recordings] == ["own", "a", "b", "c", "a0"]
    assert found.recordings[2].camera is not None and found.recordings[2].camera.fx == 500
    # What is written of the settings anywhere does not depend on the files that they came in.
    whole = OWN + "".join((ONE % (name, name)).split("\n", 1)[1] for name in ("a", "b", "c", "a0"))
    at_once = tmp_path / "whole"
    same = loaded(at_once, {"benchmark.yaml": HEAD + whole}, ("recordings.b.camera.fx=500.0",))
    assert same.model_dump_json() == found.model_dump_json()


def test_a_table_says_what_yaml_would(tmp_path: Path) -> None:
    found = loaded(tmp_path, main("[t.csv]") | {"t.csv": b"\xef\xbb\xbf" + CSV_TEXT.encode()})
    assert found == loaded(tmp_path / "yaml", {"benchmark.yaml": HEAD + SAME_AS_CSV})


@pytest.mark.parametrize("dictionary", [True, False])
def test_a_parquet_table_says_what_the_csv_does(dictionary: bool, tmp_path: Path) -> None:
    rows = list(csv.DictReader(io.StringIO(CSV_TEXT)))
    typed: list[dict[str, Any]] = [{key: cell or None for key, cell in row.items()} for row in rows]
    typed[0] |= {"camera.fx": 525.0, "camera.swap_red_blue": True, "floor.plane_world": [0.0, 0.0, 1.0, -0.5]}
    typed[1] |= {"box.center_m": [0.0, 0.0, 0.4], "box.size_m": [1.0, 1.0, 0.8]}
    parquet.write_table(pyarrow.Table.from_pylist(typed), tmp_path / "t.parquet", use_dictionary=dictionary)
    found = loaded(tmp_path, main("[t.parquet]"))
    assert found == loaded(tmp_path / "yaml", {"benchmark.yaml": HEAD + SAME_AS_CSV})


def test_every_field_of_a_recording_has_its_column() -> None:
    columns = recording_table.columns()
    assert {"id", "path", "object", "camera.depth_code", "box.yaw_rad", "floor.plane_world", "masks"} <= set(
        columns
    )
    assert not {"camera", "box", "floor"} & set(columns)


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        (main("[gone.yaml]"), "gone.yaml: no such file; it is named at benchmark.yaml:3: include; "),
        (main('["rooms/*.yaml"]'), "benchmark.yaml:3: include: no file is called 'rooms/*.yaml' in HERE"),
        (main("[../a.yaml]"), "benchmark.yaml:3: include: '../a.yaml' leads out of the folder"),
        (main("[/etc/a.yaml]"), "benchmark.yaml:3: include: '/etc/a.yaml' leads out of the folder"),
        (main("[.a.yaml]"), "benchmark.yaml:3: include: '.a.yaml' is hidden"),
        (main('["**/a.yaml"]'), "benchmark.yaml:3: include: '**/a.yaml' looks through folders of any depth"),
        (main('[""]'), "benchmark.yaml:3: include: is no name of a file"),
        (main("[benchmark.yaml]"), "benchmark.yaml:3: include: 'benchmark.yaml' is this file itself; remove"),
        (main('["*.yaml"]'), "benchmark.yaml:3: recordings: found a list of 0; wanted a list with at least"),
        (main("a.yaml", OWN), "benchmark.yaml:3: include: found the text 'a.yaml'; wanted a list with at"),
        (main("[3]"), "benchmark.yaml:3: include[0]: found 3; wanted text: write '3' in quotes"),
        (main("[[a.yaml]]"), "benchmark.yaml:3: include[0]: found ['a.yaml']; wanted text"),
        (main("[null]", OWN), "benchmark.yaml:3: include[0]: found nothing; wanted text"),
        (main("[rooms]") | {"rooms/a.yaml": "x"}, "benchmark.yaml:3: include: 'rooms' is a folder; name its"),
        (main("[rooms/]") | {"rooms/a.yaml": "x"}, "benchmark.yaml:3: include: 'rooms' is a folder; name"),
        (main("[t.tsv]") | {"t.tsv": "id\tpath\na\ta\n"}, f"benchmark.yaml:3: include: t.tsv:1: {ONLY}"),
        (main("[t.xlsx]") | {"t.xlsx": "\0PK"}, "benchmark.yaml:3: include: t.xlsx"),
        (main("['s3://b/a.yaml']"), "benchmark.yaml:3: include: 's3://b/a.yaml' is a URL; files are named"),
        (main("['s3:///a.yaml']"), "benchmark.yaml:3: include: 's3:///a.yaml' is a URL; files are named"),
        (main("['ftp://b/a.yaml']"), "benchmark.yaml:3: include: 'ftp://b/a.yaml' is a URL; files are"),
        (main("[t.csv]") | {"t.csv": 'id,path,category\na,a,"c\n'}, f"t.csv: no CSV table: line 2: {OPEN}"),
        (
            main("[t.csv]") | {"t.csv": 'id,path\n"a\nb",c\nd,"\n'},
            f"t.csv: no CSV table: line 4: {OPEN}",
        ),
        (
            main("[t.csv]") | {"t.csv": 'id,path\n"a"b,c\n'},
            "t.csv: no CSV table: line 2: a quote is followed",
        ),
        (main("[]", OWN), "benchmark.yaml:3: include: found a list of 0; wanted a list with at least one"),
        (
            main("[a.yaml]") | {"a.yaml": "views: {count: 1}\n"},
            "a.yaml:1: views: an included file holds `rec",
        ),
        (main("[a.yaml]") | {"a.yaml": "include: [b.yaml]\n"}, "a.yaml:1: include: an included file holds"),
        (
            main("[a.yaml]") | {"a.yaml": ""},
            "a.yaml:1: an included file holds `recordings:` and nothing else",
        ),
        (main("[a.yaml]") | {"a.yaml": "- {id: a}\n"}, "a.yaml:1: an included file holds `recordings:` and"),
        (main("[a.yaml]") | {"a.yaml": "recordings: x\n"}, "a.yaml:1: an included file holds `recordings:`"),
        (main("[a.yaml]") | {"a.yaml": "\n" + ONE % ("a/b", "c")}, "a.yaml:3: recordings.a/b.id: found the"),
        (
            main("[a.yaml]", OWN) | {"a.yaml": ONE % ("own", "c")},
            "a.yaml:2: recordings.own: two recordings have the id 'own': give each its own (the other is at "
            "benchmark.yaml:5)",
        ),
        (main("[t.csv]") | {"t.csv": ""}, "t.csv: an empty file; its first line names the columns"),
        (
            main("[t.csv]") | {"t.csv": "id,path,catgory\n"},
            "t.csv:1: 'catgory' is no column of recordings; did",
        ),
        (
            main("[t.csv]") | {"t.csv": "id,camera\n"},
            "t.csv:1: 'camera' is no column of recordings; write a c",
        ),
        (
            main("[t.csv]") | {"t.csv": "id;path\n"},
            "t.csv:1: 'id;path' is no column of recordings; columns ar",
        ),
        (main("[t.csv]") | {"t.csv": "id,id\n"}, "t.csv:1: the column 'id' stands 2 times; keep one"),
        (
            main("[t.csv]") | {"t.csv": "id\na,b\n"},
            "t.csv:2: 2 cells under 1 columns; put a cell with a comma",
        ),
        (main("[t.csv]") | {"t.csv": b"id\n\xff\n"}, "t.csv:2: not UTF-8 text; save the file as UTF-8"),
        (
            main("[t.csv]") | {"t.csv": 'id,path,category,camera.fx\n"a","x\ny",chair,1\nb,x,chair,wide\n'},
            "t.csv:4: recordings.b.camera.fx: found the text 'wide'; wanted a number above 0",
        ),
        (main("[t.parquet]") | {"t.parquet": "PAR1"}, "t.parquet: no Parquet table: "),
    ],
)
def test_what_cannot_be_included_is_one_line(
    files: dict[str, str | bytes], expected: str, tmp_path: Path
) -> None:
    told = complaint(tmp_path, files)
    assert told.startswith(expected)
    assert len(told.splitlines()) == 1


def test_a_file_that_two_patterns_mean_is_read_once(tmp_path: Path) -> None:
    files = main('[a.yaml, "?.yaml"]') | {"a.yaml": ONE % ("a", "a"), "b.yaml": ONE % ("b", "b")}
    assert [recording.id for recording in loaded(tmp_path, files).recordings] == ["a", "b"]


def test_links_lead_nowhere_else(tmp_path: Path) -> None:
    (tmp_path / "elsewhere.yaml").write_text(ONE % ("a", "a"))
    here = tmp_path / "here"
    here.mkdir()
    (here / "a.yaml").symlink_to("../elsewhere.yaml")
    assert complaint(here, main("[a.yaml]")).startswith("a.yaml: a link that leads out of HERE")
    (here / "a.yaml").unlink()
    os.mkfifo(here / "a.yaml")
    assert "a.yaml: cannot be read: not a plain file but a pipe" in complaint(here, main("[a.yaml]"))


def test_included_files_together_may_hold_as_much_as_one(tmp_path: Path) -> None:
    ones = ", ".join("1" * 150_000)
    most = f"recordings:\n  - {{id: a, path: x, category: c, license: [{ones}]}}\n"
    files = main('["*.yaml"]') | {f"{n}.yaml": most for n in range(3)}
    assert complaint(tmp_path, files) == (
        "2.yaml:2: more than the 400000 keys and values that such a file may have"
    )
    large = "#" * (9 << 20) + "\nrecordings: [{id: a, path: x, category: c}]\n"
    assert "1.yaml: cannot be read: larger than the" in complaint(
        tmp_path, files | {f"{n}.yaml": large for n in range(2)}
    )


def test_a_parquet_file_that_unpacks_to_too_much_is_refused(tmp_path: Path) -> None:
    table = pyarrow.table({"id": ["a" * 100_000] * 2_000})
    parquet.write_table(table, tmp_path / "t.parquet", compression="zstd")
    assert (tmp_path / "t.parquet").stat().st_size < 1 << 20
    assert complaint(tmp_path, main("[t.parquet]")) == "t.parquet: a column of more than 16777216 characters"
    rows = pyarrow.table({"id": ["a"] * (recording_table.MOST_ROWS + 1)})
    parquet.write_table(rows, tmp_path / "t.parquet")
    assert complaint(tmp_path, main("[t.parquet]")) == "t.parquet: 100001 rows; at most 100000 may be there"
    for value, kind in ({"a": 1}, "struct<"), (["x"], "list<"):
        parquet.write_table(pyarrow.table({"id": [value]}), tmp_path / "t.parquet")
        assert complaint(tmp_path, main("[t.parquet]")).startswith(f"t.parquet: the column 'id' holds {kind}")


def test_repeated_long_text_of_a_parquet_file_is_counted_before_it_is_expanded(tmp_path: Path) -> None:
    of_one = pyarrow.array(["a" * 100_000] * 2_000, pyarrow.large_string())
    parquet.write_table(pyarrow.table({"id": of_one}), tmp_path / "t.parquet", compression="zstd")
    before = pyarrow.default_memory_pool().max_memory()
    assert complaint(tmp_path, main("[t.parquet]")) == "t.parquet: a column of more than 16777216 characters"
    assert pyarrow.default_memory_pool().max_memory() - before < 100e6


def test_what_is_included_stands_in_the_file_alone(tmp_path: Path) -> None:
    files: dict[str, str | bytes] = {"benchmark.yaml": HEAD + OWN}
    assert complaint(tmp_path, files, ("include=[a.yaml]",)) == (
        "in --set include=[a.yaml]: what is included is read first; write it into the file"
    )


def test_files_in_a_store_are_included_likewise(s3: str, tmp_path: Path) -> None:
    files = main('["rooms/*.yaml", t.csv]', OWN) | {"t.csv": CSV_TEXT, "rooms/.b.yaml": "no"}
    files |= {f"rooms/{name}.yaml": ONE % (name, name) for name in ("b", "a", "deep/c")}
    for name, content in files.items():
        Store(s3).put(name, content if isinstance(content, bytes) else content.encode())
    there = load_benchmark(Path(s3) / "benchmark.yaml")
    assert [recording.id for recording in there.recordings] == ["own", "a", "b", "007", "8"]
    assert there == loaded(tmp_path, files)


def test_files_come_in_one_order_wherever_they_lie(s3: str, tmp_path: Path) -> None:
    # "-" and "." stand before "/" among signs.
    folders = ("rooms", "rooms-2", "rooms.b")
    files = main('["rooms*/*.yaml"]', OWN) | {f"{name}/a.yaml": ONE % (name, name) for name in folders}
    for name, content in files.items():
        Store(s3).put(name, content if isinstance(content, bytes) else content.encode())
    there = load_benchmark(Path(s3) / "benchmark.yaml")
    assert [recording.id for recording in there.recordings] == ["own", *folders]
    assert there == loaded(tmp_path, files)


def test_faults_of_included_files_in_a_store_are_told(s3: str) -> None:
    Store(s3).put("benchmark.yaml", b"name: a\ninclude: ['rooms/*.yaml']\n")
    Store(s3).put("rooms/a.yaml", b"recordings: [{}]")
    with raises(SettingsError, "settings.missing-key", match=f"{s3}/rooms/a.yaml:1"):
        load_benchmark(Path(s3) / "benchmark.yaml")
    Store(s3).put("benchmark.yaml", b"name: a\ninclude: [gone.yaml]\n")
    with raises(SettingsError, "settings.no-file", match=f"{s3}/gone.yaml"):
        load_benchmark(Path(s3) / "benchmark.yaml")
    Store(s3).put("benchmark.yaml", b"name: a\ninclude: ['gone/*.yaml']\n")
    with raises(SettingsError, "settings.wrong-value", match=f"{s3}/benchmark.yaml:2"):
        load_benchmark(Path(s3) / "benchmark.yaml")


def test_a_link_to_itself_is_a_line(tmp_path: Path) -> None:
    (tmp_path / "loop.csv").symlink_to("loop.csv")
    assert "loop.csv: cannot be read: Too many levels of symbolic links" in complaint(
        tmp_path, main("[loop.csv]", OWN)
    )
