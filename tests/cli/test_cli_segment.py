"""`segment --suggest` and `--pick`: boxes to choose from, and one of them into benchmark.yaml."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import pytest
import yaml
from read_pictures import read_picture
from small_benchmark import Run, copied, hashes, leftovers

pytestmark = pytest.mark.xdist_group("commands")

Command = Callable[..., Run]


@pytest.fixture
def one(small: Path, tmp_path: Path) -> Path:
    """A copy of the small benchmark and of what was built of its chair."""
    return copied(small, tmp_path / "one", "benchmark.yaml", "recordings/chair", "build/chair")


def test_suggest_and_pick(command: Command, one: Path) -> None:
    before = hashes(one / "build/chair")
    listed = command(one, "segment", "chair", "--suggest")
    assert listed.status == 0, listed.err
    assert "1: " in listed.out and "chosen without a box" in listed.out
    rows = json.loads(command(one, "segment", "chair", "--suggest", "--json").out)
    (row,) = rows
    assert "suggest" in row["current"] and row["made"] == []
    found = row["candidates"]["candidates"]
    assert [each["number"] for each in found] == list(range(1, len(found) + 1))
    for picture in (row["candidates"]["plan"], *(each["picture"] for each in found)):
        assert read_picture(one / picture).size
    # Every line that is printed can be pasted.
    lines = [line.strip() for line in listed.out.splitlines() if line.strip().startswith("box:")]
    assert [yaml.safe_load(line)["box"] for line in lines] == [each["box"] for each in found]
    after = hashes(one / "build/chair")
    assert {name: after[name] for name in before} == before
    assert leftovers(one) == []

    picked = command(one, "segment", "chair", "--pick", "1")
    assert (picked.status, picked.progress) == (0, ()), picked
    assert picked.out == "wrote box 1 of chair to benchmark.yaml; `kinectbench build chair` uses it\n"
    assert hashes(one / "build/chair") == after, "--pick writes a box, and runs no stage"
    recordings = yaml.safe_load((one / "benchmark.yaml").read_text())["recordings"]
    assert recordings[0]["box"] == found[0]["box"] and "box" not in recordings[1]
    assert command(one, "segment", "chair").status == 0
    quality = json.loads((one / "build/chair/object/quality.json").read_text())
    assert quality["selection"] == "box"


def test_wrong_picks(command: Command, one: Path) -> None:
    text = (one / "benchmark.yaml").read_text()
    for arguments, says in (
        (("chair", "--pick", "1"), "run `kinectbench segment chair --suggest`"),
        (("--pick", "1"), "name the one recording"),
        (("chair", "--suggest", "--pick", "1"), "give one of them"),
        (("chair", "--suggest", "--carry-masks"), "give one of them"),
        (("chiar", "--pick", "1"), "did you mean 'chair'"),
    ):
        run = command(one, "segment", *arguments)
        assert (run.status, len(run.err.splitlines())) == (2, 1), run.err
        assert says in run.err
    assert command(one, "segment", "chair", "--suggest").status == 0
    run = command(one, "segment", "chair", "--pick", "99")
    assert (run.status, "none of number 99" in run.err) == (2, True)
    # Fused anew with other settings, the old list does not count.
    changed = command(one, "segment", "chair", "--pick", "1", "--set", "fusion.scene_voxel_size_m=0.04")
    assert (changed.status, "an old one" in changed.err) == (2, True)
    assert (one / "benchmark.yaml").read_text() == text


def test_a_mask_of_the_wrong_size(command: Command, one: Path) -> None:
    import numpy as np

    masks = one / "masks"
    masks.mkdir()
    cv2.imwrite(str(masks / "000.png"), np.ones((60, 80), np.uint8))
    run = command(one, "pairs", "chair", "--set", "recordings.chair.masks=masks")
    assert run.status == 1
    assert "the mask is 80x60, the depth image 160x120" in run.err
