"""The files of an object, its views and pairs: the same text comes back, and damage is told in one line."""

import json
from pathlib import Path

import numpy as np
import pytest
from raising import raises

from kinectbench.core.artefacts.object import (
    BoxPart,
    FloorFile,
    QualityFile,
    SynthesisedQualityFile,
    UnseenSidePart,
)
from kinectbench.core.artefacts.object_grids import Label, ObjectVolume, Surround
from kinectbench.core.artefacts.stored import Stored
from kinectbench.core.artefacts.views import PairsFile, ViewRow, ViewsFile
from kinectbench.core.errors import StorageError
from kinectbench.core.geometry import Grid, OrientedBox
from kinectbench.core.storage import pretty_json

EYE = np.eye(4).tolist()
VIEWS = {
    "format_version": 1,
    "color_registered": True,
    "views": [
        {"view": "000", "frame": 3, "stamp_ns": 5, "reason": "random", "T_world_camera": EYE, "blur": None},
        {"view": "001", "K": np.eye(3).tolist(), "width": 640, "height": 480, "pair": True},
    ],
    "refused": [{"frame": 1, "reason": "too few pixels"}],
    "warnings": [],
}
SYNTHESISED_VIEWS = {
    "format_version": 1,
    "order": "roll, pitch, yaw",
    "steps_per_turn": [1, 4, 8],
    "camera": {"width": 320, "height": 240, "fx": 300.0, "fy": 300.0, "cx": 159.5, "cy": 119.5},
    "views": [{"view": "000", "steps": [0, 0, 1], "angles_rad": [0.0, 0.0, 0.785], "T_world_camera": EYE}],
    "refused": [{"view": "001", "steps": [0, 1, 1], "angles_rad": [0.0, 1.5, 0.785], "reason": "cut"}],
}
PAIRS = {
    "format_version": 1,
    "pairs": [{"view": "000", "frame": 3, "containment": 1.0, "residual_m": 0.002, "cut_share": 0.0}],
    "refused": [{"view": "001", "frame": 4, "reason": "no depth"}],
}
FLOOR = {
    "format_version": 1,
    "plane_world": [0.0, 0.0, 1.0, -0.1],
    "T_floor_world": EYE,
    "noise_m": 0.001,
    "inlier_share": 0.5,
}
QUALITY = {
    "format_version": 1,
    "verdict": "good",
    "warnings": [],
    "surface_sigma_m": 0.0008,
    "box": {"center_m": [0.0, 0.1, 0.4], "size_m": [0.5, 0.5, 0.8], "yaw_rad": -0.7},
    "unseen_side": {"gap_deg": 7.8, "towards_deg": -9.8, "share": 0.0},
    "method": {"name": "carving", "free_by_noise": [0.1, 2.0], "of_a_newer_version": 3},
}


@pytest.mark.parametrize(
    ("model", "content"),
    [
        (ViewsFile, VIEWS),
        (ViewsFile, SYNTHESISED_VIEWS),
        (PairsFile, PAIRS),
        (FloorFile, FLOOR),
        (QualityFile, QUALITY),
        (
            SynthesisedQualityFile,
            {"verdict": "good", "method": "winding", "source": "a.obj", "faces": 12, "warnings": []},
        ),
    ],
)
def test_the_same_text_comes_back(model: type[Stored], content: dict[str, object], tmp_path: Path) -> None:
    (tmp_path / model.FILE).write_text(pretty_json(content))
    assert model.read(tmp_path).text() == pretty_json(content)


def test_what_is_unknown_is_written_and_what_is_absent_is_not() -> None:
    assert ViewRow(view="000", blur=None).json_value() == {"view": "000", "blur": None}


def test_the_word_about_the_underside_is_one_of_three_and_older_files_have_none() -> None:
    older = QualityFile.parse(json.dumps(QUALITY), "quality.json")
    assert (older.underside, older.underside_share) == (None, None)
    said = QUALITY | {"underside": "closed", "underside_share": 0.25}
    assert QualityFile.parse(json.dumps(said), "quality.json").json_value() == said
    with raises(StorageError, "storage.damaged", match=r"^quality\.json: 'underside': "):
        QualityFile.parse(json.dumps(QUALITY | {"underside": "shut"}), "quality.json")


