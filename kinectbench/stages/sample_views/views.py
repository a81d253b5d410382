"""The stage `sample-views`: samples frames (usually 50), with the object's mask in each, and stores them.

They are stored as views.json with depth, colour and mask images.
"""

import contextlib
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from kinectbench.core import IMAGE_BYTES, SegmentationError, StorageError, listed_paths, read_plain
from kinectbench.core.artefacts.stored import known, number
from kinectbench.core.artefacts.views import MasksFile, Refused, ViewRow, ViewsFile
from kinectbench.core.encoded_images import decoded_image, decoded_mask, image_head
from kinectbench.core.geometry import TOO_FAR, DepthRenderer, depth_in_mm, too_far_for_mm, transform_points
from kinectbench.core.images import png
from kinectbench.core.jpeg_metadata import without_metadata
from kinectbench.core.sequence import Sequence
from kinectbench.core.threads import ahead
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Bools, Progress
from kinectbench.settings.models import FitLimits, MaskCuts, ViewSettings
from kinectbench.stages.sample_views.alignment import ViewAlignment, align_view
from kinectbench.stages.sample_views.masks import (
    GivenMasks,
    object_mask,
    override_mask,
    recorded_mask,
    unused_masks,
)
from kinectbench.stages.sample_views.view_fit import ViewFit, fit_of_view, refusal
from kinectbench.stages.sample_views.view_order import frame_order
from kinectbench.stages.segment.object_model import ObjectModel

# Only for colour that was not recorded as JPEG (chosen by hand: artefacts are hardly visible).
JPEG_QUALITY = 90
# The image border cuts a view's object if more than these shares of it are cut off, or of its mask lie there.
CUT_OFF, AT_BORDER = 0.02, 0.01
# Values of a view's fit that have the same names in views.json.
FIT_FIGURES = tuple(field.name for field in fields(ViewFit) if field.name != "pixels")


# A depth image that came twice has given poses of two stamps: at 30 Hz a hand moves by some cm between
# them. An exact symmetric scene looks the same from farther apart, too.
SAME_PLACE_M = 0.1


@dataclass(frozen=True)
class View:
    """One sampled view.

    Attributes:
        name: zero-padded number, from "000" on.
        frame: index of the frame in the sequence.
        stamp_ns: stamp of its depth.
        reason: why the frame was tried at this point of the order.
        alignment: its pose, corrected by aligning its depth with the object.
        mask: (height, width) bool, the object, in depth pixels.
        fit: how well depth fits the object, computed with the mask before the user's masks are applied. But
            in a view that was read from a file, `fit.pixels` counts the final mask.
        blur: blur of the colour relative to the recording, as in health.json; None if unknown.
        pose_residual_m: residual between its depth and that of other frames, under the trajectory's poses,
            metres; None if unknown.
        too_far_share: share of its depth pixels beyond the range of a 16-bit depth image in mm.
        depth_digest: of its depth in memory; empty in a view that was read from a file.
    """

    name: str
    frame: int
    stamp_ns: int
    reason: str
    alignment: ViewAlignment
    mask: Bools
    fit: ViewFit
    blur: float | None = None
    pose_residual_m: float | None = None
    too_far_share: float = 0.0
    depth_digest: bytes = b""


@dataclass(frozen=True)
class Views:
    """The views of one recording, the refused frames as (frame, why it is refused), and warnings."""

    views: list[View]
    refused: list[tuple[int, str]]
    warnings: list[str]


