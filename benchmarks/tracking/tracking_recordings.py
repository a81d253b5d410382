"""The recordings that the tracker is measured on: simulated once into a folder, or real; whole or in part."""

import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.errors import SettingsError
from kinectbench.core.sequence import FrameStore, Sequence
from kinectbench.core.trajectory.association import poses_at
from kinectbench.lab.simulate.presets import preset_spec
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.lab.simulate.truth import is_truth, truth_folder
from kinectbench.settings.models import TrackingSettings
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence

FAMILIES, SEEDS = ("chair", "table", "couch", "bench"), (1, 2, 3)
OBJECTS = tuple((family, seed) for seed in SEEDS for family in FAMILIES)
# A round and a bit every 250 frames, for as long as it takes.
LONG_FRAMES, ROUND_FRAMES = 2000, 250
ROUND_RAD, ROUND_SWINGS = 2.2 * np.pi, 1.6


@dataclass(frozen=True)
class Part:
    """Some frames of a sequence, with or without their colour.

    Attributes:
        whole: where they lie.
        frames: their indices.
        with_color: false: as if there were none.
    """

    whole: FrameStore
    frames: NDArray[np.int64]
    with_color: bool

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        return self.whole.depth_native(int(self.frames[index]))

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        return self.whole.color_encoded(int(self.frames[index])) if self.with_color else None


def part(sequence: Sequence, frames: NDArray[np.int64], *, with_color: bool = True) -> Sequence:
    """The sequence of some of the frames, ascending."""
    return replace(
        sequence,
        stamps_ns=sequence.stamps_ns[frames],
        color_registered=sequence.color_registered and with_color,
        frames=Part(sequence.frames, frames, with_color),
    )


def true_poses(sequence: Sequence) -> NDArray[np.float64]:
    """(n, 4, 4) T_world_camera by the trajectory that came with the recording; NaN where it has none."""
    assert sequence.given_trajectory is not None
    return poses_at(sequence.given_trajectory, sequence.stamps_ns, TrackingSettings().max_stamp_gap_s)


def object_spec(family: str, seed: int, preset: str) -> SimulationSpec:
    """One of the objects, recorded as a preset says."""
    changes = {"object": f"{family}:seed={seed}", "seed": seed, "save_depth": False}
    return preset_spec(preset, changes)


def long_spec() -> SimulationSpec:
    """Round after round about a chair; its beginnings are shorter recordings of the same kind."""
    rounds = LONG_FRAMES / ROUND_FRAMES
    path = {"frames": LONG_FRAMES, "arc_rad": ROUND_RAD * rounds, "swings": ROUND_SWINGS * rounds}
    changes = {"object": "chair:seed=1", "seed": 1, "save_depth": False, "path": path}
    return preset_spec("orbit-v1", changes)


def simulated(spec: SimulationSpec, path: Path) -> Path:
    """Simulate a recording, if it does not lie there already.

    Raises:
        SettingsError: another recording lies there.
        StorageError: it cannot be written.
    """
    truth = truth_folder(path)
    if not is_truth(truth):
        simulate(spec, path)
    # save_depth changes what is kept of the truth, not the recording
    said = {**json.loads((truth / "truth.json").read_text())["spec"], "save_depth": spec.save_depth}
    if said != spec.model_dump(mode="json"):
        raise SettingsError(f"{path}: holds another recording than is asked for; delete it and its .truth")
    return path


@contextmanager
def ingested(path: Path) -> Iterator[Path]:
    """A recording as a build ingests it, in a temporary folder.

    Raises:
        RecordingError: it cannot be read.
    """
    with tempfile.TemporaryDirectory(prefix="kinectbench-") as folder:
        write_sequence(open_recording(path), Path(folder))
        yield Path(folder)


def sequence_in(
    folder: Path, stride: int = 1, first: int | None = None, *, with_color: bool = True
) -> Sequence:
    """An ingested sequence, or the first or every n-th of its frames."""
    sequence = read_sequence(folder)
    return part(sequence, np.arange(len(sequence))[:first:stride], with_color=with_color)
