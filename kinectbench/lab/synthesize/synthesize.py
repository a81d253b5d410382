"""`kinectbench synthesize`: find, check and assign models, make their pairs, collect these in one folder."""

import os
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from kinectbench._version import __version__
from kinectbench.core import (
    KinectBenchError,
    PairError,
    SettingsError,
    ShapeError,
    StorageError,
    pretty_json,
    replaced_folder,
    sha256_file,
)
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, RecordingInfo
from kinectbench.core.artefacts.object import MadeModel, QualityFile
from kinectbench.core.artefacts.stored import Stored
from kinectbench.core.artefacts.targets import SHA256SUMS, parse_sums
from kinectbench.core.artefacts.views import ViewsFile
from kinectbench.core.types import NamedProgress, no_progress
from kinectbench.engine.locks import locked, sweep
from kinectbench.lab.synthesize.make import FILES, Task, make_model
from kinectbench.lab.synthesize.mesh_check import load_model
from kinectbench.lab.synthesize.models import (
    Dealt,
    LeftOut,
    Model,
    SynthesisSettings,
    deal,
    family_models,
    folder_models,
)
from kinectbench.release.contents import release_files
from kinectbench.release.exchange.layouts import names_sha256, refuse_others
from kinectbench.release.publish.card import CardTexts
from kinectbench.release.publish.small_files import release_info, write_small_files
from kinectbench.release.published import release_text
from kinectbench.release.release import Target
from kinectbench.scoring.workers import run_tasks
from kinectbench.settings.models import PairSettings

SYNTHESIS_JSON = "synthesis.json"
TEXTS = CardTexts(
    "meshes seen by a virtual camera",
    "The\nangles of the views are in `views/`, the meshes in `objects/`. `occupancy_rule` says how `full` "
    "was filled: `winding`,\nexact, for a closed mesh; `seeable`, with what no camera could see, too; "
    "`six-rays`, the rule of the paper's authors, for one that is not. `known` is set everywhere,\nbut for "
    "slits of `seeable` ones. A mesh's own unit stands for a metre.",
)
# Up to this many models are checked sooner than other processes would start.
FEW = 40


class SynthesisFile(Stored):
    """The keys of synthesis.json that are read before an earlier result is replaced."""

    FILE: ClassVar[str] = SYNTHESIS_JSON
    ERROR: ClassVar[type[KinectBenchError]] = SettingsError
    ADVICE: ClassVar[str] = "choose a new or empty folder"

    files_sha256: str | None = None


def assemble(
    tasks: Sequence[Task], settings: dict[str, Any], out: Path, lines: Sequence[str]
) -> tuple[int, str]:
    """Collect the files of all finished tasks in `out`, atomically replacing its content.

    Files are linked instead of copied, if the disk allows it. The settings are without paths. `lines` are
    the report, for the dataset card or synthesis.json.

    Returns:
        The number of pairs, and the release's benchmark_sha256; "" in layout recgan.

    Raises:
        PairError: every pair was refused.
        StorageError: the disk is full or read-only, or an artefact is missing.
    """
    with replaced_folder(out) as folder:
        for task in tasks:
            _link(task.folder / FILES, folder)
        made = [MadeModel.read(task.folder) for task in tasks]
        pairs = sum(len(group.views) for model in made for group in model.groups.values())
        if not pairs:
            first = next(
                reason for model in made for group in model.groups.values() for reason in group.refused
            )
            raise PairError(
                f"{out}: every single pair was refused, the first because {first}", what="all-refused"
            )
        if settings["layout"] == "recgan":
            content = {"package_version": __version__, "settings": settings, "report": list(lines)}
            content["models"] = {
                task.model.name: row.json_value() for task, row in zip(tasks, made, strict=True)
            }
            content["files_sha256"] = names_sha256(folder, SYNTHESIS_JSON)
            (folder / SYNTHESIS_JSON).write_text(pretty_json(content), encoding="utf-8")
            return pairs, ""
        return pairs, _complete(tasks, made, settings, folder, lines)


