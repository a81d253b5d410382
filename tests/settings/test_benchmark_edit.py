"""A box put into a benchmark.yaml: nothing else of the file changes."""

import pytest
from raising import raises

from kinectbench.core.artefacts.object import BoxPart
from kinectbench.core.errors import SettingsError
from kinectbench.settings.edit import with_box
from kinectbench.settings.file import parse_benchmark
from kinectbench.settings.models import BoxSettings

BOX = BoxPart(center_m=(0.1, -0.2, 0.3), size_m=(0.5, 0.6, 0.7), yaw_rad=-0.25)
LINE = "box: {center_m: [0.1, -0.2, 0.3], size_m: [0.5, 0.6, 0.7], yaw_rad: -0.25}"
BLOCK = """\
# mine
name: two
recordings:
  - id: a   # the first
    path: rec/a
    category: chair
  - path: rec/b
    category: chair
    id: b
"""
FLOW = """\
name: two
recordings:
  - {id: a, path: rec/a, category: chair}  # the first
  - {path: rec/b, category: chair, id: b}
"""


@pytest.mark.parametrize("text", [BLOCK, FLOW, BLOCK.rstrip("\n")])
@pytest.mark.parametrize("recording", ["a", "b"])
def test_put_in(text: str, recording: str) -> None:
    changed = with_box(text, "x.yaml", recording, BOX)
    box = BoxSettings.model_validate(BOX.json_value())
    assert parse_benchmark(changed, "x.yaml").by_id()[recording].box == box
    other = "b" if recording == "a" else "a"
    assert parse_benchmark(changed, "x.yaml").by_id()[other].box is None
    # Taken away again, the file is as before.
    assert changed.replace(f", {LINE}", "").replace(f"\n    {LINE}", "") == text


@pytest.mark.parametrize(
    "old",
    [
        "    box: {center_m: [9, 9, 9], size_m: [1, 1, 1]}  # by hand\n",
        "    box:\n      center_m: [9, 9, 9]\n      size_m: [1, 1, 1]\n",
    ],
)
def test_replaced(old: str) -> None:
    text = BLOCK.replace("    path: rec/a\n", "    path: rec/a\n" + old)
    once = with_box(text, "x.yaml", "a", BOX)
    assert "9" not in once and "# mine" in once
    assert parse_benchmark(once, "x.yaml").by_id()["a"].box == BoxSettings.model_validate(BOX.json_value())
    assert with_box(once, "x.yaml", "a", BOX) == once
    assert ("# by hand" in once) == ("# by hand" in old)


def test_what_cannot_be_changed_safely_is_told() -> None:
    shared = """\
name: two
recordings:
  - &first {id: a, path: rec/a, category: &kind chair}
  - id: "b" # said
    path: [no
"""
    with pytest.raises(SettingsError):
        with_box(shared, "x.yaml", "b", BOX)
    aliased = BLOCK.replace(
        "id: a   # the first", "id: a\n    box: &b {center_m: [1, 1, 1], size_m: [1, 1, 1]}"
    )
    aliased = aliased.replace("    id: b\n", "    id: b\n    box: *b\n")
    with raises(SettingsError, "settings.not-editable"):
        with_box(aliased, "x.yaml", "a", BOX)
