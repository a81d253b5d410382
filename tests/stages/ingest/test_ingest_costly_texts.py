"""Texts of strangers that are small and cost much: keys that nobody reads, numbers without end, odd names."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bounds import within
from ingest_writers import depth_image, png, write_folder
from raising import raises
from test_ingest_phones_bop import bop, scanner_app

from kinectbench.core.errors import RecordingError
from kinectbench.core.trajectory.stamps import parse_stamp_ns
from kinectbench.core.trajectory.text_rows import MOST_ROWS, text_rows
from kinectbench.stages.ingest.json_values import FRAME_JSON_BYTES, json_numbers, number_of, object_of
from kinectbench.stages.ingest.readers import open_recording

CAMERA = {"fl_x": 60, "fl_y": 60, "cx": 32, "cy": 24, "w": 64, "h": 48}
NINES = "9" * 5000


def transforms(folder: Path, said: dict[str, Any], frames: list[dict[str, Any]]) -> Path:
    """A transforms.json beside one depth image, d.png, that every frame may name."""
    folder.mkdir()
    (folder / "d.png").write_bytes(png(depth_image(0, 1000.0)))
    (folder / "transforms.json").write_text(json.dumps({**CAMERA, **said, "frames": frames}))
    return folder


def test_keys_that_nobody_reads_do_not_multiply_with_frames(tmp_path: Path) -> None:
    count = 10_000
    folder = transforms(
        tmp_path / "r", {f"k{n}": 0 for n in range(count)}, [{"depth_file_path": "d.png"}] * count
    )
    with within(8, 100):
        assert len(open_recording(folder)) == count


@pytest.mark.parametrize("name", [f"{NINES}.png", "\ud800.png", "a" * 300, "a/" * 1000 + "b"])
@pytest.mark.parametrize("key", ["depth_file_path", "file_path"])
def test_names_that_no_file_can_have(name: str, key: str, tmp_path: Path) -> None:
    frames = [{"depth_file_path": "d.png"}, {"depth_file_path": "d.png", key: name}]
    with raises(RecordingError, "recording.link") as told:
        open_recording(transforms(tmp_path / "r", {}, frames))
    assert len(str(told.value).replace(str(tmp_path), "")) < 200


@pytest.mark.parametrize("model", [{"a": [0] * 10_000}, "x" * 10_000, NINES, 1e300])
def test_a_camera_model_of_any_type_is_quoted_in_short(model: Any, tmp_path: Path) -> None:
    folder = transforms(tmp_path / "r", {"camera_model": model}, [{"depth_file_path": "d.png"}])
    with raises(RecordingError, "recording.lens") as told:
        open_recording(folder)
    assert len(str(told.value).replace(str(tmp_path), "")) < 200


@pytest.mark.parametrize("index", [NINES, "²", "-1", "1.0", ""])
def test_a_log_that_names_no_frame(index: str, tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / "trajectory.log").write_text(f"{index or 'x'} 0 0\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    said = open_recording(folder).trajectory_error
    assert "does not name one of the" in said and len(said.replace(str(tmp_path), "")) < 250


def test_stamps_are_quoted_in_short() -> None:
    with pytest.raises(RecordingError) as told:
        parse_stamp_ns(NINES, "f, line 1")
    assert len(str(told.value)) < 200


@pytest.mark.parametrize("value", [10**400, -(10**400), "x" * 5000, [0] * 5000, {"a": "\x1b[2J"}, True, None])
def test_what_is_no_number_is_quoted_in_short(value: Any) -> None:
    with raises(RecordingError, "recording.malformed", match="number, not") as told:
        number_of(value, "f: 'w'")
    assert len(str(told.value)) < 120 and str(told.value).isprintable()
    assert json_numbers([value, 1]).shape in ((0,), (2,))


def test_json_of_strangers_is_bounded_by_its_values_too() -> None:
    assert np.isnan(object_of('{"T": [NaN, 1]}', "f", "T")["T"][0])
    with within(2, 50), raises(RecordingError, "recording.malformed", match="2000000"):
        object_of('{"a": [' + "[]," * 2_000_001 + "0]}", "f", "T")


CHANGES: dict[str, Callable[[dict[str, Any]], Any]] = {
    "time without end": lambda said: said.update(time=10**400),
    "time beyond 292 years": lambda said: said.update(time=1e300),
    "no time": lambda said: said.update(time=None),
    "a text": lambda said: said.update(time="soon"),
    "a list": lambda said: said.update(time=[1, 2]),
}


@pytest.mark.parametrize("name", CHANGES)
def test_times_of_phones_that_are_none(name: str, tmp_path: Path) -> None:
    folder = scanner_app(tmp_path / "r")
    file = sorted(folder.glob("frame_*.json"))[1]
    said = json.loads(file.read_text())
    CHANGES[name](said)
    file.write_text(json.dumps(said))
    assert any("frames are counted instead" in warning for warning in open_recording(folder).warnings)


def test_the_json_of_a_frame_is_bounded(tmp_path: Path) -> None:
    folder = scanner_app(tmp_path / "r")
    file = sorted(folder.glob("frame_*.json"))[1]
    file.write_text(file.read_text() + " " * FRAME_JSON_BYTES)
    with raises(RecordingError, "recording.unreadable", match="262144"):
        open_recording(folder)


def test_an_object_of_bop_whose_number_is_none(tmp_path: Path) -> None:
    folder = bop(tmp_path / "r")
    (folder / "mask_visib").mkdir(exist_ok=True)
    (folder / "scene_gt.json").write_text('{"0": [{"obj_id": 1e999}]}')
    with raises(RecordingError, "recording.malformed", match="obj_id"):
        open_recording(folder)
    (folder / "scene_gt.json").write_text(json.dumps({"0": [{"obj_id": n} for n in range(10_000)]}))
    assert max(map(len, open_recording(folder).warnings)) < 300


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_the_bound_on_lines_is_the_one_that_is_told(end: str, tmp_path: Path) -> None:
    path = tmp_path / "l.txt"
    path.write_bytes(f"1{end}".encode() * MOST_ROWS)
    assert len(text_rows(path)) == MOST_ROWS
    path.write_bytes(f"1{end}".encode() * (MOST_ROWS + 1))
    with raises(RecordingError, "recording.too-large", match="500000"):
        text_rows(path)
