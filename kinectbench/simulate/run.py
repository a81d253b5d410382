"""Simulated recordings from the words of the command line."""

from collections.abc import Callable
from pathlib import Path

from kinectbench.errors import SettingsError
from kinectbench.simulate.furniture import parse_object
from kinectbench.simulate.samples import make_demo, make_samples
from kinectbench.simulate.simulate import SimulationSpec, simulate

Progress = Callable[[str, int, int], None]


def simulate_named(
    out: Path | None,
    object_name: str,
    frames: int,
    samples: Path | None,
    demo: Path | None,
    progress: Progress,
) -> list[Path]:
    """Write one recording, or the sample recordings, or the demo's.

    Args:
        out: one recording: a ROS 1 bag if it ends in .bag, else a TUM folder.
        object_name: of that one, such as "chair:seed=3".
        frames: of that one.
        samples: folder for the sample recordings.
        demo: folder for the demo's recordings.
        progress: told (recording, done, total).

    Returns:
        The recordings written.

    Raises:
        SettingsError: not just one of `out`, `samples` and `demo`; no such furniture; a value out of range.
    """
    if sum(choice is not None for choice in (out, samples, demo)) != 1:
        raise SettingsError("simulate: give one of OUT, --samples FOLDER and --demo FOLDER")
    if samples is not None:
        return make_samples(samples, progress)
    if demo is not None:
        return make_demo(demo, progress)
    assert out is not None
    name = parse_object(object_name)
    simulate(
        SimulationSpec(
            name.family, name.seed, frames=frames, format="bag" if out.suffix == ".bag" else "tum"
        ),
        out,
        lambda done, total: progress(out.name, done, total),
    )
    return [out]
