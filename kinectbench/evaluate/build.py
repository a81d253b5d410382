"""What kinectbench made of one recording, as far as it was built."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.errors import StorageError
from kinectbench.shape.object_model import ObjectModel
from kinectbench.tracking.trajectory import Trajectory
from kinectbench.views import View
from kinectbench.voxels.pair_file import Pair
from kinectbench.workspace import MANIFEST


@dataclass(frozen=True)
class Build:
    """The artefacts of a recording; None for a stage that was not built.

    Attributes:
        stamps_ns: (n,) int64, stamps of the sequence's frames.
        trajectory: a pose for each of them.
        model: the object, in the trajectory's world.
        views: the sampled views.
        valid_depth: of a view, the pixels (height, width) that measured something.
        pair_names: names of the views that became pairs.
        pair: one pair, by its view's name.
    """

    stamps_ns: NDArray[np.int64]
    trajectory: Trajectory | None
    model: ObjectModel | None
    views: tuple[View, ...] | None
    valid_depth: Callable[[View], NDArray[np.bool_]]
    pair_names: tuple[str, ...] | None
    pair: Callable[[str], Pair]


def read_build(folder: Path) -> Build:
    """Open `build/<recording>/`; images and pairs are read when asked for.

    A stage that was made from an earlier version of what it stands on counts as not built: it may be left
    over from a run with other settings.

    Raises:
        StorageError: nothing was built there, or an artefact is damaged.
    """
    from kinectbench.ingest.sequence_folder import read_sequence
    from kinectbench.shape.object_folder import read_object
    from kinectbench.tracking.trajectory_folder import read_trajectory
    from kinectbench.views_folder import read_views
    from kinectbench.voxels.pair_file import read_pair

    current = _current_folders(folder)

    def built(stage: str) -> bool:
        return stage in current

    def valid_depth(view: View) -> NDArray[np.bool_]:
        """Where the view has depth, (height, width) bool."""
        from kinectbench.report.images import read_gray

        path = folder / "views" / f"{view.name}.depth.png"
        try:
            return read_gray(path) > 0
        except OSError as error:
            raise StorageError(f"{path}: cannot be read ({error.strerror}); build the views again") from error

    if not built("sequence"):
        raise StorageError(f"{folder}: nothing was built there; run `kinectbench build`, or name build/<id>")
    stamps_ns = read_sequence(folder / "sequence").stamps_ns
    names = tuple(sorted(path.stem for path in (folder / "pairs").glob("*.npz")))
    return Build(
        stamps_ns=stamps_ns,
        trajectory=read_trajectory(folder / "trajectory", stamps_ns) if built("trajectory") else None,
        model=read_object(folder / "object") if built("object") else None,
        views=tuple(read_views(folder / "views")) if built("views") else None,
        valid_depth=valid_depth,
        pair_names=names if built("pairs") else None,
        pair=lambda name: read_pair(folder / "pairs" / f"{name}.npz"),
    )


def _current_folders(build: Path) -> set[str]:
    """Folders of the stages whose manifests name the inputs that lie there now (if they have manifests)."""
    from kinectbench.stages import STAGES

    fingerprints: dict[str, str | None] = {}
    current = set()
    for stage in STAGES:
        folder = build / stage.folder
        manifest = _manifest(folder)
        inputs = manifest.get("inputs", {})
        if folder.is_dir() and all(
            stage_input in fingerprints and inputs.get(stage_input) == fingerprints[stage_input]
            for stage_input in (stage.inputs if manifest else ())
        ):
            current.add(stage.folder)
            fingerprints[stage.name] = manifest.get("fingerprint")
    return current


def _manifest(folder: Path) -> dict[str, Any]:
    try:
        content = json.loads((folder / MANIFEST).read_text())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
