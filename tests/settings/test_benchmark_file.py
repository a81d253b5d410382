import re
from pathlib import Path

import pytest
from raising import raises

from kinectbench.core.errors import SettingsError
from kinectbench.settings.base import Settings
from kinectbench.settings.file import load_benchmark
from kinectbench.settings.models import BenchmarkSettings, RecordingSettings
from kinectbench.settings.template import init_benchmark
from kinectbench.stages.ingest.readers import name_suffixes

GOOD = """\
name: furniture
license: CC-BY-4.0
recordings:
  - id: chair.01
    path: recordings/chair_01
    category: chair
  - {id: chair, path: x.bag, category: chair, split: train, camera: {fx: 525}}
fusion:
  voxel_size_m: 5e-3
views: {count: 10}
"""


def load(tmp_path: Path, text: str | bytes, *overrides: str) -> BenchmarkSettings:
    path = tmp_path / "benchmark.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return load_benchmark(path, overrides)


def complaint(tmp_path: Path, text: str | bytes, *overrides: str) -> str:
    """The message, with the folder cut away."""
    with pytest.raises(SettingsError) as caught:
        load(tmp_path, text, *overrides)
    return str(caught.value).replace(f"{tmp_path}/", "")


def test_a_good_file_loads_with_defaults(tmp_path: Path) -> None:
    settings = load(tmp_path, GOOD)
    assert settings.name == "furniture"
    assert settings.recordings[0].split == "test"
    assert settings.recordings[1].camera is not None and settings.recordings[1].camera.fx == 525.0
    assert settings.fusion.voxel_size_m == 0.005
    assert settings.views.count == 10
    assert settings.pairs == BenchmarkSettings.model_fields["pairs"].default


def test_bytes_that_editors_add_do_no_harm(tmp_path: Path) -> None:
    assert load(tmp_path, b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode()) == load(tmp_path, GOOD)


def test_a_section_left_empty_keeps_its_defaults(tmp_path: Path) -> None:
    text = GOOD + "pairs:\ntracking:\n  # check_stride_px: 4\n"
    assert load(tmp_path, text) == load(tmp_path, GOOD)


def test_text_that_yaml_1_1_would_change_stays_text(tmp_path: Path) -> None:
    settings = load(
        tmp_path, GOOD.replace("id: chair,", "id: 007,").replace("category: chair\n", "category: no\n")
    )
    assert settings.recordings[1].id == "007"
    assert settings.recordings[0].category == "no"


