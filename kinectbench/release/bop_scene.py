"""A recording's views as a BOP scene."""

import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.errors import ReleaseError
from kinectbench.geometry import Camera, invert_rigid
from kinectbench.release.bop_masks import ObjectInView, object_in_view
from kinectbench.release.bop_model import MM_PER_M, BopModel
from kinectbench.release.metadata import strict_json
from kinectbench.release.release import Release, Target
from kinectbench.segmentation.render import DepthRenderer
from kinectbench.voxels.npz import UNREADABLE
from kinectbench.workspace import pretty_json


def write_scene(
    release: Release,
    targets: Sequence[Target],
    folder: Path,
    obj_id: int,
    model: BopModel | None,
    step: Callable[[], None],
) -> Camera:
    """Write one scene: depth/, rgb/ if colour lies on depth, masks, and its JSON files.

    Args:
        release: opened.
        targets: the pairs of one recording; the image's number is the view's.
        folder: of the scene, to be made.
        obj_id: of the recording's object.
        model: the object, or None if its truth is held back: then there is no ground truth.
        step: called after each view.

    Returns:
        The camera of the last view.

    Raises:
        ReleaseError: a file of the release is missing or damaged.
    """
    renderer = None if model is None else DepthRenderer(model.mesh)
    colored = _color_registered(release, targets[0].recording)
    cameras: dict[str, Any] = {}
    poses: dict[str, Any] = {}
    infos: dict[str, Any] = {}
    for target in targets:
        image = int(target.view)
        source = f"views/{target.recording}/{target.view}"
        png = release.content(f"{source}.depth.png")
        _write(folder / "depth" / f"{image:06d}.png", png)
        if colored and f"{source}.color.jpg" in release.sums:
            _write(folder / "rgb" / f"{image:06d}.jpg", release.content(f"{source}.color.jpg"))
        K, T_world_camera = _camera(release, target)
        depth_mm = _depth_mm(png, f"{source}.depth.png")
        camera = Camera(depth_mm.shape[1], depth_mm.shape[0], K[0, 0], K[1, 1], K[0, 2], K[1, 2])
        cameras[str(image)] = {"cam_K": K.ravel().tolist(), "depth_scale": 1.0}
        if model is not None and renderer is not None:
            cameras[str(image)] |= _rigid_mm(invert_rigid(T_world_camera), "w2c")
            T_camera_model = invert_rigid(T_world_camera) @ model.T_world_model
            poses[str(image)] = [{**_rigid_mm(T_camera_model, "m2c"), "obj_id": obj_id}]
            seen = object_in_view(depth_mm, camera, T_world_camera, model.mesh, renderer)
            infos[str(image)] = [_info(seen)]
            for name, mask in (("mask", seen.mask), ("mask_visib", seen.mask_visib)):
                _write(folder / name / f"{image:06d}_000000.png", _mask_png(mask))
        step()
    (folder / "scene_camera.json").write_text(pretty_json(cameras))
    if model is not None:
        (folder / "scene_gt.json").write_text(pretty_json(poses))
        (folder / "scene_gt_info.json").write_text(pretty_json(infos))
    return camera


def _rigid_mm(T: NDArray[np.float64], frames: str) -> dict[str, list[float]]:
    """A rigid transform in metres as BOP writes it: rotation row by row, translation in millimetres."""
    return {
        f"cam_R_{frames}": T[:3, :3].ravel().tolist(),
        f"cam_t_{frames}": (T[:3, 3] * MM_PER_M).tolist(),
    }


def _info(seen: ObjectInView) -> Mapping[str, Any]:
    """A row of scene_gt_info.json."""
    return {
        "bbox_obj": list(seen.bbox_obj),
        "bbox_visib": list(seen.bbox_visib),
        "px_count_all": seen.px_count_all,
        "px_count_valid": seen.px_count_valid,
        "px_count_visib": seen.px_count_visib,
        "visib_fract": seen.visib_fract,
    }


def _camera(release: Release, target: Target) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """K and T_world_camera of a pair; its grids are not unpacked."""
    try:
        with np.load(io.BytesIO(release.content(target.file)), allow_pickle=False) as pair:
            return pair["K"].reshape(3, 3), pair["T_world_camera"].reshape(4, 4)
    except UNREADABLE as error:
        raise ReleaseError(f"{release.pair_path(target)}: cannot be read as a pair ({error})") from error


def _color_registered(release: Release, recording: str) -> bool:
    """Whether the recording's colour lies on the pixels of depth, as BOP asks."""
    name = f"views/{recording}/views.json"
    if name not in release.sums:
        raise ReleaseError(f"{release.folder / name}: missing; BOP needs the depth images of the views")
    views = strict_json(release.content(name).decode(), name)
    return bool(views.get("color_registered")) if isinstance(views, dict) else False


def _depth_mm(png: bytes, where: str) -> NDArray[np.uint16]:
    import cv2

    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 2 or image.dtype != np.uint16:
        raise ReleaseError(f"{where}: not a PNG of 16-bit depth")
    return np.asarray(image, dtype=np.uint16)


def _mask_png(mask: NDArray[np.bool_]) -> bytes:
    import cv2

    return bytes(cv2.imencode(".png", mask.astype(np.uint8) * 255)[1].tobytes())


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
