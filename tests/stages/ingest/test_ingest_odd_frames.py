"""Depth in .npz files, and single frames of another kind: left out as damaged ones are, or named."""

import errno
import io
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from ingest_writers import HEIGHT, WIDTH, depth_image, jpeg, png, write_folder
from numpy.typing import NDArray
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.core.untrusted import read_plain
from kinectbench.doctor import Diagnosis, inspect
from kinectbench.stages.ingest.images import DamagedImageError
from kinectbench.stages.ingest.plausibility import FIND_DEPTH
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import FileRecording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence

MANY = tuple(map(str, range(24)))
Image = NDArray[np.generic]


def npy(array: Image) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def npz(**arrays: Any) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def metres(index: int) -> NDArray[np.float32]:
    return (depth_image(index, 1000.0) / 1000).astype(np.float32)


def recorded(folder: Path, suffix: str, images: list[bytes]) -> Path:
    """A plain folder whose depth images are these files."""
    write_folder(folder, MANY[: len(images)])
    for number, data in enumerate(images):
        (folder / f"depth/{number}.png").unlink()
        (folder / f"depth/{number}{suffix}").write_bytes(data)
    return folder


@pytest.mark.parametrize("others", [{}, {"depth": 1}, {"depth": 1, "confidence": 1}])
def test_depth_in_npz(tmp_path: Path, others: dict[str, int]) -> None:
    """The only image under any key, or the one that is called depth."""
    files = []
    for i in range(4):
        arrays: dict[str, Image] = {"K": np.eye(3)[0], "arr_0": metres(i)}
        if others:
            arrays = {"K": np.eye(3), **dict.fromkeys(others, np.ones((HEIGHT, WIDTH)))} | {
                "depth": metres(i)
            }
        files.append(npz(**arrays))
    recording = open_recording(recorded(tmp_path / "r", ".npz", files))
    for i in range(4):
        np.testing.assert_allclose(recording.frame(i).depth / recording.depth_scale, metres(i), atol=0.0006)


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"a": metres(0), "b": metres(1)}, r"0\.npz: holds 'a' \(\d+, \d+\), 'b' .*which one is depth"),
        ({"a": metres(0)[0]}, r"0\.npz: holds 'a' \(\d+,\): which one is depth"),
        ({"depth": np.array([{}], object)}, r"0\.npz: the \.npz file is damaged .*pickle"),
    ],
)
def test_npz_without_one_image_is_named_with_its_keys(
    tmp_path: Path, arrays: dict[str, Image], words: str
) -> None:
    folder = recorded(tmp_path / "r", ".npz", [npz(**arrays)] * 4)
    with raises(RecordingError, "recording.no-frame", match=words):
        open_recording(folder)
    assert "unreadable" in {found.name for found in inspect(folder)[0].findings}


ODD = {
    "one axis": (".npy", npy(metres(0)[0]), r"7\.npy: depth is float32 of shape \(\d+,\), not \(height"),
    "no bytes": (".npy", b"", r"7\.npy: the \.npy file is damaged \(the file is empty\)"),
    "another size": (".npy", npy(metres(0)[:-4]), r"7\.npy: depth is \d+x\d+, but the first frame's is"),
    "whole numbers": (
        ".npy",
        npy(depth_image(7, 1000.0)),
        r"7\.npy: holds whole numbers, but .*0\.npy holds floats: keep one kind",
    ),
    "8 bits": (".png", png(np.ones((HEIGHT, WIDTH), np.uint8)), r"7\.png: depth is 8-bit"),
    "small PNG": (".png", png(depth_image(0, 1000.0)[:-4]), r"7\.png: depth is \d+x\d+, but the first"),
}


def looked_over(folder: Path) -> tuple[Diagnosis, list[str]]:
    diagnosis = inspect(folder)[0]
    kinds = ("depth_format", "damaged_frames", "depth_sizes")
    return diagnosis, [found.severity for found in diagnosis.findings if found.name in kinds]


