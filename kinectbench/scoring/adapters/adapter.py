"""An adapter: a writer of a method's input files, and a reader of its output."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinectbench.core.errors import PredictionError
from kinectbench.core.types import Float64
from kinectbench.core.untrusted import listed_paths
from kinectbench.release.exchange.rgbd import ViewCamera, WriteView
from kinectbench.scoring.camera_shape import CameraShape

# Files in the folder of one view that are looked at (chosen here).
MOST_FILES = 1000


@dataclass(frozen=True)
class Adapter:
    """Input and output of one method.

    Attributes:
        write: the files that its own loader reads, and `T_camera_method` for camera.json.
        output: name of the file that it writes for a view; `*` stands for anything.
        read: from that file and camera.json to the shape in the frame that `T_camera_method` maps from;
            it raises PredictionError, ValueError or one of `UNREADABLE`.
        form: of its predictions: mesh, points or voxels.
        inputs: its inputs.
        module: that `write` needs beyond the extra `build`; "" if none.
    """

    write: WriteView
    output: str
    read: Callable[[Path, ViewCamera], CameraShape]
    form: str
    inputs: tuple[str, ...]
    module: str = ""


def find_output(folder: Path, pattern: str) -> Path | None:
    """A method's output file in the folder of a view; None if there is none.

    Raises:
        PredictionError: there are several.
    """
    if not folder.is_dir():
        return None
    files = sorted(path for path in listed_paths(folder, MOST_FILES) if path.match(pattern))
    if len(files) > 1:
        raise PredictionError(f"{files[0].name} and {files[1].name} are there; keep one")
    return files[0] if files else None


def scaling(scale: float) -> Float64:
    """The (4, 4) similarity that scales alone."""
    return np.diag([scale, scale, scale, 1.0])
