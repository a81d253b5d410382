"""Locales without UTF-8: commands do their work, files are the same bytes, no character ends a command."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_benchmark import Run, hashes, run

from kinectbench.core.errors import internal_error

pytestmark = pytest.mark.xdist_group("commands")

Command = Callable[..., Run]
# Python would take UTF-8 all the same, were it not told not to.
POSIX = {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
TEXTS = ("--set", "license=Größe 1 µm …", "--set", "source=σ Ελλάδα")


def test_files_are_the_same_bytes_in_any_locale(command: Command, one: Path) -> None:
    """In a process that has POSIX, and in this one."""
    (one / "predictions/chair").mkdir(parents=True)
    for view in ("000", "001", "002"):
        np.save(one / f"predictions/chair/{view}.npy", np.full((8, 8, 8), 0.3, np.float32))
    score = ("score", "predictions", "--benchmark", "benchmark", "--no-surface", "--no-baselines")
    made = []
    for locale in ("POSIX", "this process's"):
        for words in (("publish", "--allow-poor", *TEXTS), (*score, "--jobs", "1")):
            result = run(one, *words, variables=POSIX) if locale == "POSIX" else command(one, *words)
            assert result.status == 0 and "internal error" not in result.err, (words, result.err)
        folders = ("benchmark", "scores")
        made.append({f"{name}/{path}": sha for name in folders for path, sha in hashes(one / name).items()})
        assert "Größe" in (one / "benchmark" / "LICENSE").read_text(encoding="utf-8")
        for name in folders:
            shutil.rmtree(one / name)
        (one / "build" / "publish.json").unlink()
    assert made[0] == made[1]


def test_init_and_its_file(small: Path, tmp_path: Path) -> None:
    shutil.copytree(small / "recordings" / "chair", tmp_path / "in" / "chair")
    result = run(tmp_path, "init", "in", variables=POSIX)
    assert result.status == 0 and "internal error" not in result.err, result.err
    assert "…" in (tmp_path / "in" / "benchmark.yaml").read_text(encoding="utf-8")


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_what_a_terminal_cannot_show_is_a_question_mark(tmp_path: Path, encoding: str) -> None:
    """Also a name that is no text in any encoding, as file systems have them."""
    odd = os.fsencode(tmp_path) + b"/\xff\xe2\x88\x91"
    Path(os.fsdecode(odd)).mkdir()
    result = run(tmp_path, "inspect", os.fsdecode(odd), variables=POSIX | {"PYTHONIOENCODING": encoding})
    assert result.status == 1 and result.err == "", result.err
    assert "stops: unreadable: " in result.out and "?" in result.out


def test_names_that_the_locale_lacks(tmp_path: Path) -> None:
    text = "name: a\nrecordings: [{id: a, path: bücher, category: chair}]\n"
    (tmp_path / "benchmark.yaml").write_text(text, encoding="utf-8")
    result = run(tmp_path, "ingest", variables=POSIX)
    assert result.status == 1 and "no such recording" in result.err, result.err


@pytest.mark.parametrize(
    ("name", "encoding", "advice"),
    [("\udcff.png", "utf-8", "not UTF-8; rename"), ("bücher", "ascii", "set LC_ALL=C.UTF-8")],
)
def test_names_that_cannot_be_written_are_told_with_what_to_do(name: str, encoding: str, advice: str) -> None:
    with pytest.raises(UnicodeEncodeError) as refused:
        name.encode(encoding)
    line = internal_error(refused.value)
    assert advice in line and ascii(name) in line and not line.startswith("internal error")
