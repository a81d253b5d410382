"""The recordings of the sample benchmark and of the demo, each made with one call."""

from collections.abc import Callable
from pathlib import Path

from kinectbench.simulate.simulate import simulate
from kinectbench.simulate.spec import Format, SimulationSpec, WorldFrame


def _spec(name: str, frames: int, form: Format, world: WorldFrame) -> SimulationSpec:
    """A short, small recording: 320x240 at 5 Hz; its noise-free depth is left out to save space.

    Around tables the camera is held low, so that it sees what is under the top too.
    """
    low = {"elevation_rad": 0.2} if name.startswith("table") else {}
    values = {
        "object": name,
        "format": form,
        "world": world,
        "path": {"frames": frames, "rate_hz": 5.0, **low},
        "sensor": {"width": 320, "height": 240},
        "save_depth": False,
    }
    return SimulationSpec.model_validate(values)


# `kinectbench simulate --samples recordings` makes these two again, bit for bit.
SAMPLES: dict[str, SimulationSpec] = {
    "chair_01": _spec("chair:seed=7", 72, "tum", "upright"),
    "table_01.bag": _spec("table:seed=9", 72, "bag", "first_camera"),
}

# `kinectbench simulate --demo demo/recordings` makes these four.
DEMO: dict[str, SimulationSpec] = {
    "chair_02": _spec("chair:seed=9", 60, "tum", "first_camera"),
    "table_02.bag": _spec("table:seed=11", 60, "bag", "upright"),
    "chair_03.bag": _spec("chair:seed=33", 60, "bag", "random"),
    "table_03": _spec("table:seed=4", 60, "tum", "random"),
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
