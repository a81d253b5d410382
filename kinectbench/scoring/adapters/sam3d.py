"""SAM 3D Objects (Meta, 2025) predicts a mesh in a box of side 1, and its pose in PyTorch3D's camera frame.

Source: its repository, commit cf06676. `Inference(...)(image, mask, pointmap=...)` returns a dictionary.
`layout_post_optimization_utils.get_mesh` and `transforms_3d.compose_transform` place the mesh.
"""

from pathlib import Path

import numpy as np

from kinectbench.core import PredictionError
from kinectbench.core.geometry import rotation_from_quaternion_xyzw
from kinectbench.core.types import Float64
from kinectbench.core.voxels.npz import UNREADABLE, load_arrays
from kinectbench.release.exchange.rgbd import RgbdView, write_color, write_png
from kinectbench.release.release import Release
from kinectbench.scoring.adapters.adapter import Adapter
from kinectbench.scoring.camera_shape import FARTHEST_M, CameraShape, read_shape

# PyTorch3D's camera has x to the left and y up.
T_CAMERA_PYTORCH3D = np.diag([-1.0, -1.0, 1.0, 1.0])
# Maps row vectors of the GLB (y up) to the frame of the pose (z up).
FROM_GLB = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]).T
# File beside mesh.glb, written by np.savez: `rotation`, `translation` and `scale` of SAM 3D's dictionary.
POSE, POSE_BYTES = "pose.npz", 1 << 16


def write_sam3d(release: Release, view: RgbdView, folder: Path) -> tuple[RgbdView, dict[str, object]]:
    """Write a view as SAM 3D Objects reads it: image.png, mask.png and pointmap.npy.

    pointmap.npy is (height, width, 3) float32, metres, in PyTorch3D's camera frame (x left, y up). NaN means
    no depth. `release` is unused; other adapters need it.

    Returns:
        The view, and an entry for camera.json: `T_camera_method` (4, 4).
    """
    write_color(view, folder, "image.png")
    write_png(folder / "mask.png", view.mask.astype(np.uint8) * 255)
    np.save(folder / "pointmap.npy", view.pointmap_m * np.array([-1, -1, 1], np.float32))
    return view, {"T_camera_method": T_CAMERA_PYTORCH3D}


def read_sam3d(path: Path) -> CameraShape:
    """Read mesh.glb, and transform the mesh to PyTorch3D's camera frame by the pose in pose.npz beside it.

    Raises:
        PredictionError: one of the two files is missing or damaged.
    """
    scale, rotation, translation = _pose(path.with_name(POSE))
    mesh = read_shape(path, path.name)
    # PyTorch3D's transforms multiply row vectors.
    points = (mesh.points_m @ FROM_GLB * scale) @ rotation + translation
    return CameraShape("mesh", points, mesh.faces)


def _pose(path: Path) -> tuple[float, Float64, Float64]:
    """Read scale s, rotation R (3, 3), translation t (3,) from pose.npz; a row vector p becomes s p R + t."""
    advice = (
        f"save rotation, translation and scale of its output there: np.savez('{POSE}', rotation=..., ...)"
    )
    try:
        arrays = load_arrays(path, POSE_BYTES)
        parts = [arrays[key].astype(np.float64).ravel() for key in ("rotation", "translation", "scale")]
    except (ValueError, *UNREADABLE) as error:
        raise PredictionError(f"{POSE}: missing or cannot be read; {advice}") from error
    if [len(part) for part in parts[:2]] != [4, 3] or not len(parts[2]):
        raise PredictionError(f"{POSE}: not a quaternion (w, x, y, z), 3 numbers and a scale; {advice}")
    wxyz, translation, scale = parts
    if not all((np.abs(part) < FARTHEST_M).all() for part in parts) or not np.linalg.norm(wxyz) > 0:
        raise PredictionError(f"{POSE}: a number is not finite, or too large; {advice}")
    if not scale[0] > 0 or np.ptp(scale) > 1e-4 * scale[0]:
        raise PredictionError(f"{POSE}: scale must be > 0, and the same for all axes")
    return float(scale[0]), rotation_from_quaternion_xyzw(wxyz[[1, 2, 3, 0]]), translation


SAM3D = Adapter(write_sam3d, "mesh.glb", read_sam3d, "mesh", ("color", "depth", "mask"))
