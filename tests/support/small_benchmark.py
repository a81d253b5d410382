"""A benchmark of two small simulated recordings, and ways to run commands on copies of it."""

import hashlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

from kinectbench.cli import main as cli
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.spec import SimulationSpec

YAML = """\
name: small
recordings:
  - {id: chair, path: recordings/chair, category: chair, underside: closed}
  - {id: table, path: recordings/table, category: table, split: validation, underside: closed}
fusion: {voxel_size_m: 0.015, scene_voxel_size_m: 0.03}
views: {count: 3, min_pixels: 100}
tracking: {check_stride_px: 4}
publish: {gate: {min_estimated_iou: 0.4, max_doubts: 2}}  # so few voxels do not resolve the table's top
"""
# What a run may write without having made anything.
NOT_MADE = (".lock", "sources.json", "failed.json", "timing.json")
STAGE_FOLDERS = {
    "ingest": "sequence",
    "track": "trajectory",
    "fuse": "reconstruction",
    "segment": "object",
    "sample-views": "views",
    "pairs": "pairs",
}


PROGRESS = re.compile(r"\[ *\d+ s\] ")


@dataclass(frozen=True)
class Run:
    """What became of one command; lines of progress are apart from the other messages."""

    status: int
    out: str
    err: str
    progress: tuple[str, ...] = ()


def _run(status: int, out: str, err: str) -> Run:
    lines = err.splitlines(keepends=True)
    progress = [line for line in lines if PROGRESS.match(line)]
    rest = [line for line in lines if line not in progress]
    return Run(status, out, "".join(rest), tuple(line.partition("] ")[2].rstrip() for line in progress))


def small_spec(family: str, form: str = "tum", frames: int = 24) -> SimulationSpec:
    """160 x 120 pixels, an orbit of 24 frames."""
    return SimulationSpec.model_validate(
        {
            "object": f"{family}:seed=0",
            "format": form,
            "path": {"frames": frames, "rate_hz": 5.0},
            "sensor": {"width": 160, "height": 120},
        }
    )


def make_benchmark(root: Path) -> Path:
    """Write the recordings and benchmark.yaml; returns `root`."""
    for family in ("chair", "table"):
        simulate(small_spec(family), root / "recordings" / family)
    (root / "benchmark.yaml").write_text(YAML)
    return root


def build_small(root: Path) -> None:
    """Write the recordings and benchmark.yaml, and build them up to the pairs."""
    built = run(make_benchmark(root), "build", "--jobs", "1")
    assert built.status == 0, built.err


def run_here(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], folder: Path, *arguments: str
) -> Run:
    """Run a command in this process, in a folder."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", ["kinectbench", *arguments])
    capsys.readouterr()
    with pytest.raises(SystemExit) as end:
        cli.main()
    captured = capsys.readouterr()
    return _run(int(end.value.code or 0), captured.out, captured.err)


def start(
    folder: Path, *arguments: str, variables: Mapping[str, str] | None = None
) -> "subprocess.Popen[str]":
    """Start a command in a process (and process group) of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "kinectbench", *arguments],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, **(variables or {})},
    )


def finish(process: "subprocess.Popen[str]", timeout_s: float = 600) -> Run:
    """Wait for a started command."""
    out, err = process.communicate(timeout=timeout_s)
    return _run(process.returncode, out, err)


def run(folder: Path, *arguments: str, variables: Mapping[str, str] | None = None) -> Run:
    """Run a command in a process of its own."""
    return finish(start(folder, *arguments, variables=variables))


def copied(root: Path, to: Path, *names: str) -> Path:
    """A copy of a benchmark's folder (or of the named things in it) with all times; returns `to`."""
    if not names:
        shutil.copytree(root, to)
    for name in names:
        source, target = root / name, to / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, target)
        else:
            shutil.copy2(source, target)
    return to


def hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of every file that was made, by path."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.name.endswith(NOT_MADE)
    }


def leftovers(folder: Path) -> list[Path]:
    """Temporary files and folders that nobody removed."""
    return [*folder.rglob(".*.part"), *folder.rglob(".*.old")]
