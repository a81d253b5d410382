"""A release as a BOP data set: a scene and an object model per recording, in millimetres."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import cdist

from kinectbench.core import ReleaseError, StorageError, images, pretty_json, write_below
from kinectbench.core.artefacts.object import FloorFile
from kinectbench.core.artefacts.targets import Target
from kinectbench.core.geometry import (
    Camera,
    DepthRenderer,
    TriangleMesh,
    decimated,
    invert_rigid,
    parse_ply,
    rigid,
    transform_points,
)
from kinectbench.core.store.address import shown
from kinectbench.core.types import MM_PER_M, Bools, Float64, Progress, no_progress
from kinectbench.core.voxels.pair_file import SHARE_DECIMALS, unknown_share
from kinectbench.release import view_images
from kinectbench.release.exchange.layouts import SPLIT_NAMES, new_folder, write_export_json
from kinectbench.release.exchange.rgbd import camera_of, color_registered, parts_of
from kinectbench.release.release import Release

# Rows of the distance matrix that are held at once.
CHUNK = 512
# Fewest points, less one, of a hull that Qhull computes of flat meshes: a simplex and a point.
MIN_HULL = 4
# A model's pixel is visible if it lies at most this far behind the measured depth (BOP: delta).
DELTA_MM = 15.0
NO_BOX = (-1, -1, -1, -1)
Box = tuple[int, int, int, int]


@dataclass(frozen=True)
class BopModel:
    """An object's mesh in the world frame, and the pose of its BOP model frame.

    Attributes:
        mesh: closed mesh, world frame, metres.
        T_world_model: (4, 4), model to world, metres. The model frame has the floor's axes, z up; its origin
            is the middle of the mesh's bounding box along these axes.
    """

    mesh: TriangleMesh
    T_world_model: Float64

    @property
    def mesh_mm(self) -> TriangleMesh:
        """The mesh in the model frame, millimetres."""
        mesh = self.mesh.transformed(invert_rigid(self.T_world_model))
        return TriangleMesh(mesh.vertices * MM_PER_M, mesh.faces)


def read_bop_model(release: Release, recording: str) -> BopModel:
    """Read the object of a recording.

    Raises:
        ReleaseError: a file of the object is missing or damaged.
    """
    folder = f"objects/{recording}"
    try:
        mesh = parse_ply(release.content(f"{folder}/mesh.ply"))
        floor = FloorFile.parse(release.text(f"{folder}/{FloorFile.FILE}"), FloorFile.FILE)
        if not len(mesh.faces):
            raise ValueError("it has no faces")
    except (StorageError, ValueError) as error:
        raise ReleaseError(
            f"{shown(release.folder / folder)}: the object cannot be read ({error})"
        ) from error
    vertices_floor = mesh.transformed(floor.T_floor_world).vertices
    middle = (vertices_floor.min(axis=0) + vertices_floor.max(axis=0)) / 2
    return BopModel(mesh, invert_rigid(floor.T_floor_world) @ rigid(np.eye(3), middle))


def model_ply(mesh: TriangleMesh) -> bytes:
    """Return a binary PLY file with vertex normals, in types that the BOP toolkit reads (float, int)."""
    shell = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return bytes(trimesh.exchange.ply.export_ply(shell, vertex_normal=True))


def model_info(mesh: TriangleMesh) -> dict[str, float]:
    """Return a mesh's row of models_info.json, in the mesh's unit: its `_diameter` and its bounding box."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    info = {"diameter": _diameter(mesh.vertices)}
    info |= {f"min_{axis}": float(value) for axis, value in zip("xyz", low, strict=True)}
    return info | {f"size_{axis}": float(value) for axis, value in zip("xyz", high - low, strict=True)}


def _diameter(vertices: Float64) -> float:
    """Return the largest distance between any two vertices (n, 3), by comparing the convex hull's corners."""
    corners = vertices
    try:
        corners = vertices[ConvexHull(vertices).vertices]
    except QhullError:  # flat: corners of the hull of vertices that are moved by rounding errors
        if len(vertices) > MIN_HULL:
            corners = vertices[ConvexHull(vertices, qhull_options="QJ").vertices]
    return max(float(cdist(corners[i : i + CHUNK], corners).max()) for i in range(0, len(corners), CHUNK))


