"""`shell`: the surface alone as truth, on request; other protocols' rows keep their bytes."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_benchmark import Run
from typed import present

import kinectbench
from kinectbench.cli.score_tables import score_table
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.voxels.pair_file import read_pair, unpack
from kinectbench.release.release import Release
from kinectbench.report.paper_table import paper_tables
from kinectbench.scoring.protocols import PROTOCOLS
from kinectbench.scoring.read_table import read_table
from kinectbench.scoring.recheck import recheck
from kinectbench.scoring.score import score_methods

ASKED = ("paper", "known", "occluded", "shell")
SIDE = 64


@pytest.fixture(scope="module")
def scored(release: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Predictions of 64 cells a side, the shape moved, scored with `shell` and without."""
    root = tmp_path_factory.mktemp("shell")
    for target in release.targets:
        full = unpack(read_pair(release.pair_path(target)).full)
        path = root / "moved" / target.recording / f"{target.view}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, coarse(np.roll(full, 5, axis=2)))
    score_methods(release, root / "moved", root / "scores", protocols=ASKED)
    score_methods(release, root / "moved", root / "usual")
    return root


def coarse(full: np.ndarray) -> np.ndarray:
    step = len(full) // SIDE
    shares = full.reshape(SIDE, step, SIDE, step, SIDE, step).mean(axis=(1, 3, 5))
    return np.asarray(shares, np.float32)


def table_of(root: Path, folder: str = "scores") -> ScoreTable:
    return read_table(root / folder / "scores.json")


def test_its_truth_is_the_surface_alone(release: Release, scored: Path) -> None:
    """By numpy: every voxel counts, the prediction stays solid, thresholds are those of the solid truth."""
    from scipy.ndimage import zoom

    table = table_of(scored)
    for target in release.split("test"):
        pair = read_pair(release.pair_path(target))
        rows = {row.protocol: row for row in table.rows if row.pair == target.name}
        row, solid = rows["shell"], rows["paper"]
        coarse_y = np.load(scored / "moved" / target.recording / f"{target.view}.npy").astype(np.float64)
        y = zoom(coarse_y, 256 // SIDE, order=1, grid_mode=True, mode="nearest")
        shell = unpack(pair.shell)
        ce = -np.log(np.clip(np.where(shell, y, 1 - y), 1e-7, 1)).mean()
        found = y > row.threshold
        assert row.iou == pytest.approx((found & shell).sum() / (found | shell).sum(), abs=1e-5)
        assert row.recall == pytest.approx((found & shell).sum() / shell.sum(), abs=1e-5)
        assert row.ce == pytest.approx(ce, rel=1e-4)
        assert (row.coverage_voxels, row.coverage_shape) == (1.0, 1.0)
        assert present(row.iou) < present(solid.iou) and row.threshold == solid.threshold
        assert (row.chamfer_mm, row.unknown_share) == (solid.chamfer_mm, solid.unknown_share)
        # What the truth itself reaches at this side, at the best of the thresholds.
        best = zoom(coarse(shell).astype(np.float64), 256 // SIDE, order=1, grid_mode=True, mode="nearest")
        reached = max(((best > k / 20) & shell).sum() / ((best > k / 20) | shell).sum() for k in range(2, 19))
        assert row.ceiling_iou == pytest.approx(reached, abs=1e-4)


def test_it_changes_no_other_row(scored: Path) -> None:
    asked, usual = table_of(scored), table_of(scored, "usual")
    assert "shell" not in usual.settings.protocols and "shell" in PROTOCOLS
    assert [row for row in asked.rows if row.protocol != "shell"] == [*usual.rows]
    # Pairs weigh the same, as under `paper`.
    averages = asked.averages("shell")
    for category in {row.category for row in asked.rows}:
        own = [row.iou for row in asked.pairs("shell") if row.category == category]
        assert averages[category].iou == pytest.approx(np.mean([value or 0.0 for value in own]))


def test_it_is_rechecked_compared_and_scored_in_python(
    release: Release, scored: Path, command: Callable[..., Run]
) -> None:
    assert recheck(release, scored / "scores" / "scores.json", scored / "moved") == []
    scorer = kinectbench.Scorer(release.folder, method="moved", protocols=["shell"], surface=False)
    for target in release.split("validation") + release.split("test"):
        scorer.update(target.name, np.load(scored / "moved" / target.recording / f"{target.view}.npy"))
    ours = {row.pair: row.iou for row in table_of(scored).pairs("shell")}
    assert {row.pair: row.iou for row in scorer.result().rows} == ours
    page = command(
        scored, "report", "--scores", "scores", "--benchmark", str(release.folder), "--out", "page.html"
    )
    assert page.status == 0 and "Protocol “shell”" in (scored / "page.html").read_text(), page


def test_the_papers_real_table_stands_beside_both(scored: Path) -> None:
    """The paper does not say how solid its truth is; without `shell` all is as before."""
    solid, shell = paper_tables([table_of(scored)])
    assert shell.title == "all pairs, the surface alone as truth"
    assert len(solid.rows) == len(shell.rows) == 6 and solid.rows[1:] == shell.rows[1:]
    assert paper_tables([table_of(scored, "usual")]) == [solid]
    columns = score_table([table_of(scored)], published=True).columns
    headed = [str(c.header).splitlines()[-1] for c in columns if "0.208 / 0.153" in [*c.cells]]
    assert headed == ["paper", "shell"]