def _complete(
    tasks: Sequence[Task],
    made: Sequence[MadeModel],
    settings: dict[str, Any],
    folder: Path,
    lines: Sequence[str],
) -> str:
    """Write all files of a release but the pairs, views and objects; return its benchmark_sha256."""
    targets: list[Target] = []
    infos: dict[str, RecordingInfo] = {}
    for task, content in zip(tasks, made, strict=True):
        for group, views in content.groups.items():
            recording = f"{task.model.name}-{group}"
            files = {view: f"pairs/{recording}/{view}.npz" for view in views.views}
            rows = ViewsFile.read(folder / "views" / recording).views if files else ()
            shares = {row.view: row.unknown_share for row in rows}
            targets += [
                Target(
                    recording=recording,
                    object=task.model.name,
                    view=view,
                    category=task.model.category,
                    split=task.split,
                    file=file,
                    sha256=sha256_file(folder / file),
                    unknown_share=shares[view],
                )
                for view, file in files.items()
            ]
            if files:
                infos[recording] = RecordingInfo(
                    object=task.model.name,
                    category=task.model.category,
                    split=task.split,
                    pairs=len(files),
                    refused=len(views.refused),
                    quality=QualityFile.model_validate(content.quality.json_value()),
                )
    pairs = PairSettings(framing=settings["framing"], min_containment=settings["min_containment"])
    public = {"pairs": pairs.model_dump(mode="json"), "synthesis": settings}
    info = release_info(settings["name"], settings["license"], settings["framing"], "any", public, infos)
    return write_small_files(info, folder, tuple(sorted(targets)), lines, TEXTS)


def _link(source: Path, target: Path) -> None:
    """Hard-link, or else copy, every file below `source` to the same place below `target`."""
    if not source.is_dir():
        raise StorageError(f"{source}: gone while it was needed; run the command again", what="changed")
    for path in sorted(source.rglob("*")):
        if path.is_file():
            link = target / path.relative_to(source)
            link.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(path, link)
            except OSError:  # another disk, or no links
                shutil.copyfile(path, link)


@dataclass(frozen=True)
class Report:
    """The result of a synthesis.

    Attributes:
        folder: the folder that was written.
        models: number of models used.
        pairs: number of pairs.
        left_out: models that could not be used, and why.
        benchmark_sha256: hash that identifies the release; "" in layout recgan.
        lines: the report in words: counts per category, rules, notes, models left out.
    """

    folder: Path
    models: int
    pairs: int
    left_out: tuple[LeftOut, ...]
    benchmark_sha256: str
    lines: tuple[str, ...]


def synthesize(
    settings: SynthesisSettings, out: Path, jobs: int = 1, progress: NamedProgress = no_progress
) -> Report:
    """Make the paper's synthetic pairs (Sec. 3.6) from a folder of meshes or from parametric furniture.

    Finished models are kept in `<out>.work/` until the run is complete, so that an interrupted run can
    continue. The result depends neither on interruptions nor on `jobs`.

    Args:
        settings: the settings; `models` is relative to the working folder.
        out: a new folder, or an earlier result, which is replaced.
        jobs: number of processes.
        progress: called with ("checking" or "making", models done, models in all).

    Raises:
        SettingsError: there are no such models, or `out` or `<out>.work` holds something else.
        KinectBenchError: no model can be used, every pair was refused, or a process was killed.
        StorageError: the disk is full or read-only.
    """
    _check_target(out)
    models, left_out = _models(settings)
    work = out.absolute().with_name(f"{out.absolute().name}.work")
    _check_work(work)
    with _kept_if_used(work), locked(work):
        sweep(out)
        check = partial(_check_all, max_faces=settings.max_faces, jobs=jobs, progress=progress)
        dealt = deal(models, settings, check)
        tasks = [
            Task(model, split, settings, work)
            for here in dealt.values()
            for model, split in sorted(here.split_of.items())
        ]
        left_out += tuple(bad for here in dealt.values() for bad in here.left_out)
        if not tasks:
            reason = f": {left_out[0].model}: {left_out[0].reason}" if left_out else ""
            raise KinectBenchError(
                f"{settings.models or 'families'}: not one model can be used{reason}", what="no-model"
            )
        run_tasks(make_model, tasks, jobs, partial(progress, "making"))
        lines = tuple(_lines(settings, dealt, tasks, left_out))
        public = settings.stored(without={"models"})
        public["source"] = "meshes" if settings.models else "families"
        pairs, benchmark_sha256 = assemble(tasks, public, out, lines)
        shutil.rmtree(work, ignore_errors=True)
    return Report(out, len(tasks), pairs, left_out, benchmark_sha256, lines)


