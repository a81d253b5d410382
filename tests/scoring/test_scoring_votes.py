"""The votes of several predictions against the truth: tenths, expected calibration error, and the figure."""

import json
from dataclasses import replace
from pathlib import Path

import analytic_release
import numpy as np
import pytest

from kinectbench.core.artefacts.score_figures import Alignment
from kinectbench.release.release import open_release
from kinectbench.report.charts import calibration_charts
from kinectbench.scoring.camera.calibration import calibration_of
from kinectbench.scoring.camera_shape import CameraShape, write_shape
from kinectbench.scoring.read_table import read_table
from kinectbench.scoring.score import score


def test_calibrated_votes_have_no_error() -> None:
    """Of 5 predictions: with v votes, v of 5 cells are solid."""
    cells = np.array([1000, 50, 50, 50, 50, 50])
    exact = calibration_of(cells, np.array([0, 10, 20, 30, 40, 50]))
    assert exact is not None and exact.error == pytest.approx(0)
    assert exact.cells == (0, 50, 0, 50, 0, 50, 0, 50, 0, 50) and exact.said[1] == exact.true[1] == 0.2
    assert exact.said[0] is None and exact.true[0] is None
    never = calibration_of(cells, np.zeros(6, np.int64))
    assert never is not None and never.error == pytest.approx(0.6)  # the mean of 0.2, 0.4, ... 1
    assert calibration_of(np.array([7, 0, 0]), np.zeros(3, np.int64)) is None


def test_the_tenths_hold_every_share() -> None:
    """Of 100 predictions the share 0.3 is the last of its tenth, 0.31 the first of the next."""
    cells = np.zeros(101, np.int64)
    cells[[1, 10, 30, 31, 100]] = 1, 2, 3, 4, 5
    found = calibration_of(cells, cells)
    assert found is not None and found.cells == (3, 0, 3, 4, 0, 0, 0, 0, 0, 5)


def test_rows_of_the_mean_have_it_and_the_page_draws_it(analytic: Path, tmp_path: Path) -> None:
    release, folder = open_release(analytic / "benchmark"), tmp_path / "several"
    for target in release.split("test"):
        shape = analytic_release.true_in_camera(target.recording, target.category, target.view)
        for k, moved_m in enumerate((0.0, 0.02)):
            moved = CameraShape("mesh", shape.points_m + np.array([0, 0, moved_m]), shape.faces)
            write_shape(moved, folder / f"{target.name}.{k}")
    (folder / "method.json").write_text(json.dumps({"name": "several", "frame": "camera", "hypotheses": 2}))
    score(release, folder, method="several", protocols=["camera"]).write(tmp_path)
    table = read_table(tmp_path / "scores.json")
    for row in table.pairs("camera-mean-of-2"):
        of = row.calibration
        assert of is not None and of.said[4] == 0.5 and of.said[9] == 1 and 0 < of.error < 0.5
        # The first is the truth: whatever both have is solid; its whole is what it has alone, too.
        assert of.true[9] is not None and of.true[9] > 0.97
    assert all(row.calibration is None for row in table.rows if row.hypotheses is None)
    (chart,) = calibration_charts([table], "camera")
    assert "several: expected calibration error 0." in chart.svg and "solid in the truth" in chart.svg
    assert calibration_charts([table], "aligned-t+s") == ()
    found = Alignment(kind="t+s", scale=1.0, rotation_deg=0.0, translation_m=0.0, ok=True)
    ways = (found, replace(found, kind="R+t+s"))
    kinds = [replace(row, protocol="aligned", alignment=way) for way in ways for row in table.rows]
    aligned = table.model_copy(update={"rows": tuple(kinds)})
    assert len(calibration_charts([aligned], "aligned-t+s")) == 1  # as the page of predictions of free size