def sample_views(
    sequence: Sequence,
    trajectory: Trajectory,
    model: ObjectModel,
    settings: ViewSettings,
    segmentation: MaskCuts,
    pairs: FitLimits,
    masks: GivenMasks | None = None,
    progress: Progress | None = None,
) -> Views:
    """Try good frames, in the order of the strategy, until enough of them fit the object.

    With `random` every good frame is equally likely (paper, Sec. 3.6: 50 random views of the trajectory). A
    refused frame is replaced by another good frame, if any is left. So is one with the depth image of an
    earlier view, which a driver delivered twice: a pair would count twice.

    Args:
        sequence: the recording.
        trajectory: poses of the frames.
        model: the object: floor and closed mesh.
        settings: number of views, strategy and seed; and whether to use the masks that came with the
            recording, in the frames that have one.
        segmentation: tolerance of the masks, and their smallest height above the floor.
        pairs: smallest containment, largest residual, smallest visible share.
        masks: the user's masks; None if there are none.
        progress: called with (views found, views wanted).

    Raises:
        SegmentationError: no frame fits, or a mask given by the user is unusable.
    """
    renderer = DepthRenderer(model.shape.mesh)
    order = frame_order(sequence, trajectory, model, renderer, settings, segmentation)
    health = {row.frame: row for row in trajectory.health.per_frame} if trajectory.health else {}
    views: list[View] = []
    refused: list[tuple[int, str]] = []
    look = partial(_look, sequence, trajectory, model, renderer, settings, segmentation)
    for seen in ahead(look, order):
        reason = refusal(seen.fit, settings, pairs) or _came_before(seen, views)
        if reason:
            refused.append((seen.frame, reason))
            continue
        name, row = f"{len(views):03d}", health.get(seen.frame)
        mask = seen.mask if masks is None else override_mask(seen.mask, masks, name, seen.frame)
        blur, residual_m = (row.blur, row.residual_m) if row else (None, None)
        views.append(replace(seen, name=name, mask=mask, blur=blur, pose_residual_m=residual_m))
        if progress:
            progress(len(views), settings.count)
        if len(views) == settings.count:
            break
    if not views:
        first = refused[0][1] if refused else "no frame has a pose"
        raise SegmentationError(
            f"no view fits the object: {len(refused)} frames refused ({first})", what="no-view"
        )
    warnings = _warnings(views, settings, len(order))
    if masks is not None:
        warnings += unused_masks(masks, {view.name: view.frame for view in views})
    return Views(views, refused, warnings)


def _came_before(seen: View, views: list[View]) -> str:
    """Return why a frame is refused whose depth image an earlier view has, from the same place; or ""."""
    for view in views:
        if view.depth_digest == seen.depth_digest:
            apart_m = view.alignment.T_world_camera[:3, 3] - seen.alignment.T_world_camera[:3, 3]
            if np.linalg.norm(apart_m) < SAME_PLACE_M:
                return f"its depth image is that of view {view.name}"
    return ""


def _look(
    sequence: Sequence,
    trajectory: Trajectory,
    model: ObjectModel,
    renderer: DepthRenderer,
    settings: ViewSettings,
    segmentation: MaskCuts,
    chosen: tuple[int, str],
) -> View:
    """Make a view from `chosen` (frame, reason for its rank), without a name and without the user's masks."""
    frame, why = chosen
    camera, floor, tolerance_m = sequence.camera, model.floor, segmentation.mask_tolerance_m
    depth_m = sequence.depth_m(frame)
    digest = hashlib.blake2b(depth_m.tobytes()).digest()
    too_far_share = too_far_for_mm(depth_m)
    recorded = sequence.masks(frame) if sequence.masks and settings.recorded_masks else None
    if recorded is not None:
        # Things in front of the object, or touching it, do not affect the fit.
        depth_m = np.where(recorded, depth_m, np.float32(0))
    pose_sigma_m = trajectory.assumed_pose_sigma_m(frame)
    rendered_m = renderer.depth_m(camera, trajectory.T_world_camera[frame])
    alignment = align_view(depth_m, camera, trajectory.T_world_camera[frame], rendered_m, pose_sigma_m)
    T_world_camera = alignment.T_world_camera
    if alignment.moved_m or alignment.turned_rad:
        rendered_m = renderer.depth_m(camera, T_world_camera)
    if recorded is None:
        heights_m = floor.heights_m(depth_m, camera, T_world_camera)
        mask = object_mask(depth_m, rendered_m, heights_m, tolerance_m, floor.low_cut_m(segmentation))
    else:
        points = camera.backproject(depth_m)
        points_floor = transform_points(floor.T_floor_world @ T_world_camera, points.reshape(-1, 3))
        mask = recorded_mask(depth_m, recorded, points_floor.reshape(points.shape), model.box, tolerance_m)
    return View(
        name="",
        frame=frame,
        stamp_ns=int(sequence.stamps_ns[frame]),
        reason=why,
        alignment=alignment,
        mask=mask,
        fit=fit_of_view(depth_m, rendered_m, mask, sequence, T_world_camera, model, renderer),
        too_far_share=too_far_share,
        depth_digest=digest,
    )


