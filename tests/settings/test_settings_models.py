import subprocess
import sys

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from kinectbench.core.names import Name
from kinectbench.settings.base import Settings
from kinectbench.settings.models import (
    BenchmarkSettings,
    BoxSettings,
    CameraSettings,
    FusionSettings,
    RecordingSettings,
)
from kinectbench.settings.words import field_at, model_of, range_in_words, suggestion, wanted

CHAIR = {"id": "chair_01", "path": "recordings/chair_01", "category": "chair"}


def every_model() -> list[type[Settings]]:
    """All settings models that benchmark.yaml reaches."""
    found: list[type[Settings]] = [BenchmarkSettings, RecordingSettings, CameraSettings, BoxSettings]
    return found + [
        type(f.default) for f in BenchmarkSettings.model_fields.values() if isinstance(f.default, Settings)
    ]


@pytest.mark.parametrize("model", every_model())
def test_every_model_refuses_unknown_keys_and_describes_each_field(model: type[Settings]) -> None:
    assert model.model_config["extra"] == "forbid"
    assert model.__doc__
    for name, field in model.model_fields.items():
        assert field.description or model_of(field.annotation), name


def test_defaults_satisfy_their_own_ranges() -> None:
    for model in every_model()[4:]:
        defaults = model()
        assert model.model_validate(defaults.model_dump()) == defaults


@pytest.mark.parametrize("model", every_model()[4:])
def test_each_end_of_a_range_holds(model: type[Settings]) -> None:
    for name, field in model.model_fields.items():
        for constraint in field.metadata:
            for attribute, outward in (("ge", -1), ("gt", 0), ("le", 1), ("lt", 0)):
                if (limit := getattr(constraint, attribute, None)) is not None:
                    with pytest.raises(ValidationError, match=name):
                        model.model_validate({name: limit + outward})


@pytest.mark.parametrize("value", ["4", True, None, float("nan"), float("inf"), [4.0]])
def test_values_of_another_type_are_not_converted(value: object) -> None:
    with pytest.raises(ValidationError):
        FusionSettings.model_validate({"truncation_voxels": value})


def test_settings_cannot_be_changed() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        FusionSettings().voxel_size_m = 0.01  # type: ignore[misc]


@pytest.mark.parametrize("name", ["chair_01", "a", "7", "Chair.v2-b", "x" * 80])
def test_safe_names_pass(name: str) -> None:
    assert TypeAdapter(Name).validate_python(name) == name


@pytest.mark.parametrize("name", ["", ".", "..", ".git", "a/b", "a b", "ü", "x" * 81, "a\n", "-x", "a\0"])
def test_names_that_are_unsafe_as_files_do_not(name: str) -> None:
    with pytest.raises(ValueError, match="letters, digits"):
        TypeAdapter(Name).validate_python(name)


def test_recordings_of_one_object_share_a_split() -> None:
    def benchmark(*recordings: dict[str, str]) -> BenchmarkSettings:
        return BenchmarkSettings.model_validate({"name": "x", "recordings": list(recordings)})

    again = {**CHAIR, "id": "chair_02", "object": "chair_01"}
    assert benchmark(CHAIR, again).by_id()["chair_02"].object_name == "chair_01"
    with pytest.raises(
        ValidationError, match="in two splits: 'test' \\(chair_01\\) and 'train' \\(chair_02\\)"
    ):
        benchmark(CHAIR, {**again, "split": "train"})
    with pytest.raises(ValidationError, match="two recordings have the id 'chair_01'"):
        benchmark(CHAIR, CHAIR)
    with pytest.raises(KeyError):
        benchmark(CHAIR).by_id()["nobody"]


def test_a_box_becomes_a_value() -> None:
    box = BoxSettings.model_validate(
        {"center_m": [0, 0, 0.5], "size_m": [1, 2, 1], "yaw_rad": np.pi / 2}
    ).box()
    assert box.contains(np.array([[0.9, 0.0, 0.5], [0.0, 0.9, 0.5]])).tolist() == [True, False]


@pytest.mark.parametrize(
    ("location", "words", "used"),
    [
        ((), "a mapping with name, license", 0),
        (("fusion", "voxel_size_m"), "a number from 0.001 to 0.05", 2),
        (("recordings", 3, "split"), "one of train, validation, test", 3),
        (("recordings", 3, "camera", "fx"), "a number above 0", 4),
        (("recordings", 3, "camera", "width"), "a whole number from 16 to 8192", 4),
        (("recordings", 0, "box", "size_m", 1), "a list of 3 numbers", 4),
        (("recordings",), "a list with at least one entry", 1),
        (("publish", "color"), "true or false", 2),
        (("name",), "text", 1),
        (("recordings", 3, "object"), "text", 3),
        (("publish", "citation", "title"), "text", 3),
        (("tracking", "max_stamp_gap_s"), "a number above 0 and up to 10", 2),
        (("views", "seed"), "a whole number from 0 up", 2),
    ],
)
def test_what_is_wanted_in_words(location: tuple[str | int, ...], words: str, used: int) -> None:
    annotation, constraints, depth = field_at(location)
    assert wanted(annotation, constraints).startswith(words)
    assert depth == used


def test_suggestions() -> None:
    assert suggestion("Voxel-Size-M", ["voxel_size_m", "count"]) == "did you mean 'voxel_size_m'?"
    assert suggestion("qqq", ["count", "seed"]) == "valid here: count, seed"
    assert range_in_words([]) == ""


def test_reading_settings_and_bags_loads_no_heavy_library() -> None:
    code = (
        "import sys, kinectbench.settings.models, kinectbench.settings.file, kinectbench.core.storage\n"
        "import kinectbench.stages.ingest.bags.rosbag1, kinectbench.stages.ingest.bags.rosbag2\n"
        "heavy = {'open3d', 'cv2', 'numba', 'trimesh', 'scipy', 'rosbags', 'jinja2', 'rich', 'matplotlib'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    "floor", [[0, 0, 0, 1], [0, 0, 1], [0, 0, 1, "1"], [0, 0, 100, 1], [0, 0, float("nan"), 1]]
)
def test_a_plane_has_a_normal_and_a_distance(floor: object) -> None:
    said = {"id": "a", "path": "a", "category": "mug"}
    with pytest.raises(ValidationError, match="floor"):
        RecordingSettings.model_validate({**said, "floor": {"plane_world": floor}})
    given = RecordingSettings.model_validate({**said, "floor": {"plane_world": [0, 0.6, 0.8, -1]}})
    assert given.plane_world == (0, 0.6, 0.8, -1)
    assert RecordingSettings.model_validate(said).plane_world is None


@pytest.mark.parametrize("model", every_model())
def test_what_is_wanted_of_every_field(model: type[Settings]) -> None:
    for field in model.model_fields.values():
        assert wanted(field.annotation, field.metadata)
