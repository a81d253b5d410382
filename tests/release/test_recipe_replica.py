"""Four scans in Redwood's layout, from a server that lies and one that tells the truth, to scores."""

import json
from pathlib import Path

import pytest
from replica import Commands, the_whole_way
from replica_scans import four, make, served

from kinectbench.core.artefacts.benchmark import ReleaseInfo
from kinectbench.core.artefacts.triage import TriageFile

SMALL = {"width": 160, "height": 120, "frames": 60}
CAMERA = "{fx: 131.25, fy: 131.25, cx: 79.5, cy: 59.5}"
COARSE = """\
fusion: {voxel_size_m: 0.02, scene_voxel_size_m: 0.04}
views: {count: 2, min_pixels: 100}
publish: {gate: {min_estimated_iou: 0, max_unknown_share: 1, max_doubts: 100}}
"""


@pytest.mark.slow
def test_four_scans_become_scores_by_the_commands_of_a_recipe(tmp_path: Path) -> None:
    scans = four()
    made, root = tmp_path / "made", tmp_path / "recipe"
    made.mkdir()
    root.mkdir()
    for scan in scans:
        make(scan, made, **SMALL)
    the_whole_way(Commands(root, 1), scans, served(scans, made), COARSE, camera=CAMERA)
    kinds = {scan.name: scan.kind for scan in scans}
    locked = json.loads((root / "sources.lock").read_text())["files"]
    cut = next(name for name, kind in kinds.items() if kind == "cut")
    assert set(locked) == {"categories.json", *(f"{name}.zip" for name in kinds if name != cut)}
    rows = {row.recording: row for row in TriageFile.read(root / "triage").rows}
    assert set(rows) == set(kinds) - {cut}
    decisions = {kinds[name]: row.decision for name, row in rows.items()}
    assert decisions["good"] != "reject" and decisions["person"] != "accept"
    flow = ReleaseInfo.read(root / "benchmark").flow
    assert flow is not None and flow.tried == 3
    assert json.loads((root / "scores" / "partial" / "scores.json").read_text())