@dataclass(frozen=True)
class ObjectInView:
    """The object in one view: its two masks, and the values of its row in scene_gt_info.json.

    Attributes:
        mask: (height, width) bool, the silhouette within the image.
        mask_visib: (height, width) bool, the visible part of `mask`.
        px_count_all: number of pixels of the silhouette, including those beyond the image.
        px_count_valid: number of pixels of `mask` with a measured depth.
        px_count_visib: number of pixels of `mask_visib`.
        bbox_obj: x, y, width, height of the whole silhouette, pixels. Width and height are differences of the
            last and first pixel, so one pixel has width 0. All are -1 if nothing is visible.
        bbox_visib: x, y, width, height of `mask_visib`, defined in the same way.
    """

    mask: Bools
    mask_visib: Bools
    px_count_all: int
    px_count_valid: int
    px_count_visib: int
    bbox_obj: Box
    bbox_visib: Box

    @property
    def visib_fract(self) -> float:
        """The visible share of the silhouette."""
        return self.px_count_visib / self.px_count_all if self.px_count_all else 0.0


def object_in_view(
    depth_mm: NDArray[np.uint16],
    camera: Camera,
    T_world_camera: Float64,
    mesh: TriangleMesh,
    renderer: DepthRenderer,
) -> ObjectInView:
    """Return the object's silhouette in a view, the visible part of it, and pixel counts and boxes of both.

    Args:
        depth_mm: (height, width) uint16, measured depth, 0 = none.
        camera: the image's camera.
        T_world_camera: (4, 4), metres.
        mesh: the object's mesh, world frame, metres.
        renderer: a renderer of the same mesh.

    Source: the BOP format page and its definition of visibility, mode `bop19`: a pixel of the silhouette is
    visible if the model lies at most 15 mm behind the measurement along the ray, or if nothing is measured.
    The silhouette is rendered in an image enlarged to hold the whole object, to at most three times its size.
    """
    wide, left, top = _wide_camera(camera, T_world_camera, mesh)
    wide_m = renderer.depth_m(wide, T_world_camera)
    model_m = wide_m[top : top + camera.height, left : left + camera.width]
    mask = model_m > 0
    ray_lengths = np.linalg.norm(camera.rays(), axis=-1)
    behind_mm = (model_m * 1000.0 - depth_mm) * ray_lengths
    mask_visib = mask & ((behind_mm <= DELTA_MM) | (depth_mm == 0))
    visible = bool(mask_visib.any())
    return ObjectInView(
        mask=mask,
        mask_visib=mask_visib,
        px_count_all=int((wide_m > 0).sum()),
        px_count_valid=int((depth_mm[mask] > 0).sum()),
        px_count_visib=int(mask_visib.sum()),
        bbox_obj=_box(wide_m > 0, left, top) if visible else NO_BOX,
        bbox_visib=_box(mask_visib, 0, 0) if visible else NO_BOX,
    )


def _wide_camera(camera: Camera, T_world_camera: Float64, mesh: TriangleMesh) -> tuple[Camera, int, int]:
    """Enlarge a camera's image to hold the object; return camera, and pixels added on the left and on top."""
    points_camera = transform_points(invert_rigid(T_world_camera), mesh.vertices)
    left, right, top, bottom = camera.width, camera.width, camera.height, camera.height
    if points_camera[:, 2].min() > 0:
        u, v = np.moveaxis(camera.project(points_camera), -1, 0)
        left, right = _margins(u, camera.width)
        top, bottom = _margins(v, camera.height)
    wide = replace(
        camera,
        width=camera.width + left + right,
        height=camera.height + top + bottom,
        cx=camera.cx + left,
        cy=camera.cy + top,
    )
    return wide, left, top


def _margins(pixels: Float64, size: int) -> tuple[int, int]:
    """Return how many pixels to add before and after an axis of `size` to hold `pixels`; at most `size`."""
    before, after = np.ceil([-pixels.min(), pixels.max() - (size - 1)])
    return int(np.clip(before, 0, size)), int(np.clip(after, 0, size))


def _box(mask: Bools, left: int, top: int) -> Box:
    """Return BOP's box (x, y, width, height) of a mask; x and y count from the mask's pixel (left, top)."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return (
        int(columns[0]) - left,
        int(rows[0]) - top,
        int(columns[-1] - columns[0]),
        int(rows[-1] - rows[0]),
    )


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
    """Write a release as a BOP data set; return the number of images.

    Args:
        release: the opened release.
        out: a new folder, or an earlier export, which is replaced.
        progress: called with (images done, images in all).

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
    return {f"cam_R_{frames}": T[:3, :3].ravel().tolist(), f"cam_t_{frames}": (T[:3, 3] * MM_PER_M).tolist()}


def _unknown_share(release: Release, target: Target) -> float:
    return round(unknown_share(*parts_of(release, target, ("full", "known"))), SHARE_DECIMALS)
