"""The recordings of the sample benchmark and of the demo, each made with one call."""

from collections.abc import Callable
from pathlib import Path

from kinectbench.simulate.simulate import SimulationSpec, simulate

# `kinectbench simulate --samples recordings` makes these two again, bit for bit.
SAMPLES: dict[str, SimulationSpec] = {
    "chair_01": SimulationSpec("chair", 10, frames=72, format="tum", world="upright"),
    "table_01.bag": SimulationSpec("table", 2, frames=72, format="bag", world="first_camera"),
}

# `kinectbench simulate --demo demo/recordings` makes these four.
DEMO: dict[str, SimulationSpec] = {
    "chair_02": SimulationSpec("chair", 9, frames=60, format="tum", world="first_camera"),
    "table_02.bag": SimulationSpec("table", 1, frames=60, format="bag", world="upright"),
    "chair_03.bag": SimulationSpec("chair", 3, frames=60, format="bag", world="random"),
    "table_03": SimulationSpec("table", 11, frames=60, format="tum", world="random"),
}

Progress = Callable[[str, int, int], None]


def make_samples(out: Path, progress: Progress = lambda name, done, total: None) -> list[Path]:
    """Write the sample recordings and their truth into the folder `out`; returns the recordings' paths.

    Args:
        out: the folder.
        progress: told (recording, frames done, frames in all).

    Raises:
        StorageError: they cannot be written.
    """
    return _make(SAMPLES, out, progress)


def make_demo(out: Path, progress: Progress = lambda name, done, total: None) -> list[Path]:
    """Write the demo's recordings and their truth into the folder `out`; like `make_samples`."""
    return _make(DEMO, out, progress)


def _make(specs: dict[str, SimulationSpec], out: Path, progress: Progress) -> list[Path]:
    paths = []
    for name, spec in specs.items():

        def tell(done: int, total: int, name: str = name) -> None:
            progress(name, done, total)

        simulate(spec, out / name, tell)
        paths.append(out / name)
    return paths
