"""An adapter writes the input files of a published method, and reads the method's output."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinectbench.core import PredictionError, listed_paths
from kinectbench.core.types import Float64
from kinectbench.release.exchange.rgbd import WriteView
from kinectbench.scoring.camera_shape import CameraShape

# Maximum number of files in the folder of one view (chosen here).
MOST_FILES = 1000


@dataclass(frozen=True)
class Adapter:
    """Input and output of one method.

    Attributes:
        write: function that writes the method's input files for a view. It returns the view as written, and
            entries for camera.json, among them `T_camera_method` (4, 4).
        output: name of the file that the method writes for a view; may contain the wildcard `*`.
        read: function that reads this file. It returns the shape in the method's own frame; `T_camera_method`
            in camera.json maps that frame to the camera. It raises PredictionError, ValueError or one of
            `UNREADABLE`.
        form: what the method predicts: mesh, points or voxels.
        inputs: the images that the method reads, a subset of "color", "depth", "mask".
        module: the package that `write` needs beside those of the extra `kinectbench[build]`; "" if none.
    """

    write: WriteView
    output: str
    read: Callable[[Path], CameraShape]
    form: str
    inputs: tuple[str, ...]
    module: str = ""


def find_output(folder: Path, pattern: str) -> Path | None:
    """Return the file in `folder` that matches `pattern` (`*` is a wildcard); None if there is none.

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
