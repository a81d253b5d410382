"""Train a network on the pairs of releases. A stopped training resumes deterministically."""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import torch

from kinectbench.core import KinectBenchError, PredictionError, SettingsError
from kinectbench.core.artefacts.method import TrainingRow
from kinectbench.core.types import Progress, no_progress
from kinectbench.engine.interrupts import interrupts_held
from kinectbench.engine.locks import locked
from kinectbench.networks.allocator import memory_kept
from kinectbench.networks.checkpoint import State
from kinectbench.networks.config import MethodSettings
from kinectbench.networks.data import (
    Batch,
    PairFile,
    batches,
    steps_in_all,
    training_targets,
    validation_pairs,
)
from kinectbench.networks.distributed import (
    agreed,
    chosen_device,
    joined_processes,
    mean_of_all,
    wait_for_all,
)
from kinectbench.networks.registry import make_network
from kinectbench.networks.run_folder import (
    check_weights_are_there,
    hardware,
    make_folder,
    prepare_folder,
    restore,
    save,
)
from kinectbench.networks.steps import Learner, Losses, StepError
from kinectbench.networks.validate import validation_iou
from kinectbench.networks.weights import FILE as WEIGHTS
from kinectbench.networks.weights import arrays_of_network, check_values, write_weights
from kinectbench.release.release import Release, Target

# A killed run loses at most this time; writing 2 GB takes some seconds.
SAVE_EVERY_S = 300.0


@dataclass(frozen=True)
class Training:
    """A running training in this process.

    Attributes:
        config: the method's configuration.
        pairs: the training pairs.
        validation: the validation pairs.
        folder: the training's folder.
        device: the network's device.
        part: (rank, number of processes).
        learner: network and optimisers.
        state: progress of the training.
        facts: the entries of training.json that do not change.
    """

    config: MethodSettings
    pairs: Sequence[PairFile]
    validation: Sequence[PairFile]
    folder: Path
    device: str
    part: tuple[int, int]
    learner: Learner
    state: State
    facts: dict[str, object]

    @property
    def steps(self) -> int:
        """Number of steps of the whole training."""
        return steps_in_all(len(self.pairs), self.config)

    def save(self) -> None:
        """Save the training in its folder; only the process of rank 0 writes."""
        if self.part[0] == 0:
            save(self.folder, self.learner, self.state, self.facts, self.config)


def train(
    config: MethodSettings,
    releases: Sequence[Release],
    folder: Path,
    *,
    minutes: float | None = None,
    device: str | None = None,
    wait: bool = True,
    progress: Progress = no_progress,
    watch: Callable[[TrainingRow], None] | None = None,
) -> State:
    """Train a network, or resume a training in the same folder; return its progress.

    On one machine and with the same number of threads, a training gives the same weights, however often it is
    stopped and resumed. If torchrun starts several processes, they share each batch.

    Args:
        config: the method's configuration.
        releases: their train splits are for training, their validation splits for validation.
        folder: the training's folder.
        minutes: stop after this time; default: after all epochs.
        device: a device of torch, such as "cpu" or "cuda"; default: the GPU if there is one, else the CPU.
        wait: whether to wait if another run uses the folder; if False, an error is raised.
        progress: called with (steps done, steps in all).
        watch: called with each new row of the log.

    Raises:
        ReleaseError, PredictionError: there is no pair, one is missing or changed, or an output is wrong.
        SettingsError: the folder belongs to another training, or `config` or `device` cannot be used.
        StorageError: the disk cannot be written, the checkpoint is damaged, or another run uses the folder.
        StepError: memory is full, a loss or a weight is not finite, or another process has stopped.
    """
    asked = config.training
    targets = training_targets(releases, asked.leave_out, asked.category)
    pairs = [PairFile(release.pair_path(target), target.sha256) for release, target in targets]
    validation = validation_pairs(releases, asked.validation_pairs, asked.category)
    if asked.keep == "best" and not validation:
        raise SettingsError("training.keep: best needs validation pairs, and there are none; choose last")
    where = chosen_device(device)
    make_folder(folder)
    with memory_kept(), _deterministic(where), joined_processes(where) as part:
        _check_shared(asked.batch, part[1])
        with locked(folder, wait=wait) if part[0] == 0 else nullcontext():
            if part[0] == 0:
                prepare_folder(folder, config)
            wait_for_all(part[1])  # rank 0 prepares the folder first
            network = make_network(config.network, config.training.seed, where)
            check_values(network)
            learner = Learner(network, config, where, part)
            facts = _facts_of(releases, targets)
            facts |= {"parameter_count": network.parameter_count, "hardware": hardware(where)}
            state = restore(folder, learner, facts, where)
            check_weights_are_there(folder, config, state)
            facts["steps_in_all"] = steps_in_all(len(pairs), config)
            made = Training(config, pairs, validation, folder, where, part, learner, state, facts)
            _run(made, minutes, progress, watch)
            return state


def _facts_of(releases: Sequence[Release], targets: Sequence[tuple[Release, Target]]) -> dict[str, object]:
    """Return the entries of training.json that describe the training pairs."""
    return {
        "benchmark_sha256": releases[0].benchmark_sha256,
        "further_benchmarks_sha256": tuple(release.benchmark_sha256 for release in releases[1:]),
        "framings": tuple(sorted({release.metadata.framing for release in releases})),
        "objects": tuple(sorted({target.object for _, target in targets})),
        "pairs": len(targets),
    }


