"""Loaders of methods of today, written anew from notes on their code: what each makes of a folder.

Each gives points in the camera (x right, y down, z forward), metres, and keeps to what its method's own
loader reads: nothing here looks into camera.json.
"""

import json
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from read_pictures import read_picture

Points = NDArray[np.float64]


def _image(path: Path) -> NDArray[np.integer]:
    image = read_picture(path, cv2.IMREAD_UNCHANGED)
    assert image.ndim == 2
    return image


def _backprojected(depth_m: Points, mask: NDArray[np.integer], K: Points) -> Points:
    v, u = np.nonzero((mask > 0) & (depth_m > 0))
    z = depth_m[v, u]
    return np.stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z], axis=1)


def rayst3r(folder: Path) -> Points:
    """`eval_wrapper/eval.py`: depth is v * 10 / 65535 m; 640 x 480 or else stretched; no cam2world.pt."""
    depth, mask = _image(folder / "depth.png"), _image(folder / "mask.png")
    K = torch.load(folder / "intrinsics.pt", weights_only=True)
    assert depth.dtype == np.uint16 and depth.shape == mask.shape == (480, 640) and K.shape == (3, 3)
    assert K.dtype == torch.float32 and not (folder / "cam2world.pt").exists()
    depth_m = depth.astype(np.float64) * 10 / 65535
    depth_m[depth_m <= 0.1] = 0
    return _backprojected(depth_m, mask, K.numpy().astype(np.float64))


def octmae(folder: Path) -> tuple[Points, NDArray[np.bool_]]:
    """`demo.py`: depth in mm, K from cam_K; and which points its cube of 1,280 mm holds."""
    depth, mask = _image(folder / "depth.png"), _image(folder / "mask.png")
    assert depth.dtype == np.uint16 and depth.shape == mask.shape == (480, 640)
    K = np.array(json.loads((folder / "intrinsics.json").read_text())["cam_K"]).reshape(3, 3)
    mm = _backprojected(depth.astype(np.float64), mask, K)
    z_min = np.floor(mm[:, 2].min() / 40) * 40 - 200
    held = (np.abs(mm[:, :2]) < 640).all(axis=1) & (mm[:, 2] >= z_min) & (mm[:, 2] < z_min + 1280)
    return mm / 1000, held


def sam3d(folder: Path) -> Points:
    """`Inference(image, mask, pointmap=...)`: float32, PyTorch3D's camera (-x, -y, z), NaN = none."""
    pointmap, mask = np.load(folder / "pointmap.npy"), _image(folder / "mask.png")
    assert pointmap.dtype == np.float32 and pointmap.shape == (*mask.shape, 3)
    points = pointmap[(mask > 0) & np.isfinite(pointmap).all(axis=2)]
    sam3d: Points = points.astype(np.float64) * [-1, -1, 1]
    return sam3d


def pointr(folder: Path) -> tuple[Points, Points, float]:
    """`tools/inference.py`: (n, 3) points, centred and divided by the largest norm; and these two."""
    points = np.load(folder / "points.npy").astype(np.float32)
    assert points.ndim == 2 and points.shape[1] == 3
    center = points.mean(axis=0)
    norm = float(np.sqrt(((points - center) ** 2).sum(axis=1)).max())
    return ((points - center) / norm).astype(np.float64), center.astype(np.float64), norm


def patchcomplete(path: Path) -> NDArray[np.float32]:
    """`tsdf` of 32^3, times 32: voxels, clipped at 2.5."""
    tsdf = np.load(path)["tsdf"]
    assert tsdf.shape == (32, 32, 32) and tsdf.dtype == np.float32
    patchcomplete: NDArray[np.float32] = np.clip(tsdf * 32, -2.5, 2.5)
    return patchcomplete
