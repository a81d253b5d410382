"""Things in YCB's layout, and a scanner's exact mesh of each in its place; beside right and wrong meshes."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from slow import first
from small_benchmark import Run

pytest.importorskip("h5py", reason="needs kinectbench[ycb]")
from typing import Any

from ycb_replica import MESH, make_thing, scanned

from kinectbench.core.artefacts.reference import ReferenceFile
from kinectbench.core.geometry import TriangleMesh, transform_points
from kinectbench.core.geometry.rigid import rotation_angle_rad
from kinectbench.core.types import Float64
from kinectbench.lab.evaluate.reference import solids_iou
from kinectbench.lab.simulate.objects import make_object
from kinectbench.stages.reference.judge import register_reference
from kinectbench.stages.reference.register import mirror_image, sampled
from kinectbench.stages.segment.object_model import read_object

Command = Callable[..., Run]
# As `fetch recipes/ycb` writes a recording.
BENCHMARK = """\
name: replica
license: CC-BY-4.0
recordings:
  - {{id: {name}_NP5, path: scans/{name}, category: thing, object: {name},
     segment_by: masks, trajectory: trust, camera: {{sensor: NP5}}}}
fusion: {{voxel_size_m: 0.004, scene_voxel_size_m: 0.03}}
views: {{count: 2, min_pixels: 60}}
"""
# 40 images of a turn, as small as keeps the bars.
SIZE: dict[str, dict[str, Any]] = {
    "path": {"frames": 40, "moves": "turntable", "arc_rad": 6.2},
    "sensor": {"width": 320, "height": 240},
}
# A vase and a bin have rotational symmetry. All but a shoe and an animal are their own mirror images.
THINGS = ("mug:0", "vase:1", "shoe:2", "bin:0", "toy_animal:2", "toy_car:1")
SYMMETRIC, MIRRORED = ("vase:1", "bin:0"), ("shoe:2", "toy_animal:2")


def off(wrong: Float64, mesh: TriangleMesh, symmetric: bool) -> tuple[float, float]:
    """How far a motion moves a thing: metres, degrees; of a symmetric one its axis, which is upright."""
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    far_m = float(np.linalg.norm(transform_points(wrong, middle[None])[0] - middle))
    tilt = float(np.arccos(min(1.0, wrong[2, 2])))
    return far_m, float(np.degrees(tilt if symmetric else rotation_angle_rad(wrong[:3, :3])))


def larger(mesh: TriangleMesh) -> TriangleMesh:
    return TriangleMesh(mesh.vertices * 1.05, mesh.faces)


@pytest.mark.parametrize("subject", first(1, THINGS))
def test_a_scanners_mesh_is_laid_onto_what_was_built(command: Command, subject: str, tmp_path: Path) -> None:
    family, _, seed = subject.partition(":")
    true = make_thing(tmp_path / "scans", family, f"{family}:seed={seed}", **SIZE)
    T = scanned(true, tmp_path / "scans" / family / MESH, THINGS.index(subject))
    (tmp_path / "benchmark.yaml").write_text(BENCHMARK.format(name=family))
    run = command(tmp_path, "compare-truth", "--references", "scans", "--jobs", "1")
    assert run.status == 0, run.err
    folder = tmp_path / "build" / f"{family}_NP5"
    found, model = ReferenceFile.read(folder), read_object(folder / "object")
    assert found.refused is None and found.T_world_reference is not None
    assert (found.symmetric_axis_floor is not None) == (subject in SYMMETRIC)
    far_m, turned_deg = off(found.T_world_reference @ T, true, subject in SYMMETRIC)
    assert far_m < 0.001 and turned_deg < 0.5
    exact = solids_iou(model, true)[1]
    assert found.iou == pytest.approx(exact, abs=0.01)
    other, _, its_seed = THINGS[THINGS.index(subject) - 1].partition(":")
    mesh = make_object(other, int(its_seed)).mesh
    wrong = [larger(true), TriangleMesh(mesh.vertices, mesh.faces)]
    if subject in MIRRORED:
        wrong.append(mirror_image(sampled(true)).mesh)
    assert all(register_reference(model, each).refused is not None for each in wrong)


@pytest.mark.slow
def test_of_a_bottle_that_was_fused_too_far_out_no_size_is_accepted(command: Command, tmp_path: Path) -> None:
    true = make_thing(tmp_path / "scans", "bottle", "bottle:seed=1", **SIZE)
    (tmp_path / "benchmark.yaml").write_text(BENCHMARK.format(name="bottle"))
    assert command(tmp_path, "segment", "--jobs", "1").status == 0
    model = read_object(tmp_path / "build/bottle_NP5/object")
    for mesh in (true, larger(true)):
        assert register_reference(model, mesh).refused is not None
