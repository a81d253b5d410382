"""`kinectbench formats` lists every reader."""

import json
from collections.abc import Callable
from pathlib import Path

from small_benchmark import Run

from kinectbench.stages.ingest.readers import FORMATS


def test_formats(command: Callable[..., Run], tmp_path: Path) -> None:
    rows = json.loads(command(tmp_path, "formats", "--json").out)
    assert [row["format"] for row in rows] == list(FORMATS)
    tried = {row["format"]: row["evidence"] for row in rows}
    assert {name for name, evidence in tried.items() if evidence == "recording"} == {"7scenes"}
    assert {name for name, evidence in tried.items() if evidence == "copy"} == {"tum", "scanner_app"}
    # Whoever claims a real recording names it.
    assert all(row["verified"] for row in rows if row["evidence"] != "writer")
    text = command(tmp_path, "formats").out
    assert "klg: a .klg file of ElasticFusion\n    verified on: nothing real, but files written" in text
    assert "    verified on: a real recording: 150 frames of redkitchen" in text
    assert "    verified on: a real recording whose licence lets it be copied: fr3/cabinet" in text
