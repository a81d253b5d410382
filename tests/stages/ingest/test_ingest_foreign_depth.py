"""Depth of kinds that are not read: each is named, with a line of Python that converts it."""

import gzip
import io
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from ingest_writers import HEIGHT, WIDTH, color_image, depth_image, jpeg, png

from kinectbench.core import untrusted
from kinectbench.core.errors import RecordingError
from kinectbench.stages.ingest.readers import foreign_depth, open_recording
from kinectbench.stages.ingest.readers.color_only import without_depth

MM = depth_image(0, 1000.0)
METRES = MM.astype(np.float32) / 1000


def saved(**arrays: np.ndarray) -> bytes:
    file, given = io.BytesIO(), dict[str, Any](arrays)
    np.savez(file, **given)
    return file.getvalue()


def rows(separator: str) -> bytes:
    return "\n".join(separator.join(map(str, row)) for row in MM.tolist()).encode()


# Kind -> the bytes of one image.
CONVERTED = {
    ".raw": MM.astype("<u2").tobytes(),
    ".bin": METRES.astype("<f4").tobytes(),
    ".csv": rows(","),
    ".txt": rows(" "),
}
NAMED = {
    ".h5": (b"\x89HDF\r\n\x1a\n", r"\.h5 is not read: .*h5py\.File"),
    ".mat": (b"MATLAB", r"\.mat is not read: .*scipy\.io\.loadmat"),
    ".exr": (b"v/1\x01", r"EXR images are not read.*`import OpenEXR, numpy; numpy\.save"),
    ".pkl": (b"\x80\x04", r"\.pkl is not read: write it as 16-bit PNG in mm"),
    ".ply": (b"ply\n", "clouds of points: export the depth images"),
    ".png.gz": (gzip.compress(png(MM)), r"\.gz is not read: unpack them"),
    ".bmp": (bytes(cv2.imencode(".bmp", MM.astype(np.uint8))[1]), "pictures in 8 bits"),
}


def folder_of(tmp_path: Path, pattern: str, data: bytes, color: str = "color/{:04d}.jpg") -> Path:
    for i in range(5):
        for name, content in ((pattern, data), (color, jpeg(color_image(i)))):
            file = tmp_path / "r" / name.format(i)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
    return tmp_path / "r"


