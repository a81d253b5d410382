"""Depth in PGM and PFM, as OpenCV, libfreenect and ZED's SDK write them."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from ingest_writers import HEIGHT, WIDTH, depth_image, write_folder
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.stages.ingest.depth_files import depth_size_px
from kinectbench.stages.ingest.images import DamagedImageError, OddImageError
from kinectbench.stages.ingest.netpbm import HEAD_BYTES, decode_netpbm
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import write_sequence

MM = depth_image(1, 1000.0)
METRES = (MM / 1000).astype(np.float32)
VALUES = MM.astype(">u2").tobytes()


def encoded(suffix: str, mm: np.ndarray) -> bytes:
    array = mm if suffix == ".pgm" else (mm / 1000).astype(np.float32)
    return bytes(cv2.imencode(suffix, array)[1])


def recorded(folder: Path, suffix: str, cut: int | None = None) -> Path:
    """A recording of 40 frames, the seventh of which is cut after so many bytes."""
    write_folder(folder, stems=[str(i) for i in range(40)])
    for i in range(40):
        (folder / f"depth/{i}.png").unlink()
        data = encoded(suffix, depth_image(i % 4, 1000.0))
        (folder / f"depth/{i}{suffix}").write_bytes(data[:cut] if i == 7 else data)
    return folder


@pytest.mark.parametrize(("suffix", "scale"), [(".pgm", 1000.0), (".pfm", 5000.0)])
def test_depth_is_read(tmp_path: Path, suffix: str, scale: float) -> None:
    recording = open_recording(recorded(tmp_path / "r", suffix))
    assert (len(recording), recording.depth_scale) == (40, scale)
    for i in range(4):
        found_m = recording.frame(i).depth / recording.depth_scale
        np.testing.assert_allclose(found_m, depth_image(i, 1000.0) / 1000, atol=0.0001)


@pytest.mark.parametrize(
    "data",
    [
        b"P5 # a comment 1 2\n# another\n%d\t%d\r\n65535\n" % (WIDTH, HEIGHT) + VALUES,
        b"P5\n%d %d 1023\n" % (WIDTH, HEIGHT) + VALUES + b"more",
    ],
)
def test_heads_with_comments_and_other_ranges(data: bytes) -> None:
    np.testing.assert_array_equal(decode_netpbm(data, "x.pgm"), MM)
    assert depth_size_px(data, "x.pgm") == (WIDTH, HEIGHT)


@pytest.mark.parametrize(("scale", "kind"), [(b"-1.0", "<f4"), (b"1", ">f4"), (b"-0.003922", "<f4")])
def test_the_sign_of_the_scale_is_the_order_of_bytes(scale: bytes, kind: str) -> None:
    data = b"Pf\n%d %d\n" % (WIDTH, HEIGHT) + scale + b"\n" + METRES[::-1].astype(kind).tobytes()
    np.testing.assert_array_equal(decode_netpbm(data, "x.pfm"), METRES)


@pytest.mark.parametrize(
    ("data", "error", "words"),
    [
        (b"P5", DamagedImageError, "head of the image is damaged"),
        (b"P5\n5 " + b"#" * HEAD_BYTES + b"\n5 65535\n" + VALUES, DamagedImageError, "head of the image"),
        (b"Pf\n5 5 1e999\n" + VALUES, DamagedImageError, "head of the image"),
        (b"Pf\n5 5 0\n" + VALUES, DamagedImageError, "head of the image"),
        (b"Pf\n5 5 -.-\n" + VALUES, DamagedImageError, "head of the image"),
        (b"P5\n999999 999999 65535\n", DamagedImageError, "more pixels than an image may have"),
        (b"P5\n0 5 65535\n" + VALUES, DamagedImageError, "empty or cut off"),
        (b"P5\n%d %d 65535\n" % (WIDTH, HEIGHT) + VALUES[:-1], DamagedImageError, "empty or cut off"),
        (b"P5\n%d %d 255\n" % (WIDTH, HEIGHT) + VALUES, OddImageError, "8-bit"),
        (b"P2\n%d %d 65535\n" % (WIDTH, HEIGHT), OddImageError, "is a text"),
        (b"PF\n%d %d -1\n" % (WIDTH, HEIGHT), OddImageError, "is in colour"),
    ],
)
def test_what_is_no_depth_is_refused(data: bytes, error: type[RecordingError], words: str) -> None:
    for read in (decode_netpbm, depth_size_px):
        with pytest.raises(error, match=words) as caught:
            read(data, "x.pgm")
        assert type(caught.value) is error


@pytest.mark.parametrize("suffix", [".pgm", ".pfm"])
@pytest.mark.parametrize("cut", [0, 1, 9, 60])
def test_a_damaged_image_is_left_out(tmp_path: Path, suffix: str, cut: int) -> None:
    (said,) = write_sequence(open_recording(recorded(tmp_path / "r", suffix, cut)), tmp_path / "out")
    assert "frame left out" in said and "PNG" not in said


def test_pictures_of_depth_are_refused(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "r", ".pgm")
    for file in (folder / "depth").iterdir():
        file.write_bytes(b"P5\n%d %d 255\n" % (WIDTH, HEIGHT) + bytes(WIDTH * HEIGHT))
    with raises(RecordingError, "recording.no-frame", match="8-bit.*not a picture of it"):
        write_sequence(open_recording(folder), tmp_path / "out")
