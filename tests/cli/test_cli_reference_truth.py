"""`reference` in benchmark.yaml: from a recording and its scanner's mesh to a release that is labelled so."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from slow import slow
from small_benchmark import YAML, Run, copied, hashes

from kinectbench.core.artefacts.benchmark import ReleaseInfo
from kinectbench.core.artefacts.manifest import Manifest
from kinectbench.core.geometry import Grid, rigid
from kinectbench.core.geometry.mesh import write_ply
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.core.voxels.solid import voxelize_solid
from kinectbench.lab.simulate.truth import read_truth
from kinectbench.release.release import open_release

Command = Callable[..., Run]
ROWS = "license: CC0-1.0\nsource: simulated\n"


@pytest.fixture
def root(small: Path, tmp_path: Path) -> Path:
    """A copy of the benchmark, and the chair's exact mesh in another frame."""
    root = copied(small, tmp_path / "small")
    T = rigid(Rotation.random(random_state=3).as_matrix(), [0.5, 1.0, -2.0])
    write_ply(read_truth(root / "recordings/chair.truth").mesh_world.transformed(T), root / "scan.ply")
    return root


def referenced(root: Path, name: str, mesh: str = "scan.ply") -> None:
    """Name the mesh as the truth of a recording."""
    rows = YAML.splitlines()
    at = next(i for i, row in enumerate(rows) if f"id: {name}," in row)
    rows[at] = rows[at].replace("}", f", reference: {mesh}}}")
    (root / "benchmark.yaml").write_text(ROWS + "\n".join(rows) + "\n")


def test_the_truth_of_a_recording_is_the_mesh(command: Command, root: Path) -> None:
    before = hashes(root / "build/table")
    referenced(root, "chair")
    assert "1 of 2 done" in command(root, "build", "--status").out
    run = command(root, "build", "--jobs", "1")
    assert run.status == 0, run.err
    assert "2 of 2 done" in command(root, "build", "--status").out
    # Another recording is as it was, and so are the stages that do not see the mesh.
    assert hashes(root / "build/table") == before
    assert "reference" in Manifest.read(root / "build/chair/object").inputs
    assert "reference" not in Manifest.read(root / "build/table/object").inputs
    exact = read_truth(root / "recordings/chair.truth").mesh_world
    for path in sorted((root / "build/chair/pairs").glob("*.npz")):
        with np.load(path) as pair:
            grid = Grid((256,) * 3, float(pair["voxel_size_m"]), pair["T_world_grid"])
            full, known = unpack(pair["full"]), unpack(pair["known"])
        inside = unpack(voxelize_solid(exact.vertices, exact.faces, grid))
        # Measured: 0.980; registered to what 24 frames of 160 x 120 pixels show in voxels of 15 mm. The fused
        # shape of that has 0.63.
        assert known.all() and (full & inside).sum() / (full | inside).sum() > 0.97
    run = command(root, "publish", "--allow-poor")
    assert run.status == 0, run.err
    folder = root / "benchmark"
    assert command(root, "verify", str(folder)).status == 0
    info = ReleaseInfo.read(folder)
    truth = info.recordings["chair"].quality.truth
    assert truth is not None and truth.kind == "reference mesh" and truth.reference == "scan.ply"
    assert {t.recording: t.truth for t in open_release(folder).targets} == {
        "chair": "reference mesh",
        "table": "",
    }
    table = json.loads((folder / "schemas/targets.csv.json").read_text())
    listed = json.loads((folder / "croissant.json").read_text())["recordSet"][0]["field"]
    columns = (folder / "targets.csv").read_text().splitlines()[0].split(",")
    assert [row["name"] for row in table["fields"]] == [row["name"] for row in listed] == columns
    assert columns[-1] == "truth" and table["fieldsMatch"] == "superset"
    run = command(root, "compare-truth", "chair", "--reference", "scan.ply")
    assert "scan.ply is this very truth: it is compared with itself" in run.err, run
    stated = json.loads((folder / "objects/chair/quality.json").read_text())
    assert stated["truth"]["kind"] == "reference mesh"
    assert "| truth |" in (folder / "README.md").read_text()
    assert info.settings.recordings and all("reference" not in row for row in info.settings.recordings)


@pytest.mark.parametrize(
    ("name", "mesh", "said"),
    [
        slow("table", "scan.ply", "scan.ply: the reference mesh does not fit the object"),
        ("chair", "gone.ply", "no such reference mesh; add it, or correct `reference` of 'chair'"),
        ("chair", "recordings", "recordings"),
    ],
)
def test_a_wrong_mesh_fails_its_recording_in_one_line(
    command: Command, root: Path, name: str, mesh: str, said: str
) -> None:
    referenced(root, name, mesh)
    run = command(root, "build", name, "--jobs", "1")
    assert run.status == 1 and "Traceback" not in run.err  # none was built
    errors = [line for line in run.err.splitlines() if "error: " in line]
    assert len(errors) == 1 and said in errors[0] and errors[0].startswith(f"{name}: error: ")
