"""What `pip install kinectbench` can do alone: load, check, score; what needs an extra says so in a line."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from made_once import made_once
from synthetic_release import publish_synthetic

from kinectbench.core.extras import EXTRA_OF

ABSENT = [module for module, extra in EXTRA_OF.items() if extra == "build"]
# Whoever imports a module that is None gets ModuleNotFoundError, as of one that is not installed.
WITHOUT = "import os, sys\nsys.modules.update(dict.fromkeys(os.environ['ABSENT'].split(',')))\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    def make(to: Path) -> None:
        publish_synthetic(to)

    return made_once(tmp_path_factory, "light", make)


def kinectbench(folder: Path, scratch: Path, *arguments: str) -> "subprocess.CompletedProcess[str]":
    """Run a command, or with "-c" Python, where the modules of `build` are absent."""
    (scratch / "sitecustomize.py").write_text(WITHOUT, encoding="utf-8")
    command = arguments if arguments[0] == "-c" else ("-m", "kinectbench", *arguments)
    path = os.pathsep.join([str(scratch), *(p for p in [os.environ.get("PYTHONPATH")] if p)])
    environment = {**os.environ, "ABSENT": ",".join(ABSENT), "PYTHONPATH": path}
    return subprocess.run(
        [sys.executable, *command], cwd=folder, env=environment, capture_output=True, text=True, timeout=300
    )


def test_a_release_is_loaded_checked_and_scored(folder: Path, tmp_path: Path) -> None:
    release, out = str(folder / "benchmark"), str(tmp_path / "predictions")
    for command in (
        ("verify", release),
        ("baseline", "hull", "--benchmark", release, "--out", out),
        ("check", f"{out}/hull", "--benchmark", release),
        ("score", f"{out}/hull", "--benchmark", release, "--out", str(tmp_path / "s"), "--no-surface"),
        ("compare", str(tmp_path / "s"), str(tmp_path / "s/baselines/partial")),
    ):
        done = kinectbench(tmp_path, tmp_path, *command)
        assert done.returncode == 0, (command, done.stderr)
        unchecked = "no partial was compared with its view's depth: " in done.stdout
        assert unchecked is (command[0] == "verify"), done.stdout
    loaded = "import sys, kinectbench as k; p = k.load(sys.argv[1])[0]; print(p['full'].shape)"
    done = kinectbench(tmp_path, tmp_path, "-c", loaded, release)
    assert done.stdout == "(256, 256, 256)\n", done.stderr


@pytest.mark.parametrize(
    "command",
    [("build",), ("inspect", "x"), ("fuse",), ("publish",), ("simulate", "x"), ("synthesize", "x")],
    ids=lambda command: command[0],
)
def test_what_needs_the_extra_says_so_in_one_line(tmp_path: Path, command: tuple[str, ...]) -> None:
    done = kinectbench(tmp_path, tmp_path, *command)
    assert done.returncode == 2 and not done.stdout
    assert done.stderr.count("\n") == 1 and "pip install 'kinectbench[build]'" in done.stderr
    assert {entry.name for entry in tmp_path.iterdir()} <= {"sitecustomize.py", "__pycache__"}


@pytest.mark.parametrize("command", [("score",), ("report",), ("baseline", "hull"), ("export", "x")])
def test_a_command_that_builds_first_says_so_too(tmp_path: Path, command: tuple[str, ...]) -> None:
    text = "name: a\nrecordings:\n  - {id: chair_01, path: chair_01, category: chair}\n"
    (tmp_path / "benchmark.yaml").write_text(text)
    done = kinectbench(tmp_path, tmp_path, *command)
    assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
    assert "pip install 'kinectbench[build]'" in done.stderr and not (tmp_path / "scores").exists()


def test_the_map_of_extras_is_that_of_the_project() -> None:
    import tomllib

    project = Path(__file__).parents[2] / "pyproject.toml"
    extras = tomllib.loads(project.read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    distribution = {"cv2": "opencv-python-headless", "fast_simplification": "fast-simplification"}
    for module, extra in EXTRA_OF.items():
        name = distribution.get(module, module)
        assert any(requirement.startswith(name) for requirement in extras[extra]), (module, extra)
