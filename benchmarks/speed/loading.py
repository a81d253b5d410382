"""What a pair costs whoever trains: milliseconds of the processor, and items a second with worker processes.

For each number of worker processes: items a second, and milliseconds of the processor an item, in the process
that trains and in the workers together. "CPU ms" is what reading alone takes; a DataLoader, also one without
workers, puts each item into a batch besides. "unpacked here": workers hand packed grids over, and the process
that trains unpacks them. "reduced to 64^3": a transform makes of each grid the share of 4^3 cells that are
set.

Beside plain numpy, which opens a pair file and unpacks the same arrays. Worker processes are those of torch's
DataLoader where torch is installed, else of `multiprocessing`, which copies each item once more.
"""

import argparse
import itertools
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from figures import Figure, arguments, run, stated

import kinectbench

GRIDS = ("partial", "full", "known")
HERE = "unpacked here"
SIDE = 64


def reduced(item: dict[str, Any]) -> list[np.ndarray]:
    """The grids of an item at 64^3, float32."""
    grids = []
    for name in GRIDS:
        block = len(item[name]) // SIDE
        parts = item[name].reshape((SIDE, block) * 3)
        grids.append(parts.mean(axis=(1, 3, 5), dtype=np.float32))
    return grids


WAYS: dict[str, dict[str, Any]] = {
    "packed": {"keys": GRIDS, "packed": True},
    HERE: {"keys": GRIDS, "packed": True},
    "unpacked": {"keys": GRIDS},
    "reduced to 64^3": {"keys": GRIDS, "transform": reduced},
    "default keys": {},
    "with images": {"keys": (*GRIDS, "depth", "mask")},
}
REPEATS = 10


def by_numpy(path: Path, packed: bool) -> list[np.ndarray]:
    """The three grids of a pair file, without a look at its SHA-256."""
    with np.load(path) as pair:
        grids = [pair[name] for name in GRIDS]
    return grids if packed else [np.unpackbits(grid, axis=-1).view(np.bool_) for grid in grids]


def cpu_ms(read: Callable[[int], object], count: int) -> float:
    """Median time of the processor to read one of `count` items, milliseconds."""
    took = []
    for index in itertools.islice(itertools.cycle(range(count)), REPEATS + 1):
        began = time.process_time()
        read(index)
        took.append((time.process_time() - began) * 1e3)
    return float(np.median(took[1:]))


def items(dataset: kinectbench.Dataset, workers: int) -> Iterator[Any]:
    """The items of a dataset over and over, read by so many processes; 0: by this one."""
    try:
        import torch
        from torch.utils.data import DataLoader
    except ImportError:
        indices = itertools.cycle(range(len(dataset)))
        if not workers:
            yield from map(dataset.__getitem__, indices)
        with multiprocessing.get_context("fork").Pool(workers) as pool:
            yield from pool.imap(dataset.__getitem__, indices)
    # Batches of one, as images differ in size; a batch is put together in shared memory, whatever its size.
    torch.set_num_threads(1)  # as in workers
    loader = DataLoader(dataset, num_workers=workers, persistent_workers=workers > 0)
    while True:
        yield from loader


def unpacked(item: Any) -> list[np.ndarray]:
    """The grids of an item, or of a batch of tensors."""
    return [np.unpackbits(np.asarray(item[name]), axis=-1).view(np.bool_) for name in GRIDS]


def workers_cpu_s() -> float:
    """Time of the processor that the processes started by this one have taken, seconds (Linux; proc(5))."""
    took = 0.0
    for child in multiprocessing.active_children():
        user, system = Path(f"/proc/{child.pid}/stat").read_text("utf-8").rsplit(")", 1)[1].split()[11:13]
        took += (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
    return took


def measured(
    dataset: kinectbench.Dataset, workers: int, seconds: float, unpack: bool
) -> tuple[float, float, float]:
    """Items a second once the processes are started; processor ms an item, here and in the workers."""
    stream = items(dataset, workers)
    for _ in range(2 + workers):
        next(stream)
    began, here_s, there_s, count = time.perf_counter(), time.process_time(), workers_cpu_s(), 0
    while time.perf_counter() - began < seconds:
        item = next(stream)
        if unpack:
            unpacked(item)
        count += 1
    rate = count / (time.perf_counter() - began)
    here_ms = (time.process_time() - here_s) / count * 1e3
    return rate, here_ms, (workers_cpu_s() - there_s) / count * 1e3


def measure(options: argparse.Namespace) -> list[Figure]:
    """A figure for each way to read, and for each number of workers."""
    figures = []
    for name, how in WAYS.items():
        dataset = kinectbench.load(options.benchmark, **how)
        read = (
            (lambda index, dataset=dataset: unpacked(dataset[index])) if name == HERE else dataset.__getitem__
        )
        figures.append(stated(f"{name}: CPU ms", cpu_ms(read, len(dataset))))
        for workers in options.workers:
            rate, here_ms, there_ms = measured(dataset, workers, options.seconds, name == HERE)
            figures += [
                stated(f"{name}, {workers} workers: items a second", rate),
                stated(f"{name}, {workers} workers: CPU ms here, in the workers", [here_ms, there_ms]),
            ]
    paths = [dataset.release.pair_path(target) for target in dataset.targets]
    for packed in (True, False) if paths[0].is_file() else ():
        took = cpu_ms(lambda index, packed=packed: by_numpy(paths[index], packed), len(paths))
        figures.append(stated(f"numpy, {'packed' if packed else 'unpacked'}: CPU ms", took))
    return figures


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("benchmark", type=Path)
    parser.add_argument("--seconds", type=float, default=5, help="of each measurement")
    parser.add_argument("--workers", type=int, nargs="+", default=[0, 1, 2])
    options = parser.parse_args()
    run(options, lambda: measure(options))


if __name__ == "__main__":
    main()
