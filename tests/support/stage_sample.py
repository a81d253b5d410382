"""One small sample of everything that has a version: what each stage writes of a recording that lies here.

The recording's bytes are the same on every machine, so that no simulation comes between. It is built
with the poses that it brings. Without them its first half is tracked, and no further: what is fused along
tracked poses differs more from one processor to the next than a tolerance should allow. With a box and masks
only those stages are pinned that look at them. Baselines and scores are those of simple shapes by formula: a
score's fingerprint holds no stage's version, so a stage's change may not hide one of theirs.
"""

import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from synthetic_release import Recordings, publish_synthetic

from kinectbench.engine.pipeline import build_recording
from kinectbench.engine.stages import STAGES, SUGGEST, Job
from kinectbench.lab.synthesize.models import SynthesisSettings
from kinectbench.lab.synthesize.synthesize import synthesize
from kinectbench.release.publish.publish_if_stale import publish_if_stale
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
        {"id": "given", "path": str(RECORDING), "category": "chair", "underside": "closed"},
        {"id": "tracked", "path": "half", "category": "chair", "trajectory": "ignore"},
        {"id": "refined", "path": "half", "category": "chair", "trajectory": "refine"},
        {
            "id": "boxed",
            "path": str(RECORDING),
            "category": "chair",
            "box": {"center_m": [0.0, 0.0, 0.45], "size_m": [0.7, 0.7, 0.95], "yaw_rad": -0.7},
            "masks": "masks",
        },
    ],
    "fusion": {"voxel_size_m": 0.01, "scene_voxel_size_m": 0.02},
    "views": {"count": 2},
}
SYNTHESIS = {"categories": ["chair"], "train": 1, "validation": 0, "test": 0, "sv_steps": 1, "image_px": 96}
# What is built of each recording, and pinned.
BUILT = {
    "given": tuple(stage.name for stage in (*STAGES, SUGGEST)),
    "tracked": ("ingest", "track"),
    "refined": ("track",),
    "boxed": ("segment", "sample-views"),  # on what was made of "given"
}
# Of the release that is predicted and scored.
FIXED: Recordings = (
    ("chair_01", "chair", "red_chair", "test", 1),
    ("chair_02", "chair", "val_chair", "validation", 1),
    ("chair_03", "chair", "old_chair", "train", 1),
)
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
        inputs: their fingerprints are in its own: where one of them wrote something else, so may this one.
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
    _draw_masks(root / "masks")
    _halve(root / "half")
    for job in jobs(root):
        stages = BUILT[job.recording.id]
        if job.recording.id == "boxed":
            shutil.copytree(root / "build" / "given", job.build)
        for last in stages[-2:]:
            outcome = build_recording(job, last)
            assert outcome.error is None, outcome.error
    settings = jobs(root)[0].settings
    publish_if_stale(settings, root, [settings.recordings[0].id])
    publish_synthetic(root / "fixed", FIXED)
    release = open_release(root / "fixed" / "benchmark")
    write_baselines(release, root / "fixed" / "baselines")
    _predict(root / "fixed" / "predictions")
    score_methods(release, root / "fixed" / "predictions", root / "fixed" / "scores")
    synthesize(SynthesisSettings.model_validate(SYNTHESIS), root / "synthetic")
    return read_sample(root)


def _halve(folder: Path) -> None:
    """The first half of the recording's frames."""
    for name in ("depth", "rgb"):
        (folder / name).mkdir(parents=True)
        rows = (RECORDING / f"{name}.txt").read_text(encoding="utf-8").splitlines()
        kept = rows[: 1 + (len(rows) - 1) // 2]
        (folder / f"{name}.txt").write_text("\n".join(kept) + "\n", encoding="utf-8")
        for row in kept[1:]:
            shutil.copy(RECORDING / row.split()[1], folder / name)
    for name in ("camera.json", "groundtruth.txt"):
        shutil.copy(RECORDING / name, folder)


def _draw_masks(folder: Path) -> None:
    """Pixels that are added to the mask of one view, and taken from that of another."""
    folder.mkdir()
    block = np.zeros((240, 320), np.uint8)
    block[100:140, 100:200] = 255
    for name in ("000.exclude.png", "001.include.png"):
        cv2.imwrite(str(folder / name), block)


def _predict(folder: Path) -> None:
    """A blurred ball of 64 cells a side, and a sharp one of 256, for every pair but those of training."""
    for method, side in (("soft", 64), ("sharp", 256)):
        axis = (np.arange(side) + 0.5) * (256 / side)
        x, y, z = ((axis - centre) ** 2 for centre in (124, 126, 130))
        value = np.clip((100 - np.sqrt(x[:, None, None] + y[:, None] + z)) / 40, 0, 1)
        for recording, *_, split, _ in FIXED:
            if split != "train":
                path = folder / method / recording / "000.npy"
                path.parent.mkdir(parents=True)
                np.save(path, value.astype(np.float32) if method == "soft" else value > 0.4)


def read_sample(root: Path) -> Sample:
    """What lies in the folder of `make_sample`, or in a copy of it."""
    built = {
        stage.name: Written(
            stage.inputs,
            {
                f"{job.recording.id}/{name}": path
                for job in jobs(root)
                if stage.name in BUILT[job.recording.id]
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
        "baselines": ((), dict(_files(root / "fixed" / "baselines", "baselines"))),
        "score": ((), dict(_files(root / "fixed" / "scores", "scores"))),
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