@pytest.mark.parametrize("name", ODD)
def test_a_frame_of_another_kind_is_left_out(tmp_path: Path, name: str) -> None:
    suffix, odd, words = ODD[name]
    right = [npy(metres(i)) if suffix == ".npy" else png(depth_image(i, 1000.0)) for i in range(24)]
    folder = recorded(tmp_path / "r", suffix, [*right[:7], odd, *right[8:]])
    (warning,) = write_sequence(open_recording(folder), tmp_path / "out")
    assert re.match(f"frame left out: .*{words}", warning)
    assert read_sequence(tmp_path / "out").recorded == (*range(7), *range(8, 24))
    diagnosis, severities = looked_over(folder)
    assert severities == ["warning"] and not diagnosis.stops


def test_the_unit_of_floats_is_that_of_the_first_image_that_measures(tmp_path: Path) -> None:
    images = [npy(np.zeros((HEIGHT, WIDTH), np.float32)), *(npy(1000 * metres(i)) for i in range(1, 8))]
    recording = open_recording(recorded(tmp_path / "r", ".npy", images))
    assert any("taken for millimetres" in warning for warning in recording.warnings)
    assert np.abs(recording.frame(5).depth / recording.depth_scale - metres(5)).max() < 2e-4
    empty = open_recording(recorded(tmp_path / "s", ".npy", [images[0]] * 5))
    with raises(RecordingError, "recording.empty-depth"):
        write_sequence(empty, tmp_path / "out")


def in_channels(depth: NDArray[np.uint16]) -> bytes:
    return png(np.dstack([depth & 255, depth >> 8, 0 * depth]).astype(np.uint8))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_another_kind_of_png_among_two_channels_is_refused(
    tmp_path: Path, dtype: type[np.unsignedinteger[Any]], channels: tuple[int, ...]
) -> None:
    rows = np.arange(HEIGHT, dtype=np.uint16)[:, None] * 20
    images = [in_channels(np.asarray(depth_image(i, 1000.0) + rows, np.uint16)) for i in range(3)]
    odd = np.ones((HEIGHT, WIDTH, *channels), dtype)
    recording = open_recording(recorded(tmp_path / "r", ".png", [*images, png(odd)]))
    if channels and dtype is np.uint8:
        assert recording.frame(3).depth[0, 0] == 257
        return
    with raises(RecordingError, "recording.other-image", match="8-bit channels"):
        recording.frame(3)


@pytest.mark.parametrize("first", [in_channels(0 * depth_image(0)), b""], ids=["empty", "damaged"])
def test_two_channels_are_those_of_the_first_image_that_measures(tmp_path: Path, first: bytes) -> None:
    rows = np.arange(HEIGHT, dtype=np.uint16)[:, None] * 20
    images = [np.asarray(depth_image(i, 1000.0) + rows, np.uint16) for i in range(8)]
    recording = open_recording(recorded(tmp_path / "r", ".png", [first, *map(in_channels, images[1:])]))
    np.testing.assert_array_equal(recording.frame(5).depth, images[5])


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".tiff", ".png"])
def test_a_picture_of_depth_in_8_bits_is_no_depth(tmp_path: Path, suffix: str) -> None:
    picture = np.tile(np.linspace(120, 250, WIDTH).astype(np.uint8), (HEIGHT, 1))
    encoded = {".npy": npy(picture), ".npz": npz(depth=picture), ".png": png(picture)}
    data = encoded.get(suffix) or bytes(cv2.imencode(".tiff", picture)[1])
    recording = open_recording(recorded(tmp_path / "r", suffix, [data] * 5))
    with raises(RecordingError, "recording.too-many-damaged", match="8-bit.*not a picture of it"):
        write_sequence(recording, tmp_path / "out")