def test_an_alias_is_read_and_an_override_changes_one_place_only(tmp_path: Path) -> None:
    desk = "  - {id: desk, path: y, category: table, camera: &kinect {fx: 500}}\n"
    shared = GOOD.replace("recordings:\n", "recordings:\n" + desk).replace("{fx: 525}", "*kinect")
    settings = load(tmp_path, shared, "recordings.chair.camera.fx=600")
    assert [r.camera.fx if r.camera else None for r in settings.recordings] == [500, None, 600]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "voxel_size_m: 5e-3",
            "voxel_sise_m: 1",
            "9: fusion.voxel_sise_m: unknown key; did you mean 'voxel_size_m'?",
        ),
        ("fusion:", "fussion:", "8: fussion: unknown key; did you mean 'fusion'?"),
        ("count: 10", "framing: view", "10: views.framing: unknown key; it belongs under 'pairs:'"),
        (
            "count: 10",
            "qqq: 1",
            "10: views.qqq: unknown key; valid here: count, seed, strategy, min_pixels, recorded_masks",
        ),
        ("fx: 525", "fxx: 5", "7: recordings.chair.camera.fxx: unknown key; did you mean 'fx'?"),
        ("5e-3", "9", "9: fusion.voxel_size_m: found 9; wanted a number from 0.001 to 0.05"),
        (
            "count: 10",
            "min_pixels: ",
            "10: views.min_pixels: found nothing; wanted a whole number from 16 up",
        ),
        ("5e-3", "5mm", "9: fusion.voxel_size_m: found the text '5mm'; wanted a number from 0.001 to 0.05"),
        ("5e-3", "[1, 2]", "9: fusion.voxel_size_m: found [1, 2]; wanted a number from 0.001 to 0.05"),
        ("525", "-1", "7: recordings.chair.camera.fx: found -1; wanted a number above 0"),
        (
            "525",
            ".inf",
            "7: recordings.chair.camera.fx: found .inf; wanted a number above 0; it must be finite",
        ),
        (
            "525",
            ".nan",
            "7: recordings.chair.camera.fx: found .nan; wanted a number above 0; it must be finite",
        ),
        ("525", "yes", "7: recordings.chair.camera.fx: found the text 'yes'; wanted a number above 0"),
        ("count: 10", "count: 10.5", "10: views.count: found 10.5; wanted a whole number from 1 to 1000"),
        ("count: 10", "count: true", "10: views.count: found true; wanted a whole number from 1 to 1000"),
        (
            "{count: 10}",
            "3",
            "10: views: found 3; wanted a mapping with count, seed, strategy, min_pixels, recorded_masks",
        ),
        (
            "split: train",
            "split: trian",
            "7: recordings.chair.split: found the text 'trian'; wanted one of train, validation, test; "
            "did you mean 'train'?",
        ),
        (
            "split: train",
            "category2: x",
            "7: recordings.chair.category2: unknown key; did you mean 'category'?",
        ),
        ("path: x.bag", "path: 12", "7: recordings.chair.path: found 12; wanted text: write '12' in quotes"),
        ("path: x.bag, ", "", "7: recordings.chair.path: missing; wanted text"),
        ("name: furniture\n", "", "1: name: missing; wanted text"),
        (
            "id: chair,",
            "id: a/b,",
            "7: recordings.a/b.id: found the text 'a/b'; use letters, digits, '.', '_' and '-' only "
            "(at most 80, not starting with '.')",
        ),
        (
            "id: chair,",
            "id: chair.01,",
            "7: recordings.chair.01: two recordings have the id 'chair.01': give each its own "
            "(the other is at benchmark.yaml:4)",
        ),
        (
            "id: chair,",
            "id: chair, object: chair.01,",
            "7: recordings.chair: object 'chair.01' is in two splits: 'test' (chair.01) and 'train' (chair); "
            "an object belongs to one (the other is at benchmark.yaml:4)",
        ),
    ],
)
def test_each_wrong_setting_gets_its_line(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert old in GOOD
    assert complaint(tmp_path, GOOD.replace(old, new)) == f"benchmark.yaml:{expected}"


@pytest.mark.parametrize(
    ("box", "expected"),
    [
        ("{center_m: [0, 0], size_m: [1, 1, 1]}", "center_m: found [0, 0]; wanted a list of 3 numbers"),
        (
            "{center_m: [0, 0, '1'], size_m: [1, 1, 1]}",
            "center_m: found [0, 0, '1']; wanted a list of 3 numbers",
        ),
        ("{center_m: [0, 0, 0], size_m: [1, 1, 0]}", "size_m: every edge must be longer than 0"),
        (
            "{center_m: [0, 0, 0], size_m: [1, 1, 1e300]}",
            "size_m: no more than 1000000 m each: give it in metres",
        ),
        (
            "{center_m: [-1e300, 0, 0], size_m: [1, 1, 1]}",
            "center_m: no more than 1000000 m each: give it in metres",
        ),
        ("{center_m: [0, 0, 0]}", "size_m: missing; wanted a list of 3 numbers"),
        (
            "{center_m: [0, 0, 0], size_m: [1, 1, 1], yaw_rad: 45}",
            "yaw_rad: found 45; more than a whole turn: in radians 45 degrees are 0.785",
        ),
        (
            "[1, 2]",
            "found [1, 2]; wanted a mapping with center_m, size_m, yaw_rad, anchor_frame, anchor_pose, "
            "anchor_depth_sha256",
        ),
    ],
)
def test_wrong_boxes(tmp_path: Path, box: str, expected: str) -> None:
    message = complaint(tmp_path, GOOD.replace("camera: {fx: 525}", f"box: {box}"))
    dot = ": " if expected.startswith("found") else "."
    assert message == f"benchmark.yaml:7: recordings.chair.box{dot}{expected}"


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (
            "floor: {plane_world: [0, 0, 1, 1e300]}",
            "floor.plane_world: the last number, d, is no more than 1000000: give it in metres",
        ),
        (
            "camera: {trajectory_delay_s: 1e10}",
            "camera.trajectory_delay_s: found 1e10; wanted a number from -4000000000.0 to 4000000000.0",
        ),
    ],
)
def test_numbers_out_of_all_range(tmp_path: Path, line: str, expected: str) -> None:
    message = complaint(tmp_path, GOOD.replace("camera: {fx: 525}", line))
    assert message == f"benchmark.yaml:7: recordings.chair.{expected}"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "benchmark.yaml: holds no settings"),
        ("# only a comment\n", "benchmark.yaml: holds no settings"),
        ("- 1\n", "benchmark.yaml:1: found [1]; wanted lines like 'name: furniture'"),
        ("furniture", "benchmark.yaml:1: found the text 'furniture'"),
        ("name: x\nviews:\n\tcount: 3\n", "benchmark.yaml:3: indented with a tab; use spaces"),
        ("name: x\nname: y\n", "benchmark.yaml:2: 'name' stands twice, first at benchmark.yaml:1; keep one"),
        (
            "name: x\nviews: {seed: 1,\n  seed: 2}\n",
            "benchmark.yaml:3: 'seed' stands twice, first at benchmark.yaml:2",
        ),
        ("name: x\nviews: [1\npairs: 3\n", "benchmark.yaml:3: not valid YAML: "),
        ("name: x: y\n", "benchmark.yaml:1: not valid YAML: mapping values are not allowed here"),
        ("name: *x\n", "benchmark.yaml:1: not valid YAML: found undefined alias 'x'"),
        ("name: &a [*a]\n", "benchmark.yaml:1: an alias that contains itself"),
        ("name: !!python/object/apply:os.system [ls]\n", "benchmark.yaml:1: name: found ['ls']; wanted text"),
        (
            "name: !!python/name:os.system ls\n",
            "benchmark.yaml:1: the tag 'tag:yaml.org,2002:python/name:os.system'",
        ),
        ("name: !!int x\n", "benchmark.yaml:1: 'x' does not fit its tag"),
        ("name: x\n---\nname: y\n", "benchmark.yaml:2: not valid YAML: expected a single document"),
        (b"name: x\nlicense: \xff\n", "benchmark.yaml:2: not UTF-8 text"),
        ("name: x\nlicense: \x07\n", "benchmark.yaml:2: the control character U+0007; remove it"),
        ("? [a]\n: 3\n", "benchmark.yaml:1: a key must be a name"),
        ("[" * 5000, "benchmark.yaml: nested too deeply"),
        (
            "name: x\nrecordings:\n",
            "benchmark.yaml:2: recordings: found nothing; wanted a list with at least one entry",
        ),
        ("name: x\nrecordings: []\n", "benchmark.yaml:2: recordings: found a list of 0; wanted a list"),
        (
            "name: x\nrecordings:\n  - chair\n",
            "benchmark.yaml:3: recordings[0]: found the text 'chair'; wanted a mapping",
        ),
    ],
)
def test_a_broken_file_gets_one_line(tmp_path: Path, text: str | bytes, expected: str) -> None:
    message = complaint(tmp_path, text)
    assert expected in message
    assert all(line.startswith("benchmark.yaml:") for line in message.splitlines())


