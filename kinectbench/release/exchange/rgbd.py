"""Export of a release's views as plain images, depth maps and point maps, which current methods take.

Each view gets a folder `<recording>/<view>/`. For each method that reads other files, units or axes,
`scoring/adapters/` has a writer, which takes the same `RgbdView`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from kinectbench.core import KinectBenchError, PredictionError, ReleaseError, images
from kinectbench.core.artefacts.method import Box
from kinectbench.core.artefacts.stored import Matrix3, Matrix4, Stored, optional
from kinectbench.core.artefacts.targets import Target
from kinectbench.core.artefacts.views import Side, ViewsFile
from kinectbench.core.geometry import Camera, is_rigid
from kinectbench.core.store.address import shown
from kinectbench.core.types import MM_PER_M, Bools, FileArray, Float32, Float64, Progress, Rgb, no_progress
from kinectbench.core.voxels.npz import UNREADABLE
from kinectbench.core.voxels.pair_file import pair_parts
from kinectbench.release import view_images
from kinectbench.release.exchange.layouts import new_folder, write_export_json
from kinectbench.release.release import Release

_Pixel = TypeVar("_Pixel", bound=np.generic)

# Values of `color` in camera.json.
REGISTERED = "on the pixels of depth"
UNREGISTERED = "none: the recording's colour is not registered to its depth"
HOW_TO_PUBLISH = (
    "`publish: {color: true}` in benchmark.yaml publishes it, once somebody has looked through the pictures"
)
UNPUBLISHED = "none: the release has no colour of this view"


@dataclass(frozen=True)
class RgbdView:
    """The input of a method for one view.

    Attributes:
        target: the view's pair.
        depth_mm: (height, width) uint16, millimetres along z, 0 where nothing was measured.
        mask: (height, width) bool, the object.
        color: (height, width, 3) uint8 RGB, registered to the depth; None if there is none.
        color_words: where the colour comes from, or why there is none.
        K: (3, 3) intrinsics, pixels; pixel centres are integers.
        T_world_camera: (4, 4), camera (x right, y down, z forward) to world, metres.
    """

    target: Target
    depth_mm: NDArray[np.uint16]
    mask: Bools
    color: Rgb | None
    color_words: str
    K: Float64
    T_world_camera: Float64

    @property
    def camera(self) -> Camera:
        """The camera of the images."""
        K, (height, width) = self.K, self.depth_mm.shape
        return Camera(width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2])

    @property
    def depth_m(self) -> Float32:
        """Depth, (height, width) float32, metres, 0 without a measurement."""
        return self.depth_mm.astype(np.float32) / np.float32(MM_PER_M)

    @cached_property
    def pointmap_m(self) -> Float32:
        """Point map, (height, width, 3) float32, camera frame, metres, NaN without a measurement."""
        points = self.camera.backproject(self.depth_mm / MM_PER_M).astype(np.float32)
        points[self.depth_mm == 0] = np.nan
        return points

    @property
    def object_points_m(self) -> Float64:
        """The measured points of the object, (n, 3), camera frame, metres."""
        return self.pointmap_m[self.mask & (self.depth_mm > 0)].astype(np.float64)


def framed(view: RgbdView, width: int, height: int) -> RgbdView:
    """Crop a view to an image of width x height pixels around the object, and adapt K.

    If the object's bounding box does not fit, only every second, third, ... row and column of the view is
    kept. Nothing is interpolated, so K is exact. Pixels beyond the view's image have depth 0 and are outside
    the mask. A view that already has this size is returned unchanged.
    """
    if view.depth_mm.shape == (height, width):
        return view
    size = np.array([width, height])
    rows, columns = np.nonzero(view.mask)
    spots = np.array([columns, rows]) if len(rows) else np.zeros((2, 1), int)
    step = int(np.ceil(((np.ptp(spots, axis=1) + 1) / size).max()))
    size_px = np.array(view.depth_mm.shape[::-1])
    extent = -(-size_px // step)
    middle = (spots.min(axis=1) + spots.max(axis=1)) // (2 * step)
    # The window: around the object, inside a larger image; around the whole of a smaller one, centred.
    around = np.clip(middle - size // 2, spots.max(axis=1) // step - size + 1, -(-spots.min(axis=1) // step))
    first = np.where(extent >= size, np.clip(around, 0, np.maximum(extent - size, 0)), (extent - size) // 2)

    def cut(image: NDArray[_Pixel]) -> NDArray[_Pixel]:
        """Return the cropped part of an image (h, w, ...), with zeros beyond the image."""
        kept = image[::step, ::step]
        out = np.zeros((height, width, *image.shape[2:]), image.dtype)
        low, high = np.maximum(first, 0), np.minimum(first + size, extent)
        (x, y), (right, bottom) = low - first, high - first
        out[y:bottom, x:right] = kept[low[1] : high[1], low[0] : high[0]]
        return out

    K = view.K / np.array([[step], [step], [1.0]])
    K[:2, 2] -= first
    color = None if view.color is None else cut(view.color)
    return replace(view, depth_mm=cut(view.depth_mm), mask=cut(view.mask), color=color, K=K)


class ViewCamera(Stored):
    """camera.json of an exported view; `adapt` uses it to transform predictions to the camera frame."""

    FILE: ClassVar[str] = "camera.json"
    ADVICE: ClassVar[str] = "export the views again"
    ERROR: ClassVar[type[KinectBenchError]] = PredictionError
    # A few matrices (chosen here).
    MAX_BYTES: ClassVar[int] = 1 << 16

    K: Matrix3 = Field(description="intrinsics of the images beside it, pixels; pixel centres are integers")
    width: Side = Field(description="width of the images, pixels")
    height: Side = Field(description="height of the images, pixels")
    T_world_camera: Matrix4 = Field(description="camera to world, metres")
    color: str = Field(description="where rgb.png comes from, or why there is none")
    method: str | None = optional("the method that the files are for")
    T_camera_method: Matrix4 | None = optional(
        "similarity from the frame of the method's files to the camera, metres"
    )
    volume_m: Box | None = optional("lowest and highest corner of the method's volume, camera frame, metres")
    cut_share: float | None = Field(
        None, ge=0, le=1, description="share of the object outside the method's volume"
    )
    cut_of: str | None = optional("base of cut_share: truth (cells of the solid) or seen (measured points)")


# Writes the files of one view into an existing folder, and returns further keys of its camera.json. It may
# crop the images, and returns the view as written.
WriteView = Callable[[Release, RgbdView, Path], tuple[RgbdView, dict[str, object]]]


def export_rgbd(
    release: Release,
    out: Path,
    progress: Progress = no_progress,
    method: str | None = None,
    write: WriteView | None = None,
    reads_color: bool = True,
) -> tuple[int, list[str]]:
    """Write the views of a release, each in a folder `<recording>/<view>/`.

    Args:
        release: the opened release.
        out: a new folder, or an earlier export, which is replaced.
        progress: called with (views done, views in all).
        method: the method whose input files are written; None: the plain files of `write_plain`.
        write: function that writes a view's files; needed with `method`.
        reads_color: whether the method reads colour; if so, views without colour are reported.

    Returns:
        The number of views, and notes: a line on missing colour, and one on objects that the method's input
        volume cuts off.

    Raises:
        SettingsError: `out` holds something else.
        ReleaseError: the release has no depth images, or a file of it is missing or damaged.
        StorageError: the disk is full or read-only.
    """
    without, cut = list[str](), list[ViewCamera]()
    with new_folder(out) as folder:
        for done, target in enumerate(release.targets, start=1):
            view = read_view(release, target)
            (folder / target.recording / target.view).mkdir(parents=True)
            stated = _write(release, view, folder / target.recording / target.view, method, write)
            cut.append(stated)
            without += [target.name] * (reads_color and view.color is None)
            progress(done, len(release.targets))
        write_export_json(folder, release, {"layout": "rgbd", "method": method})
    return len(release.targets), [*_color_lines(without, len(release.targets)), *_cut_lines(cut)]


def _write(
    release: Release, view: RgbdView, folder: Path, method: str | None, write: WriteView | None
) -> ViewCamera:
    """Write a view's files by `write` (None: `write_plain`); write and return its camera.json."""
    shown_view, more = (write or write_plain)(release, view, folder)
    given: dict[str, Any] = {} if method is None else {"method": method, **more}
    stated = ViewCamera(
        K=shown_view.K,
        width=shown_view.depth_mm.shape[1],
        height=shown_view.depth_mm.shape[0],
        T_world_camera=view.T_world_camera,
        color=view.color_words,
        **given,
    )
    stated.write(folder)
    return stated


