"""What the terminal shows of texts that strangers wrote: one line each, and nothing that steers it."""

import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from rich.table import Table
from rich.text import Text
from small_benchmark import Run

from kinectbench.cli import console
from kinectbench.cli.common import Common
from kinectbench.cli.progress_bars import PlainLines, progress_bar, step_shown
from kinectbench.cli.wide_table import WideTable
from kinectbench.core.errors import SettingsError
from kinectbench.release.release import Release

Command = Callable[..., Run]
EVIL = "a\x1b]0;pwned\x07\x1b[2J\x9b2J\u202e\u2028b\x08\x00c\rd\x7f"
CONTROL = [chr(n) for n in (*range(9), *range(11, 32), *range(127, 160), 0x202E, 0x2028, 0x2029, 0xFEFF)]


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[io.StringIO]:
    """A terminal that takes every sequence, for both streams."""
    shown = io.StringIO()
    for name in ("err", "out"):
        made = console.SafeConsole(file=shown, force_terminal=True, color_system=None, width=200)
        monkeypatch.setattr(console, name, made)
    yield shown


def check(text: str, lines: int) -> None:
    assert [sign for sign in CONTROL if sign in text] == []
    assert len(text.splitlines()) == lines


@pytest.mark.parametrize("sign", CONTROL)
def test_no_control_character_is_shown(sign: str, terminal: io.StringIO) -> None:
    console.lines(f"x{sign}", [f"a{sign}b"], "red")
    console.out.print(Text(f"a{sign}b"), soft_wrap=True)
    check(terminal.getvalue(), 2)


def test_a_message_is_one_line_whatever_is_in_it(
    terminal: io.StringIO, capsys: pytest.CaptureFixture[str]
) -> None:
    message = f"x.npy\nerror: all well{EVIL}\r\nerror: indeed"
    console.lines("error", [message], "red")
    console.recording_lines("r\nerror", "warning", [message], "yellow")
    console.say(message)
    watcher = PlainLines()
    watcher.say(message)
    check(terminal.getvalue(), 3)
    check(capsys.readouterr().out, 1)


def test_a_log_has_the_step_of_a_command_if_it_has_had_no_line_for_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shown = io.StringIO()
    monkeypatch.setattr(console, "err", console.SafeConsole(file=shown, width=80))
    with step_shown("inspect") as step:
        step("reading frames")
        assert shown.getvalue() == ""
        monkeypatch.setattr("kinectbench.cli.progress_bars.LOG_EVERY_S", 0.0)
        step("comparing frames")
    assert shown.getvalue() == "[   0 s] inspect: comparing frames\n"


def test_a_flood_of_messages_is_cut(terminal: io.StringIO, capsys: pytest.CaptureFixture[str]) -> None:
    flood = [f"{number}: not part of the release" for number in range(250_000)]
    console.lines("error", flood, "red")
    Common(as_json=True).tell_problems(flood, "all well")
    shown, told = terminal.getvalue().splitlines(), json.loads(capsys.readouterr().out)
    assert len(shown) == 2 * (console.MOST_LINES + 1) and len(told) == console.MOST_LINES + 1
    assert shown[-1] == "error: and 249000 more" and told[-1] == "and 249000 more"


def test_one_line_for_each_mistake() -> None:
    """Messages of one mistake differ in their files and voxels; others stay as they are."""
    missing = [f"{name}: no prediction; expected {name}.npy" for name in ("chair/000", "table/12", "x/y")]
    wrong = [
        "chair/001.npy: nan at (3, 2, 1)",
        "table/13.npz: nan at (30, 0, 1)",
        "chair/2.npy: inf at (3, 2, 1)",
    ]
    whole = ["method.json: no `name`", "incomplete: 7 predictions could not be scored"]
    lines = console.by_mistake([*whole, missing[0], *wrong, *missing[1:]])
    assert lines == [*whole, f"3 files, first {missing[0]}", f"2 files, first {wrong[0]}", wrong[2]]
    # Another size is another mistake; another measurement is not.
    far = [f"{name}.ply: {off_mm} mm too far" for name, off_mm in (("a", 10.5), ("b", 1.09e3), ("c", 932))]
    assert console.by_mistake(far) == [f"3 files, first {far[0]}"]
    sizes = [f"chair/{name}.npy: expected 32^3, found {side}^3" for name, side in (("0", 64), ("1", 128))]
    assert console.by_mistake(sizes) == sizes
    values = [f"{name}.npy: {value} at (0, 0, 7): in [0, 1]" for name, value in (("a", 1.5), ("b", -2e-7))]
    assert console.by_mistake(values) == [f"2 files, first {values[0]}"]
    assert console.by_mistake(["", ": ", "x", "x: "]) == ["", ": ", "x", "x: "]