def test_nested_aliases_cost_nothing(tmp_path: Path) -> None:
    levels = "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 30))
    assert "a9: unknown key" in complaint(tmp_path, f"name: x\na0: &a0 [x]\n{levels}")


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with raises(SettingsError, "settings.no-file", match="`kinectbench init FOLDER`"):
        load_benchmark(tmp_path / "benchmark.yaml")
    with raises(SettingsError, "settings.no-file", match=r"benchmark\.yaml"):
        load_benchmark(tmp_path)


def test_all_errors_come_at_once_in_the_order_of_the_file(tmp_path: Path) -> None:
    text = GOOD.replace("525", "-1").replace("count: 10", "count: 0").replace("license:", "licence:")
    lines = complaint(tmp_path, text, "pairs.framing=views").splitlines()
    assert [re.match(r"benchmark.yaml:(\d+)|in --set", line)[0] for line in lines] == [  # type: ignore[index]
        "benchmark.yaml:2",
        "benchmark.yaml:7",
        "benchmark.yaml:10",
        "in --set",
    ]


def test_overrides_win_and_the_last_one_most(tmp_path: Path) -> None:
    settings = load(
        tmp_path,
        GOOD,
        "fusion.voxel_size_m=0.01",
        "views.count=3",
        "views.count=4",
        "name=other",
        "recordings.chair.01.split=validation",
        "recordings.chair.camera.fy=500",
        "recordings.chair.01.box={center_m: [0, 0, 1], size_m: [1, 1, 1]}",
        "recordings.chair.object=",
    )
    assert settings.fusion.voxel_size_m == 0.01
    assert settings.views.count == 4
    assert settings.name == "other"
    first, second = settings.recordings
    assert first.split == "validation" and first.box is not None
    assert second.camera is not None and (second.camera.fx, second.camera.fy) == (525, 500)


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("fusion.voxel_size_m=9", "found 9; wanted a number from 0.001 to 0.05"),
        ("fusion.voxel_sise_m=1", "unknown key; did you mean 'voxel_size_m'?"),
        ("fusion.voxel_size_m=[1", "not valid YAML: "),
        ("fusion.voxel_size_m", "write --set section.key=value"),
        ("fusion..voxel_size_m=1", "write --set section.key=value"),
        ("=1", "write --set section.key=value"),
        ("recordings.char.split=test", "no recording 'char'; did you mean 'chair'?"),
        ("recordings.chair=test", "write --set recordings.chair.key=value"),
        ("recordings.chair.pth=x", "unknown key; did you mean 'path'?"),
        ("recordings.chair.camera={fxx: 3}", "recordings.chair.camera.fxx: unknown key; did you mean 'fx'?"),
    ],
)
def test_wrong_overrides_name_the_override(tmp_path: Path, override: str, expected: str) -> None:
    message = complaint(tmp_path, GOOD, override)
    assert message.startswith(f"in --set {override}: {expected}")
    assert "\n" not in message


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        (
            "fusion.min_depth_m=3",
            "fusion: min_depth_m is 3, and of some recordings no depth beyond 3 m would be fused: give",
        ),
        ("fusion={min_depth_m: 2, max_depth_m: 0.2}", "min_depth_m is 2 and max_depth_m 0.2, so"),
        ("fusion.max_depth_m=0.2", "fusion: min_depth_m is 0.3 and max_depth_m 0.2, so"),
    ],
)
def test_a_range_of_depth_without_depth(tmp_path: Path, override: str, expected: str) -> None:
    (line,) = complaint(tmp_path, "name: x\nrecordings: [{id: a, path: r, category: c}]\n", override).split(
        "\n"
    )
    assert expected in line


