"""One recording from its frames to its pairs, stage by stage, beside the time that the camera took.

Without RECORDING, 1000 frames of 640x480 around a simulated chair are made first, without poses. They are
built with as many threads as there are cores (eight at most, as `build` takes them), and with one: both must
write the same bytes. The bar is for two idle cores.
"""

import argparse
import hashlib
import time
from pathlib import Path

from builds import CORES, run_on_build
from figures import Figure, arguments, at_most, equals, told

from kinectbench.core.threads import using_threads
from kinectbench.engine.parallel import MOST_THREADS
from kinectbench.engine.pipeline import build_recording
from kinectbench.engine.stages import STAGES, Job
from kinectbench.lab.simulate.presets import preset_spec
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.settings.models import BenchmarkSettings, RecordingSettings, ViewSettings
from kinectbench.stages.ingest.readers import open_recording

FRAMES, VIEWS, SEED = 1000, 50, 31
BAR_S = 75.0
THREADS = min(CORES, MOST_THREADS)
# What tells the time that a run took.
NOT_COMPARED = frozenset({"timing.json", "sources.json", ".lock"})


def recorded(root: Path) -> Path:
    """The simulated recording, made when it is not there yet."""
    path = root / "chair"
    if not path.exists():
        changes = {
            "object": f"chair:seed={SEED}",
            "path": {"frames": FRAMES, "rate_hz": 30.0},
            "given": {"trajectory": "none"},
        }
        simulate(preset_spec("orbit-v1", changes), path)
    return path


def measured(recording: Path, root: Path, threads: int) -> tuple[list[tuple[str, float, float]], str]:
    """(stage, seconds, CPU seconds) of a build with so many threads, and a digest of all that it wrote."""
    settings = BenchmarkSettings(
        name="pipeline",
        recordings=[RecordingSettings(id="one", path=str(recording.resolve()), category="chair")],
        views=ViewSettings(count=VIEWS),
    )
    job = Job(settings, settings.recordings[0], root / f"threads-{threads}")
    rows = []
    for stage in STAGES:
        started, cpu_started = time.perf_counter(), time.process_time()
        with using_threads(threads):
            outcome = build_recording(job, stage.name)
        if outcome.error:
            raise SystemExit(f"{stage.name}: {outcome.error}")
        rows.append((stage.name, time.perf_counter() - started, time.process_time() - cpu_started))
    return rows, digest(job.build)


def digest(folder: Path) -> str:
    """SHA-256 of every file below a folder but those that tell the time."""
    found = hashlib.sha256()
    for file in sorted(f for f in folder.rglob("*") if f.is_file() and f.name not in NOT_COMPARED):
        found.update(f"{file.relative_to(folder)}\0".encode() + hashlib.sha256(file.read_bytes()).digest())
    return found.hexdigest()


def measure(options: argparse.Namespace, root: Path) -> list[Figure]:
    recording = options.recording or recorded(root)
    opened = open_recording(recording)
    camera_s = float(opened.stamps_ns[-1] - opened.stamps_ns[0]) / 1e9
    size = f"{len(opened)} frames of {opened.camera.width}x{opened.camera.height}"
    figures = [told("recording", size), told("the camera took, s", round(camera_s, 1))]
    digests = {}
    for threads in sorted({THREADS, 1}, reverse=True):
        rows, digests[threads] = measured(recording, root, threads)
        for name, wall_s, cpu_s in rows:
            figures.append(told(f"{name}, {threads} threads", f"{wall_s:.1f} s, {cpu_s:.1f} CPU s"))
        whole_s, cpu_s = (sum(row[k] for row in rows) for k in (1, 2))
        figures.append(told(f"CPU s in all, {threads} threads", round(cpu_s, 1)))
        figures.append(told(f"times the camera's, {threads} threads", round(whole_s / camera_s, 2)))
        name = f"s in all, {threads} threads"
        figures.append(at_most(name, round(whole_s, 1), BAR_S) if threads == THREADS else told(name, whole_s))
    figures.append(equals("the same bytes, however many threads", len(set(digests.values())), 1))
    return figures


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("recording", nargs="?", type=Path, metavar="RECORDING", help="another one to build")
    run_on_build(parser, measure)


if __name__ == "__main__":
    main()
