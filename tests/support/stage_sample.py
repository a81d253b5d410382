"""One small sample of everything that has a version: what each stage writes of a recording that lies here.

The recording's bytes are the same on every machine, so that no simulation comes between. It is built
with the poses that it brings. Without them it is tracked, and no further: what is fused along tracked poses
differs more from one processor to the next than a tolerance should allow.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from kinectbench.engine.pipeline import build_recording
from kinectbench.engine.stages import STAGES, SUGGEST, Job
from kinectbench.lab.synthesize.models import SynthesisSettings
from kinectbench.lab.synthesize.synthesize import synthesize
from kinectbench.release.publish.current import publish_if_stale
from kinectbench.release.release import open_release
from kinectbench.scoring.baselines.predict import write_baselines
from kinectbench.scoring.score import score_methods
from kinectbench.settings.models import BenchmarkSettings

REPOSITORY = Path(__file__).parents[2]
RECORDING = REPOSITORY / "recordings" / "chair_01"
SETTINGS = {
    "name": "sample",
    "license": "CC0-1.0",
    "source": "simulated",
    "recordings": [
        {"id": "given", "path": str(RECORDING), "category": "chair"},
        {"id": "tracked", "path": str(RECORDING), "category": "chair", "trajectory": "ignore"},
    ],
    "fusion": {"voxel_size_m": 0.01, "scene_voxel_size_m": 0.02},
    "views": {"count": 2},
}
SYNTHESIS = {"categories": ["chair"], "train": 1, "validation": 0, "test": 0, "sv_steps": 1, "image_px": 96}
METHODS = ("hull", "mirror")
# Of the frames of a sequence so many are left out between two that are looked at.
EVERY = 24
# The releases' and builds' own bookkeeping, which follows from the rest.
UNPINNED = {"manifest.json", "timing.json", "SHA256SUMS", ".lock"}
# A release copies these from the build.
COPIED = {".npz", ".ply", ".png"}


@dataclass(frozen=True)
class Written:
    """What one stage wrote, and the stages that it stands on.

    Attributes:
        inputs: where one of these wrote something else, so may this one.
        files: by a name that is the same on every machine.
    """

    inputs: tuple[str, ...]
    files: Mapping[str, Path]


Sample = Mapping[str, Written]


def jobs(root: Path) -> tuple[Job, ...]:
    """The recordings of the sample at `root`."""
    settings = BenchmarkSettings.model_validate(SETTINGS)
    return tuple(Job(settings, recording, root) for recording in settings.recordings)


def make_sample(root: Path) -> Sample:
    """Build, publish, synthesise, predict and score the sample in an empty folder; some 20 s on two cores."""
    for job in jobs(root):
        for last in ("track",) if job.recording.id == "tracked" else ("pairs", SUGGEST.name):
            outcome = build_recording(job, last)
            assert outcome.error is None, outcome.error
    settings = jobs(root)[0].settings
    publish_if_stale(settings, root, [settings.recordings[0].id])
    release = open_release(root / "benchmark")
    write_baselines(release, root / "predictions", METHODS)
    score_methods(release, root / "predictions", root / "scores")
    synthesize(SynthesisSettings.model_validate(SYNTHESIS), root / "synthetic")
    return read_sample(root)


def read_sample(root: Path) -> Sample:
    """What lies in the folder of `make_sample`, or in a copy of it."""
    built = {
        stage.name: Written(
            stage.inputs,
            {
                f"{job.recording.id}/{name}": path
                for job in jobs(root)
                for name, path in _files(job.build / stage.folder, stage.folder)
            },
        )
        for stage in (*STAGES, SUGGEST)
    }
    release = dict(_files(root / "benchmark", "benchmark"))
    synthetic = dict(_files(root / "synthetic", "synthetic"))
    others = {
        "publish": (tuple(stage.name for stage in STAGES), _own(release)),
        "synthesize": ((), {name: path for name, path in synthetic.items() if name not in _own(synthetic)}),
        "baselines": (("pairs",), dict(_files(root / "predictions", "predictions"))),
        "score": (("pairs", "baselines"), dict(_files(root / "scores", "scores"))),
    }
    return built | {name: Written(*content) for name, content in others.items()}


def _own(release: Mapping[str, Path]) -> dict[str, Path]:
    """The files of a release that publishing writes itself."""
    return {name: path for name, path in release.items() if path.suffix not in COPIED}


def _files(folder: Path, name: str) -> Iterator[tuple[str, Path]]:
    """Files below a folder with their names, in order; of numbered frames a few."""
    for path in sorted(folder.rglob("*")):
        frame = path.parent.name in ("depth", "color", "mask") and path.stem.isdigit()
        schema = path.parent.name == "schemas"  # what a file may hold, not what it holds
        if (
            path.is_file()
            and not schema
            and path.name not in UNPINNED
            and not (frame and int(path.stem) % EVERY)
        ):
            yield f"{name}/{path.relative_to(folder).as_posix()}", path
