"""Import of the ten Redwood scans of SDS-Complete: each has one masked view, and an open mesh as its truth.

Layout, units and names follow NVlabs/sds-complete @64fa943; docs/second-truth.md says what is unverified. The
masks have a licence of NVIDIA that forbids commercial use; no package contains them.
"""

import io
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import (
    IMAGE_BYTES,
    PairError,
    SettingsError,
    followed,
    lies_below,
    read_plain,
    replaced_folder,
    sha256_file,
    write_below,
)
from kinectbench.core.artefacts.benchmark import RecordingInfo
from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.targets import Target
from kinectbench.core.artefacts.views import ViewRow, ViewsFile
from kinectbench.core.geometry import Camera, TriangleMesh, is_rigid, write_ply
from kinectbench.core.images import png
from kinectbench.core.mesh_files import MAX_FILE_BYTES, read_ply
from kinectbench.core.types import MM_PER_M, Bools, FileArray, Float64, Progress, no_progress
from kinectbench.core.voxels.npy import read_npy
from kinectbench.core.voxels.pair_file import PairInput, pair_bytes
from kinectbench.core.voxels.seen_cells import seen_cells
from kinectbench.core.voxels.view_grids import partial_grids, view_cube
from kinectbench.release.contents import surface_name
from kinectbench.release.own_folder import refuse_other_content
from kinectbench.release.publish.card import CardTexts
from kinectbench.release.publish.small_files import release_info, write_small_files
from kinectbench.release.view_images import DEPTH, MASK, depth_mm
from kinectbench.settings.models import PairSettings

# {id of a scan: its category, and the frame for which the mask was drawn}.
SCANS = {
    "01184": ("trash_container", "0000394-000013114115"),
    "05117": ("chair", "0000699-000023291737"),
    "05452": ("chair", "0002573-000085825711"),
    "06127": ("plant", "0000004-000000100108"),
    "06145": ("table", "0000715-000023825644"),
    "06188": ("motorcycle", "0000036-000001167924"),
    "06830": ("tricycle", "0000262-000008709374"),
    "07136": ("couch", "0000052-000001701832"),
    "07306": ("trash_container", "0000081-000002669540"),
    "09639": ("chair", "0000174-000005772880"),
}
# Camera of Redwood's scanner; its depth is registered to colour.
CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
VIEW = "000"
# Farthest vertex: a scan's world is a room or a street.
FARTHEST_M = 1000.0
# A mask with fewer pixels gives no size: one gave voxels of 0 m (chosen here).
LEAST_PIXELS = 100
MASK_FILE = "data_processing/for_inputs/masks/{scan}.npy"
POSE_FILE = "data_processing/for_GT/transformations/{scan}_transformation.npy"
VERTICES_FILE = "data_processing/for_GT/masks/mask_{scan}.npy"
DEPTH_FILE = "frames_data_full/{scan}/depth/{frame}.png"
MESH_FILE = "mesh/{scan}.ply"
LICENSE = "scans: public domain; masks: NVIDIA, non-commercial"
TEXTS = CardTexts(
    "ten scans of Redwood with the masks of SDS-Complete",
    "Depth and\nmask of each view are in `views/`, the open mesh of each object in `surfaces/`.",
)


@dataclass(frozen=True)
class RedwoodScan:
    """A scan as read from its files.

    Attributes:
        png: content of the depth image's PNG file, millimetres.
        depth_m: (480, 640) float32, metres.
        mask: (480, 640) bool, the object.
        mesh: open mesh of the scan's faces on the object, camera frame, metres.
    """

    png: bytes
    depth_m: NDArray[np.float32]
    mask: Bools
    mesh: TriangleMesh


def import_redwood10(folder: Path, out: Path, progress: Progress = no_progress) -> int:
    """Write a release from the SDS-Complete scans in a folder; the camera frame serves as world frame.

    Args:
        folder: the folder that holds `data_processing/`, `frames_data_full/` and `mesh/`.
        out: a new folder, or a release, which is replaced.
        progress: called with (scans done, scans in all).

    Returns:
        The number of pairs.

    Raises:
        SettingsError: the folder has no mask of any scan.
        PairError: a file is missing or damaged, or is a link out of the folder.
        ReleaseError: a depth image is damaged, or `out` holds something else.
        StorageError: the disk is full or read-only.
    """
    there = [scan for scan in SCANS if (folder / MASK_FILE.format(scan=scan)).is_file()]
    if not there:
        raise SettingsError(f"{folder}: no {MASK_FILE.format(scan='<scan>')} there", what="no-file")
    refuse_other_content(out)
    with replaced_folder(out) as temporary:
        targets = []
        for done, name in enumerate(there, start=1):
            targets.append(_written(name, _scan(folder, name), temporary))
            progress(done, len(there))
        name = followed(folder).name or "redwood10"
        settings = {"pairs": PairSettings(framing="view", min_containment=0.0).model_dump(mode="json")}
        infos = {target.recording: _info(target) for target in targets}
        info = release_info(name, LICENSE, "view", "any", settings, infos, surface_truth=("test",))
        write_small_files(info, temporary, tuple(targets), [], TEXTS)
    return len(targets)