def _warnings(views: list[View], settings: ViewSettings, good_frames: int) -> list[str]:
    warnings = []
    if len(views) < settings.count:
        warnings.append(
            f"{len(views)} views instead of {settings.count}: all {good_frames} good frames were tried"
        )
    cut = sum(view.fit.truncated_share > CUT_OFF or view.fit.border_share > AT_BORDER for view in views)
    if cut > len(views) / 2:
        warnings.append(f"the image border cuts the object in {cut} of {len(views)} views: step back")
    far = [view.too_far_share for view in views if view.too_far_share > 0]
    if far:
        warnings.append(
            f"{len(far)} of {len(views)} views have {TOO_FAR} ({max(far):.1%} of the "
            "pixels with depth at most), which their 16-bit depth images hold as 0, no measurement: is "
            "`depth_scale` right?"
        )
    return warnings


def write_views(views: Views, sequence: Sequence, folder: Path) -> None:
    """Write views.json and, for each view, depth (uint16 mm), mask (255 = object) and any colour (JPEG)."""

    def images(view: View) -> dict[str, bytes]:
        mask = view.mask.astype(np.uint8) * 255
        return {**pictures_of(sequence, view.frame), "mask.png": png(mask)}

    for view, files in zip(views.views, ahead(images, views.views), strict=True):
        for name, data in files.items():
            (folder / f"{view.name}.{name}").write_bytes(data)
    ViewsFile(
        color_registered=sequence.color_registered,
        views=tuple(_row(view) for view in views.views),
        refused=tuple(Refused(frame=frame, reason=reason) for frame, reason in views.refused),
        warnings=tuple(views.warnings),
    ).write(folder)


def pictures_of(sequence: Sequence, frame: int) -> dict[str, bytes]:
    """Return a view's images: {"depth.png": PNG file (uint16 mm), "color.jpg": JPEG file if it has colour}.

    Raises:
        StorageError: depth is missing or damaged, or colour is damaged.
    """
    encoded = sequence.frames.color_encoded(frame)
    color = {} if encoded is None else {"color.jpg": _jpeg(*encoded)}
    return {"depth.png": png(depth_in_mm(sequence.depth_m(frame))), **color}


def _row(view: View) -> ViewRow:
    fit: dict[str, Any] = {name: known(getattr(view.fit, name), 6) for name in FIT_FIGURES}
    return ViewRow(
        view=view.name,
        frame=view.frame,
        stamp_ns=view.stamp_ns,
        reason=view.reason,
        T_world_camera=view.alignment.T_world_camera,
        moved_m=known(view.alignment.moved_m, 6),
        turned_rad=known(view.alignment.turned_rad, 6),
        blur=view.blur,
        pose_residual_m=view.pose_residual_m,
        pixels=int(view.mask.sum()),
        **fit,
    )


def read_views(folder: Path) -> list[View]:
    """Read stored views and their masks.

    Raises:
        StorageError: a file is missing or damaged.
    """
    return [_view(row, folder) for row in ViewsFile.read(folder).views]