def test_tables_and_titles(terminal: io.StringIO) -> None:
    rows = [{"recording": EVIL, "status": f"{EVIL}"}]
    console.out.print(
        console.text_table(rows, {"recording": "recording", "status": EVIL}, {}, title=EVIL, caption=EVIL)
    )
    table = Table(title=EVIL)
    table.add_column(EVIL)
    table.add_row(Text(EVIL))
    console.out.print(table)
    assert [sign for sign in CONTROL if sign in terminal.getvalue()] == []


@pytest.mark.parametrize("width", [20, 40, 80, 120])
@pytest.mark.parametrize(
    "name", ["room_scan_01", "hall_of_the_second_floor_chair_01_by_the_window", "n" * 90]
)
def test_no_table_shortens_an_id_or_a_number(width: int, name: str) -> None:
    keys = ("frames", "left_out", "lost", "repeatability_iou", "estimated_iou", "views", "pairs", "residual")
    columns = {key: key for key in ("recording", *keys, "status")}
    numbers = {key: number + 0.125 for number, key in enumerate(keys)}
    row = {"recording": name, **numbers, "estimated_iou": "0.82 (0.59 to 0.95)", "status": "made " * 12}
    made = console.SafeConsole(width=width, record=True, file=io.StringIO())
    made.print(console.text_table([row], columns, {}))
    text = made.export_text()
    assert "…" not in text and all(len(line) <= width for line in text.splitlines())
    cells = "".join(line.strip("│").split("│")[0].strip() for line in text.splitlines() if "│" in line)
    assert name in cells
    joined = "".join(line.strip("│ ").split("│")[-1].strip() for line in text.splitlines())
    assert joined.count("made") == 12
    if width >= 80:
        assert all(f" {value:.3f} " in text for key, value in numbers.items() if key != "estimated_iou")
        assert " 0.82 (0.59 to 0.95) " in text
        assert len(name) > 47 or f" {name} " in text


def test_no_cell_title_or_caption_is_read_as_markup() -> None:
    """Categories of somebody's scores.json are headings: `[/x]` would end the command, `[red]` vanish."""
    made = console.SafeConsole(width=160, record=True, file=io.StringIO())
    table = WideTable(title="[/title]", caption=":smile:")
    table.add_column("[/x]")
    table.add_row("[red]")
    made.print(table)
    text = made.export_text()
    assert all(each in text for each in ("[/title]", ":smile:", "[/x]", "[red]"))


def test_colours_and_progress_of_ours_are_left(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = io.StringIO()
    made = console.SafeConsole(file=shown, force_terminal=True, color_system="standard", width=80)
    monkeypatch.setattr(console, "err", made)
    console.lines("error", ["a"], "red")
    assert "\x1b[31m" in shown.getvalue()
    with progress_bar("score") as update:
        update(1, 2)
    assert "\x1b[?25" in shown.getvalue()


def test_each_line_of_an_error_of_several_is_shown(command: Command, tmp_path: Path) -> None:
    (tmp_path / "benchmark.yaml").write_text('name: a\nx: 1\n"y\\e[2Jz\\nerror: well": 2\n', encoding="utf-8")
    result = command(tmp_path, "build")
    assert result.status == 2
    lines = result.err.splitlines()
    assert len(lines) == 3 and all(line.startswith("error: benchmark.yaml:") for line in lines)
    check(result.err, 3)
    assert SettingsError("a", "b").lines == ("a", "b") and str(SettingsError("a", "b")) == "a\nb"


def test_strays_with_evil_names(command: Command, release: Release, tmp_path: Path) -> None:
    for target in release.split("test"):
        (tmp_path / "p" / target.recording).mkdir(parents=True, exist_ok=True)
        np.save(tmp_path / "p" / target.recording / f"{target.view}.npy", np.zeros((4, 4, 4), bool))
    (tmp_path / "p" / f"{EVIL.replace(chr(0), '')}\nerror: all well.npy").touch()
    result = command(tmp_path, "check", "p", "--benchmark", str(release.folder))
    assert result.status == 3
    check(result.err, 2)  # the stray one, and that all the others are equal


def test_of_thousands_that_failed_a_thousand_are_printed(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(console, "MOST_LINES", 3)
    rows = "".join(f"  - {{id: r{n}, path: in/r{n}, category: chair}}\n" for n in range(9))
    (tmp_path / "benchmark.yaml").write_text(f"name: many\nrecordings:\n{rows}")
    ended = command(tmp_path, "ingest", "--jobs", "1")
    assert ended.status == 1
    assert ended.err.count("no such recording") == 3 == sum("no such" in line for line in ended.progress)
    assert "6 more recordings failed: `kinectbench build --status --json` lists all" in ended.err
    failed = tmp_path / "build" / "r8" / "failed.json"
    written_ns = failed.stat().st_mtime_ns
    command(tmp_path, "ingest", "--jobs", "1")
    assert failed.stat().st_mtime_ns == written_ns  # the same reason is not written again
