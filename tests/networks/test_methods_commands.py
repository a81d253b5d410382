"""The three commands: with wrong words, and from training to predictions after a kill."""

import json
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from narrow_recgan import narrow_recgan
from small_benchmark import Run, finish, run, start
from tensor_bundle_writer import write_bundle

from kinectbench.networks import trained
from kinectbench.release.release import Release

Command = Callable[..., Run]
WRONG = {
    "no configuration": (["train", "nowhere", "--data", ".", "--out", "o"], 2, "nowhere: no such file"),
    "no release": (["train", "recae-small", "--data", ".", "--out", "o"], 1, "no release there"),
    "no method": (["predict", "nowhere", "."], 2, "nowhere: no folder of `kinectbench train` or `convert`"),
    "no weights": (
        ["predict", "recae-small", "."],
        2,
        "comes without weights; train it: `kinectbench train recae-small --data RELEASE --out FOLDER`",
    ),
    "no kind": (["convert", "recnet", ".", "--out", "o"], 2, "no kind of checkpoint 'recnet': choose recgan"),
    "no checkpoint": (["convert", "recgan", ".", "--out", "o"], 1, "no checkpoint there"),
    "threshold": (["predict", "nowhere", ".", "--threshold", "2"], 2, "--threshold"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_words_are_told_in_one_line(
    command: Command, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trained, "FOLDER", tmp_path)  # as if no network were shipped
    arguments, status, words = WRONG[name]
    result = command(tmp_path, *arguments)
    assert (result.status, result.err.count("\n")) == (status, 1) and words in result.err, result
    assert list(tmp_path.iterdir()) == []


def test_one_category_is_trained_by_the_command(
    command: Command, tiny: Callable[..., Path], learning: Release, tmp_path: Path
) -> None:
    config = tiny(("batch: 2", "batch: 2, leave_out: [chair_z]"))
    words = ("train", str(config), "--data", str(learning.folder), "--out", "run", "--device", "cpu")
    note = "{}: note: training.leave_out: chair_z: in no release that was given"
    wrong = command(tmp_path, *words, "--category", "tabel")
    lines = wrong.err.splitlines()
    assert (wrong.status, lines[0], len(lines)) == (1, note.format("tiny-tabel"), 2), wrong
    assert "did you mean 'table'?" in lines[1]
    made = command(tmp_path, *words, "--category", "table", "--json")
    assert (made.status, made.err.splitlines()[0]) == (0, note.format("tiny-table"))
    assert json.loads((tmp_path / "run" / "training.json").read_text())["pairs"] == 2
    assert trained.open_trained(tmp_path / "run").config.name == "tiny-table"


def test_a_checkpoint_becomes_a_method(command: Command, tmp_path: Path) -> None:
    write_bundle(tmp_path / "theirs", narrow_recgan())
    made = command(tmp_path, "convert", "recgan", "theirs", "--out", "ours")
    assert (made.status, made.err) == (0, "")
    assert made.out.startswith("36 tensors fit: generator ") and made.out.endswith("\nwrote ours\n")


@pytest.mark.slow  # test_methods_training.py kills one as well, in this process
def test_a_training_that_is_killed_goes_on(
    tiny: Callable[..., Path], learning: Release, tmp_path: Path
) -> None:
    """By SIGTERM, as `timeout` and batch systems do, and then to the end: the weights are as of one run."""
    config = tiny(("epochs: 2", "epochs: 4"))
    words = ("train", str(config), "--data", str(learning.folder), "--device", "cpu", "--out")
    single = {"OMP_NUM_THREADS": "1"}
    assert run(tmp_path, *words, "whole", variables=single).status == 0
    stopped = start(tmp_path, *words, "parts", variables=single)
    deadline = time.monotonic() + 120
    while not (tmp_path / "parts" / "config.yaml").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(1.0)
    os.killpg(stopped.pid, signal.SIGTERM)
    ended = finish(stopped)
    assert ended.status in (143, 0), ended
    done = run(tmp_path, *words, "parts", variables=single)
    assert done.status == 0 and done.out.startswith("10 steps in "), done
    for name in ("weights.npz", "curves.png"):
        assert (tmp_path / "parts" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