def _view(row: ViewRow, folder: Path) -> View:
    if row.frame is None or row.stamp_ns is None or row.reason is None or row.T_world_camera is None:
        raise StorageError(f"{folder / ViewsFile.FILE}: view {row.view} has no frame; {ViewsFile.ADVICE}")
    if row.pixels is None:
        raise StorageError(
            f"{folder / ViewsFile.FILE}: 'pixels' of view {row.view} is missing; {ViewsFile.ADVICE}"
        )
    path = folder / f"{row.view}.mask.png"
    mask = _read_mask(path)
    if mask is None:
        raise StorageError(f"{path}: not a readable PNG; {ViewsFile.ADVICE}")
    return View(
        name=row.view,
        frame=row.frame,
        stamp_ns=row.stamp_ns,
        reason=row.reason,
        alignment=ViewAlignment(row.T_world_camera, number(row.moved_m), number(row.turned_rad)),
        mask=mask,
        fit=ViewFit(row.pixels, **{name: number(getattr(row, name)) for name in FIT_FIGURES}),
        blur=row.blur,
        pose_residual_m=row.pose_residual_m,
    )


def read_pictures(folder: Path, view: str) -> dict[str, bytes]:
    """Read the stored images of a view: {"depth.png": PNG file, "color.jpg": JPEG file if there is one}.

    Raises:
        StorageError: the depth image is missing, or an image cannot be read.
    """
    paths = {end: folder / f"{view}.{end}" for end in ("depth.png", "color.jpg")}
    try:
        color = ("color.jpg",) if paths["color.jpg"].exists() else ()
        return {end: read_plain(paths[end], IMAGE_BYTES) for end in ("depth.png", *color)}
    except OSError as error:
        raise StorageError(
            f"{error.filename}: cannot be read ({error.strerror}); {ViewsFile.ADVICE}"
        ) from error


def picture_digest(pictures: Mapping[str, bytes]) -> str:
    """Return the SHA-256 (hex) of a view's images: the shape and pixels of depth in mm, and any colour file.

    Depth is hashed by pixels, because its PNG may differ with the version of zlib. The colour file is usually
    that of the recording.

    Args:
        pictures: {"depth.png": PNG file, "color.jpg": JPEG file if there is one}.

    Raises:
        StorageError: the depth image is damaged.
    """
    try:
        image_head(pictures["depth.png"])
        depth = decoded_image(pictures["depth.png"], cv2.IMREAD_UNCHANGED)
    except ValueError as error:
        raise StorageError(f"the depth image of a view is damaged ({error}); {ViewsFile.ADVICE}") from error
    of_depth = f"{depth.shape}".encode() + depth.astype("<u2").tobytes()
    return hashlib.sha256(of_depth + pictures.get("color.jpg", b"")).hexdigest()


def read_masks(folder: Path) -> GivenMasks:
    """Return the user's masks in a folder: PNGs, nonzero on the object. Each is read on request."""

    def read(name: str) -> Bools:
        """Read a mask (height, width) by the name of its file."""
        mask = _read_mask(folder / name)
        if mask is None:
            raise SegmentationError(
                f"{folder / name}: not a readable PNG; save the mask again", what="bad-mask"
            )
        return mask

    names = (path.name for path in listed_paths(folder) if path.name != MasksFile.FILE and path.is_file())
    return GivenMasks(str(folder), tuple(sorted(names)), read)


def _read_mask(path: Path) -> Bools | None:
    """Read an image's nonzero pixels as a mask; return None if it is missing or damaged."""
    try:
        data = read_plain(path, IMAGE_BYTES)
        image_head(data)
        return decoded_mask(data)
    except (OSError, ValueError):
        return None


def _jpeg(suffix: str, data: bytes) -> bytes:
    """Return colour as a JPEG: a recorded JPEG without its metadata, pixels unchanged; else encoded here.

    A JPEG whose metadata cannot be separated from its pixels is also encoded here. EXIF's orientation is
    dropped, because depth and mask are not rotated by it.

    Raises:
        StorageError: the image is damaged.
    """
    try:
        if suffix in (".jpg", ".jpeg"):
            image_head(data)
            with contextlib.suppress(ValueError):
                clean, removed = without_metadata(data)
                return clean if removed else data
        image = decoded_image(data, cv2.IMREAD_COLOR)
    except ValueError as error:
        line = f"a stored colour image is damaged ({error}); `kinectbench build --force` makes it again"
        raise StorageError(line) from error
    encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
    return bytes(encoded.tobytes())