def test_degrees_of_the_file_are_radians_in_memory() -> None:
    side = QualityFile.parse(json.dumps(QUALITY), "quality.json").unseen_side
    assert side is not None
    assert side.gap_rad == pytest.approx(np.radians(7.8))
    again = UnseenSidePart(gap_rad=side.gap_rad, towards_rad=side.towards_rad, share=0.0)
    assert again.json_value() == QUALITY["unseen_side"]


def test_a_box_comes_back_rounded() -> None:
    box = BoxPart.of(OrientedBox((0.00004, -1.23456, 0.4), (1.0, 2.0, 0.8), 0.123456), 4, 5).box()
    assert box == OrientedBox((0.0, -1.2346, 0.4), (1.0, 2.0, 0.8), 0.12346)


@pytest.mark.parametrize(
    ("model", "content", "part"),
    [
        (FloorFile, FLOOR | {"T_floor_world": np.eye(3).tolist()}, "'T_floor_world': "),
        (FloorFile, FLOOR | {"noise_m": "0.001"}, "'noise_m': "),
        (ViewsFile, VIEWS | {"views": [{"view": "../000"}]}, "'views.0.view': "),
        (ViewsFile, VIEWS | {"views": [{"view": "000", "frame": 1.5}]}, "'views.0.frame': "),
        (QualityFile, QUALITY | {"box": {"center_m": [0.0, 0.1]}}, "'box."),
        (PairsFile, {"format_version": 1}, "'pairs': "),
    ],
)
def test_what_is_wrong_is_named(
    model: type[Stored], content: dict[str, object], part: str, tmp_path: Path
) -> None:
    path = tmp_path / model.FILE
    path.write_text(pretty_json(content))
    with pytest.raises(StorageError) as error:
        model.read(tmp_path)
    assert str(error.value).startswith(f"{path}: {part}") and "\n" not in str(error.value)


def test_arrays_come_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    grid = Grid((4, 5, 6), 0.005, np.eye(4))
    labels = rng.integers(0, 5, grid.shape, dtype=np.uint8)
    ObjectVolume(grid, labels > 1, labels, rng.random(grid.shape).astype(np.float16), labels == 4).write(
        tmp_path
    )
    volume = ObjectVolume.read(tmp_path)
    assert volume.grid.shape == grid.shape and volume.grid.voxel_size_m == 0.005
    assert volume.solid.dtype == bool and volume.probability.dtype == np.float16
    assert np.array_equal(volume.labels, labels) and np.array_equal(volume.solid, labels > 1)
    Surround(grid, labels).write(tmp_path)
    assert np.array_equal(Surround.read(tmp_path).labels, labels)


def test_an_underside_that_nobody_saw_comes_back(tmp_path: Path) -> None:
    """A file of before there was one has none."""
    grid = Grid((4, 5, 6), 0.005, np.eye(4))
    labels = np.full(grid.shape, Label.INTERIOR, np.uint8)
    underside = np.arange(6) < np.full(grid.shape, 2)
    ObjectVolume(grid, labels > 1, labels, labels.astype(np.float16), underside).write(tmp_path)
    np.testing.assert_array_equal(ObjectVolume.read(tmp_path).underside, underside)
    with np.load(tmp_path / ObjectVolume.FILE) as archive:
        older = {name: archive[name] for name in archive.files if name != "underside"}
    np.savez(tmp_path / ObjectVolume.FILE, **older)
    again = ObjectVolume.read(tmp_path)
    assert again.underside.shape == grid.shape and again.underside.dtype == bool and not again.underside.any()


def test_damaged_arrays_are_told(tmp_path: Path) -> None:
    grid = Grid((4, 5, 6), 0.005, np.eye(4))
    labels = np.zeros((4, 5, 6), np.uint8)
    ObjectVolume(grid, labels[1:] > 1, labels, labels.astype(np.float16), labels == 4).write(tmp_path)
    with raises(StorageError, "storage.damaged", match=r"volume\.npz"):
        ObjectVolume.read(tmp_path)
    (tmp_path / "surround.npz").write_bytes(b"PK")
    with raises(StorageError, "storage.damaged", match=r"surround\.npz"):
        Surround.read(tmp_path)


@pytest.mark.parametrize("model", [ViewsFile, PairsFile, FloorFile, QualityFile])
def test_every_key_is_described(model: type[Stored]) -> None:
    schema = model.model_json_schema(mode="serialization")
    for part in (schema, *schema.get("$defs", {}).values()):
        assert all("description" in value for value in part["properties"].values()), part["title"]
