"""A benchmark.yaml that hangs, is huge, nested or wrong in a hundred thousand places is told in short."""

import gc
import os
import re
import time
from pathlib import Path

import pytest
import yaml
from raising import raises
from test_benchmark_file import GOOD, complaint

from kinectbench.core.errors import SettingsError
from kinectbench.core.storage import name_problem
from kinectbench.settings import yaml_nodes
from kinectbench.settings.file import SHOWN, load_benchmark
from kinectbench.settings.reading import MOST_BYTES
from kinectbench.settings.template import init_benchmark


@pytest.mark.parametrize("what", ["pipe", "zero"])
def test_what_is_no_plain_file_is_refused_at_once(what: str, tmp_path: Path) -> None:
    path = tmp_path / "benchmark.yaml"
    if what == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    with raises(SettingsError, "settings.unreadable", match="cannot be read: not a plain file but a pipe"):
        load_benchmark(path)


def test_a_file_that_is_too_large(tmp_path: Path) -> None:
    path = tmp_path / "benchmark.yaml"
    with path.open("wb") as file:
        file.truncate(MOST_BYTES + 1)
    with raises(SettingsError, "settings.unreadable", match="16777216"):
        load_benchmark(path)


NESTED = {
    "brackets": "[" * 200_000,
    "dashes": "- " * 200_000,
    "braces": "{a: " * 200_000,
    "closed": "[" * 400 + "]" * 400,
    "lists of maps": "[{a: " * 9000,
}


