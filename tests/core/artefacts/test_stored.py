"""A stored value is in the units of memory by a field's name, and in those of the file by its key."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from peak_memory import peak_mb
from pydantic import ValidationError
from raising import raises
from slow import slow

from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.artefacts.object import FloorFile
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.artefacts.trajectory import FrameHealth, TrajectoryHealth
from kinectbench.core.errors import PredictionError, StorageError

MOST_TEXT = 1_000_000  # characters
HEAD = {"source": "tracked", "verdict": "", "grade": "5 mm", "frames": 1, "tracked": 1}


def test_a_key_of_the_file_is_refused_in_memory() -> None:
    row = FrameHealth(frame=0, shift_m=0.005)
    assert row.json_value()["shift_mm"] == 5.0
    with pytest.raises(ValidationError, match="shift_mm: in the units of the file"):
        FrameHealth(frame=0, shift_mm=5.0)  # type: ignore[call-arg]
    with pytest.raises(ValidationError, match="shift_mm: in the units of the file"):
        FrameHealth.model_validate(row.json_value())


def test_a_file_is_in_its_own_units_and_keeps_what_it_does_not_know() -> None:
    content = {**HEAD, "per_frame": [{"frame": 0, "shift_mm": 5.0, "other_mm": 7.0}], "arc_deg": 90.0}
    health = TrajectoryHealth.parse(json.dumps(content), "here")
    assert health.per_frame[0].shift_m == 0.005
    assert health.arc_rad == pytest.approx(1.5707963)
    assert health.json_value()["per_frame"][0]["other_mm"] == 7.0
    assert TrajectoryHealth.parse(health.text(), "again") == health
    assert TrajectoryHealth.model_validate(health) == health


@pytest.mark.parametrize(
    ("older", "now"), [("5 mm", "good"), ("10 mm", "fair"), ("not good", "not good"), ("fair", "fair")]
)
def test_grades_of_older_files_are_read_by_their_names_of_today(older: str, now: str) -> None:
    assert TrajectoryHealth.parse(json.dumps({**HEAD, "grade": older}), "here").grade == now
    with raises(StorageError, "storage.damaged", match="grade"):
        TrajectoryHealth.parse(json.dumps({**HEAD, "grade": f"{older} "}), "here")


def test_rows_are_of_the_frames_and_none_twice() -> None:
    for frames in ([7], [-1], [0, 0]):
        content = {**HEAD, "per_frame": [{"frame": frame} for frame in frames]}
        with raises(StorageError, "storage.damaged", match="'per_frame'"):
            TrajectoryHealth.parse(json.dumps(content), "here")


def test_what_a_file_does_not_say_is_not_known() -> None:
    content = {**HEAD, "lost_stretches": [{"first_frame": 0, "last_frame": 0}]}
    health = TrajectoryHealth.parse(json.dumps(content), "here")
    assert (health.unchecked, health.path_length_m, health.open_path_m) == (None, None, None)
    assert (health.lost_stretches[0].from_s, health.lost_stretches[0].to_s) == (None, None)
    assert not {"unchecked", "path_length_m", "open_path_m"} & set(health.json_value())


@pytest.mark.parametrize(
    "plane",
    [
        None,
        {"a": 1},
        ["0", "0", "1", "0"],
        [False, False, True, False],
        [0.0, 0.0, True, 0.0],
        [0.0, 0.0, None, 0.0],
        [[0.0], 0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.0, 0.0, 10**400, 0.0],
    ],
)
def test_an_array_is_of_numbers_alone(plane: object) -> None:
    content = {"plane_world": plane, "T_floor_world": [[0] * 4] * 4, "noise_m": 0.0, "inlier_share": 0.5}
    with raises(StorageError, "storage.damaged", match="'plane_world': must be 4"):
        FloorFile.parse(json.dumps(content), "here")
    sound = FloorFile.parse(json.dumps(content | {"plane_world": [0, 0.0, 1, 10**30]}), "here")
    assert sound.plane_world.tolist() == [0.0, 0.0, 1.0, 1e30]


READ = """
import sys
from kinectbench.core.artefacts import scores, sequence
from kinectbench.core.errors import StorageError
from pathlib import Path
try:
    {"scores.json": scores.ScoreTable, "frames.json": sequence.FramesFile}[Path(sys.argv[1]).name].read_file(
        Path(sys.argv[1])
    )
