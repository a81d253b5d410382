"""Train one network in several processes, started by torchrun; each process takes a part of every batch."""

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, distributed, nn

from kinectbench.core import SettingsError, printable


def chosen_device(asked: str | None) -> str:
    """Return the requested device or, by default, the GPU if there is one, else the CPU.

    "cuda" becomes this process's GPU, "cuda:<LOCAL_RANK>".

    Raises:
        SettingsError: unknown device.
    """
    if asked is None:
        asked = "cuda" if torch.cuda.is_available() else "cpu"
    named = asked
    if asked == "cuda":
        asked = f"cuda:{os.environ.get('LOCAL_RANK', '0')}"
    try:
        torch.Generator(asked)
        # torch accepts any number after "cpu".
        if asked.startswith("cpu") and asked != "cpu":
            raise RuntimeError
    except (RuntimeError, AssertionError):
        raise SettingsError(
            f"--device {printable(named)}: torch has no such device here; leave the option out, or name one "
            "as torch does: cpu, cuda, cuda:1"
        ) from None
    return asked


@contextmanager
def joined_processes(device: str) -> Iterator[tuple[int, int]]:
    """Connect torchrun's processes within the block; yield (rank, number of processes), else (0, 1)."""
    rank, size = int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1"))
    if size == 1:
        yield 0, 1
        return
    if device.startswith("cuda"):
        torch.cuda.set_device(device)  # else the barriers of all ranks use the first GPU
    distributed.init_process_group("nccl" if device.startswith("cuda") else "gloo")
    try:
        yield rank, size
    finally:
        distributed.destroy_process_group()


def wait_for_all(size: int) -> None:
    """Wait until all `size` processes have called this function."""
    if size > 1:
        distributed.barrier()


def average_gradients(parameters: Iterable[nn.Parameter], size: int) -> None:
    """Average the gradients over all processes.

    Call it after `backward`. DistributedDataParallel is not used, because it does not support a gradient
    penalty.
    """
    if size == 1:
        return
    for values in parameters:
        if values.grad is not None:
            distributed.all_reduce(values.grad)
            values.grad /= size


def average_buffers(network: nn.Module, size: int) -> None:
    """Average a network's floating-point buffers, such as batch normalisation's, over processes."""
    if size == 1:
        return
    for values in network.buffers():
        if values.is_floating_point():
            distributed.all_reduce(values)
            values /= size


def mean_of_all(values: dict[str, float], size: int, device: str) -> dict[str, float]:
    """Return the mean of each value over the processes."""
    if size == 1:
        return values
    summed = torch.tensor([*values.values()], dtype=torch.float64, device=device)
    distributed.all_reduce(summed)
    return dict(zip(values, (summed / size).tolist(), strict=True))


def agreed(value: bool, size: int, device: str) -> bool:
    """Return the value of the first process, in every process."""
    if size == 1:
        return value
    tensor: Tensor = torch.tensor(int(value), device=device)
    distributed.broadcast(tensor, 0)
    return bool(tensor.item())
