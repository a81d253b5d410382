"""A person's masks of frames: each belongs to the frame whose number is its name."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from raising import raises

from kinectbench.core.errors import SegmentationError
from kinectbench.core.own_pixels import Masks
from kinectbench.engine.frame_masks import _of_folder


def masks_of(folder: Path, names: tuple[str, ...]) -> Masks:
    folder.mkdir()
    for name in names:
        image = np.full((4, 6), 255, np.uint8) if name.lower().endswith("png") else np.zeros((2, 2), np.uint8)
        data = cv2.imencode(".png", image)[1].tobytes() if name.lower().endswith("png") else b"x"
        (folder / name).write_bytes(data)
    sequence: Any = type("Frames", (), {"__len__": lambda _: 9})()
    sequence.camera = SimpleNamespace(height=4, width=6)
    return _of_folder(folder, sequence)


@pytest.mark.parametrize("beside", ["000003.txt", "3.xml", "000003.json", "notes.png", "³.png"])
@pytest.mark.parametrize("own", ["000003.png", "3.PNG"])
def test_what_lies_beside_a_mask_takes_nothing_from_it(own: str, beside: str, tmp_path: Path) -> None:
    mask = masks_of(tmp_path / "masks", (own, beside))(3)
    assert mask is not None and mask.all()


@pytest.mark.parametrize("names", [("3.png", "003.png"), ("000003.png", "000003.PNG")])
def test_two_masks_of_one_frame_are_refused_by_name(names: tuple[str, ...], tmp_path: Path) -> None:
    with raises(SegmentationError, "segmentation.bad-mask") as told:
        masks_of(tmp_path / "masks", names)
    assert all(name in str(told.value) for name in names)


@pytest.mark.parametrize("kind", ["include", "exclude"])
@pytest.mark.parametrize("name", ["3.{}.png", "000003.{}.png", "frame_000003.{}.PNG"])
def test_a_part_of_a_mask_is_refused(name: str, kind: str, tmp_path: Path) -> None:
    with raises(SegmentationError, "segmentation.bad-mask") as told:
        masks_of(tmp_path / "masks", ("000003.png", name.format(kind)))
    assert str(told.value).endswith(f"name the whole mask {name.replace('.{}', '')}")


@pytest.mark.parametrize("name", [f"{'9' * 200}.png", "000009.png", "3.jpg"])
def test_names_of_no_frame(name: str, tmp_path: Path) -> None:
    with raises(SegmentationError, "segmentation.no-masks"):
        masks_of(tmp_path / "masks", (name,))
