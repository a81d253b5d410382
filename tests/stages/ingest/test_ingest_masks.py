"""Masks that come with a recording, in each layout that has a place for them."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from read_pictures import read_picture

from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.lab.simulate.truth import truth_folder
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.images import DamagedImageError
from kinectbench.stages.ingest.readers import open_recording

FRAMES = 3


def recorded(folder: Path, layout: str, **path: object) -> Path:
    spec = {
        "object": "mug:seed=0",
        "format": layout,
        "path": {"frames": FRAMES, "rate_hz": 1.0, "arc_rad": 1.0, **path},
        "sensor": {"model": "ideal", "width": 64, "height": 48},
        "given": {"masks": True},
    }
    simulate(SimulationSpec.model_validate(spec), folder)
    return folder


def true_mask(recording: Path, index: int) -> np.ndarray:
    image = read_picture(truth_folder(recording) / "masks" / f"{index:06d}.png", cv2.IMREAD_GRAYSCALE)
    return np.asarray(image) > 0


@pytest.mark.parametrize("layout", ["tum", "folder", "bop", "wildrgbd"])
def test_masks_are_those_of_their_frames(layout: str, tmp_path: Path) -> None:
    recording = recorded(tmp_path / "mug", layout)
    opened = open_recording(recording, CameraSettings())
    for index in range(FRAMES):
        mask = opened.frame(index).mask
        assert mask is not None
        assert mask.any()
        assert (mask == true_mask(recording, index)).all()


def test_masks_by_hand_beside_a_tum_folder(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "mug", "tum")
    shutil.rmtree(recording / "masks")
    opened = open_recording(recording, CameraSettings())
    assert [opened.frame(index).mask for index in range(FRAMES)] == [None] * FRAMES
    (recording / "masks").mkdir()
    depth = sorted((recording / "depth").iterdir())
    cv2.imwrite(str(recording / "masks" / depth[1].name), true_mask(recording, 1).astype(np.uint8))
    masks = [open_recording(recording, CameraSettings()).frame(index).mask for index in range(FRAMES)]
    assert masks[0] is None
    assert masks[2] is None
    assert masks[1] is not None
    assert (masks[1] == true_mask(recording, 1)).all()


@pytest.mark.parametrize("layout", ["tum", "folder"])
def test_masks_of_no_frame_are_named(layout: str, tmp_path: Path) -> None:
    recording = recorded(tmp_path / "mug", layout)
    (first, *_) = sorted((recording / "masks").iterdir())
    assert not any("masks" in line for line in open_recording(recording, CameraSettings()).warnings)
    shutil.copy(first, recording / "masks" / "000999.png")
    (line,) = (line for line in open_recording(recording, CameraSettings()).warnings if "masks" in line)
    assert "1 mask is of no frame, such as 000999.png" in line


def test_masks_of_another_kind_or_size_are_named(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "mug", "folder")
    for mask in sorted((recording / "masks").iterdir()):
        image = read_picture(mask, cv2.IMREAD_GRAYSCALE)
        assert cv2.imwrite(str(mask), cv2.resize(image, (128, 96)))
    with pytest.raises(DamagedImageError, match="its size is not that of the depth image") as error:
        open_recording(recording, CameraSettings()).frame(0)
    assert error.value.advice == "masks lie on depth's pixels, 64x48: draw or scale them so"
    for mask in sorted((recording / "masks").iterdir()):
        mask.rename(mask.with_suffix(".jpg"))
    (line,) = (line for line in open_recording(recording, CameraSettings()).warnings if "masks" in line)
    assert "3 masks are no PNG, such as 000000.jpg: write it as PNG" in line


@pytest.mark.parametrize("kind", [".npy", ".jpg"])
def test_other_files_of_a_mask_that_is_read_are_not_named(tmp_path: Path, kind: str) -> None:
    recording = recorded(tmp_path / "mug", "folder")
    for mask in sorted((recording / "masks").iterdir()):
        mask.with_suffix(kind).touch()
    assert not any("masks" in line for line in open_recording(recording, CameraSettings()).warnings)
    (recording / "masks/000002.png").rename(recording / "masks/000999.png")
    (recording / "masks/other.tiff").touch()
    said = [line for line in open_recording(recording, CameraSettings()).warnings if "masks" in line]
    assert [line.partition("masks: ")[2] for line in said] == [
        "2 masks are of no frame, such as 000999.png: name each as its depth image is named, as PNG",
        f"1 mask is no PNG, such as 000002{kind}: write it as PNG",
    ]


@pytest.mark.parametrize("moves", ["turntable", "hand"])
def test_around_what_moves_nothing_does(moves: str, tmp_path: Path) -> None:
    recording = recorded(tmp_path / "mug", "folder", moves=moves)
    opened = open_recording(recording, CameraSettings())
    frames = [opened.frame(index) for index in range(FRAMES)]
    # Beside the silhouettes there is the arm; above them only what stands around.
    top = min(int(np.argmax(true_mask(recording, index).any(axis=1))) for index in range(FRAMES))
    assert top > 2
    for frame in frames[1:]:
        assert (frame.depth[: top - 1] == frames[0].depth[: top - 1]).all()
        assert (frame.depth != frames[0].depth).any()
    given = opened.given_trajectory
    assert given is not None
    assert (given.T_world_camera == given.T_world_camera[0]).all()
    # The truth is the camera's way about the object.
    T_true = np.load(truth_folder(recording) / "frames.npz")["T_world_camera"]
    assert np.linalg.norm(T_true[-1, :3, 3] - T_true[0, :3, 3]) > 0.2