def write_plain(release: Release, view: RgbdView, folder: Path) -> tuple[RgbdView, dict[str, object]]:
    """Write depth.png, depth_m.npy, pointmap_cv.npy, mask.png and, if there is colour, rgb.png.

    It is a `WriteView`: it returns the view unchanged, and no further keys of camera.json.
    """
    write_color(view, folder)
    write_png(folder / "depth.png", view.depth_mm)
    np.save(folder / "depth_m.npy", view.depth_m)
    np.save(folder / "pointmap_cv.npy", view.pointmap_m)
    write_png(folder / "mask.png", view.mask.astype(np.uint8) * 255)
    return view, {}


def write_color(view: RgbdView, folder: Path, name: str = "rgb.png") -> None:
    """Write the colour of a view, if it has any."""
    if view.color is not None:
        write_png(folder / name, view.color[..., ::-1])


def _color_lines(without: Sequence[str], count: int) -> list[str]:
    """Return a line on the number of views `without` colour, among `count` views; [] if all have colour."""
    if not without:
        return []
    return [
        f"{len(without)} of {count} views have no colour image, such as {without[0]}: their colour is not "
        f"published, or not registered to the depth (camera.json says which); {HOW_TO_PUBLISH}"
    ]


def _cut_lines(stated: Sequence[ViewCamera]) -> list[str]:
    """Return a line on objects that the method's input volume cuts off, by `cut_share`; [] if none is."""
    shares = [one.cut_share for one in stated if one.cut_share is not None]
    if not any(shares):
        return []
    return [
        f"the method's volume cuts the object of {np.count_nonzero(shares)} of {len(shares)} views: "
        f"{np.mean(shares):.1%} of it in the mean, {max(shares):.1%} at most (cut_share in camera.json)"
    ]