@pytest.mark.parametrize(
    ("depth", "color", "kind"),
    [("{}-depth", "{}-color", ".png"), ("depth/{}", "color/{}", ".png"), ("depth/{}", "color/{}", ".tiff")],
)
def test_depth_of_a_frame_in_two_files_is_read_once(
    tmp_path: Path, depth: str, color: str, kind: str
) -> None:
    folder = write_folder(tmp_path / "r", MANY[:4])
    for i in range(4):
        image = cv2.imencode(kind, depth_image(i, 1000.0))[1]
        (folder / f"depth/{i}.png").unlink()
        (folder / f"{depth.format(i)}{kind}").write_bytes(bytes(image))
        (folder / f"{depth.format(i)}.npy").write_bytes(npy(metres(i)))
        (folder / f"color/{i}.jpg").rename(folder / f"{color.format(i)}.jpg")
    for name in ("depth", "color"):
        if "/" not in depth:
            (folder / name).rmdir()
    recording = open_recording(folder)
    assert isinstance(recording, FileRecording)
    assert (len(recording), all(place.color for place in recording.places)) == (4, True)
    assert len({place.depth.suffix for place in recording.places}) == 1
    assert "are not read: keep one kind" in recording.warnings[0]


@pytest.mark.parametrize("name", [name for name in ODD if name != "no bytes"])
def test_several_frames_of_another_kind_stop_build_and_inspect(tmp_path: Path, name: str) -> None:
    suffix, odd, words = ODD[name]
    right = [npy(metres(i)) if suffix == ".npy" else png(depth_image(i, 1000.0)) for i in range(24)]
    folder = recorded(tmp_path / "r", suffix, [*right[:7], odd, odd, *right[9:]])
    with raises(RecordingError, "recording.too-many-damaged", match=rf"{words}.*2 of 24") as error:
        write_sequence(open_recording(folder), tmp_path / "out")
    diagnosis, severities = looked_over(folder)
    assert severities == ["stops"] and diagnosis.stops
    assert str(error.value).endswith(diagnosis.findings[0].advice)


def test_colour_of_another_size_stops_build_and_inspect(tmp_path: Path) -> None:
    write_folder(tmp_path / "r", MANY)
    small = np.zeros((HEIGHT // 2, WIDTH // 2, 3), np.uint8)
    for number in range(7, 12):
        (tmp_path / f"r/color/{number}.jpg").write_bytes(jpeg(small))
    with raises(RecordingError, "recording.too-many-damaged", match="5 of 24") as error:
        write_sequence(open_recording(tmp_path / "r"), tmp_path / "out")
    diagnosis, _ = inspect(tmp_path / "r")
    (found,) = (found for found in diagnosis.findings if found.severity == "stops")
    assert "its colour is" in found.what and str(error.value).endswith(found.advice)
    assert "color_registered" in found.advice


@pytest.mark.parametrize("kind", ["empty-depth", "no-frame", "too-many-damaged"])
def test_a_fault_of_all_frames_gets_the_same_advice_of_build_and_inspect(tmp_path: Path, kind: str) -> None:
    """Depth without a measured pixel, cut off depth, and cut off colour."""
    folder = write_folder(tmp_path / "r", MANY)
    for file in (folder / ("color" if kind == "too-many-damaged" else "depth")).iterdir():
        empty = png(np.zeros((HEIGHT, WIDTH), np.uint16))
        file.write_bytes(empty if kind == "empty-depth" else file.read_bytes()[:60])
    with raises(RecordingError, f"recording.{kind}") as error:
        write_sequence(open_recording(folder), tmp_path / "out")
    diagnosis, _ = inspect(folder)
    found = diagnosis.findings[0]
    assert found.severity == "stops" and str(error.value).endswith(found.advice or found.what)
    assert (found.advice or found.what).endswith((FIND_DEPTH, DamagedImageError.advice))
    if kind == "too-many-damaged":
        assert (diagnosis.facts["frames_looked_at"], diagnosis.facts["frames_usable"]) == (len(MANY), 0)


def test_what_the_machine_cannot_read_now_is_no_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A read error of a disk ends the build, which is tried again; it leaves no frame out for ever."""
    recording = open_recording(write_folder(tmp_path / "r", MANY))

    def failing(path: Path, most_bytes: int) -> bytes:
        if path.stem == "7":
            raise OSError(errno.EIO, "Input/output error", str(path))
        return read_plain(path, most_bytes)

    monkeypatch.setattr("kinectbench.stages.ingest.recording.read_plain", failing)
    with raises(RecordingError, "recording.unreadable", match="Input/output error") as caught:
        write_sequence(recording, tmp_path / "out")
    assert isinstance(caught.value.__cause__, OSError)
