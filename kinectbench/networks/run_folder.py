"""The folder of a training: configuration, checkpoint, weights, log of validations, and curves."""

import platform
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import torch

from kinectbench.core import (
    SettingsError,
    StorageError,
    quoted,
    read_plain_text,
    replaced_file,
    storage_errors,
)
from kinectbench.core.artefacts.method import TrainingFile, TrainingRow
from kinectbench.core.pictures import INK, SOFT, figure_png, new_figure
from kinectbench.networks.checkpoint import DAMAGED, State, checked_state, read_checkpoint, set_values
from kinectbench.networks.config import MethodSettings, read_config, write_config
from kinectbench.networks.data import steps_in_all
from kinectbench.networks.steps import Learner
from kinectbench.networks.weights import FILE as WEIGHTS
from kinectbench.networks.weights import arrays_of_network, write_weights

# Maximum number of differing keys that are named.
SHOWN = 3
CPU_INFO = Path("/proc/cpuinfo")
CONFIG, CHECKPOINT, CURVES = "config.yaml", "checkpoint.pt", "curves.png"


def make_folder(folder: Path) -> None:
    """Create a folder if it is missing.

    Raises:
        StorageError: a parent of it is a file, or the disk cannot be written.
    """
    try:
        with storage_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise StorageError(
            f"{folder}: a parent of it is a file; choose another folder", what="no-way"
        ) from None


def _differences(before: MethodSettings, now: MethodSettings) -> str:
    """Return a text with the first keys whose values differ, and both values of each."""
    old, new = (dict(_flat(config.model_dump(mode="json"))) for config in (before, now))
    keys = [key for key in (old | new) if old.get(key) != new.get(key)]
    changes = [f"{key} {quoted(old.get(key))} there, {quoted(new.get(key))} here" for key in keys[:SHOWN]]
    return "; ".join(changes) + (f"; and {len(keys) - SHOWN} more" if len(keys) > SHOWN else "")


def _flat(values: dict[str, object], before: str = "") -> Iterator[tuple[str, object]]:
    """Yield (dotted key, value) of nested values; `before` is the prefix of the keys."""
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{before}{key}.")
        else:
            yield before + key, value


def prepare_folder(folder: Path, config: MethodSettings) -> None:
    """Create the folder and write the configuration; if the folder has one, check that it is equal.

    Raises:
        SettingsError: the folder holds a training with another configuration, or its configuration cannot be
            read.
        StorageError: the disk is full or read-only.
    """
    make_folder(folder)
    path = folder / CONFIG
    if path.exists():
        before = read_config(path)
        trained, where = before.sha256, f": {_differences(before, config)}"
    else:  # it was deleted; its results still exist
        course = TrainingFile.read_if_there(folder)
        trained, where = course.config_sha256 if course else config.sha256, ""
    if trained != config.sha256:
        raise SettingsError(
            f"{folder}: trained with other settings{where}; choose another folder", what="other-content"
        )
    with replaced_file(path) as temporary:
        write_config(config, temporary)


def save(folder: Path, learner: Learner, state: State, facts: dict[str, Any], config: MethodSettings) -> None:
    """Write checkpoint, log and curves; also weights, unless the best weights are kept and already written.

    `facts` are the entries of training.json that do not change, with the hashes of the releases.
    """
    latest = config.training.keep == "last" or state.best_step == 0  # validation writes the best
    if latest:
        write_weights(arrays_of_network(learner.network), folder / WEIGHTS)
    content = {
        "benchmarks_sha256": benchmarks(facts),
        "config_sha256": config.sha256,
        "network": learner.network.state_dict(),
        "optimisers": [optimiser.state_dict() for optimiser in learner.optimisers],
        "state": {**vars(state), "rows": [row.json_value() for row in state.rows]},
    }
    with replaced_file(folder / CHECKPOINT) as temporary, temporary.open("wb") as file:
        torch.save(content, file)
    step = state.step if latest else state.best_step
    course = TrainingFile(
        name=config.name,
        config_sha256=config.sha256,
        steps=state.step,
        weights_step=step,
        seconds=round(state.seconds, 3),
        rows=tuple(state.rows),
        **facts,
    )
    with replaced_file(folder / TrainingFile.FILE) as temporary:
        temporary.write_text(course.text(), encoding="utf-8")
    with replaced_file(folder / CURVES) as temporary:
        temporary.write_bytes(_curves_png(config.name, state.rows))