@pytest.mark.parametrize("fast", [True, False])
@pytest.mark.parametrize("name", NESTED)
def test_nesting_ends_in_a_line(
    name: str, fast: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not fast:
        monkeypatch.setattr(yaml_nodes, "_Parser", None)
    assert len(complaint(tmp_path, f"name: a\nx: {NESTED[name]}\n").splitlines()) <= 2


# Whatever grows with their square takes minutes.
MANY = 30_000
COSTLY = {
    "unknown keys": ("".join(f"k{n}: 1\n" for n in range(MANY)), "k18: unknown key"),
    "wrong values": (
        "publish: {changelog: [" + "1, " * MANY + "]}\n",
        "publish.changelog[26]: found 1; wanted a mapping",
    ),
    "a comment": ("#" * (10 << 20) + "\n", "recordings: missing"),
    "wrong recordings": ("".join(["recordings:\n", *["- {id: a/b}\n"] * MANY]), "missing"),
    "a long key": (f"? {'k' * 100_000}\n: 1\n", "kkkk…kkkk"),
    "a long id": (f"recordings: [{{id: {'k' * 100_000}, path: a, category: a}}]\n", "kkkk…kkkk"),
    "a key twice": (f"? {'k' * 100_000}\n: 1\n? {'k' * 100_000}\n: 2\n", "stands twice"),
    "a long number": (f"license: 1.{'0' * 100_000}\n", "in quotes"),
    "a long tag": (f"license: !{'k' * 100_000} a\n", "is not used here"),
}


TOO_MANY = "more than the 400000 keys and values that such a file may have"
COSTLIER = {
    "values": ("x: [" + "1," * (yaml_nodes.MOST_VALUES + 10) + "]\n", TOO_MANY),
    "lines": ("x:\n" + "- 1\n" * (2 * yaml_nodes.MOST_VALUES), TOO_MANY),
    "numbers for recordings": ("recordings: [" + "1," * 20_000 + "]\n", "recordings[0]: found 1; wanted"),
    "nothing for recordings": ("recordings: [" + "{}," * 20_000 + "]\n", "recordings[0].id: missing"),
    "many aliases": ("a: &a [1, 1]\nb: [" + "*a," * 50_000 + "]\n", "a: unknown key"),
}


@pytest.mark.parametrize("name", COSTLIER)
def test_what_costs_most_of_so_many_values(name: str, tmp_path: Path) -> None:
    text, words = COSTLIER[name]
    started = time.process_time()
    assert words in complaint(tmp_path, f"name: a\n{text}")
    assert time.process_time() - started < 10


def test_the_first_wrong_recording_of_many_is_told_by_its_place(tmp_path: Path) -> None:
    rows = [f"- {{id: r{n}, path: p, category: c}}\n" for n in range(12_000)]
    rows[7000] = "- {id: r7000, path: p, category: 7}\n"
    told = complaint(tmp_path, "".join(["name: a\n", "recordings:\n", *rows]))
    assert told.startswith("benchmark.yaml:7003: recordings.r7000.category: found 7")
    rows[7000] = rows[1].replace("p,", "q,")
    told = complaint(tmp_path, "".join(["name: a\n", "recordings:\n", *rows]))
    assert told.startswith("benchmark.yaml:7003: ") and "r1" in told


@pytest.mark.parametrize("name", COSTLY)
def test_what_is_wrong_is_told_in_time_and_in_short(name: str, tmp_path: Path) -> None:
    text, words = COSTLY[name]
    started = time.process_time()
    told = complaint(tmp_path, f"name: a\n{text}")
    assert time.process_time() - started < 5
    lines = told.splitlines()
    assert words in told and len(lines) <= SHOWN + 1 and max(map(len, lines)) < 600
    if len(lines) > SHOWN:
        assert re.fullmatch(r"benchmark.yaml: and \d+ more errors", lines[-1])


def test_both_parsers_give_the_same_nodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def marks(node: yaml.Node) -> list[object]:
        inside = node.value if isinstance(node.value, list) else []
        children = [child for one in inside for child in (one if isinstance(one, tuple) else (one,))]
        mark = (
            node.tag,
            node.start_mark.line,
            node.start_mark.column,
            node.start_mark.index,
            node.end_mark.index,
        )
        return [mark, *(of for child in children for of in marks(child))]

    text = "é: [1, ' ü', \"\\u00e4\"]\n# …\na: &x {b: yes}\nc: *x\nd: 5e-3\ne: |\n  ä\n  ö\nf: 1\n"
    assert yaml_nodes._Parser is not None, "PyYAML is built with libyaml here"
    first = marks(yaml_nodes.compose(text, "a.yaml"))
    monkeypatch.setattr(yaml_nodes, "_Parser", None)
    assert first == marks(yaml_nodes.compose(text, "a.yaml"))


OURS = ("publish.json", "INDEX.HTML", "gallery.npz", "scores.csv", "baselines", "a.part")


@pytest.mark.parametrize("name", OURS)
def test_names_of_files_of_ours_are_for_nothing_else(name: str, tmp_path: Path) -> None:
    told = complaint(tmp_path, f"name: a\nrecordings: [{{id: {name}, path: a, category: chair}}]\n")
    assert "files and folders of kinectbench have such names" in told
    assert name_problem("chair.01") is None and name_problem("scores") is None


def test_thousands_of_recordings_are_read_soon(tmp_path: Path) -> None:
    rows = "".join(f"  - {{id: r{n}, path: in/r{n}, category: chair}}\n" for n in range(5000))
    (tmp_path / "benchmark.yaml").write_text(f"name: many\nrecordings:\n{rows}", encoding="utf-8")
    gc.freeze()  # what other tests left would be searched for garbage again and again
    started = time.process_time()
    assert len(load_benchmark(tmp_path / "benchmark.yaml", ["recordings.r7.split=train"]).recordings) == 5000
    assert time.process_time() - started < 4  # 0.4 s where nothing else runs
    gc.unfreeze()
    with raises(SettingsError, "settings.no-recording", match=r"r0.*r1.*4960") as told:
        load_benchmark(tmp_path / "benchmark.yaml", ["recordings.x.split=train"])
    assert len(str(told.value)) < 500


def test_init_gives_names_that_can_be_used_and_soon(tmp_path: Path) -> None:
    found = [(f"{n}/{name}", "tum") for n in range(400) for name in (*OURS, "same")]
    started = time.process_time()
    text = init_benchmark(tmp_path / "baselines", found, ())
    assert time.process_time() - started < 1.6
    (tmp_path / "benchmark.yaml").write_text(text, encoding="utf-8")
    settings = load_benchmark(tmp_path / "benchmark.yaml")
    assert len({one.id.lower() for one in settings.recordings}) == len(found)


@pytest.mark.parametrize(
    "day",
    ["٢٠٢٤-01-01", "２０２４-01-01", "2024-13-01", "2024-02-30", "0000-01-01", "20240101", "2024-W01-1"],
)
def test_a_date_is_a_day_of_the_calendar_in_plain_digits(day: str, tmp_path: Path) -> None:
    assert "date_released" in complaint(
        tmp_path, f'name: a\nrecordings: []\npublish: {{citation: {{date_released: "{day}"}}}}\n'
    )


@pytest.mark.parametrize(
    ("first", "then"),
    [("fusion={[1]: 2}", "fusion.voxel_size_m=0.01"), ("recordings=[{[1]: 2}]", "recordings.a.split=test")],
)
def test_a_key_that_is_a_list_is_a_line(first: str, then: str, tmp_path: Path) -> None:
    assert complaint(tmp_path, GOOD, first, then)