def _scan(folder: Path, name: str) -> RedwoodScan:
    of = {"scan": name, "frame": SCANS[name][1]}
    mask, T_camera_mesh, kept = (
        _array(folder, file.format(**of)) for file in (MASK_FILE, POSE_FILE, VERTICES_FILE)
    )
    png = _content(folder, DEPTH_FILE.format(**of), IMAGE_BYTES)
    where = folder / DEPTH_FILE.format(**of)
    depth = depth_mm(png, str(where))
    if mask.dtype != bool or mask.shape != (CAMERA.height, CAMERA.width) or depth.shape != mask.shape:
        raise PairError(f"{folder / MASK_FILE.format(**of)}: not a mask of {where}, 480 x 640 bool")
    if T_camera_mesh.shape != (4, 4) or T_camera_mesh.dtype.kind != "f" or not is_rigid(T_camera_mesh):
        raise PairError(f"{folder / POSE_FILE.format(**of)}: not a rigid transform (4, 4), metres")
    path = folder / MESH_FILE.format(**of)
    try:
        vertices, faces = read_ply(_content(folder, MESH_FILE.format(**of), MAX_FILE_BYTES))
    except ValueError as error:
        raise PairError(f"{path}: not a readable mesh ({error}); download it again") from error
    chosen = _chosen(kept, len(vertices), folder / VERTICES_FILE.format(**of))
    mesh = TriangleMesh(vertices, faces.astype(np.int32)).keep_faces(np.asarray(chosen[faces].all(axis=1)))
    if not (np.abs(mesh.vertices) <= FARTHEST_M).all():  # false for NaN, too
        raise PairError(f"{path}: a vertex is not finite, or beyond {FARTHEST_M:g} m; download it again")
    if not len(mesh.faces) or (mask & (depth > 0)).sum() < LEAST_PIXELS:
        raise PairError(f"{path}: nothing of the object is left; are masks and mesh of one scan?")
    return RedwoodScan(
        png, depth.astype(np.float32) / np.float32(MM_PER_M), mask, mesh.transformed(T_camera_mesh)
    )


def _chosen(kept: FileArray, count: int, path: Path) -> Bools:
    """Return (count,) bool, which vertices of the mesh lie on the object; `kept` is a mask or has indices."""
    if kept.dtype == bool and kept.shape == (count,):
        return kept
    is_list = kept.ndim == 1 and kept.dtype.kind in "iu" and len(kept) > 0
    if not is_list or kept.min() < 0 or kept.max() >= count:
        raise PairError(f"{path}: not a list of the mesh's vertices, of which there are {count}")
    chosen = np.zeros(count, bool)
    chosen[kept] = True
    return chosen


def _content(folder: Path, name: str, most: int) -> bytes:
    """Return the bytes of a file; refuse a link out of the folder, whose target the release would publish."""
    path = folder / name
    if not lies_below(path, followed(folder)):
        raise PairError(f"{path}: a link out of the folder; put the file itself there")
    try:
        return read_plain(path, most)
    except OSError as error:
        raise PairError(f"{path}: cannot be read ({error.strerror or error}); fetch it") from error


def _array(folder: Path, name: str) -> FileArray:
    content = _content(folder, name, MAX_FILE_BYTES)
    try:
        return read_npy(io.BytesIO(content), len(content))
    except (ValueError, EOFError) as error:
        raise PairError(f"{folder / name}: not a readable .npy file; fetch it again") from error


def _written(name: str, scan: RedwoodScan, folder: Path) -> Target:
    """Write the pair, images and truth mesh of a scan into a release's folder; return the pair's target."""
    T: Float64 = np.eye(4)
    object_m = np.where(scan.mask, scan.depth_m, np.float32(0))
    grid = view_cube(CAMERA.backproject(scan.depth_m)[object_m > 0], T)
    partial_256, partial = partial_grids(object_m, CAMERA, T, grid)
    pair = PairInput(
        partial=partial,
        partial_256=partial_256,
        seen=seen_cells(scan.depth_m, CAMERA, T, grid),
        T_world_grid=grid.T_world_grid,
        T_world_camera=T,
        K=CAMERA.K,
        voxel_size_m=grid.voxel_size_m,
        framing="view",
        partial_rule="any",
    )
    target = Target(name, name, VIEW, SCANS[name][0], "test", f"pairs/{name}/{VIEW}.npz", "")
    write_below(folder / target.file, pair_bytes(pair))
    views = folder / "views" / name
    write_below(views / f"{VIEW}{DEPTH.suffix}", scan.png)
    write_below(views / f"{VIEW}{MASK.suffix}", png(scan.mask.astype(np.uint8) * 255))
    row = ViewRow(
        view=VIEW, T_world_camera=T, K=CAMERA.K, width=CAMERA.width, height=CAMERA.height, pair=True
    )
    ViewsFile(views=(row,), refused=()).write(views)
    surface = folder / surface_name(name)
    surface.parent.mkdir(exist_ok=True)
    write_ply(scan.mesh, surface)
    return replace(target, sha256=sha256_file(folder / target.file))


def _info(target: Target) -> RecordingInfo:
    return RecordingInfo(
        object=target.object,
        category=target.category,
        split="test",
        pairs=1,
        refused=0,
        quality=QualityFile(verdict="unknown", warnings=("imported: others' mesh of the same depth",)),
        license=LICENSE,
        source=f"Redwood 3dscan {target.recording}; masks of SDS-Complete",
    )
