"""Predictions of a release's test pairs that are all the same: tiny grids of one value."""

from pathlib import Path

import numpy as np

from kinectbench.release.release import Release


def small_grids(release: Release, folder: Path, value: bool) -> Path:
    """Write a grid (2, 2, 2) of one value for each test pair; return the folder."""
    for target in release.split("test"):
        (folder / target.recording).mkdir(parents=True, exist_ok=True)
        np.save(folder / f"{target.name}.npy", np.full((2, 2, 2), value))
    return folder