def refused(path: Path) -> str:
    with pytest.raises(RecordingError) as error:
        open_recording(path)
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("kind", CONVERTED)
@pytest.mark.parametrize("pattern", ["depth/{:04d}", "Depth_raw/frame {:04d}", "cam/depth/{:04d}"])
def test_the_line_converts(tmp_path: Path, kind: str, pattern: str, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = folder_of(tmp_path, pattern + kind, CONVERTED[kind])
    said = refused(folder)
    assert f"{kind} is not read" in said and "record with a camera" not in said
    (line,) = re.findall("such as by `(.*?)`", said)
    monkeypatch.chdir(folder)
    Path("depth").mkdir(exist_ok=True)
    exec(line, {})
    (written,) = Path("depth").glob("*.npy")
    read = np.load(written)
    assert read.shape == MM.shape
    assert np.allclose(read, METRES if read.dtype == np.float32 else MM)


@pytest.mark.parametrize("kind", NAMED)
@pytest.mark.parametrize("pattern", ["depth/{:04d}", "depth_images/{:04d}", "{:04d}_depth"])
def test_kinds_without_a_line_are_named(tmp_path: Path, kind: str, pattern: str) -> None:
    data, words = NAMED[kind]
    said = refused(folder_of(tmp_path, pattern + kind, data))
    assert re.search(words, said) and "record with a camera" not in said


@pytest.mark.parametrize(
    ("pattern", "data", "words"),
    [
        (
            "scan_{:04d}.npz",
            saved(scan=METRES),
            "5 .npz files, such as scan_0000.npz, may be depth, but in no",
        ),
        ("data/d/{:04d}.tiff", bytes(cv2.imencode(".tiff", MM)[1]), "such as data/d/0000.tiff, may be depth"),
        ("scan_{:04d}.bin", CONVERTED[".bin"], f'"float32").reshape({HEIGHT}, {WIDTH})'),
        ("scan_{:04d}.h5", b"\x89HDF", "if its 5 .h5 files, such as scan_0000.h5, are depth, write"),
        ("scan_{:04d}.npz", saved(a=METRES, b=MM), "if its 5 .npz files, such as scan_0000.npz, are depth"),
    ],
)
def test_files_of_other_names_may_be_depth(tmp_path: Path, pattern: str, data: bytes, words: str) -> None:
    assert words in refused(folder_of(tmp_path, pattern, data, "scan_{:04d}.jpg"))


@pytest.mark.parametrize(
    "pattern", ["labels/{:04d}.txt", "{:04d}_depth_info.txt", "{:04d}.json", "s_{:04d}.bin"]
)
def test_other_files_beside_colour_are_no_depth(tmp_path: Path, pattern: str) -> None:
    said = refused(folder_of(tmp_path, pattern, b"0 0.5 0.5 1 1"))
    assert re.search(
        r"holds 5 colour images, but no depth that is read \([^)]*\): record with a camera", said
    )


@pytest.mark.parametrize("inside", ["data/d", "data/today/box"])
def test_16_bit_images_some_folders_below_are_found(tmp_path: Path, inside: str) -> None:
    said = refused(folder_of(tmp_path, f"{inside}/{{:04d}}.png", png(MM), "data/c/{:04d}.jpg"))
    assert f"{inside}/ holds 16-bit PNG images that look like depth (0000.png)" in said


def test_three_pictures_of_depth_among_many_of_colour_are_named(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "data/images/{:04d}.jpg", jpeg(color_image(0)))
    (folder / "data/depth_filtered").mkdir()
    for i in range(3):
        (folder / f"data/depth_filtered/depth{i}.png").write_bytes(png(MM.astype(np.uint8)))
    assert "its 3 images named depth, such as data/depth_filtered/depth0.png, are pictures" in refused(folder)


@pytest.mark.parametrize("name", ["it's", 'a"); raise SystemExit("', "back\\slash", "{f}", "x" * 200])
@pytest.mark.parametrize("kind", [".raw", ".csv"])
def test_the_line_holds_any_name_as_a_text(
    tmp_path: Path, name: str, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = folder_of(
        tmp_path, f"depth/{name.replace('{', '{{').replace('}', '}}')}{{}}{kind}", CONVERTED[kind]
    )
    (line,) = re.findall("such as by `(.*?)`", refused(folder))
    monkeypatch.chdir(folder)
    exec(line, {})
    assert np.load(f"depth/{name}0.npy").shape == MM.shape


def test_a_name_that_ends_the_line_has_none(tmp_path: Path) -> None:
    said = refused(folder_of(tmp_path, "depth/`touch x`{}.csv", CONVERTED[".csv"]))
    assert ".csv is not read: write it as" in said and "such as by" not in said


def test_each_folder_is_listed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [f"{i}{kind}" for kind in (".bin", ".raw", ".dat") for i in range(5)]
    for number in range(30):
        (tmp_path / f"r/{number}").mkdir(parents=True)
        for name in names:
            (tmp_path / f"r/{number}/{name}").touch()
    entries, scanned = list[str](), untrusted.scanned

    def counted(*arguments: Any) -> Iterator["os.DirEntry[str]"]:
        for entry in scanned(*arguments):
            entries.append(entry.name)
            yield entry

    for module in (untrusted, foreign_depth):
        monkeypatch.setattr(module, "scanned", counted, raising=False)
    assert without_depth(tmp_path / "r", ()) is None
    assert len(entries) == 30 * (1 + len(names))
    monkeypatch.setattr(foreign_depth, "MOST_ENTRIES", 100)
    entries.clear()
    assert without_depth(tmp_path / "r", ()) is None
    assert len(entries) <= 101


def test_the_size_of_colour_is_found_behind_other_files(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "depth/{:04d}.raw", np.zeros((HEIGHT, WIDTH + 1), np.uint16).tobytes())
    for file in (folder / "color").iterdir():
        file.unlink()
    for number in range(9):
        (folder / f"color/{number}.json").touch()
    (folder / "color/image.png").write_bytes(png(np.zeros((HEIGHT, WIDTH + 1), np.uint8)))
    assert f"reshape({HEIGHT}, {WIDTH + 1})" in refused(folder)


def test_links_below_the_folder_are_not_followed(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "more/{:04d}.txt", b"x")
    (tmp_path / "elsewhere/depth").mkdir(parents=True)
    for number in range(5):
        (tmp_path / f"elsewhere/depth/{number}.raw").write_bytes(CONVERTED[".raw"])
    assert ".raw is not read" in refused(tmp_path / "elsewhere")
    (folder / "link").symlink_to(tmp_path / "elsewhere")
    assert "holds 5 colour images, but no depth" in refused(folder)


def test_a_folder_that_cannot_be_read_is_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = folder_of(tmp_path, "closed/{:04d}.txt", b"x")
    scandir = os.scandir

    def closed(path: Any) -> Any:
        if Path(path).name == "closed":
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", closed)
    assert "holds 5 colour images, but no depth" in str(without_depth(folder, ()))
    with pytest.raises(PermissionError):
        without_depth(folder / "closed", ())


@pytest.mark.parametrize("kind", [".bag", ".mkv", ".sens", ".zip", ".db3.zstd"])
def test_damaged_files_of_kinds_that_are_read_are_not_called_unread(tmp_path: Path, kind: str) -> None:
    said = refused(folder_of(tmp_path, f"depth_{{}}{kind}", b"x" * 100))
    assert "is not read" not in said and "look like depth" not in said


@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize("further", [(), (-1,), (1,)])
def test_one_array_of_all_frames_is_named_with_a_line_that_divides_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, axis: int, further: tuple[int, ...]
) -> None:
    folder = tmp_path / "r"
    folder.mkdir()
    array = np.stack([depth_image(i, 1000.0) for i in range(6)], axis)
    np.save(folder / "depth.npy", np.expand_dims(array, further))
    with pytest.raises(RecordingError, match="holds 6 images in one array, which is not read") as error:
        open_recording(folder)
    (line,) = re.findall(r"such as by `([^`]*)`", str(error.value))
    monkeypatch.chdir(folder)
    exec(line, {})
    assert len(list((folder / "depth").iterdir())) == 6
    np.testing.assert_array_equal(np.load(folder / "depth/000003.npy").squeeze(), depth_image(3, 1000.0))


def test_an_array_of_many_upright_images_has_its_frames_first(tmp_path: Path) -> None:
    np.save(tmp_path / "depth.npy", np.zeros((400, 256, 192), np.uint8))
    assert "holds 400 images in one array" in str(without_depth(tmp_path, ()))


@pytest.mark.parametrize("shape", [(480, 640, 1), (480, 640), (4, 480, 640), (60, 80, 3), (60, 20, 80), (9,)])
def test_an_array_of_few_or_small_images_is_no_stack(tmp_path: Path, shape: tuple[int, ...]) -> None:
    np.save(tmp_path / "depth.npy", np.zeros(shape, np.uint8))
    assert "in one array" not in str(without_depth(tmp_path, ()))


@pytest.mark.parametrize(
    "said",
    [
        "{'descr': '<u2', 'fortran_order': False, 'shape': (1000000000000000000000, 10, 10), }",
        "{'descr': '<u2', 'fortran_order': False, 'shape': (60, 60, 60), }",
        "{'descr': '<u2', 'fortran_order': False, 'shape': (60, 60, 60",
        "{'descr': '''",
        "",
    ],
)
def test_a_damaged_header_is_no_internal_error(tmp_path: Path, said: str) -> None:
    text = said.encode() + b"\n"
    head = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text
    (tmp_path / "depth.npy").write_bytes(head + b"0" * 100)
    assert "in one array" not in str(without_depth(tmp_path, ()))
