"""Colour in BMP and PPM is read as any other; of depth in EXR it is said how to convert it."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from ingest_writers import color_image, write_folder, write_tum
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.stages.ingest.images import DamagedImageError, decode_color_bgr
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import read_image_file


def test_a_list_of_depth_in_exr_says_how_to_convert_it(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    for file in [*folder.glob("depth/*.png")]:
        file.with_suffix(".exr").write_bytes(b"v/1\x01" + bytes(60))
    rows = folder / "depth.txt"
    rows.write_text(rows.read_text().replace(".png", ".exr"))
    said = r"EXR images are not read: write each as \.npy in metres.*OPENCV_IO_ENABLE_OPENEXR=1"
    with raises(RecordingError, "recording.no-frame", match=said):
        open_recording(folder)


@pytest.mark.parametrize("kind", [".bmp", ".ppm"])
@pytest.mark.parametrize("write", [write_folder, write_tum])
def test_colour_in_bmp_and_ppm_is_read(tmp_path: Path, write: Callable[[Path], Path], kind: str) -> None:
    folder = write(tmp_path / "r")
    for file in [*folder.glob("color/*.jpg"), *folder.glob("rgb/*.jpg")]:
        done, encoded = cv2.imencode(kind, color_image(int(file.stem)))
        assert done
        file.with_suffix(kind).write_bytes(encoded.tobytes())
        file.unlink()
    for rows in folder.glob("rgb.txt"):
        rows.write_text(rows.read_text().replace(".jpg", kind))
    recording = open_recording(folder)
    assert recording.color_registered and recording.warnings == ()
    for index in range(len(recording)):
        color = recording.frame(index).color
        assert color is not None and color[0] == ".png"
        assert np.array_equal(decode_color_bgr(color[1], "it"), color_image(index))
    damaged = next(folder.rglob(f"*{kind}"))
    whole = damaged.read_bytes()
    for data, said in ((whole[:99], "cannot be decoded"), (whole[:12], "head of the image is damaged")):
        damaged.write_bytes(data)
        with raises(DamagedImageError, "recording.damaged-image", match=said):
            read_image_file(damaged)