def benchmarks(facts: dict[str, Any]) -> list[str]:
    """Return the `benchmark_sha256` of each training release, in order."""
    return [facts["benchmark_sha256"], *facts["further_benchmarks_sha256"]]


def check_weights_are_there(folder: Path, config: MethodSettings, state: State) -> None:
    """Refuse to continue if the best weights are missing, because later steps cannot restore them.

    Raises:
        StorageError: the weights of the best step are missing.
    """
    if config.training.keep == "best" and state.best_step and not (folder / WEIGHTS).is_file():
        raise StorageError(f"{folder / WEIGHTS}: gone; remove {CHECKPOINT} beside it to train from the start")


def restore(folder: Path, learner: Learner, facts: dict[str, Any], device: str) -> State:
    """Restore the learner from a folder; return the progress, or a new `State` if there is no checkpoint.

    Raises:
        SettingsError: the training in the folder is of another release, or has other settings.
        StorageError: the checkpoint is damaged.
    """
    path = folder / CHECKPOINT
    if not path.exists():
        return State()
    config = read_config(folder / CONFIG)
    steps = steps_in_all(facts["pairs"], config)
    try:
        content = read_checkpoint(path, learner.network, steps, device)
    except DAMAGED as error:
        raise _damaged(path) from error
    if content.benchmarks_sha256 != benchmarks(facts):
        named = ", ".join(f"{sha256[:8]}…" for sha256 in content.benchmarks_sha256[:20])
        raise SettingsError(
            f"{folder}: was trained on another release ({named}); choose another folder", what="other-content"
        )
    if content.config_sha256 not in (None, config.sha256):
        raise SettingsError(
            f"{folder}: trained with other settings; choose another folder", what="other-content"
        )
    try:
        state = checked_state(content, steps)
        set_values(content, learner.network, learner.optimisers, state.step)
    except DAMAGED as error:
        raise _damaged(path) from error
    return state


def _damaged(path: Path) -> StorageError:
    return StorageError(f"{path}: cannot be read; remove it to train from the start")


def hardware(device: str) -> str:
    """Return the GPU's name; for a CPU, the processor's name and torch's number of threads."""
    if device.startswith("cuda"):
        return str(torch.cuda.get_device_name(device))
    threads = torch.get_num_threads()
    return f"{_processor()}, {threads} thread{'s' * (threads != 1)}"


def _processor() -> str:
    """Return the processor's model as Linux reports it, else its architecture."""
    try:
        lines = read_plain_text(CPU_INFO).splitlines()
    except (OSError, UnicodeDecodeError):
        return platform.machine()
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models and models[0] else platform.machine()


BLUE, ORANGE = "#3b6ea5", "#c77728"
LOSSES = (("loss", INK), ("reconstruction", BLUE), ("discriminator", ORANGE))


def _curves_png(name: str, rows: Sequence[TrainingRow]) -> bytes:
    """Plot a method's losses and validation IoU over steps, as a PNG; the same rows give the same bytes."""
    figure = new_figure(7.0, 5.0)
    above, below = figure.subplots(2, 1, sharex=True)
    steps = [row.step for row in rows]
    for key, color in LOSSES:
        values = [getattr(row, key) for row in rows]
        if any(value is not None for value in values):
            above.plot(steps, values, ".-", color=color, linewidth=1.0, markersize=4, label=key)
    if rows:
        above.legend(frameon=False, fontsize=8)
    above.set_title(name, fontsize=10, loc="left")
    above.set_ylabel("loss, mean", fontsize=9)
    looked = [(row.step, row.validation_iou) for row in rows if row.validation_iou is not None]
    if looked:
        below.plot(*zip(*looked, strict=True), ".-", color=BLUE, linewidth=1.0, markersize=4)
    else:
        below.text(0.5, 0.5, "no validation pairs", color=SOFT, transform=below.transAxes, ha="center")
    below.set_ylabel("validation IoU", fontsize=9)
    below.set_xlabel("step", fontsize=9)
    for axes in (above, below):
        axes.tick_params(labelsize=8)
        axes.grid(color=SOFT, alpha=0.25, linewidth=0.5)
    return figure_png(figure)
