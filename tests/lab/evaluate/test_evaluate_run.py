"""From folders to evaluation.json, pictures and a page."""

import io
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from known_builds import T_WORLD_OBJECT, Known, write_build
from raising import raises
from read_pictures import read_picture
from rich.console import Console

from kinectbench.core.errors import KinectBenchError, RecordingError, StorageError
from kinectbench.core.geometry import OrientedBox
from kinectbench.core.geometry.mesh import box_mesh
from kinectbench.engine.artefact import VERSIONS
from kinectbench.lab.evaluate.build import read_build
from kinectbench.lab.evaluate.evaluation import Evaluation, evaluate, evaluation_json
from kinectbench.lab.evaluate.run import evaluate_recording, make_page
from kinectbench.lab.evaluate.solid import check_fills_cells
from kinectbench.lab.evaluate.table import evaluation_table, sections
from kinectbench.lab.simulate.truth import Truth, read_truth, write_truth

PICTURES = {"path", "meshes", "errors", "slices"}
STAGES = ("trajectory", "object", "views", "pairs")


@pytest.fixture(scope="module")
def folders(perfect: Known, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A perfect build and its truth on disk; not to be changed."""
    build = tmp_path_factory.mktemp("build") / "chair<01>"
    write_build(perfect, build)
    write_truth(perfect.truth, {})
    return build, perfect.truth.folder


@pytest.fixture(scope="module")
def written(folders: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Evaluation, Path]:
    out = tmp_path_factory.mktemp("out") / "chair"
    return evaluate_recording(*folders, out), out


def test_perfect_through_the_disk(written: tuple[Evaluation, Path]) -> None:
    evaluation, out = written
    found = json.loads((out / "evaluation.json").read_text())
    assert found["format_version"] == 2
    # Vertices on disk are float32: 0.1 um.
    assert found["trajectory"]["error"]["ate_m"]["rmse"] < 1e-9
    assert found["surface"]["whole"]["accuracy"]["mean_m"] < 1e-6
    assert [score["f"] for score in found["surface"]["whole"]["scores"]] == [1, 1]
    assert found["solid"]["fine"]["iou"] > 0.9999
    assert found["solid"]["coarse"]["known_iou"] > 0.999
    assert found["solid"]["fine"]["true_unknown_share"] == 0
    assert found["solid"]["known_gross_share"] == found["solid"]["calibration_error"] == 0
    assert found["solid"]["unknown_near_measured"] == {"solid": 0, "air": 0}
    assert [row["count"] > 0 for row in found["solid"]["calibration_bins"]] == [True] * 10
    # Of the underside, 0.42 m above the floor, no camera saw anything.
    assert max(abs(found["solid"]["face_bias_m"][side]) for side in ("up", "side")) < 1e-6
    assert found["solid"]["face_bias_m"]["down"] is None
    assert found["solid"]["estimated_iou"] is found["solid"]["iou_in_interval"] is None
    assert found["solid"]["estimated_known_iou"] is found["solid"]["known_iou_in_interval"] is None
    assert [score["f"] for score in found["scene"]["visible"]["scores"]] == [1, 1]
    assert found["masks"]["mean_valid_iou"] == found["masks"]["mean_iou"] == 1
    assert found["pairs"]["iou"]["worst"] > 0.9999
    assert found["pairs"]["containment"]["worst"] == 1
    assert abs(found["floor"]["height_m"]) < 1e-6
    assert len(found["pairs"]["rows"]) == len(found["masks"]["rows"]) == 5
    assert evaluation.pairs and evaluation.pairs.iou
    assert found["pairs"]["iou"]["mean"] == pytest.approx(evaluation.pairs.iou.mean, rel=1e-6)


def test_a_pair_of_which_nothing_is_known_stands_on_the_page(written: tuple[Evaluation, Path]) -> None:
    evaluation, _ = written
    assert evaluation.pairs
    unknown = replace(evaluation.pairs.rows[0], known_iou=None)
    pairs = replace(evaluation.pairs, rows=(unknown, *evaluation.pairs.rows[1:]))
    page = make_page("chair", replace(evaluation, pairs=pairs), {})
    assert f"<td>{unknown.iou:.4f}</td><td>–</td>" in page


def test_pictures_show_what_they_should(written: tuple[Evaluation, Path]) -> None:
    _, out = written
    assert {path.stem for path in out.glob("*.png")} == PICTURES
    for name in PICTURES:
        image = read_picture(out / f"{name}.png")
        assert image is not None and min(image.shape[:2]) > 300
    slices = read_picture(out / "slices.png")[:-80, :, ::-1].reshape(-1, 3).astype(int)
    # Grey where true and built agree; nothing is missing, too much or unknown (above the legend).
    assert (np.abs(slices - (176, 172, 164)).max(axis=1) < 3).sum() > 5000
    for color in ((43, 108, 180), (200, 70, 40), (249, 231, 178)):
        assert (np.abs(slices - color).max(axis=1) < 3).sum() == 0


def test_the_page_opens_alone(written: tuple[Evaluation, Path]) -> None:
    _, out = written
    page = (out / "index.html").read_text()
    assert set(re.findall(r'src="(.{0,22})', page)) == {"data:image/png;base64,"}
    assert page.count("<img") == len(PICTURES)
    assert "chair&lt;01&gt;" in page
    assert "chair<01>" not in page
    assert "href=" not in page.partition("<body>")[2]
    assert "http:" not in page and "https:" not in page
    for text in ("chair of boxes", "F at 5 mm, all", "containment of the partial, mean", "<td>1.0000</td>"):
        assert text in page


def test_the_same_again(written: tuple[Evaluation, Path], folders: tuple[Path, Path], tmp_path: Path) -> None:
    _, out = written
    shutil.copytree(out, tmp_path / "again")
    (tmp_path / "again" / "slices.png").write_text("of an earlier run")
    evaluate_recording(*folders, tmp_path / "again")
    again = {path.name: path.read_bytes() for path in (tmp_path / "again").iterdir()}
    assert again == {path.name: path.read_bytes() for path in out.iterdir()}
    assert [path.name for path in tmp_path.iterdir()] == ["again"]


@pytest.fixture(scope="module")
def true(folders: tuple[Path, Path]) -> Truth:
    """What is seeable of it is found once."""
    return read_truth(folders[1])


@pytest.mark.parametrize("built", range(len(STAGES)))
def test_later_stages_may_be_missing(
    built: int, folders: tuple[Path, Path], true: Truth, tmp_path: Path
) -> None:
    build = folders[0]
    for stage in ("sequence", "reconstruction", *STAGES[:built]):
        shutil.copytree(build / stage, tmp_path / stage)
    evaluation = evaluate(read_build(tmp_path), true)
    found = evaluation_json(evaluation)
    there = [found[key] is not None for key in ("trajectory", "solid", "masks", "pairs")]
    assert there == [number < built for number in range(4)]
    assert (found["surface"] is None) == (found["floor"] is None) == (found["solid"] is None)
    missing = [section.title for section in sections(evaluation) if not section.rows]
    # Of this build nothing was measured: its labels are of a solid seen by nobody.
    assert len(missing) == [9, 7, 3, 2][built]
    assert printed(evaluation).count("not built") == len(missing)


def test_what_is_not_current_is_not_evaluated(
    folders: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(folders[0], tmp_path / "build")
    whole = read_build(tmp_path / "build")
    assert whole.trajectory and whole.model and whole.views and whole.pair_names
    depth = tmp_path / "build" / "views" / "002.depth.png"
    depth.write_bytes(depth.read_bytes()[:-1])
    cut = read_build(tmp_path / "build")
    assert cut.trajectory and cut.model and cut.views is None and cut.pair_names is None
    monkeypatch.setitem(VERSIONS, "segment", VERSIONS["segment"] + 1)
    other = read_build(folders[0])
    assert other.trajectory and (other.model, other.views, other.pair_names) == (None, None, None)
    (tmp_path / "build" / "trajectory" / "manifest.json").unlink()
    assert read_build(tmp_path / "build").trajectory is None


@pytest.mark.parametrize("size_m", [(1.5, 0.5, 0.004), (1.5, 0.004, 0.9)])
def test_an_object_between_two_layers_of_cells_is_refused_at_once(
    size_m: tuple[float, float, float], folders: tuple[Path, Path], tmp_path: Path
) -> None:
    """A pane or a sign; 6 mm are a cell."""
    truth = tmp_path / "thin.truth"
    shutil.copytree(folders[1], truth)
    known = read_truth(truth)
    x, y, z = size_m
    thin, thick = (
        replace(
            known, mesh_world=box_mesh(OrientedBox((0, 0, size[2] / 2), size)).transformed(T_WORLD_OBJECT)
        )
        for size in (size_m, (x, max(y, 0.007), max(z, 0.007)))
    )
    check_fills_cells(thick)
    write_truth(thin, {})
    with raises(RecordingError, "recording.bad-mesh", match=r"thin\.truth: .* than a cell \(6\.0 mm\)"):
        evaluate_recording(folders[0], truth, tmp_path / "out")


def test_the_page_of_a_trajectory_alone(folders: tuple[Path, Path], tmp_path: Path) -> None:
    build, truth = folders
    for stage in ("sequence", "trajectory"):
        shutil.copytree(build / stage, tmp_path / "build" / stage)
    evaluate_recording(tmp_path / "build", truth, tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "evaluation.json", "index.html", "path.png",
    }  # fmt: skip
    page = (tmp_path / "out" / "index.html").read_text()
    assert page.count("not built") == 8
    assert page.count("<img") == 1


def printed(evaluation: Evaluation) -> str:
    console = Console(width=120, file=io.StringIO(), record=True)
    console.print(evaluation_table(evaluation))
    return console.export_text()


def test_the_estimated_iou_is_rounded_as_the_build_says_it(written: tuple[Evaluation, Path]) -> None:
    evaluation = written[0]
    assert evaluation.solid is not None
    for low, high, words in ((None, None, "0.808"), (0.4309, 1.0, r"0\.81 \(0\.43 to 1\.00\)")):
        solid = replace(
            evaluation.solid, estimated_iou=0.8078, estimated_iou_low=low, estimated_iou_high=high
        )
        assert re.search(rf"estimated IoU +│ +{words} │", printed(replace(evaluation, solid=solid)))


def test_the_table(written: tuple[Evaluation, Path]) -> None:
    text = printed(written[0])
    for line in (
        r"F at 10 mm, seen +│ +100\.0 │ %",
        r"ATE, rmse +│ +0\.00 │ mm",
        r"frames tracked +│ +60 of 60",
    ):
        assert re.search(line, text), line


def test_bad_input_is_one_line(folders: tuple[Path, Path], tmp_path: Path) -> None:
    build, truth = folders
    shutil.copytree(build, tmp_path / "build")
    cases: list[tuple[type[KinectBenchError], Path, Path, str]] = [
        (StorageError, tmp_path / "nowhere", truth, "nothing was built there"),
        (RecordingError, build, tmp_path / "nowhere", "no readable truth"),
    ]
    depth = tmp_path / "build" / "views" / "002.depth.png"
    depth.write_bytes(b" " * depth.stat().st_size)
    cases.append((StorageError, tmp_path / "build", truth, "002.depth.png"))
    for error, built, true, words in cases:
        with pytest.raises(error, match=words) as caught:
            evaluate_recording(built, true, tmp_path / "out")
        assert "\n" not in str(caught.value)
    (tmp_path / "build" / "sequence" / "camera.json").unlink()
    with raises(StorageError, "storage.not-built"):
        evaluate_recording(tmp_path / "build", truth, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    for beside in ("", "evaluation.json"):
        if beside:
            (tmp_path / "mine" / beside).write_text("{}")
        with raises(StorageError, "storage.other-content"):
            evaluate_recording(build, truth, tmp_path / "mine")
    assert (tmp_path / "mine" / "thesis.txt").read_text() == "years of work"
