"""Examples of adapters: a mesh, points and cells go from exported views to scores, as the guide says."""

import runpy
from pathlib import Path

import pytest

from kinectbench.core.artefacts.scores import OVERALL
from kinectbench.release.exchange.rgbd import export_rgbd
from kinectbench.release.release import Release, open_release
from kinectbench.scoring.camera_predictions import check_camera
from kinectbench.scoring.method_json import read_in_camera
from kinectbench.scoring.score import score

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def release(analytic: Path) -> Release:
    return open_release(analytic / "benchmark")


@pytest.fixture(scope="module")
def views(release: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported") / "views"
    export_rgbd(release, folder)
    return folder


@pytest.mark.parametrize(("form", "solid"), [("mesh", True), ("points", False), ("voxels", True)])
def test_an_example_passes_check_and_is_scored(
    release: Release, views: Path, tmp_path: Path, form: str, solid: bool
) -> None:
    folder = tmp_path / form
    runpy.run_path(str(EXAMPLES / f"adapt_{form}.py"))["main"](views, folder)
    method = read_in_camera(folder)
    assert method is not None and method.form == form
    problems, notes = check_camera(release, folder, method)
    assert problems == [] and "median distance" in notes[0]
    table = score(release, folder, method=form, protocols=["camera"])
    overall = table.averages("camera")[OVERALL]
    assert table.complete and (overall.iou is not None) == solid
    # What was measured lies on the object; the rest is a guess of three lines.
    assert overall.chamfer_l1_m is not None and overall.chamfer_l1_m < 0.15
    assert f"adapt_{form}.py" in (EXAMPLES.parent / "docs" / "add-your-method.md").read_text(encoding="utf-8")