def test_an_override_does_not_hide_a_wrong_file(tmp_path: Path) -> None:
    assert "'name' stands twice" in complaint(tmp_path, GOOD + "name: again\n", "name=x")


def test_init_writes_a_file_that_loads(tmp_path: Path) -> None:
    found = [
        ("recordings/OfficeChairA.bag", "ROS 1 bag"),
        ("sofas/01/rgbd.bag", "ROS 1 bag"),
        ("tables/rgbd.bag", "ROS 1 bag"),
        ("a b/Ünï: #x", "TUM folder"),
        ("stable", "TUM folder"),
        ("001", "TUM folder"),
        ("true", "TUM folder"),
        (".", "TUM folder"),
    ]
    folder = tmp_path / "my furniture"
    settings = load(tmp_path, init_benchmark(folder, found, name_suffixes()))
    assert settings.name == "my_furniture"
    assert [r.path for r in settings.recordings] == [path for path, _ in found]
    ids = ["OfficeChairA", "sofas_01_rgbd", "tables_rgbd", "Uni_x", "stable", "001", "true", "my_furniture"]
    assert [r.id for r in settings.recordings] == ids
    defaults = BenchmarkSettings.model_fields
    assert settings.fusion == defaults["fusion"].default and settings.views == defaults["views"].default


def test_init_gives_unique_ids_even_without_a_usable_name(tmp_path: Path) -> None:
    paths = ["???", "///", "A", "a", "x/y", "x_y", "x/z/y"]
    settings = load(tmp_path, init_benchmark(tmp_path, [(path, "log") for path in paths], name_suffixes()))
    names = [recording.id.lower() for recording in settings.recordings]
    assert len(set(names)) == len(names)


def test_init_shows_every_setting_at_its_default(tmp_path: Path) -> None:
    text = init_benchmark(tmp_path / "x", [("chair_01", "log")], ())
    uncommented = re.sub(r"^  # ", "  ", text, flags=re.MULTILINE)
    assert uncommented != text
    settings = load(tmp_path, uncommented)
    for section, field in BenchmarkSettings.model_fields.items():
        if isinstance(field.default, Settings):
            assert getattr(settings, section) == field.default
            for key in type(field.default).model_fields:
                assert re.search(rf"^  {key}: ", uncommented, re.MULTILINE)
    for key in RecordingSettings.model_fields:
        assert re.search(rf"\b{key}: ", text)


@pytest.mark.parametrize("path", ["OfficeChairA.bag", "sofas/01", "tables/red_table", "scan", "."])
def test_init_asks_for_category_and_object_and_invents_neither(tmp_path: Path, path: str) -> None:
    text = init_benchmark(tmp_path / "chairs", [(path, "log"), ("desk", "log")], name_suffixes())
    assert re.findall(r"^    category: (\w+) +# fill in what it is", text, re.MULTILINE) == ["unknown"] * 2
    assert len(re.findall(r"^    # object: … +# fill in", text, re.MULTILINE)) == 2
    settings = load(tmp_path, text)
    assert [(r.category, r.object) for r in settings.recordings] == [("unknown", None)] * 2
    # A file of an earlier version, with a category that it took from the folder's name, is read as before.
    earlier = text.replace("category: unknown", "category: chair", 1)
    assert [r.category for r in load(tmp_path, earlier).recordings] == ["chair", "unknown"]


def test_init_without_recordings_says_so(tmp_path: Path) -> None:
    with raises(SettingsError, "settings.no-recording"):
        init_benchmark(tmp_path, [], ())