except StorageError as error:
    assert sys.argv[2] in str(error), error
"""
# File, text (made by the test that takes it: together they take a second and 300 MB), what is said of it.
COSTLY: dict[str, tuple[str, Callable[[], str], str]] = {
    "keys": (
        "scores.json",
        lambda: "{" + ",".join(f'"k{n}":0' for n in range(1_900_000)) + "}",
        "300000 keys",
    ),
    "objects": ("scores.json", lambda: '{"x":[' + ",".join(['{"a":0}'] * 1_000_000) + "]}", "3000000 values"),
    "as many as may be": (
        "scores.json",
        lambda: '{"x":[' + ",".join(['{"a":0}'] * 740_000) + "]}",
        "'method': Field required",
    ),
    "a key that lacks": (
        "scores.json",
        lambda: '{"x":' + json.dumps([f"s{n}" for n in range(2_900_000)]) + "}",
        "'method': Field required",
    ),
    "wrong rows": (
        "frames.json",
        lambda: "[" + ",".join(['{"a":0}'] * 490_000) + "]",
        "'0.index': Field required",
    ),
    "wrong values": (
        "scores.json",
        lambda: '{"method":"a","base_rate":{' + ",".join(f'"k{n}":{{}}' for n in range(290_000)) + "}}",
        "'base_rate.k0.value': Field required",
    ),
    "wide": ("scores.json", lambda: '{"x":"\U0001f600' + "a" * (60 << 20) + '"}', "as a text"),
    "wide by an escape": (
        "scores.json",
        lambda: '{"x":"\\ud83d\\ude00' + "a" * (60 << 20) + '"}',
        "beyond U+FFFF",
    ),
}


# The others are as long, or have as many values.
FURTHER = {"objects", "as many as may be", "wide"}


@pytest.mark.skipif(sys.platform != "linux", reason="memory is told by Linux's /proc")
@pytest.mark.parametrize("name", [slow(name) if name in FURTHER else name for name in COSTLY])
def test_the_costliest_texts_take_less_than_500_mb(name: str, tmp_path: Path) -> None:
    """With Python and its libraries, which take 45 MB of it."""
    file, text, line = COSTLY[name]
    (tmp_path / file).write_text(text(), encoding="utf-8")
    assert peak_mb(READ, str(tmp_path / file), line) < 450


@pytest.mark.parametrize(
    "more",
    [
        {"source": "x" * (MOST_TEXT + 1)},
        {"settings": {"notes": [["é" * 9_000_000]]}},
        {"x" * (MOST_TEXT + 1): 1},
        {"training": {"x" * (MOST_TEXT + 1): {}}},
    ],
)
def test_a_long_text_of_any_key_is_refused_in_one_short_line(more: dict[str, object]) -> None:
    text = json.dumps({"name": "net"} | more)
    with raises(PredictionError, "prediction.too-large", match=f"at most {MOST_TEXT} are read") as caught:
        MethodFile.parse(text, "method.json")
    assert len(str(caught.value)) < 250 and "\n" not in str(caught.value)
    with raises(StorageError, "storage.too-large", match="method.* has|source.* has|notes.* has|x.* has"):
        ScoreTable.parse(text.replace('"name"', '"method"'), "scores.json")
    kept = {"name": "net", "source": "x" * (MOST_TEXT // 2) + '"' * (MOST_TEXT // 2)}
    assert MethodFile.parse(json.dumps(kept), "method.json").json_value()["source"] == kept["source"]
    with raises(PredictionError, "prediction.too-large", match=f"'source' has {2 * MOST_TEXT} characters"):
        MethodFile.parse(json.dumps(kept | {"source": 'x"' * MOST_TEXT}), "method.json")
