"""Read checkpoint.pt, the state of a training in PyTorch's format. It is untrusted and may be damaged.

The network limits the file's size, and nothing is used before everything is checked.
"""

import pickle
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Self

import torch
from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator, model_validator
from torch import Tensor

from kinectbench.core import open_plain, size_of
from kinectbench.core.artefacts.benchmark import SHA256
from kinectbench.core.artefacts.method import TrainingRow
from kinectbench.core.zip_files import DAMAGED_ZIP, open_zip
from kinectbench.networks.network import Network
from kinectbench.networks.steps import Losses

# Exceptions that a damaged file may raise: torch unpickles in Python, where hostile bytes can raise anything.
DAMAGED = (
    *DAMAGED_ZIP,
    OSError,
    LookupError,
    TypeError,
    AttributeError,
    AssertionError,
    ArithmeticError,
    MemoryError,
    pickle.UnpicklingError,
)
PICKLE = "data.pkl"
# Size limits: a tensor's description takes some 300 bytes, a row of the log some 200.
TENSOR_BYTES, ROW_BYTES, SLACK_BYTES = 2 << 10, 1 << 10, 64 << 10
# Number of copies of each value: one in the network, two in Adam's state.
COPIES = 3
# A loss is a float32.
MOST_LOSS = float(torch.finfo(torch.float32).max)
ADAM = {"step", "exp_avg", "exp_avg_sq"}

Sha256 = Annotated[str, Field(pattern=SHA256)]
Count = Annotated[int, Field(ge=0)]
Positive = Annotated[float, Field(ge=0)]
LossName = Annotated[str, Field(pattern="^(loss|reconstruction|discriminator|steps)$")]


class _Checked(BaseModel):
    """Base of models that accept exactly their keys and types, without NaN or infinity."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, arbitrary_types_allowed=True)


class State(_Checked):
    """The progress of a training. Together with the learner's values, it determines all later steps.

    A stored one is validated with the training's total number of steps as pydantic's `context`.

    Attributes:
        step: number of finished steps.
        rows: rows of the log so far.
        sums: {name of a loss: its sum over the steps since the last row}, and under `steps` the number of
            these steps.
        best_iou: the best validation IoU so far, -1 before the first; `best_step` is its step, 0 before the
            first.
        seconds: time that the steps took so far, without validation and saving.
    """

    step: Count = 0
    rows: list[TrainingRow] = []
    sums: dict[LossName, float] = {}
    best_iou: Annotated[float, Field(ge=-1, le=1)] = -1.0
    best_step: Count = 0
    seconds: Positive = 0.0

    def add(self, losses: Losses) -> None:
        """Increment the number of finished steps, and add the step's losses to the sums."""
        self.step += 1
        for name, value in {**losses, "steps": 1.0}.items():
            self.sums[name] = self.sums.get(name, 0.0) + value

    @field_validator("step")
    @classmethod
    def _within(cls, step: int, info: ValidationInfo) -> int:
        if step > (info.context or 0):
            raise ValueError("more steps than the training has")
        return step

    @field_validator("rows", mode="before")
    @classmethod
    def _rows_fit_steps(cls, rows: object, info: ValidationInfo) -> object:
        if not isinstance(rows, list) or len(rows) > info.data.get("step", 0):
            raise ValueError("more rows than steps")
        return [TrainingRow.model_validate(row) for row in rows]

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        steps = [row.step for row in self.rows]
        if steps != sorted(set(steps)) or (steps and not 0 < steps[0] <= steps[-1] <= self.step):
            raise ValueError("rows that are not in order")
        losses = [loss for row in self.rows for loss in (row.loss, row.reconstruction, row.discriminator)]
        ious = [value for row in self.rows for value in (row.validation_iou, row.threshold)]
        if any(loss is not None and abs(loss) > MOST_LOSS for loss in losses):
            raise ValueError("a loss that is too large")
        if any(value is not None and not 0 <= value <= 1 for value in ious):
            raise ValueError("an IoU that is none")
        if self.best_step > self.step or not 0 <= self.sums.get("steps", 0) <= self.step:
            raise ValueError("more steps than were done")
        return self


class Checkpoint(_Checked):
    """The content of the file; `checked_state` and `set_values` check `state` and the tensors.

    Attributes:
        benchmarks_sha256: identities of the training releases, in order.
        config_sha256: hash of the configuration; older files lack it.
        network: values of the network by name.
        optimisers: state dictionaries of the optimisers; their settings are ignored in favour of the
            configuration's.
        state: progress of the training.
    """

    benchmarks_sha256: list[Sha256]
    config_sha256: Sha256 | None = None
    network: dict[str, Tensor]
    optimisers: list[dict[str, object]]
    state: dict[str, object]


