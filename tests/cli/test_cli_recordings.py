"""`kinectbench formats` lists every reader."""

import json
from collections.abc import Callable
from pathlib import Path

from small_benchmark import Run

from kinectbench.stages.ingest.readers import FORMATS


def test_formats(command: Callable[..., Run], tmp_path: Path) -> None:
    rows = json.loads(command(tmp_path, "formats", "--json").out)
    assert [row["format"] for row in rows] == list(FORMATS)
    verified = {row["format"] for row in rows if row["verified"]}
    assert verified == {"rosbag1", "rosbag2", "tum", "7scenes", "folder"}
    text = command(tmp_path, "formats").out
    assert "klg: a .klg file of ElasticFusion\n    verified on: nothing real" in text