def _check_target(out: Path) -> None:
    """Refuse to replace a folder that `synthesize` did not write."""
    if not out.exists() and not out.is_symlink():
        return
    if (out / SYNTHESIS_JSON).is_file():
        written_sha256 = None
        with suppress(KinectBenchError):  # a damaged file says nothing
            written_sha256 = SynthesisFile.read(out).files_sha256
        refuse_others(out, written_sha256, SYNTHESIS_JSON)
        return
    if not out.is_dir() or (any(out.iterdir()) and not _is_ours(out)):
        raise SettingsError(
            f"{out}: holds something else; choose a new or empty folder", what="other-content"
        )


def _is_ours(out: Path) -> bool:
    """Return whether a folder holds only files of a release that `synthesize` wrote."""
    if not (out / BENCHMARK_JSON).is_file() or not (out / SHA256SUMS).is_file():
        return False
    sums = parse_sums(release_text(out / SHA256SUMS), str(out / SHA256SUMS))
    return all(path.relative_to(out).as_posix() in sums for path in release_files(out))


def _check_work(work: Path) -> None:
    """Refuse the folder for unfinished work if it holds anything but an unfinished run's files."""
    if work.exists() and not (work.is_dir() and ((work / ".lock").is_file() or not any(work.iterdir()))):
        raise SettingsError(
            f"{work}: holds something else, and is needed for unfinished work; move it away",
            what="other-content",
        )


@contextmanager
def _kept_if_used(work: Path) -> Iterator[None]:
    """At the end of the block, delete the folder of unfinished work unless it has a finished model."""
    try:
        yield
    finally:
        if work.is_dir() and all(path.name == ".lock" for path in work.iterdir()):
            shutil.rmtree(work, ignore_errors=True)


def _models(settings: SynthesisSettings) -> tuple[tuple[Model, ...], tuple[LeftOut, ...]]:
    if settings.models is not None:
        return folder_models(Path(settings.models), settings.categories)
    return family_models(settings.categories, sum(settings.wanted.values())), ()


def _check_all(
    models: Sequence[Model], max_faces: int, jobs: int, progress: NamedProgress
) -> list[str | None]:
    """Load and check each model; return for each why it cannot be used, None if it can be used."""
    jobs = jobs if len(models) > FEW else 1
    return run_tasks(partial(_reason, max_faces=max_faces), models, jobs, partial(progress, "checking"))


def _reason(model: Model, max_faces: int) -> str | None:
    try:
        load_model(model, max_faces)
    except ShapeError as error:
        return str(error)
    return None


def _lines(
    settings: SynthesisSettings, dealt: dict[str, Dealt], tasks: Sequence[Task], left_out: Sequence[LeftOut]
) -> Iterator[str]:
    """Yield the report line by line: counts per category, then notes on models, then models left out."""
    made = {task.model: MadeModel.read(task.folder) for task in tasks}
    if settings.noise != "none":
        yield "depth with the errors of a Kinect v1; the full shapes are exact"
    for category, models in dealt.items():
        counts = Counter(models.split_of.values())
        rules = Counter(made[model].quality.method for model in models.split_of)
        pairs: Counter[str] = Counter()
        refused = 0
        for model, split in models.split_of.items():
            for group in made[model].groups.values():
                pairs[split] += len(group.views)
                refused += len(group.refused)
        parts = [
            f"{sum(number.values())} {what} ({', '.join(f'{number[s]} {s}' for s in settings.wanted)})"
            for what, number in (("models", counts), ("pairs", pairs))
        ]
        parts += [f"{count} by {rule}" for rule, count in sorted(rules.items())]
        yield f"{category}: {', '.join(parts)}" + (f", {refused} pairs refused" if refused else "")
        if len(models.split_of) < sum(settings.wanted.values()):
            asked = ", ".join(f"{count} {split}" for split, count in settings.wanted.items())
            yield f"{category}: {len(models.split_of)} models for the {asked} asked for: dealt in proportion"
        if models.unused:
            yield f"{category}: {models.unused} more models were not needed"
    for task in tasks:
        quality = made[task.model].quality
        if quality.method == "six-rays":
            yield f"{task.model.label}: not watertight: filled by the rule {quality.method}"
        yield from (f"{task.model.label}: {note}" for note in quality.warnings)
    yield from (f"left out: {bad.model}: {bad.reason}" for bad in left_out)
