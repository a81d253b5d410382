"""What is left of a build after the last frame of a recording, by stage; whether its bytes are a build's.

FOLDER is a recording. Its frames are taken as by `record --build`, at no pace; then it is built on two
threads, first from there, then from the beginning. Others may have this machine's cores, too: time is of the
processor, and by the clock.
"""

import tempfile
import time
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path

from figures import Figure, arguments, at_most, equals, run, told
from memory import peak_mb

from kinectbench.engine.parallel import build
from kinectbench.engine.pipeline import STAGE_NAMES, Outcome
from kinectbench.engine.stages import Job
from kinectbench.record.build_process import GrowingBuild
from kinectbench.settings.models import BenchmarkSettings
from kinectbench.stages.ingest.partial_sequence import using_partial_sequence
from kinectbench.stages.track.partial_odometry import using_partial_odometry

THREADS, PEAK_MB = 2, 1500.0


class Watcher:
    """Notes when each stage begins: seconds of the processor, and by the clock."""

    def __init__(self) -> None:
        self.begun = dict[str, tuple[float, float]]()

    def __call__(self, recording: str, stage: str, done: int, total: int) -> None:
        self.begun.setdefault(stage, (time.process_time(), time.monotonic()))

    def ended(self, outcome: Outcome) -> None:
        self.begun["ended"] = time.process_time(), time.monotonic()

    def warn(self, message: str) -> None: ...

    def spent(self, name: str) -> list[Figure]:
        """Seconds of each stage, and of all."""
        stages, moments = [*self.begun], [*self.begun.values()]
        each = [
            f"{stage}: {after[0] - at[0]:.1f}, {after[1] - at[1]:.1f}"
            for stage, (at, after) in zip(stages, pairwise(moments), strict=False)
        ]
        (cpu_s, clock_s), (cpu_end_s, clock_end_s) = moments[0], moments[-1]
        return [
            told(f"{name}: stages, s of the processor and by the clock", each),
            told(f"{name}: s of the processor", round(cpu_end_s - cpu_s, 1)),
            told(f"{name}: s by the clock", round(clock_end_s - clock_s, 1)),
        ]


def contents(folder: Path) -> dict[str, bytes]:
    """Bytes of all files by their names, without the time that was taken."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != "timing.json")
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def measure(folder: Path) -> list[Figure]:
    with tempfile.TemporaryDirectory(prefix="kinectbench-") as name:
        root = Path(name)
        recording = {"id": "own", "path": str(folder.resolve()), "category": "any", "trajectory": "ignore"}
        settings = BenchmarkSettings.model_validate({"name": "own", "recordings": [recording]})
        job = Job(settings, settings.recordings[0], root)
        growing = GrowingBuild(job.source, root / "stored")
        growing.read_again()
        started_s = time.process_time()
        while growing.take(whole=True):
            pass
        taking_s = time.process_time() - started_s
        left, whole = Watcher(), Watcher()
        with ExitStack() as stack:
            stack.enter_context(using_partial_sequence(growing.sequence))
            stack.enter_context(using_partial_odometry(growing.odometry))
            outcome = build([job], workers=THREADS, watcher=left)[0]
        made, peak = contents(job.build), peak_mb()
        build([job], force=STAGE_NAMES, workers=THREADS, watcher=whole)
        again = contents(job.build)
        differ = sorted(name for name in made.keys() | again.keys() if made.get(name) != again.get(name))
    frames = sum(name.startswith("sequence/depth/") for name in made)
    return [
        equals("error", outcome.error, None),
        told("frames", frames),
        told("while one records: ms of the processor a frame", 1000 * taking_s / max(frames, 1)),
        *left.spent("after the last frame"),
        *whole.spent("from the beginning"),
        equals("files that differ", differ, []),
        at_most("peak memory until then, in one process, MB", peak, PEAK_MB),
    ]


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="a recording")
    options = parser.parse_args()
    run(options, lambda: measure(options.folder))


if __name__ == "__main__":
    main()