def read_view(release: Release, target: Target) -> RgbdView:
    """Read the input of a method for one view; without a colour image, the result's `color` is None.

    Raises:
        ReleaseError: the release has no depth or mask of the view, a file is damaged or not the published
            one, or the images have different sizes.
        StorageError: views.json is damaged.
    """
    source = f"views/{target.recording}/{target.view}"
    depth_mm = np.rint(view_images.depth_m(release, target) * MM_PER_M).astype(np.uint16)
    mask, color, words = view_images.mask(release, target), None, UNREGISTERED
    if color_registered(release, target.recording):
        has_color = f"{source}{view_images.COLOR.suffix}" in release.sums
        words = REGISTERED if has_color else UNPUBLISHED
        color = view_images.color(release, target) if has_color else None
    if mask.shape != depth_mm.shape or (color is not None and color.shape[:2] != depth_mm.shape):
        raise ReleaseError(f"{shown(release.folder / source)}: images of different sizes; run `verify`")
    return RgbdView(target, depth_mm, mask, color, words, *camera_of(release, target))


def camera_of(release: Release, target: Target) -> tuple[Float64, Float64]:
    """Return K (3, 3), pixels, and T_world_camera (4, 4), metres, of a pair.

    Raises:
        ReleaseError: the pair is missing or damaged, or one of the matrices is invalid.
    """
    K, T_world_camera = parts_of(release, target, ("K", "T_world_camera"))
    if not (K[0, 0] > 0 and K[1, 1] > 0 and is_rigid(T_world_camera)):
        raise ReleaseError(f"{release.pair_path(target)}: K or T_world_camera is not one; run `verify`")
    return K, T_world_camera


def parts_of(release: Release, target: Target, names: Sequence[str]) -> list[FileArray]:
    """Return the named arrays of a pair file; its other arrays are not unpacked.

    Raises:
        ReleaseError: the pair is missing or damaged, or lacks an array.
    """
    try:
        return pair_parts(release.pair_content(target), names)
    except UNREADABLE as error:
        raise ReleaseError(f"{release.pair_path(target)}: cannot be read as a pair ({error})") from error


def color_registered(release: Release, recording: str) -> bool:
    """Return whether the recording's colour images are registered to its depth.

    Raises:
        ReleaseError: the release has no views of the recording, or views.json is not the published one.
        StorageError: views.json is damaged.
    """
    name = f"views/{recording}/views.json"
    if name not in release.sums:
        raise ReleaseError(
            f"{shown(release.folder / name)}: missing; this layout needs the depth images of the views",
            what="missing-file",
        )
    return bool(ViewsFile.parse(release.text(name), name).color_registered)


def write_png(path: Path, image: NDArray[np.generic]) -> None:
    """Write an image as a PNG file; see `images.png` for shapes and channel order."""
    path.write_bytes(images.png(image))