def _check_shared(batch: int, processes: int) -> None:
    if batch % processes:
        raise SettingsError(
            f"training.batch: {batch} pairs cannot be shared by {processes} processes; choose a multiple"
        )


@contextmanager
def _deterministic(device: str) -> Iterator[None]:
    """Make torch deterministic within the block; on a GPU, warn of operations that are not deterministic."""
    kept = (
        torch.are_deterministic_algorithms_enabled(),
        torch.is_deterministic_algorithms_warn_only_enabled(),
        torch.backends.cudnn.benchmark,
        torch.utils.deterministic.fill_uninitialized_memory,
    )
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # else products on a GPU vary
    torch.use_deterministic_algorithms(True, warn_only=device != "cpu")
    torch.backends.cudnn.benchmark = False
    # Uninitialised memory is never read here, and filling it would cost 5 % of a step.
    torch.utils.deterministic.fill_uninitialized_memory = False
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(kept[0], warn_only=kept[1])
        torch.backends.cudnn.benchmark = kept[2]
        torch.utils.deterministic.fill_uninitialized_memory = kept[3]


def _run(
    training: Training, minutes: float | None, progress: Progress, watch: Callable[[TrainingRow], None] | None
) -> None:
    """Train until all steps are done or the time is over, and save the progress.

    The progress is also saved after an interrupt or a KinectBenchError; but not after a StepError or a
    PredictionError, which leave an incomplete step or useless weights.
    """
    config, state, device = training.config, training.state, training.device
    started = saved = time.monotonic()
    steps = range(state.step, training.steps)
    if (
        not steps
        and state.rows
        and state.rows[-1].step == state.step
        and (training.folder / WEIGHTS).exists()
    ):
        return
    try:
        _validate_if_due(training, watch)  # an earlier run may have stopped before validating
        for batch in batches(training.pairs, config, steps, device, training.part):
            with interrupts_held():  # a step is done completely or not at all
                before = time.monotonic()
                epoch = state.step * config.training.batch // len(training.pairs)
                state.add(_stepped(training, batch, epoch))
                state.seconds += time.monotonic() - before
            _validate_if_due(training, watch)
            progress(state.step, training.steps)
            now = time.monotonic()
            over = minutes is not None and now - started >= 60 * minutes
            if agreed(over, training.part[1], device):
                break
            if now - saved >= SAVE_EVERY_S:
                training.save()
                saved = time.monotonic()
    except (StepError, PredictionError):  # incomplete step, or useless weights: keep the last saved state
        raise
    except (KeyboardInterrupt, KinectBenchError):
        with interrupts_held():
            training.save()
        raise
    training.save()


def _stepped(training: Training, batch: Batch, epoch: int) -> Losses:
    """Run one step.

    Raises:
        StepError: memory is full, a loss or a weight is not finite, or another process has stopped.
    """
    step = training.state.step
    try:
        with _memory_errors_reported():
            return training.learner.step(batch, step, epoch, step / training.steps)
    except RuntimeError as error:
        if training.part[1] == 1:
            raise
        raise StepError(
            "another process of this training has stopped; run all again, it goes on from what was saved",
            what="process-stopped",
        ) from error


@contextmanager
def _memory_errors_reported() -> Iterator[None]:
    """Turn an out-of-memory error in the block, on the GPU or the CPU, into a StepError of one line."""
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        full = isinstance(error, MemoryError | torch.OutOfMemoryError)
        if not full and "allocate memory" not in str(error):  # torch's words on the CPU
            raise
        raise StepError(
            "memory is full; choose a smaller training.batch, or bfloat16", what="no-memory"
        ) from error


def _validate_if_due(training: Training, watch: Callable[[TrainingRow], None] | None) -> None:
    """Validate and add a row to the log, if this is due after the current step and not yet done.

    In the first process, `watch` is called with the row.
    """
    state, every = training.state, training.config.training.validate_every_steps
    due = state.step > 0 and (state.step % every == 0 or state.step == training.steps)
    if due and not (state.rows and state.rows[-1].step == state.step):
        row = _validate(training)
        if watch and training.part[0] == 0:
            watch(row)


def _validate(training: Training) -> TrainingRow:
    """Validate and add a row to the log; with `keep` = best, write the weights if their IoU is the best.

    An interrupt leaves everything unchanged; the validation is repeated when the training resumes.
    """
    config, state = training.config, training.state
    figures: dict[str, float] = {}
    if training.validation:
        with _memory_errors_reported():
            iou, threshold = validation_iou(
                training.learner.network, training.validation, config, training.device
            )
        figures = {"validation_iou": round(iou, 6), "threshold": threshold}
    with interrupts_held():
        better = bool(training.validation) and iou > state.best_iou
        kept = better and config.training.keep == "best"
        if better:
            state.best_iou, state.best_step = iou, state.step
            if kept and training.part[0] == 0:
                write_weights(arrays_of_network(training.learner.network), training.folder / WEIGHTS)
        count = state.sums.pop("steps")
        losses = {name: value / count for name, value in state.sums.items()}
        losses = mean_of_all(losses, training.part[1], training.device)
        state.sums.clear()
        epoch = round(state.step * config.training.batch / len(training.pairs), 6)
        row = TrainingRow(step=state.step, epoch=epoch, **losses, **figures)
        state.rows.append(row)
        if kept:  # a kill later must not leave the weights without their step and threshold
            training.save()
    return row
