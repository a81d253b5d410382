"""A release as a BOP data set: a scene and an object model per recording, in millimetres."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from kinectbench.errors import ReleaseError
from kinectbench.geometry import Camera
from kinectbench.release.bop_model import BopModel, model_info, model_ply, read_model
from kinectbench.release.bop_scene import write_scene
from kinectbench.release.export_folder import export_folder, write_export_json
from kinectbench.release.release import Release
from kinectbench.workspace import pretty_json

SPLIT_NAMES = {"train": "train", "validation": "val", "test": "test"}
DATASET_INFO = """# {name}

Made by kinectbench of the release {identity}; licence of the data: {license}.

- A scene is a recording, an image one of its views; depth is in millimetres (`depth_scale` 1).
- Each recording has an object model of its own, fused from it: `obj_id` is the number of the scene, and
  `export.json` says which recording, object and category it is.
- Model frame: the floor's axes, z up, the origin in the middle of the model's box; millimetres.
- Masks and scene_gt_info.json are by BOP's own rule (the model against the view's depth, 15 mm, missing depth
  counts as visible). The masks that the pairs were made with are in the release.
- A scene without scene_gt.json has its truth held back.
"""


def export_bop(release: Release, out: Path, progress: Callable[[int, int], None] | None = None) -> int:
    """Write a release as a BOP data set.

    Args:
        release: opened.
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
    done, infos, scenes = 0, dict[str, Any](), list[dict[str, Any]]()
    camera: Camera | None = None

    def step() -> None:
        nonlocal done
        done += 1
        if progress:
            progress(done, len(release.targets))

    with export_folder(out) as folder:
        (folder / "models").mkdir()
        for number, recording in enumerate(sorted({t.recording for t in release.targets}), start=1):
            targets = [target for target in release.targets if target.recording == recording]
            split = SPLIT_NAMES[targets[0].split]
            model = None if _held_back(release, recording) else read_model(release, recording)
            if model is not None:
                infos[str(number)] = _write_model(model, folder / "models" / f"obj_{number:06d}.ply")
            scene = folder / split / f"{number:06d}"
            last = write_scene(release, targets, scene, number, model, step)
            camera = camera or last
            scenes.append(
                {
                    "scene_id": number,
                    "split": split,
                    "obj_id": None if model is None else number,
                    **{name: getattr(targets[0], name) for name in ("recording", "object", "category")},
                    "images": [int(target.view) for target in targets],
                }
            )
        _write_dataset_files(release, folder, scenes, infos, camera)
    return done


def _held_back(release: Release, recording: str) -> bool:
    """Whether a recording's truth is not in the release, and should not be."""
    return release.metadata.recordings[recording].split in release.metadata.held_back


def _write_model(model: BopModel, path: Path) -> dict[str, float]:
    """Write the model's PLY; returns its row of models_info.json."""
    mesh_mm = model.mesh_mm
    path.write_bytes(model_ply(mesh_mm))
    return model_info(mesh_mm)


def _write_dataset_files(
    release: Release,
    folder: Path,
    scenes: list[dict[str, Any]],
    infos: dict[str, Any],
    camera: Camera | None,
) -> None:
    """Write what belongs to all scenes."""
    if camera is None:
        raise ReleaseError(f"{release.folder}: no pair, so there is no image to export")
    targets = [
        {"im_id": image, "inst_count": 1, "obj_id": scene["scene_id"], "scene_id": scene["scene_id"]}
        for scene in scenes
        if scene["split"] == "test"
        for image in scene["images"]
    ]
    nominal = {key: getattr(camera, key) for key in ("cx", "cy", "fx", "fy", "height", "width")}
    (folder / "models" / "models_info.json").write_text(pretty_json(infos))
    (folder / "test_targets_bop19.json").write_text(pretty_json(targets))
    (folder / "camera.json").write_text(pretty_json({**nominal, "depth_scale": 1.0}))
    info = release.metadata
    text = DATASET_INFO.format(name=info.name, identity=release.benchmark_sha256, license=info.license)
    (folder / "dataset_info.md").write_text(text)
    write_export_json(folder, release, {"layout": "bop", "scenes": scenes})
