"""Colour in BMP and PPM is read as any other; of depth in EXR it is said how to convert it."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from ingest_writers import color_image, write_folder, write_tum
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.stages.ingest.color_pictures import as_png
from kinectbench.stages.ingest.depth_files import decode_depth_file, depth_size_px
from kinectbench.stages.ingest.images import DamagedImageError, OddImageError, decode_color_bgr
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import read_image_file


def test_a_list_of_depth_in_exr_says_how_to_convert_it(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    for file in [*folder.glob("depth/*.png")]:
        file.with_suffix(".exr").write_bytes(b"v/1\x01" + bytes(60))
    rows = folder / "depth.txt"
    rows.write_text(rows.read_text().replace(".png", ".exr"))
    said = r"EXR images are not read: write each as \.npy.*`OpenEXR\.File\(path.*pip install OpenEXR"
    with raises(RecordingError, "recording.no-frame", match=said):
        open_recording(folder)


def test_one_depth_image_in_exr_is_odd_not_damaged() -> None:
    for read in (decode_depth_file, depth_size_px):
        with raises(OddImageError, "recording.other-image", match="EXR images are not read"):
            read(b"v/1\x01" + bytes(60), "it.exr")


@pytest.mark.parametrize(("most", "kind"), [(100, "u1"), (255, "u1"), (1023, ">u2"), (65535, ">u2")])
def test_colour_in_ppm_is_scaled_by_its_largest_value(most: int, kind: str) -> None:
    values = np.array([0, most // 2, most, most], np.uint32)
    rgb = np.broadcast_to(values[None, :, None], (2, 4, 3)).astype(kind)
    pixels = decode_color_bgr(as_png(b"P6 4 2 %d\n" % most + rgb.tobytes(), "it"), "it")
    assert np.array_equal(pixels[1, :, 0], np.floor(values * 255 / most + 0.5))


@pytest.mark.parametrize("most", [b"0", b"65536", b"99999"])
def test_a_largest_value_that_no_ppm_has_is_damage(most: bytes) -> None:
    with raises(DamagedImageError, "recording.damaged-image", match="it: the head of the image is damaged"):
        as_png(b"P6 1 1 " + most + b"\n" + bytes(6), "it")


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
