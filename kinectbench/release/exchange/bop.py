"""A release as a BOP data set: a scene and an object model per recording, in millimetres."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinectbench.core import ReleaseError, images, pretty_json, write_below
from kinectbench.core.artefacts.targets import Target
from kinectbench.core.geometry import Camera, DepthRenderer, decimated, invert_rigid
from kinectbench.core.store.address import shown
from kinectbench.core.types import MM_PER_M, Float64, Progress, no_progress
from kinectbench.core.voxels.pair_file import SHARE_DECIMALS, unknown_share
from kinectbench.release import view_images
from kinectbench.release.exchange.bop_object import (
    BopModel,
    model_info,
    model_ply,
    object_in_view,
    read_bop_model,
)
from kinectbench.release.exchange.layouts import SPLIT_NAMES, new_folder, write_export_json
from kinectbench.release.exchange.rgbd import camera_of, color_registered, parts_of
from kinectbench.release.release import Release

# Pose errors are computed with simplified models, the toolkit's model type "eval" (5,000 vertices are chosen
# here; the data sets of BOP have some thousands). An object has one diameter, so models_info.json beside them
# is that of the full models.
MODELS, MODELS_EVAL, EVAL_TRIANGLES = "models", "models_eval", 10_000
# Keys of scene_gt_info.json.
GT_INFO = ("bbox_obj", "bbox_visib", "px_count_all", "px_count_valid", "px_count_visib", "visib_fract")
DATASET_INFO = """# {name}

Made by kinectbench of the release {identity}; licence of the data: {license}.

- A scene is a recording, an image one of its views; depth is in millimetres (`depth_scale` 1).
- Each recording has an object model of its own, fused from it: `obj_id` is the number of the scene, and
  `export.json` says which recording, object and category it is, and what share of its true shape in each
  image's cube nobody knows (`unknown_share`, in the order of `images`).
- `models_eval/` has the same models with at most 10,000 triangles, for the errors of poses.
- Model frame: the floor's axes, z up, the origin in the middle of the model's box; millimetres.
- Masks and scene_gt_info.json are by BOP's rule (the model against the view's depth, 15 mm, missing depth
  counts as visible). The masks that the pairs were made with are in the release.