def read_checkpoint(path: Path, network: Network, steps: int, device: str) -> Checkpoint:
    """Read an untrusted checkpoint.

    A file larger than the network needs is refused; the log has at most one row for each of the steps.

    Raises:
        DAMAGED: one of the exceptions in this tuple, if the file is missing, damaged, or of another kind.
    """
    shapes = network.state_dict()
    tensors = (COPIES + 1) * len(shapes)
    pickled = SLACK_BYTES + TENSOR_BYTES * tensors + ROW_BYTES * steps
    values = COPIES * sum(values.numel() * values.element_size() for values in shapes.values())
    most = values + pickled + TENSOR_BYTES * tensors
    with open_plain(path) as file:
        if size_of(file) > 2 * most:
            raise ValueError("larger than a checkpoint of this network")
        for entry in open_zip(file, tensors + 16, most).infolist():
            if entry.compress_type != zipfile.ZIP_STORED:  # torch writes only stored entries
                raise ValueError("packed")
            if entry.filename.endswith(PICKLE) and entry.file_size > pickled:
                raise ValueError("a course that is too long")
        file.seek(0)
        content = torch.load(file, map_location=device, weights_only=True)
    if not isinstance(content, dict):
        raise ValueError("no checkpoint")
    return Checkpoint.model_validate({**content, "network": dict(content["network"])})


def checked_state(checkpoint: Checkpoint, steps: int) -> State:
    """Check and return a checkpoint's progress; `steps` is the number of steps of the whole training.

    Raises:
        ValueError: no such training can have this state.
    """
    return State.model_validate(checkpoint.state, context=steps)


def set_values(
    checkpoint: Checkpoint, network: Network, optimisers: Iterable[torch.optim.Optimizer], step: int
) -> None:
    """Load the checkpoint's values into a network and its optimisers.

    Raises:
        ValueError, KeyError: the values are of another network, or impossible after `step` steps.
    """
    own = network.state_dict()
    if set(own) != set(checkpoint.network):
        raise ValueError("another network's")
    for name, values in checkpoint.network.items():
        _check(values, own[name], name.endswith("running_var"))
    pairs = list(zip(optimisers, checkpoint.optimisers, strict=True))
    for optimiser, stored in pairs:
        _check_adam(stored["state"], optimiser, step)
    network.load_state_dict(checkpoint.network)
    for optimiser, stored in pairs:
        settings = optimiser.state_dict()["param_groups"]
        optimiser.load_state_dict({"state": stored["state"], "param_groups": settings})
        _set_memory_layout(optimiser)


def _check_adam(state: object, optimiser: torch.optim.Optimizer, step: int) -> None:
    """Refuse an optimiser state that Adam cannot have after this many steps."""
    parameters = optimiser.param_groups[0]["params"]
    if not isinstance(state, dict) or not set(state) <= set(range(len(parameters))):
        raise ValueError("an optimiser of other parameters")
    for index, kept in state.items():
        if not isinstance(kept, dict) or set(kept) != ADAM:
            raise ValueError("another optimiser's")
        _check(kept["step"], torch.zeros(()), True)
        if kept["step"].item() > step:
            raise ValueError("an optimiser of more steps than were done")
        _check(kept["exp_avg"], parameters[index])
        _check(kept["exp_avg_sq"], parameters[index], True)


def _check(values: object, like: Tensor, positive: bool = False) -> None:
    """Refuse a value that is no finite tensor of `like`'s shape and dtype; if `positive`, also below 0."""
    if not isinstance(values, Tensor) or values.layout != torch.strided:
        raise ValueError("no tensor")
    if (values.shape, values.dtype) != (like.shape, like.dtype):
        raise ValueError("a tensor of another shape or kind")
    if not torch.isfinite(values).all() or (positive and bool((values < 0).any())):
        raise ValueError("values that no training leaves")


def _set_memory_layout(optimiser: torch.optim.Optimizer) -> None:
    """Give an optimiser's state the memory layout of its parameters, which it would have after training.

    Otherwise sums are rounded in another order, and the training continues differently.
    """
    for parameter, kept in optimiser.state.items():
        for name, values in kept.items():
            if isinstance(values, Tensor) and values.shape == parameter.shape:
                kept[name] = torch.empty_like(parameter).copy_(values)
