"""Make the pairs of one model, and write their files atomically as one artefact."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from kinectbench.core import sha256_file, sha256_text, write_below
from kinectbench.core.artefacts.object import MadeGroup, MadeModel, SynthesisedQualityFile
from kinectbench.core.artefacts.views import Refused, SynthesisedCamera, ViewRow, ViewsFile
from kinectbench.core.geometry import Camera, write_ply
from kinectbench.core.types import Split
from kinectbench.core.voxels.pair_file import Pair, pair_bytes
from kinectbench.engine.artefact import VERSIONS, Artefact
from kinectbench.lab.synthesize.mesh_check import CheckedMesh, as_seeable, load_model
from kinectbench.lab.synthesize.models import Model, SynthesisSettings
from kinectbench.lab.synthesize.pair import make_synthetic_pair, recgan_bytes
from kinectbench.lab.synthesize.views import DepthCamera, ViewAngles, all_views, virtual_camera
from kinectbench.release.exchange.layouts import recgan_path

FILES = "files"
# Settings on which an artefact does not depend: they concern only the rest of a run. But the seed also draws
# the noise: where there is some, `artefact` adds it.
ELSEWHERE = {"name", "license", "models", "categories", "seed", "train", "validation", "test"}


@dataclass(frozen=True)
class Task:
    """One model whose pairs are to be made.

    Attributes:
        model: the model.
        split: the benchmark's split that it belongs to.
        settings: settings of the run.
        work: the folder of all models' artefacts.
    """

    model: Model
    split: Split
    settings: SynthesisSettings
    work: Path

    @property
    def groups(self) -> dict[str, int]:
        """Groups of views: {group: number of steps in a full turn, for each of roll, pitch and yaw}.

        "sv" (same viewing) has the angles of training. "cv" (cross viewing) has another angle step (paper);
        training has no such views. A group has all combinations of steps.
        """
        sv, cv = {"sv": self.settings.sv_steps}, {"cv": self.settings.cv_steps}
        return sv if self.split == "train" else sv | cv

    @property
    def folder(self) -> Path:
        """The artefact's folder."""
        return self.work / self.model.name

    def artefact(self) -> Artefact:
        """Return the artefact of the model's files. They depend on the settings, and on mesh file or seed."""
        source = sha256_file(Path(self.model.path)) if self.model.path else sha256_text(str(self.model.seed))
        settings = self.settings.stored(without=ELSEWHERE)
        own = {"split": self.split, "category": self.model.category, "model": self.model.name}
        if self.settings.noise != "none":
            settings["seed"] = self.settings.seed
        return Artefact(self.folder, "synthesize", VERSIONS["synthesize"], settings | own, {"mesh": source})


def make_model(task: Task) -> None:
    """Write all pairs of one model into its artefact, unless the artefact is up to date.

    Raises:
        ShapeError: the mesh cannot be used.
        StorageError: the disk is full or read-only.
    """
    artefact = task.artefact()
    if artefact.is_current():
        return
    settings = task.settings
    checked = load_model(task.model, settings.max_faces)
    if settings.solid == "seeable":
        checked = as_seeable(checked, settings.up_axis)
    eye = DepthCamera(checked.mesh, virtual_camera(settings.image_px))
    with artefact.write() as folder:
        groups = {}
        for name, steps in task.groups.items():
            pairs = (
                (view, *make_synthetic_pair(checked, eye, view, settings, task.model.name))
                for view in _drawn_views(task, steps)
            )
            write = _write_recgan if settings.layout == "recgan" else _write_release
            groups[name] = write(task, name, folder / FILES, checked, eye.camera, pairs)
        MadeModel(split=task.split, quality=_quality(task.model, checked), groups=groups).write(folder)


def _drawn_views(task: Task, steps: int) -> tuple[ViewAngles, ...]:
    """Return the views of one group: all, or `most_views` of them, drawn at random by the model's name."""
    views, most = all_views(steps), task.settings.most_views
    if most is None or most >= len(views):
        return views
    drawn = np.random.default_rng([steps, *task.model.name.encode()]).permutation(len(views))[:most]
    return tuple(views[index] for index in sorted(drawn))


def _quality(model: Model, checked: CheckedMesh) -> SynthesisedQualityFile:
    """Return a model's entry on quality for benchmark.json: filling rule, source, number of faces, notes."""
    return SynthesisedQualityFile(
        verdict="good",
        method=checked.rule,
        source=Path(model.path).name if model.path else f"{model.category}:seed={model.seed}",
        faces=len(checked.mesh.faces),
        warnings=checked.notes,
    )


Pairs = Iterator[tuple[ViewAngles, Pair, str | None]]


def _write_release(
    task: Task, group: str, files: Path, checked: CheckedMesh, camera: Camera, pairs: Pairs
) -> MadeGroup:
    """Write a group's pairs, views and object as a recording of a release; return its views and refusals."""
    recording = f"{task.model.name}-{group}"
    for name in ("pairs", "views", "objects"):
        (files / name / recording).mkdir(parents=True)
    rows, refused = [], []
    for index, (view, pair, reason) in enumerate(pairs):
        name, steps, angles_rad = f"{index:03d}", view.steps, view.angles_rad
        if reason:
            refused.append(Refused(view=name, steps=steps, angles_rad=angles_rad, reason=reason))
            continue
        (files / "pairs" / recording / f"{name}.npz").write_bytes(pair_bytes(pair))
        pose = pair.T_world_camera
        share = pair.stated_unknown_share
        rows.append(
            ViewRow(view=name, steps=steps, angles_rad=angles_rad, T_world_camera=pose, unknown_share=share)
        )
    ViewsFile(
        order="roll, pitch, yaw",
        steps_per_turn=task.groups[group],
        camera=SynthesisedCamera(**asdict(camera)),
        views=tuple(rows),
        refused=tuple(refused),
    ).write(files / "views" / recording)
    write_ply(checked.mesh, files / "objects" / recording / "mesh.ply")
    _quality(task.model, checked).write(files / "objects" / recording)
    return MadeGroup(views=tuple(row.view for row in rows), refused=tuple(row.reason for row in refused))


def _write_recgan(
    task: Task, group: str, files: Path, checked: CheckedMesh, camera: Camera, pairs: Pairs
) -> MadeGroup:
    """Write a group's pairs as the paper authors' two files each; return its views and refusals.

    `files` is the folder to write into; `pairs` are (view, pair, reason why it is refused or None).
    """
    model, names, refused = task.model, [], []
    for view, pair, reason in pairs:
        if reason:
            refused.append(reason)
            continue
        name = f"{model.name}_{view.name}"
        for kind, content in zip(("25d", "3d"), recgan_bytes(pair), strict=True):
            write_below(files / recgan_path(kind, model.category, task.split, view.n**3, name), content)
        names.append(view.name)
    return MadeGroup(views=tuple(names), refused=tuple(refused))
