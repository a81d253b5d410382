"""One folder of many artefacts: a release, or the authors' folders with a file that says what they hold."""

import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from kinectbench import __version__
from kinectbench.config import PairSettings, Split
from kinectbench.errors import PairError, StorageError
from kinectbench.release.card import CardTexts
from kinectbench.release.metadata import RecordingInfo
from kinectbench.release.release import Target
from kinectbench.release.small_files import Head, write_small_files
from kinectbench.synthesize.make import FILES, Task
from kinectbench.workspace import pretty_json, replaced_folder, sha256_file

SYNTHESIS_JSON = "synthesis.json"
TEXTS = CardTexts(
    "meshes seen by a virtual camera",
    "The\nangles of the views are in `views/`, the meshes in `objects/`. `occupancy_rule` says how `full` "
    "was filled: `winding`,\nexact, for a closed mesh; `six-rays`, the rule of the paper's authors, for one "
    "that is not. `known` is set everywhere.\nA mesh's own unit stands for a metre.",
)


@dataclass(frozen=True)
class Assembled:
    """What lies in the folder: number of pairs, and the release's identity or ""."""

    pairs: int
    benchmark_sha256: str


def assemble(tasks: Sequence[Task], settings: dict[str, Any], out: Path, lines: Sequence[str]) -> Assembled:
    """Put the artefacts of all tasks into `out`, in place of what was there, whole or not at all.

    Files are linked, not copied, where the disk can.

    Args:
        tasks: all made.
        settings: what the run was made with, without paths.
        out: the folder.
        lines: the report, for the card or synthesis.json.

    Raises:
        StorageError: the disk is full or read-only, or an artefact is gone.
    """
    with replaced_folder(out) as folder:
        for task in tasks:
            _link(task.folder / FILES, folder)
        made = [task.made() for task in tasks]
        pairs = sum(len(group["views"]) for content in made for group in content["groups"].values())
        if not pairs:
            first = next(
                reason for content in made for g in content["groups"].values() for reason in g["refused"]
            )
            raise PairError(f"{out}: every single pair was refused, the first because {first}")
        if settings["layout"] == "recgan":
            content = {"package_version": __version__, "settings": settings, "report": list(lines)}
            content["models"] = {task.model.name: row for task, row in zip(tasks, made, strict=True)}
            (folder / SYNTHESIS_JSON).write_text(pretty_json(content))
            return Assembled(pairs, "")
        return Assembled(pairs, _complete(tasks, made, settings, folder, lines))


def _complete(
    tasks: Sequence[Task],
    made: Sequence[dict[str, Any]],
    settings: dict[str, Any],
    folder: Path,
    lines: Sequence[str],
) -> str:
    """Write the small files of a release; returns its identity."""
    targets: list[Target] = []
    infos: dict[str, RecordingInfo] = {}
    for task, content in zip(tasks, made, strict=True):
        for group, views in content["groups"].items():
            recording = f"{task.model.name}-{group}"
            files = {view: f"pairs/{recording}/{view}.npz" for view in views["views"]}
            targets += [
                Target(
                    recording=recording,
                    object=task.model.name,
                    view=view,
                    category=task.model.category,
                    split=task.split,
                    file=file,
                    sha256=sha256_file(folder / file),
                )
                for view, file in files.items()
            ]
            if files:
                infos[recording] = _info(task, content, len(files), len(views["refused"]))
    pair_settings = PairSettings(min_containment=settings["min_containment"]).model_dump(mode="json")
    public = {"pairs": pair_settings, "synthesis": settings}
    head = Head(settings["name"], settings["license"], "object", "any", public, TEXTS)
    return write_small_files(head, folder, tuple(sorted(targets)), infos, lines)


def _info(task: Task, content: dict[str, Any], pairs: int, refused: int) -> RecordingInfo:
    split = next(name for name in get_args(Split) if name == task.split)
    return RecordingInfo(
        object=task.model.name,
        category=task.model.category,
        split=split,
        pairs=pairs,
        refused=refused,
        quality=content["quality"],
    )


def _link(source: Path, target: Path) -> None:
    """Make every file below `source` appear below `target`."""
    if not source.is_dir():
        raise StorageError(f"{source}: gone while it was needed; run the command again")
    for path in sorted(source.rglob("*")):
        if path.is_file():
            there = target / path.relative_to(source)
            there.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(path, there)
            except OSError:  # another disk, or one without links
                shutil.copyfile(path, there)
