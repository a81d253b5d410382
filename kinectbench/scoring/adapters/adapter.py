"""An adapter writes the input files of a published method, and reads the method's output."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinectbench.core import PredictionError, listed_paths
from kinectbench.core.types import Float64
from kinectbench.release.exchange.rgbd import WriteView
from kinectbench.scoring.camera_shape import CameraShape

# At most so many files are read from the folder of one view (chosen here).
MOST_FILES = 1000


@dataclass(frozen=True)
class Adapter:
    """Input and output of one method.

    Attributes:
        write: writes the method's input files for a view; returns the view as written, and keys for
            camera.json, among them `T_camera_method` (4, 4).
        output: name of the file that the method writes for a view; `*` is a wildcard.
        read: reads that file; returns the shape in the method's own frame, which `T_camera_method` of
            camera.json maps to the camera; raises PredictionError, ValueError or one of `UNREADABLE`.
        form: what the method predicts: mesh, points or voxels.
        inputs: the images that the method reads, some of "color", "depth", "mask".
        module: the package that `write` needs beyond the extra `build`; "" if none.
    """

    write: WriteView
    output: str
    read: Callable[[Path], CameraShape]
    form: str
    inputs: tuple[str, ...]
    module: str = ""


def find_output(folder: Path, pattern: str) -> Path | None:
    """Return a method's output file in the folder of a view; None if there is none.

    Raises:
        PredictionError: the folder has several output files.
        OSError: the folder cannot be listed, or holds more than `MOST_FILES` files.
    """
    if not folder.is_dir():
        return None
    files = sorted(path for path in listed_paths(folder, MOST_FILES) if path.match(pattern))
    if len(files) > 1:
        raise PredictionError(f"{files[0].name} and {files[1].name} are there; keep one")
    return files[0] if files else None


def scaling(scale: float) -> Float64:
    """Return the (4, 4) similarity that scales uniformly, without rotation and translation."""
    return np.diag([scale, scale, scale, 1.0])
