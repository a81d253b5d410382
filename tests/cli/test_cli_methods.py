"""The commands that need torch say so in one line where it is not installed, and the others do without it."""

import subprocess
import sys
from pathlib import Path

import pytest

from kinectbench.release.release import Release

WITHOUT = """
import sys
sys.modules["torch"] = None
from kinectbench.cli.main import main
sys.argv[0] = "kinectbench"
main()
"""
ARGUMENTS = {
    "train": ["train", "recae-small", "--data", "benchmark", "--out", "out"],
    "predict": ["predict", "recae-small", "benchmark"],
    "convert": ["convert", "recgan", "model", "--out", "out"],
}


@pytest.mark.parametrize("name", ARGUMENTS)
def test_without_torch_one_line_says_what_to_install(tmp_path: Path, name: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT, *ARGUMENTS[name]],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    told = "error: train, predict and convert need PyTorch: pip install 'kinectbench[methods]'\n"
    assert (done.returncode, done.stdout, done.stderr) == (1, "", told)


def test_without_torch_the_others_work(release: Release, tmp_path: Path) -> None:
    arguments = ["baseline", "partial", "--benchmark", str(release.folder), "--jobs", "1"]
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT, *arguments], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0 and "torch" not in done.stderr, done.stderr
