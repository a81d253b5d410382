"""The hash of a prediction is that of the very file that was scored."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from blake3 import blake3
from raising import raises

from kinectbench.core.errors import PredictionError
from kinectbench.scoring import prediction_file
from kinectbench.scoring.prediction_file import load_hashed, load_prediction

VOXEL_M = 0.004
KINDS = pytest.mark.parametrize("kind", ["npy", "npz", "ply", "obj"])


def write_box(path: Path) -> None:
    """A prediction, in the form that its name says."""
    grid = np.zeros((16, 16, 16), np.float32)
    grid[4:9, 4:9, 4:9] = 1
    if path.suffix == ".npy":
        np.save(path, grid)
    elif path.suffix == ".npz":
        np.savez_compressed(path, grid)
    else:
        trimesh.creation.box(bounds=[[0.1, 0.2, 0.3], [0.5, 0.4, 0.9]]).export(path)


@KINDS
def test_the_hash_is_that_of_the_file_that_was_read(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"000.{kind}"
    write_box(path)
    loaded = load_hashed(path, "a/000", VOXEL_M)
    prediction, digest = loaded.prediction, loaded.digest
    assert digest == f"blake3:{blake3(path.read_bytes()).hexdigest()}"
    np.testing.assert_array_equal(prediction, load_prediction(path, "a/000", VOXEL_M))


@KINDS
@pytest.mark.parametrize("how", ["written to", "replaced"])
def test_a_file_that_changes_meanwhile_is_refused(
    kind: str, how: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"000.{kind}"
    write_box(path)
    loaded = prediction_file._loaded

    def changes(*of: Any) -> Any:
        found = loaded(*of)
        if how == "written to":
            with path.open("ab") as file:
                file.write(b" ")
        else:
            write_box(tmp_path / f"other.{kind}")
            (tmp_path / f"other.{kind}").replace(path)
        return found

    monkeypatch.setattr(prediction_file, "_loaded", changes)
    with raises(PredictionError, "prediction.changed", match="a/000"):
        load_hashed(path, "a/000", VOXEL_M)
