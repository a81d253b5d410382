"""A benchmark that is built in seconds, and its commands as processes of their own."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from kinectbench.core.errors import KinectBenchError
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.spec import SimulationSpec

YAML = """\
name: small
license: CC0-1.0
recordings:
  - {id: chair, path: recordings/chair, category: chair}
  - {id: stool, path: recordings/stool, category: chair, split: validation}
fusion: {voxel_size_m: 0.02, scene_voxel_size_m: 0.04}
views: {count: 2, min_pixels: 100}
tracking: {check_stride_px: 4}
"""
# Two that are built from so few frames.
OBJECTS = {"chair": "chair:seed=0", "stool": "chair:seed=1"}


def make_small(root: Path, recordings: Sequence[str] = tuple(OBJECTS)) -> Path:
    """Recordings of 16 frames, 160 x 120 pixels, with their benchmark.yaml; returns `root`."""
    for recording in recordings:
        spec = {
            "object": OBJECTS[recording],
            "path": {"frames": 16, "rate_hz": 3.0},
            "sensor": {"width": 160, "height": 120},
            "save_depth": False,
        }
        simulate(SimulationSpec.model_validate(spec), root / "recordings" / recording)
    lines = [
        line
        for line in YAML.splitlines()
        if "id:" not in line or any(f"id: {r}," in line for r in recordings)
    ]
    (root / "benchmark.yaml").write_text("\n".join(lines) + "\n")
    return root


def start(root: Path, *arguments: str) -> "subprocess.Popen[str]":
    """Start a command in the benchmark's folder, in a process group of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "kinectbench", *arguments],
        cwd=root,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=os.environ,
    )


def published(root: Path) -> str:
    """Build what is missing, publish, and return `benchmark_sha256`.

    Raises:
        KinectBenchError: the command failed.
    """
    # Whatever its figures: of so few and small pictures they are poor.
    process = start(root, "publish", "--jobs", "1", "--json", "--allow-poor")
    out, err = process.communicate()
    if process.returncode:
        raise KinectBenchError(f"publish ended with {process.returncode}: {err}")
    content: dict[str, Any] = json.loads(out)
    return str(content["benchmark_sha256"])


def copied(root: Path, to: Path, *names: str) -> Path:
    """A copy of the named parts of a benchmark with their times, in place of what was there; returns `to`."""
    shutil.rmtree(to, ignore_errors=True)
    to.mkdir()
    for name in ("benchmark.yaml", "recordings", *names):
        if (root / name).is_dir():
            shutil.copytree(root / name, to / name)
        else:
            shutil.copy2(root / name, to / name)
    return to


def leftovers(root: Path) -> list[Path]:
    """Temporary files and folders that nobody cleared away."""
    return [*root.rglob(".*.part"), *root.rglob(".*.old")]
