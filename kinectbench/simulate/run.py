"""Simulated recordings from the words of the command line."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from kinectbench.errors import SettingsError
from kinectbench.simulate.presets import preset_spec
from kinectbench.simulate.samples import make_demo, make_samples
from kinectbench.simulate.simulate import simulate

Progress = Callable[[str, int, int], None]


def simulate_named(
    out: Path | None,
    preset: str,
    changes: dict[str, Any],
    overrides: Sequence[str],
    samples: Path | None,
    demo: Path | None,
    progress: Progress,
) -> list[Path]:
    """Write one recording, or the sample recordings, or the demo's.

    Args:
        out: one recording: a ROS 1 bag if it ends in .bag, else a TUM folder, if no format is asked for.
        preset: of that one, such as "orbit-v1".
        changes: of that one, nested values as in SimulationSpec.
        overrides: of that one, `section.key=value`.
        samples: folder for the sample recordings.
        demo: folder for the demo's recordings.
        progress: told (recording, done, total).

    Returns:
        The recordings written.

    Raises:
        SettingsError: not just one of `out`, `samples` and `demo`; no such preset or furniture; a value out
            of range.
        RecordingError: the mesh cannot be used.
        StorageError: it cannot be written.
    """
    if sum(choice is not None for choice in (out, samples, demo)) != 1:
        raise SettingsError("simulate: give one of OUT, --samples FOLDER and --demo FOLDER")
    if samples is not None:
        return make_samples(samples, progress)
    if demo is not None:
        return make_demo(demo, progress)
    assert out is not None
    if out.suffix == ".bag":
        changes = {"format": "bag", **changes}
    spec = preset_spec(preset, changes, overrides)
    simulate(spec, out, lambda done, total: progress(out.name, done, total))
    return [out]
