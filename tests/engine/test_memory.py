"""The memory that a recording is expected to need, against peaks that were measured on real ones."""

import ctypes
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_benchmark import copied

from kinectbench.engine import pipeline
from kinectbench.engine.parallel import (
    LIBRARIES_GB,
    UNKNOWN_PIXELS,
    UNKNOWN_VOXELS,
    build,
    expected_gb,
)
from kinectbench.engine.stages import Job
from kinectbench.settings.file import load_benchmark
from kinectbench.settings.models import BenchmarkSettings

CHAIR_BOX = {"center_m": [-1.03, 1.64, 0.48], "size_m": [0.56, 0.54, 0.96], "yaw_rad": -0.5}
CAMERA = """{"format_version": 2, "width": %d, "height": %d, "fx": 1, "fy": 1, "cx": 1, "cy": 1,
"depth_scale": 1000, "color_registered": true, "frames": %d}"""


def job_of(root: Path, fusion: Any = None, **recording: Any) -> Job:
    content = {"id": "one", "path": "one", "category": "chair", **recording}
    settings = BenchmarkSettings.model_validate(
        {"name": "memory", "recordings": [content], "fusion": fusion or {}}
    )
    return Job(settings, settings.recordings[0], root)


def ingested(root: Path, width: int, height: int, frames: int) -> None:
    folder = root / "build" / "one" / "sequence"
    folder.mkdir(parents=True)
    (folder / "camera.json").write_text(CAMERA % (width, height, frames))


# Peaks of all stages of real recordings, as kinectbench/engine/parallel.py lists them.
@pytest.mark.parametrize(
    ("camera", "box", "peak_gb"),
    [
        ((640, 480, 150), CHAIR_BOX, 0.95),
        ((640, 480, 150), None, 2.2),
        ((640, 480, 58), {"center_m": [0, 0, 0.28], "size_m": [0.82, 0.46, 0.57], "yaw_rad": 0}, 0.91),
        ((256, 192, 92), {"center_m": [0, 0, 0.01], "size_m": [0.29, 0.28, 0.02], "yaw_rad": 0}, 0.48),
        ((640, 480, 1000), {"center_m": [0, 0, 0.43], "size_m": [0.44, 0.43, 0.87], "yaw_rad": 0}, 0.97),
    ],
)
def test_it_is_somewhat_more_than_was_measured(
    tmp_path: Path, camera: tuple[int, int, int], box: Any, peak_gb: float
) -> None:
    ingested(tmp_path, *camera)
    expected = expected_gb(job_of(tmp_path, **({} if box is None else {"box": box})))
    assert peak_gb <= expected <= 1.6 * peak_gb


def test_files_bound_the_frames_that_are_not_counted_yet(tmp_path: Path) -> None:
    job = job_of(tmp_path)
    nothing = expected_gb(job)
    (tmp_path / "one" / "depth").mkdir(parents=True)
    few = expected_gb(job)
    (tmp_path / "one" / "depth" / "a.png").write_bytes(bytes(4_000_000))
    some = expected_gb(job)
    with (tmp_path / "one" / "bag").open("wb") as bag:
        bag.truncate(1 << 40)
    many = expected_gb(job)
    assert few < some < many == nothing
    assert some - few == pytest.approx(0.02) and many - few == pytest.approx(2e-9 * UNKNOWN_PIXELS, rel=0.01)


def test_smaller_voxels_need_more(tmp_path: Path) -> None:
    ingested(tmp_path, 640, 480, 150)
    usual = expected_gb(job_of(tmp_path, box=CHAIR_BOX))
    half = expected_gb(job_of(tmp_path, {"voxel_size_m": 0.0025}, box=CHAIR_BOX))
    pixels_gb = LIBRARIES_GB + 2e-9 * 640 * 480 * 150
    assert np.isclose(half - pixels_gb, 8 * (usual - pixels_gb))


@pytest.mark.parametrize("root", ["s3:/bucket/lab", "https:/host/lab"])
def test_of_a_store_nothing_is_asked(root: str) -> None:
    of_frames, of_object = 2e-9 * UNKNOWN_PIXELS, 130e-9 * UNKNOWN_VOXELS
    assert np.isclose(expected_gb(job_of(Path(root))), LIBRARIES_GB + of_frames + of_object)


def test_a_damaged_sequence_is_passed_over(small: Path, tmp_path: Path) -> None:
    root = copied(small, tmp_path / "b")
    settings = load_benchmark(root / "benchmark.yaml", ())
    job = Job(settings, settings.recordings[0], root)
    counted = expected_gb(job)
    (root / "build" / "chair" / "sequence" / "camera.json").write_text("{")
    assert counted < expected_gb(job) < counted + 2e-9 * UNKNOWN_PIXELS


def test_each_stage_gives_back_what_it_has_freed(
    small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root, given_back = copied(small, tmp_path / "b"), list[object]()
    settings = load_benchmark(root / "benchmark.yaml", ())
    monkeypatch.setattr(pipeline, "give_back_memory", lambda: given_back.append(None))
    job = Job(settings, settings.recordings[0], root)
    assert build([job], "track", ("ingest", "track"))[0].error is None and len(given_back) == 2


HOLES = """
from pathlib import Path
from kinectbench.engine.processes import give_back_memory

def resident_mb():
    lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(lines["VmRSS"].split()[0]) / 1e3

blocks = [bytearray(b"x") * 50_000 for _ in range(4_000)]  # 200 MB, too small to be mapped one by one
del blocks[:-1]  # the last one is in use, so that the heap does not shrink
before_mb = resident_mb()
give_back_memory()
print(before_mb - resident_mb())
"""


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="another C library than glibc")
def test_what_a_stage_has_freed_is_given_back() -> None:
    """Nearly all of 200 MB that were freed below a block in use."""
    said = subprocess.run([sys.executable, "-c", HOLES], capture_output=True, text=True, check=True).stdout
    assert float(said) > 150