- A scene without scene_gt.json has its truth held back.
"""


def export_bop(release: Release, out: Path, progress: Progress = no_progress) -> int:
    """Write a release as a BOP data set.

    Args:
        release: the opened release.
        out: a new folder, or an earlier export, which is replaced.
        progress: called with (images done, images in all).

    Returns:
        The number of images.

    Raises:
        SettingsError: `out` holds something else.
        ReleaseError: the release has no depth images, or a file of it is missing or damaged.
        StorageError: the disk is full or read-only.

    Source: the format page of the BOP benchmark (Hodan et al., ECCV 2018).
    """
    infos, scenes = dict[str, object](), list[dict[str, Any]]()
    camera: Camera | None = None
    done = 0
    with new_folder(out) as folder:
        for models in (MODELS, MODELS_EVAL):
            (folder / models).mkdir()
        for number, (recording, targets) in enumerate(release.by_recording.items(), start=1):
            split = SPLIT_NAMES[targets[0].split]
            model = read_bop_model(release, recording) if release.metadata.has_solid(recording) else None
            if model is not None:
                mesh_mm = model.mesh_mm
                file = f"obj_{number:06d}.ply"
                (folder / MODELS / file).write_bytes(model_ply(mesh_mm))
                (folder / MODELS_EVAL / file).write_bytes(model_ply(decimated(mesh_mm, EVAL_TRIANGLES)))
                infos[str(number)] = model_info(mesh_mm)
            scene = folder / split / f"{number:06d}"
            last = _write_scene(release, targets, scene, number, model, done, progress)
            camera, done = camera or last, done + len(targets)
            scenes.append(
                {
                    "scene_id": number,
                    "split": split,
                    "obj_id": None if model is None else number,
                    **{name: getattr(targets[0], name) for name in ("recording", "object", "category")},
                    "images": [int(target.view) for target in targets],
                    "unknown_share": None if model is None else [_unknown_share(release, t) for t in targets],
                }
            )
        _write_dataset_files(release, folder, scenes, infos, camera)
    return len(release.targets)


def _write_dataset_files(
    release: Release,
    folder: Path,
    scenes: list[dict[str, Any]],
    infos: dict[str, object],
    camera: Camera | None,
) -> None:
    """Write the files about all scenes, such as camera.json, models_info.json and export.json."""
    if camera is None:
        raise ReleaseError(
            f"{shown(release.folder)}: no pair, so there is no image to export", what="no-pairs"
        )
    targets = [
        {"im_id": image, "inst_count": 1, "obj_id": scene["scene_id"], "scene_id": scene["scene_id"]}
        for scene in scenes
        if scene["split"] == "test"
        for image in scene["images"]
    ]
    nominal = {key: getattr(camera, key) for key in ("cx", "cy", "fx", "fy", "height", "width")}
    for models in (MODELS, MODELS_EVAL):
        (folder / models / "models_info.json").write_text(pretty_json(infos), encoding="utf-8")
    (folder / "test_targets_bop19.json").write_text(pretty_json(targets), encoding="utf-8")
    (folder / "camera.json").write_text(pretty_json({**nominal, "depth_scale": 1.0}), encoding="utf-8")
    info = release.metadata
    text = DATASET_INFO.format(name=info.name, identity=release.benchmark_sha256, license=info.license)
    (folder / "dataset_info.md").write_text(text, encoding="utf-8")
    write_export_json(folder, release, {"layout": "bop", "scenes": scenes})


def _write_scene(
    release: Release,
    targets: Sequence[Target],
    folder: Path,
    obj_id: int,
    model: BopModel | None,
    before: int = 0,
    progress: Progress = no_progress,
) -> Camera:
    """Write one scene: depth, masks, its JSON files, and colour if it is registered to the depth.

    The name of a view is the number of its image. `model` is None if the truth is held back; then no ground
    truth is written. `before` is the number of views in earlier scenes. Return the camera of the last view.
    """
    renderer = None if model is None else DepthRenderer(model.mesh)
    colored = color_registered(release, targets[0].recording)
    cameras: dict[str, dict[str, object]] = {}
    poses: dict[str, object] = {}
    infos: dict[str, object] = {}
    for done, target in enumerate(targets, start=before + 1):
        image = int(target.view)
        source = f"views/{target.recording}/{target.view}"
        png = release.content(f"{source}.depth.png")
        write_below(folder / "depth" / f"{image:06d}.png", png)
        if colored and f"{source}.color.jpg" in release.sums:
            write_below(folder / "rgb" / f"{image:06d}.jpg", release.content(f"{source}.color.jpg"))
        K, T_world_camera = camera_of(release, target)
        depth_mm = view_images.depth_mm(png, f"{source}.depth.png")
        camera = Camera(depth_mm.shape[1], depth_mm.shape[0], K[0, 0], K[1, 1], K[0, 2], K[1, 2])
        cameras[str(image)] = {"cam_K": K.ravel().tolist(), "depth_scale": 1.0}
        if model is not None and renderer is not None:
            cameras[str(image)] |= _rigid_mm(invert_rigid(T_world_camera), "w2c")
            T_camera_model = invert_rigid(T_world_camera) @ model.T_world_model
            poses[str(image)] = [{**_rigid_mm(T_camera_model, "m2c"), "obj_id": obj_id}]
            seen = object_in_view(depth_mm, camera, T_world_camera, model.mesh, renderer)
            infos[str(image)] = [{key: getattr(seen, key) for key in GT_INFO}]
            for name, mask in (("mask", seen.mask), ("mask_visib", seen.mask_visib)):
                write_below(
                    folder / name / f"{image:06d}_000000.png", images.png(mask.astype(np.uint8) * 255)
                )
        progress(done, len(release.targets))
    (folder / "scene_camera.json").write_text(pretty_json(cameras), encoding="utf-8")
    if model is not None:
        (folder / "scene_gt.json").write_text(pretty_json(poses), encoding="utf-8")
        (folder / "scene_gt_info.json").write_text(pretty_json(infos), encoding="utf-8")
    return camera


def _rigid_mm(T: Float64, frames: str) -> dict[str, list[float]]:
    """Return T (4, 4), metres, as {cam_R_<frames>: rotation, row by row, cam_t_<frames>: translation, mm}."""
    return {
        f"cam_R_{frames}": T[:3, :3].ravel().tolist(),
        f"cam_t_{frames}": (T[:3, 3] * MM_PER_M).tolist(),
    }


def _unknown_share(release: Release, target: Target) -> float:
    return round(unknown_share(*parts_of(release, target, ("full", "known"))), SHARE_DECIMALS)
