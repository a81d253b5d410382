"""A reference mesh in place of a fused shape: exact in its place, and nothing of it unknown."""

import json
import struct
from dataclasses import replace
from pathlib import Path

import manifold3d
import numpy as np
import pytest
from raising import raises
from reference_models import drawn, model_of, moved

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.errors import KinectBenchError, RecordingError
from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.geometry.mesh import write_ply
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.core.voxels.solid import voxelize_solid
from kinectbench.stages.pairs import full_shape
from kinectbench.stages.reference.truth import read_reference, reference_as_truth
from kinectbench.stages.segment.object_model import read_object, write_object

# An L of three unlike edges: no turn leaves it as it is.
ARM, FOOT = manifold3d.Manifold.cube([0.12, 0.2, 0.5]), manifold3d.Manifold.cube([0.4, 0.2, 0.15])


def mesh_of(solid: manifold3d.Manifold) -> TriangleMesh:
    mesh = solid.to_mesh64()
    return TriangleMesh(np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, np.int32))


def written(mesh: TriangleMesh, folder: Path) -> Path:
    """The mesh in a frame of its own."""
    write_ply(moved(mesh, 21)[0], folder / "scan.ply")
    return folder / "scan.ply"


def test_the_mesh_takes_the_place_of_what_was_fused(tmp_path: Path) -> None:
    upright = mesh_of(ARM + FOOT)
    # What was fused is 5 mm too thick in one direction, and its lower part was not seen.
    fused = model_of(TriangleMesh(upright.vertices * [1.0, 1.025, 1.0], upright.faces), unknown_below_m=0.05)
    # Faces that look inwards are turned.
    inwards = TriangleMesh(upright.vertices, upright.faces[:, ::-1])
    found = reference_as_truth(fused, written(inwards, tmp_path))
    exact = model_of(upright).shape.mesh
    shape = found.shape
    inside = unpack(voxelize_solid(exact.vertices, exact.faces, shape.grid))
    # It was laid between both sides that are too far out: 2.5 mm, where the exact place is at one of them.
    assert (inside & shape.solid).sum() / (inside | shape.solid).sum() > 0.95
    assert shape.mesh.volume_m3 == pytest.approx(upright.volume_m3, rel=1e-4)
    assert set(np.unique(shape.labels)) == {Label.OTHER, Label.SURFACE, Label.INTERIOR}
    np.testing.assert_array_equal(np.isin(shape.labels, [Label.SURFACE, Label.INTERIOR]), shape.solid)
    assert all(known.known.all() for known in full_shape(found).known)
    truth, quality = found.quality.truth, found.quality
    assert truth is not None and truth.kind == "reference mesh" and truth.reference == "scan.ply"
    assert quality.estimated_iou is None and quality.unknown_share == 0 and quality.warnings == ()
    (tmp_path / "object").mkdir()
    write_object(found, tmp_path / "object")
    again = read_object(tmp_path / "object")
    assert again.quality.json_value() == quality.json_value()
    np.testing.assert_array_equal(again.shape.labels, shape.labels)


def test_what_lies_below_the_floor_is_kept(tmp_path: Path) -> None:
    """Nobody saw the lowest 4 cm of what a hand held: the floor is higher than the mesh reaches down."""
    whole = ARM + FOOT
    seen = model_of(mesh_of(whole.trim_by_plane((0.0, 0.0, 1.0), 0.04)))
    shape = reference_as_truth(seen, written(mesh_of(whole), tmp_path)).shape
    volume_m3 = int(shape.solid.sum()) * shape.grid.voxel_size_m**3
    assert volume_m3 == pytest.approx(whole.volume(), rel=0.01)


def test_of_a_box_the_other_pose_is_a_warning(tmp_path: Path) -> None:
    upright = mesh_of(manifold3d.Manifold.cube([0.5, 0.3, 0.4]))
    fused = replace(model_of(upright), surface_sigma_m=0.0025)
    quality = reference_as_truth(fused, written(upright, tmp_path)).quality
    turned, itself = quality.warnings
    assert "also fits turned by" in turned and quality.doubts == (turned, itself)
    # It lies on what was fused to a hundredth of that one's error: no other instrument measures so.
    assert "was it made of this recording?" in itself


@pytest.mark.parametrize(
    ("kind", "code"),
    [("open", "shape.open-mesh"), ("larger", "segmentation.other-mesh"), ("cut", "recording.bad-mesh")],
)
def test_a_mesh_that_does_not_do_is_refused_in_one_line(kind: str, code: str, tmp_path: Path) -> None:
    upright = drawn("chair:7")
    path = written(TriangleMesh(upright.vertices * (2.5 if kind == "larger" else 1), upright.faces), tmp_path)
    if kind == "open":
        write_ply(upright.keep_faces(np.arange(len(upright.faces)) > 0), path)
    if kind == "cut":
        path.write_bytes(path.read_bytes()[:-100])
    with raises(KinectBenchError, code, match="scan.ply") as caught:
        reference_as_truth(model_of(upright), path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("changed", ["translation", "matrix", "scale", "rotation", "byteStride"])
def test_a_glb_with_a_number_beyond_all_bounds_is_refused(changed: str, tmp_path: Path) -> None:
    huge = {"translation": 3, "matrix": 16, "scale": 3, "rotation": 4}
    node = {"mesh": 0} | ({changed: [10**400] * huge[changed]} if changed in huge else {})
    gltf: dict[str, object] = {
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 1}],
        "bufferViews": [{"byteStride": 10**30} if changed == "byteStride" else {}],
    }
    stated = json.dumps(gltf).encode()
    head = struct.pack("<4s4I", b"glTF", 2, 0, len(stated), 0x4E4F534A)
    path = tmp_path / "thing.glb"
    path.write_bytes(head + stated + struct.pack("<2I3f", 12, 0x4E4942, 0, 0, 0))
    with raises(RecordingError, "recording.bad-mesh"):
        read_reference(path)


def test_a_suffix_may_be_in_capitals(tmp_path: Path) -> None:
    scan = written(mesh_of(ARM), tmp_path)
    assert read_reference(scan.rename(tmp_path / "SCAN.PLY")).closed
