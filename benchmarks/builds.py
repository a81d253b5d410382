"""Building a benchmark for a measurement, in a folder of its own."""

import argparse
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from figures import Figure, run

from kinectbench.core.errors import RecordingError
from kinectbench.engine.parallel import build
from kinectbench.engine.stages import STAGES, Job
from kinectbench.settings.models import BenchmarkSettings

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def build_root(given: Path | None) -> Iterator[Path]:
    """The folder that `build` lies in: the given one, which is kept, or a temporary one."""
    if given is not None:
        given.mkdir(parents=True, exist_ok=True)
        yield given
        return
    with tempfile.TemporaryDirectory(prefix="kinectbench-") as folder:
        yield Path(folder)


def run_on_build(
    parser: argparse.ArgumentParser, measure: Callable[[argparse.Namespace, Path], Sequence[Figure]]
) -> None:
    """Run a script that builds something, in a folder that `--build` names or in a temporary one.

    Args:
        parser: of the script's other options.
        measure: makes the figures from the options and that folder.
    """
    parser.add_argument("--build", type=Path, metavar="DIR", help="build there and keep it")
    options = parser.parse_args()
    with build_root(options.build) as root:
        run(options, lambda: measure(options, root))


def built(settings: BenchmarkSettings, root: Path, workers: int = CORES) -> list[Job]:
    """Bring every recording up to date as far as its pairs; paths of recordings must be absolute.

    Raises:
        RecordingError: one of them cannot be built.
    """
    jobs = [Job(settings, recording, root) for recording in settings.recordings]
    for outcome in build(jobs, workers=workers):
        if outcome.error:
            raise RecordingError(f"{outcome.recording}: {outcome.error}")
    return jobs


def stage_seconds(job: Job) -> dict[str, float]:
    """How long each stage took when it was made."""
    return {s.name: read_json(job.build / s.folder / "timing.json")["seconds"] for s in STAGES}


def read_json(path: Path) -> Any:
    """The content of a JSON file."""
    return json.loads(path.read_text(encoding="utf-8"))
