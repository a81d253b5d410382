"""What methods of today write, faked from the known truth in each one's own convention.

Each takes points or a mesh in the camera (x right, y down, z forward), metres.
"""

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from todays_loaders import pointr as pointr_loader

Points = NDArray[np.float64]


def rayst3r(folder: Path, points: Points) -> None:
    """Binary .ply of doubles with colours, no normals, metres."""
    head = (
        f"ply\nformat binary_little_endian 1.0\ncomment by Open3D\nelement vertex {len(points)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
    )
    rows = np.zeros(len(points), np.dtype([("xyz", "<f8", 3), ("rgb", "u1", 3)]))
    rows["xyz"], rows["rgb"] = points, 77
    (folder / "inference_points.ply").write_bytes(head.encode() + rows.tobytes())


def octmae(folder: Path, points: Points, normals: Points) -> None:
    """A count, then `x y z 0 r g b`: millimetres; rgb / 255 = (normal + 1) / 2."""
    rgb = np.clip(np.rint((normals + 1) / 2 * 255), 0, 255).astype(int)
    lines = [
        f"{x:.4f} {y:.4f} {z:.4f} 0 {r} {g} {b}"
        for (x, y, z), (r, g, b) in zip(points * 1000, rgb, strict=True)
    ]
    (folder / "output.pts").write_text("\n".join([str(len(points)), *lines]) + "\n")


def sam3d(folder: Path, vertices: Points, faces: NDArray[np.int64], turn: int) -> None:
    """A mesh in a box of side 1 and its pose in PyTorch3D's camera, by row vectors; a y-up GLB.

    The pose is one of many that are right: `turn` chooses.
    """
    wxyz = np.random.default_rng(turn).normal(size=4)
    wxyz /= np.linalg.norm(wxyz)
    w, x, y, z = wxyz
    # `quaternion_to_matrix` of PyTorch3D, written out; row vectors are multiplied by it from the right.
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    in_pytorch3d = vertices * [-1, -1, 1]
    t = (in_pytorch3d.min(axis=0) + in_pytorch3d.max(axis=0)) / 2
    turned = (in_pytorch3d - t) @ np.linalg.inv(R)
    scale = 2 * np.abs(turned).max()
    z_up = turned / scale
    glb = z_up @ np.linalg.inv(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]).T)
    trimesh.Trimesh(glb, faces, process=False).export(folder / "mesh.glb")
    pose = {"rotation": wxyz[None], "translation": t[None], "scale": np.full((1, 3), scale)}
    np.savez(folder / "pose.npz", **{key: value.astype(np.float32) for key, value in pose.items()})


def pointr(folder: Path, points: Points, T_camera_method: Points) -> None:
    """fine.npy in the frame of the points that the loader read, which its own scaling leaves as they are."""
    _, center, norm = pointr_loader(folder)
    assert abs(norm - 1) < 1e-6 and np.abs(center).max() < 1e-6
    inside = (points - T_camera_method[:3, 3]) @ np.linalg.inv(T_camera_method[:3, :3]).T
    np.save(folder / "fine.npy", inside.astype(np.float32))


def patchcomplete(folder: Path, distances_m: NDArray[np.float64], edge_m: float) -> None:
    """`predicted_voxels` 32^3, in voxels."""
    voxels = np.clip(distances_m / (edge_m / 32), -2.5, 2.5).astype(np.float32)
    np.savez(folder / "000_pred.npz", predicted_voxels=voxels)
