"""What `evaluate RECORDING TRUTH` means: a recording by its id, by its path, or what was built of it."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kinectbench.benchmark_file import load_benchmark, parse_benchmark
from kinectbench.config import BenchmarkSettings
from kinectbench.config_words import suggestion
from kinectbench.errors import RecordingError, SettingsError
from kinectbench.simulate.truth import truth_folder
from kinectbench.stages import Job


@dataclass(frozen=True)
class Found:
    """A recording to be evaluated.

    Attributes:
        name: of the recording.
        root: the folder that holds `build/`.
        build: `build/<name>/`.
        truth: the folder of its truth.
        job: brings the build up to date; None if only a build folder is known.
    """

    name: str
    root: Path
    build: Path
    truth: Path
    job: Job | None


def find_built(recording: str, truth: Path | None, config: Path, overrides: Sequence[str]) -> Found:
    """Find a recording and its truth, before anything is built.

    Args:
        recording: an id of the benchmark at `config`; or the folder of a build; or a recording's path, which
            is then built with the default settings into `build/` of the current folder.
        truth: its truth; by default what lies beside the recording.
        config: a benchmark.yaml, which need not exist.
        overrides: settings that win, as `--set` takes them.

    Raises:
        SettingsError: nothing of the kind, wrong settings, or no truth is known.
        RecordingError: no truth lies there.
    """
    found = _find(recording, truth, config, overrides)
    if not (found.truth / "truth.json").is_file():
        raise RecordingError(
            f"{found.truth}: no truth there; name its folder, or simulate the recording again"
        )
    return found


def _find(recording: str, truth: Path | None, config: Path, overrides: Sequence[str]) -> Found:
    settings = load_benchmark(config, overrides) if config.is_file() else None
    known = [] if settings is None else [each.id for each in settings.recordings]
    path = Path(recording)
    if settings is not None and recording in known:
        job = Job(settings, settings.recording(recording), config.parent)
        return Found(recording, job.root, job.build, truth or truth_folder(job.source), job)
    if (path / "sequence").is_dir():
        return Found(
            path.name, path.parent.parent, path, truth or _truth_of_build(path, settings, config), None
        )
    if path.exists():
        job = _job_of(path, overrides)
        return Found(job.recording.id, job.root, job.build, truth or truth_folder(path), job)
    hint = (
        suggestion(recording, known) if known else "give a simulated recording's path, or an id and --config"
    )
    raise SettingsError(f"no recording '{recording}'; {hint}")


def _truth_of_build(build: Path, settings: BenchmarkSettings | None, config: Path) -> Path:
    """The truth beside the recording that a build folder was made of, by the benchmark."""
    if settings is not None:
        jobs = [Job(settings, recording, config.parent) for recording in settings.recordings]
        for job in jobs:
            if job.build.resolve() == build.resolve():
                return truth_folder(job.source)
    raise SettingsError(
        f"{build}: its truth is not known; name the folder: kinectbench evaluate {build} TRUTH"
    )


def _job_of(path: Path, overrides: Sequence[str]) -> Job:
    """A recording by itself, with default settings."""
    name = (
        re.sub(r"[^A-Za-z0-9._-]", "_", path.resolve().name.removesuffix(".bag")).lstrip("._-") or "recording"
    )
    text = json.dumps(
        {"name": name[:80], "recordings": [{"id": name[:80], "path": str(path), "category": "object"}]}
    )
    settings = parse_benchmark(text, "settings", overrides)
    return Job(settings, settings.recordings[0], Path())
