"""Simulated objects in the layout of YCB's Berkeley RGB-D data, with the mesh of each in its place."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.spatial.transform import Rotation

from kinectbench.core.geometry import TriangleMesh, rigid, rotation_from_quaternion_xyzw
from kinectbench.core.geometry.mesh import write_ply
from kinectbench.core.types import Float64
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.lab.simulate.truth import read_truth

# Where YCB's archive of Google's scanner has it.
MESH = "google_16k/nontextured.ply"


def make_thing(folder: Path, name: str, subject: str, **changed: Mapping[str, Any]) -> TriangleMesh:
    """A thing on a turntable in `folder/name`: depth, colour, masks, calibration, poses of the turntable.

    Returns:
        The exact mesh, in the world of the recording.
    """
    spec: dict[str, Any] = {
        "object": subject,
        "format": "ycb",
        "path": {"frames": 24, "moves": "turntable", "arc_rad": 6.2},
        "sensor": {"width": 160, "height": 120},
        "given": {"masks": True},
        "save_depth": False,
    }
    simulate(SimulationSpec.model_validate(spec | changed), folder / name)
    # The simulator writes where the camera stands; its truth is how the thing lies to the camera.
    for row in np.loadtxt(folder / f"{name}.truth" / "trajectory.txt"):
        pose = rigid(rotation_from_quaternion_xyzw(row[4:8]), row[1:4])
        with h5py.File(folder / name / "poses" / f"NP5_{int(row[0])}_pose.h5", "a") as file:
            file["H_table_from_reference_camera"][:] = pose
    return read_truth(folder / f"{name}.truth").mesh_world


def scanned(mesh: TriangleMesh, path: Path, seed: int) -> Float64:
    """Write a mesh as a scanner leaves it: in a frame of its own; returns its pose there (4, 4)."""
    T = rigid(Rotation.random(random_state=seed).as_matrix(), [0.3, -0.1, 0.2])
    path.parent.mkdir(parents=True, exist_ok=True)
    write_ply(mesh.transformed(T), path)
    return T
