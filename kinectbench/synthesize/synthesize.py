"""`synthesize`: find models, check and deal them, make every pair, and put all into one folder."""

import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from kinectbench.errors import KinectBenchError, SettingsError, ShapeError
from kinectbench.locks import locked, sweep
from kinectbench.release.layout import BENCHMARK_JSON, SHA256SUMS, read_sums, release_files
from kinectbench.release.metadata import read_text
from kinectbench.scoring.workers import run_tasks
from kinectbench.synthesize.assemble import SYNTHESIS_JSON, assemble
from kinectbench.synthesize.make import Task, make_model
from kinectbench.synthesize.mesh_check import load_model
from kinectbench.synthesize.models import LeftOut, Model, family_models, folder_models
from kinectbench.synthesize.settings import SynthesisSettings
from kinectbench.synthesize.splits import Dealt, deal

Progress = Callable[[str, int, int], None]
# So many models are checked sooner than other processes have started.
FEW = 40


@dataclass(frozen=True)
class Report:
    """What was synthesised.

    Attributes:
        folder: where it lies.
        models: number of models used.
        pairs: number of pairs.
        left_out: models that could not be used, and why.
        benchmark_sha256: the release's identity; "" for layout recgan.
        lines: all of it in words: counts per category, rules, notes, what was left out.
    """

    folder: Path
    models: int
    pairs: int
    left_out: tuple[LeftOut, ...]
    benchmark_sha256: str
    lines: tuple[str, ...]


def synthesize(
    settings: SynthesisSettings, out: Path, jobs: int = 1, progress: Progress | None = None
) -> Report:
    """Make the paper's synthetic pairs (Sec. 4.1) of a folder of meshes or of parametric furniture.

    Finished models are kept in `<out>.work/` until the whole is done, so that a run that was stopped goes on
    where it was. The result does not depend on that, nor on `jobs`.

    Args:
        settings: what to make; `models` is relative to the current folder.
        out: a new folder, or one that this wrote before: it is replaced.
        jobs: number of processes.
        progress: called with ("checking" or "making", models done, models in all).

    Raises:
        SettingsError: no such models, or `out` holds something else.
        KinectBenchError: not a single model can be used, or a process was killed.
        StorageError: the disk is full or read-only.
    """
    tell = progress or (lambda what, done, total: None)
    _check_target(out)
    models, left_out = _models(settings)
    work = out.absolute().with_name(f"{out.absolute().name}.work")
    _check_work(work)
    with _kept_if_used(work), locked(work):
        sweep(out)
        check = partial(_check_all, max_faces=settings.max_faces, jobs=jobs, progress=tell)
        dealt = deal(models, settings, check)
        tasks = [
            Task(model, split, settings, work)
            for here in dealt.values()
            for model, split in sorted(here.split_of.items())
        ]
        left_out += tuple(bad for here in dealt.values() for bad in here.left_out)
        if not tasks:
            reason = f": {left_out[0].model}: {left_out[0].reason}" if left_out else ""
            raise KinectBenchError(f"{settings.models or 'families'}: not one model can be used{reason}")
        run_tasks(make_model, tasks, jobs, partial(tell, "making"))
        lines = tuple(_lines(settings, dealt, tasks, left_out))
        public = settings.model_dump(mode="json", exclude={"models"})
        public["source"] = "meshes" if settings.models else "families"
        assembled = assemble(tasks, public, out, lines)
        shutil.rmtree(work, ignore_errors=True)
    return Report(out, len(tasks), assembled.pairs, left_out, assembled.benchmark_sha256, lines)


def _check_target(out: Path) -> None:
    """Nothing but what `synthesize` wrote may be replaced."""
    if not out.exists() and not out.is_symlink():
        return
    if not out.is_dir() or (any(out.iterdir()) and not _is_ours(out)):
        raise SettingsError(f"{out}: holds something else; choose a new or empty folder")


def _is_ours(out: Path) -> bool:
    """Whether a folder holds what `synthesize` wrote, and nothing else."""
    if (out / SYNTHESIS_JSON).is_file():
        return all(path.name == SYNTHESIS_JSON or path.name.startswith("P1_") for path in out.iterdir())
    if not (out / BENCHMARK_JSON).is_file() or not (out / SHA256SUMS).is_file():
        return False
    sums = read_sums(read_text(out / SHA256SUMS), str(out / SHA256SUMS))
    return all(path.relative_to(out).as_posix() in sums for path in release_files(out))


def _check_work(work: Path) -> None:
    """A folder of that name that is not an unfinished run's is somebody's."""
    if work.exists() and not (work.is_dir() and ((work / ".lock").is_file() or not any(work.iterdir()))):
        raise SettingsError(f"{work}: holds something else, and is needed for unfinished work; move it away")


@contextmanager
def _kept_if_used(work: Path) -> Iterator[None]:
    """Remove the folder of unfinished work if the block leaves no finished model in it."""
    try:
        yield
    finally:
        if work.is_dir() and all(path.name == ".lock" for path in work.iterdir()):
            shutil.rmtree(work, ignore_errors=True)


def _models(settings: SynthesisSettings) -> tuple[tuple[Model, ...], tuple[LeftOut, ...]]:
    if settings.models is not None:
        return folder_models(Path(settings.models), settings.categories)
    return family_models(settings.categories, sum(settings.wanted.values())), ()


def _check_all(models: Sequence[Model], max_faces: int, jobs: int, progress: Progress) -> list[str | None]:
    """Why each model cannot be used, or None."""
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
    """The report."""
    made = {task.model: task.made() for task in tasks}
    for category, models in dealt.items():
        counts = Counter(models.split_of.values())
        rules = Counter(made[model]["quality"]["method"] for model in models.split_of)
        pairs: Counter[str] = Counter()
        refused = 0
        for model, split in models.split_of.items():
            for group in made[model]["groups"].values():
                pairs[split] += len(group["views"])
                refused += len(group["refused"])
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
    yield from _model_lines(tasks, made)
    yield from (f"left out: {bad.model}: {bad.reason}" for bad in left_out)


def _model_lines(tasks: Sequence[Task], made: dict[Model, dict[str, object]]) -> Iterator[str]:
    """What is to be said of single models: those filled by the authors' rule, and notes."""
    for task in tasks:
        quality = made[task.model]["quality"]
        assert isinstance(quality, dict)
        if quality["method"] != "winding":
            yield f"{task.model.label}: not watertight: filled by the rule {quality['method']}"
        yield from (f"{task.model.label}: {note}" for note in quality["warnings"])
