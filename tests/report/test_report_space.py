"""Methods that predict in the camera frame on the page: all figures that the terminal has, and pictures."""

import json
from io import StringIO
from pathlib import Path
from typing import cast

import analytic_release
import numpy as np
import pytest
from rich.console import Console

from kinectbench.cli.score_tables import PARTS_NOTE, space_lines
from kinectbench.core.artefacts.gallery import read_gallery
from kinectbench.core.artefacts.score_figures import Ceiling
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.release.release import Release, open_release
from kinectbench.report.gallery import read_pair_truth
from kinectbench.report.run import page_of_release, write_galleries
from kinectbench.report.space_table import space_table
from kinectbench.scoring.camera_shape import CameraShape, write_shape
from kinectbench.scoring.score import score_methods


def predict(release: Release, folder: Path, faces_left_out: int, size: float = 1.0, **keys: str) -> None:
    """The truth of each test view, open and of another size if that is asked."""
    for target in release.split("test"):
        shape = analytic_release.true_in_camera(target.recording, target.category, target.view)
        made = CameraShape("mesh", shape.points_m * size, shape.faces[faces_left_out:])
        write_shape(made, folder / target.name)
    (folder / "method.json").write_text(json.dumps({"name": folder.name, "frame": "camera"} | keys))


@pytest.fixture(scope="module")
def release(analytic: Path) -> Release:
    return open_release(analytic / "benchmark")


@pytest.fixture(scope="module")
def page(release: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A closed method, an open one, and one of free size."""
    root = tmp_path_factory.mktemp("space")
    predict(release, root / "predictions" / "closed", 0)
    predict(release, root / "predictions" / "open", 1)
    predict(release, root / "predictions" / "free", 0, 2.0, scale="free")
    tables = score_methods(release, root / "predictions", root / "scores")
    write_galleries(release, root / "predictions", tables, root / "scores", "half-pixel")
    return page_of_release(release, root / "scores")[0]


def test_the_page_has_what_the_terminal_has(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for words in ("CD-L1 as OctMAE, mm", "F as PCN", "CD-L1 as SDS, mm", "outside mask", "aligned-R+t+s"):
        assert words in text, words
    assert "free" in text and "by other papers" in text


def test_pictures_lie_where_the_truth_does(release: Release, page: Path) -> None:
    """A solid is the truth's; of an open mesh the cells at its surface; of a free size it is registered."""
    for name in ("closed", "open", "free"):
        gallery = read_gallery(page.parent / name / "scores.json")
        assert gallery is not None and set(gallery) == {target.name for target in release.split("test")}
        for target in release.split("test"):
            full, cells = unpack(read_pair_truth(release, target).full), unpack(gallery[target.name])
            near = sum(np.roll(full, by, axis) for axis in range(3) for by in (-1, 0, 1)) > 0
            assert cells.any() and (cells & near).sum() > 0.95 * cells.sum(), (name, target.name)
            if name != "open":
                assert (full & cells).sum() > 0.9 * (full | cells).sum()
    assert '"chamfer_m":' in page.read_text(encoding="utf-8")


def test_ceilings_and_empty_views_are_named_alike(release: Release, tmp_path: Path) -> None:
    """The terminal's table and the page's are made of one."""
    predict(release, tmp_path / "net", 0)
    first = release.split("test")[0]
    (tmp_path / "net" / f"{first.name}.ply").unlink()
    (table,) = score_methods(
        release, tmp_path / "net", tmp_path / "scores", protocols=["camera"], missing="empty"
    )
    with_ceiling = [
        type(row)(**vars(row) | {"ceiling": Ceiling(chamfer_l1_m=0.001, iou=0.9)}) for row in table.rows
    ]
    table = table.model_copy(update={"rows": tuple(with_ceiling)})
    beside = space_table([table.model_copy(update={"method": "hull", "baseline": True})])
    assert beside.groups["camera"][0][0] == "hull (baseline) (1 empty)"
    found = space_table([table])
    assert [name for name, _ in found.groups["camera"]] == ["net (1 empty)", "(ceiling)"]
    assert found.groups["camera"][1][1][0] == "0.0010"
    terminal = space_lines([table])
    assert [str(cell) for cell in terminal.columns[1].cells][:2] == ["net (1 empty)", "(ceiling)"]
    assert terminal.caption == "\n".join((*found.notes, PARTS_NOTE))
    # Nothing was declared to be cut: the column would be empty.
    assert (
        list(found.groups) == ["camera", "camera-visible", "camera-occluded"] and "cut" not in found.columns
    )
    # Only columns that are shown are explained.
    assert "outside mask" not in found.columns
    assert not any("cut:" in note or "outside mask:" in note for note in found.notes)
    assert {str(cell) for cell in terminal.columns[0].cells} == {"camera"}
    # Both of what names a line stands in each piece.
    narrow = Console(width=80, file=StringIO())
    narrow.print(terminal)
    pieces = cast(StringIO, narrow.file).getvalue().split("┏")[1:]
    assert len(pieces) > 1 and all(piece.count("net (1 empty)") == 1 for piece in pieces)
