"""`compare-truth` as a user gives it: right and wrong meshes of two built recordings."""

import json
from collections.abc import Callable
from pathlib import Path
from shutil import copy

import pytest
from scipy.spatial.transform import Rotation
from small_benchmark import Run, copied

from kinectbench.core.artefacts.reference import ReferenceFile
from kinectbench.core.geometry import rigid
from kinectbench.core.geometry.mesh import write_ply
from kinectbench.lab.simulate.truth import read_truth

Command = Callable[..., Run]


@pytest.fixture(scope="module")
def root(small: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy with the true meshes in another frame, in meshes/."""
    root = copied(small, tmp_path_factory.mktemp("compare") / "small")
    (root / "meshes").mkdir()
    T = rigid(Rotation.random(random_state=3).as_matrix(), [0.5, 1.0, -2.0])
    for name in ("chair", "table"):
        mesh = read_truth(root / "recordings" / f"{name}.truth").mesh_world
        write_ply(mesh.transformed(T), root / "meshes" / f"{name}.ply")
    (root / "meshes/flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    (root / "meshes/points.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
        "end_header\n0 0 1\n"
    )
    return root


def test_right_meshes_of_a_folder_are_compared(command: Command, root: Path) -> None:
    run = command(root, "compare-truth", "--references", "meshes", "--json")
    assert run.status == 0, run.err
    found = json.loads(run.out)
    assert set(found) == {"chair", "table"}
    for name, each in found.items():
        compared = each.pop("compared")
        assert compared == {key: each[key] for key in ("reference", "sha256", "refused")}
        assert json.loads((root / "build" / name / "reference.json").read_text()) == each
        assert each["refused"] is None and each["reference"] == f"meshes/{name}.ply"
        assert each["f_score_10mm"] > 0.8 and abs(each["scale"] - 1) < 0.02
    # Voxels of 15 mm and 24 frames of 160 x 120 pixels make a chair too thick.
    assert found["chair"]["iou"] > 0.6


def test_a_truth_beside_itself_is_said_to_be_so(command: Command, root: Path) -> None:
    """Its F of 1 proves nothing, and takes nobody's place."""
    folder = root / "build/chair"
    (folder / "reference.json").unlink(missing_ok=True)
    run = command(root, "compare-truth", "chair", "--reference", "build/chair/object/mesh.ply")
    assert run.status == 0, run.err
    assert (
        "note: chair: build/chair/object/mesh.ply is this very truth: it is compared with itself" in run.err
    )
    found = ReferenceFile.read(folder)
    assert found.itself and found.f_score_10mm == 1.0 and found.info.json_value()["itself"] is True
    other = command(root, "compare-truth", "chair", "--reference", "meshes/chair.ply", "--json")
    assert "itself" not in other.err and "itself" not in json.loads(other.out)["chair"]
    assert "itself" not in ReferenceFile.read(folder).info.json_value()
    command(root, "compare-truth", "chair", "--reference", "build/chair/object/mesh.ply")
    found = ReferenceFile.read(folder)
    assert [Path(each.reference).name for each in found.all] == ["chair.ply", "mesh.ply"]
    assert not found.itself


def _table_decision(command: Command, root: Path) -> tuple[str, str]:
    command(root, "triage")
    rows = json.loads((root / "triage/triage.json").read_text())["rows"]
    (row,) = [row for row in rows if row["recording"] == "table"]
    return row["decision"], "; ".join(row["reasons"])


def test_a_wrong_mesh_is_refused_and_triage_says_look(command: Command, root: Path) -> None:
    run = command(root, "compare-truth", "table", "--reference", "meshes/chair.ply")
    assert run.status == 1
    assert "error: table: meshes/chair.ply is refused: " in run.err and "Traceback" not in run.err
    decision, reasons = _table_decision(command, root)
    assert decision == "look" and "its reference meshes/chair.ply does not fit: " in reasons


def test_a_refusal_keeps_the_mesh_that_fits(command: Command, root: Path) -> None:
    file = root / "build/table/reference.json"
    file.unlink(missing_ok=True)
    assert command(root, "compare-truth", "table", "--reference", "meshes/table.ply").status == 0
    good = json.loads(file.read_text())
    assert "others" not in good
    # A file of before this rule is read, and its mesh is kept.
    run = command(root, "compare-truth", "table", "--reference", "meshes/chair.ply")
    assert run.status == 1 and "meshes/table.ply" in run.out and "F: of the surface" in run.out
    assert "error: table: meshes/chair.ply is refused: " in run.err
    whole = json.loads(file.read_text())
    (other,) = whole.pop("others")
    assert whole == good and other["reference"] == "meshes/chair.ply" and other["refused"]
    decision, reasons = _table_decision(command, root)
    assert decision == "look" and "its reference meshes/chair.ply does not fit: " in reasons
    # Once more the good one: each stands there once, and the refusal is told.
    run = command(root, "compare-truth", "table", "--reference", "meshes/table.ply")
    assert run.status == 0 and "note: table: meshes/chair.ply is refused: " in run.err
    both = ["meshes/table.ply", "meshes/chair.ply"]
    assert [each.reference for each in ReferenceFile.read(file.parent).all] == both
    # Of an object that was built before nothing is kept.
    file.write_text(json.dumps({**good, "object_fingerprint": "older"}))
    command(root, "compare-truth", "table", "--reference", "meshes/chair.ply")
    assert [each.reference for each in ReferenceFile.read(file.parent).all] == ["meshes/chair.ply"]


def test_meshes_of_one_name_are_told_apart(command: Command, root: Path) -> None:
    """As those of simulated recordings are, which are all called object.ply; a release has the name alone."""
    for name in ("chair", "table"):
        (root / f"{name}.truth").mkdir()
        copy(root / f"meshes/{name}.ply", root / f"{name}.truth/object.ply")
    (root / "build/table/reference.json").unlink(missing_ok=True)
    good = str(root / "table.truth/object.ply")
    assert command(root, "compare-truth", "table", "--reference", good).status == 0
    text = command(root, "compare-truth", "table", "--reference", "chair.truth/object.ply")
    assert "error: table: chair.truth/object.ply is refused: " in text.err
    assert "table.truth/object.ply" in text.out and str(root) not in text.out
    again = command(root, "compare-truth", "table", "--reference", "chair.truth/object.ply", "--json")
    found = json.loads(again.out)["table"]
    assert found["reference"] == "table.truth/object.ply" and found["refused"] is None
    assert found["compared"]["reference"] == "chair.truth/object.ply" and found["compared"]["refused"]
    assert ReferenceFile.read(root / "build/table").info.reference == "object.ply"


def test_some_refused_is_another_status_than_all(command: Command, root: Path) -> None:
    (root / "mixed").mkdir()
    for name in ("chair", "table"):
        copy(root / "meshes/chair.ply", root / f"mixed/{name}.ply")
    run = command(root, "compare-truth", "--references", "mixed", "--json")
    assert run.status == 3 and "error: table: mixed/table.ply is refused: " in run.err


def test_recordings_without_a_mesh_are_named(command: Command, root: Path) -> None:
    (root / "some").mkdir()
    write_ply(read_truth(root / "recordings/chair.truth").mesh_world, root / "some/chair.ply")
    run = command(root, "compare-truth", "--references", "some", "--json")
    assert run.status == 0 and list(json.loads(run.out)) == ["chair"]
    assert "note: table: no mesh of it in some" in run.err


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (("chair",), 2, "give --reference MESH of one recording, or --references FOLDER"),
        (("--reference", "meshes/chair.ply"), 2, "name the one recording that the mesh is of"),
        (("--references", "nowhere"), 1, "no such folder"),
        (("--references", "recordings"), 1, "holds no mesh named as a recording or its object"),
        (("chair", "--reference", "benchmark.yaml"), 1, "save it as .ply"),
        (("chair", "--reference", "no.ply"), 1, "no.ply"),
        (("chair", "--reference", "meshes/flat.obj"), 1, "its faces have no area"),
        (("chair", "--reference", "meshes/points.ply"), 1, "no mesh, as it has no faces"),
    ],
)
def test_what_cannot_be_used_is_one_line(
    command: Command, root: Path, arguments: tuple[str, ...], status: int, said: str
) -> None:
    run = command(root, "compare-truth", *arguments)
    assert (run.status, run.out) == (status, "")
    errors = [line for line in run.err.splitlines() if line.startswith("error")]
    assert len(errors) == 1 and said in errors[0]
