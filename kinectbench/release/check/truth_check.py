"""Check that the true shape in every pair, and the volume, agree with the object's mesh in the release.

A recording's pairs are made from its mesh and its volume. Each pair's truth is computed again from these two,
so a changed pair is found. Only `verify --rebuild` finds a joint change of mesh, volume and pairs.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from statistics import fmean

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import ReleaseError, StorageError, printable
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, ReleaseInfo
from kinectbench.core.artefacts.object import FloorFile, LabelCounts, QualityFile
from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import Grid, TriangleMesh, is_rigid, parse_ply, transform_points
from kinectbench.core.types import Bools
from kinectbench.core.voxels.known_cells import KnownGrid, known_grid, known_in
from kinectbench.core.voxels.npz import UNREADABLE, arrays_of
from kinectbench.core.voxels.open_mesh import voxelize_open
from kinectbench.core.voxels.pair_file import (
    FULL_CELLS,
    SHARE_DECIMALS,
    Packed,
    Pair,
    as_float64,
    pack,
    packed_count,
    unpack,
)
from kinectbench.core.voxels.solid import costs_too_much, voxelize_solid
from kinectbench.release.check.object_check import GLB_HEAD, glb_faults
from kinectbench.release.contents import GLB, OBJECT_FILES, VOLUME_BYTES, Contents

MESH, VOLUME = OBJECT_FILES
# Share of a shape's cells that may differ. In 111 pairs and 12 volumes (eight releases, recorded and
# simulated) no cell differed; below this share an IoU keeps its third decimal.
MOST_OTHER_SHARE = 0.001
# How far, in cells, a solid may extend beyond its mesh's bounding box (in 20 pairs: at most half a cell).
MOST_BEYOND_CELLS = 1
# Sixteen sides of a pair's cube, as for predictions: a vertex farther away is in another frame, and products
# of its coordinates might not fit in 64 bits.
MAX_FAR_CELLS = 16 * FULL_CELLS
# Largest volume that is compared: 2 m at 5 mm. Four grids of as many bytes take 256 MB.
MOST_VOXELS, MOST_SIDE = 64 << 20, 1024
# For each rule, the pairs of axes perpendicular to the lines that it fills along.
ACROSS = {"winding": ((0, 1),), "seeable": ((0, 1),), "six-rays": ((0, 1), (0, 2), (1, 2))}
# Stands for the coarse grid around an object, which is not published; no cell of it is known.
NOWHERE = known_grid(Grid((1, 1, 1), 1.0, np.eye(4)), np.zeros((1, 1, 1), bool))


class TooLargeError(ReleaseError):
    """The volume is too large to be compared within a few hundred megabytes of memory."""

    what = "too-large"


@dataclass(frozen=True)
class ObjectTruth:
    """The truth of an object in a release.

    Attributes:
        mesh: the object's closed mesh, world frame, metres; None if missing or unreadable.
        recorded: whether the object has a published volume, which synthetic objects lack.
        cells: {name: cells of the volume} for "known", "unknown", "interior", and in newer volumes "said"
            (known from the user's statement about the underside); empty without a usable volume.
    """

    mesh: TriangleMesh | None = None
    recorded: bool = False
    cells: Mapping[str, KnownGrid] = field(default_factory=dict)


def _object_truth(
    contents: Contents, recording: str, whole: Collection[str], quality: QualityFile
) -> tuple[ObjectTruth, list[str]]:
    """Return the truth of an object, and a message for each difference of its volume or GLB from its mesh.

    Figures of `quality` that follow from the volume are compared, too. Missing files and damaged ones (not in
    `whole`) are skipped: `object_problems` reports them.
    """
    folder = f"objects/{recording}"
    try:
        mesh = parse_ply(contents.read(_published(f"{folder}/{MESH}", whole)))
    except (ReleaseError, ValueError):
        return ObjectTruth(), []
    if not len(mesh.faces):
        return ObjectTruth(), []
    faults = [f"{folder}{GLB}: {fault}" for fault in _glb_faults(contents, folder, whole, mesh)]
    recorded = f"{folder}/{VOLUME}" in whole
    try:
        grid, solid, labels, underside = _volume(contents, _published(f"{folder}/{VOLUME}", whole))
    except TooLargeError as error:
        return ObjectTruth(mesh, recorded), [*faults, str(error)]
    except (ReleaseError, *UNREADABLE):
        return ObjectTruth(mesh, recorded), faults
    found = (
        *_volume_faults(mesh, grid, solid, labels),
        *_other_figures(grid, solid, labels, underside, quality),
    )
    faults += [f"{folder}/{VOLUME}: {fault}" for fault in found]
    known = labels != Label.UNKNOWN
    cells = {"known": known, "unknown": ~known, "interior": labels == Label.INTERIOR}
    if underside.shape == labels.shape:
        cells["said"] = known & underside
    grids = {name: known_grid(grid, which) for name, which in cells.items()}
    return ObjectTruth(mesh, recorded, grids), faults


def _glb_faults(contents: Contents, folder: str, whole: Collection[str], mesh: TriangleMesh) -> Iterator[str]:
    """Yield a message for each difference between a GLB and its mesh; a missing or damaged GLB gives none."""
    try:
        content = contents.read(_published(f"{folder}{GLB}", whole))
        floor = f"{folder}/{FloorFile.FILE}"
        T_floor_world = np.eye(4)
        if floor in whole:
            T_floor_world = FloorFile.parse(contents.text(floor), floor).T_floor_world
    except (ReleaseError, StorageError):
        return
    if len(content) >= GLB_HEAD.size:
        yield from glb_faults(content, mesh, T_floor_world)


def _volume(contents: Contents, name: str) -> tuple[Grid, Bools, NDArray[np.integer], Bools]:
    """Read a volume.npz: return its grid and its arrays (nx, ny, nz) `solid`, `labels` and `underside`.

    Early volumes have no `underside`; an empty array is returned for it.
    """
    names = ("solid", "labels", "voxel_size_m", "T_world_grid", "underside")
    with contents.stream(name) as file:
        arrays = arrays_of(file, VOLUME_BYTES, names, {"underside": np.zeros(0, bool)})
    solid, labels, size_m = arrays["solid"], arrays["labels"], arrays["voxel_size_m"]
    if labels.ndim != 3 or labels.size > MOST_VOXELS or max(labels.shape) > MOST_SIDE:
        raise TooLargeError(
            f"{name}: {' x '.join(map(str, labels.shape))} voxels are too many: no pair is compared with it"
        )
    T = as_float64(arrays["T_world_grid"]).reshape(4, 4)
    if solid.shape != labels.shape or not is_rigid(T) or not 0 < float(size_m) < np.inf:
        raise ValueError("its arrays have different shapes, or its grid is none")
    nx, ny, nz = labels.shape
    return Grid((nx, ny, nz), float(size_m), T), solid, labels, arrays["underside"]


def _published(name: str, whole: Collection[str]) -> str:
    """Return a file's name unchanged if it is in `whole`, the files whose bytes are the published ones.

    Raises:
        ReleaseError: the file was not published, or its bytes differ.
    """
    if name not in whole:
        raise ReleaseError(f"{name}: not as it was published", what="changed")
    return name


def _volume_faults(
    mesh: TriangleMesh, grid: Grid, solid: Bools, labels: NDArray[np.integer]
) -> Iterator[str]:
    """Yield a message if `solid` disagrees with the filled mesh, and one if it disagrees with `labels`."""
    nx, ny, nz = grid.shape
    padded = Grid((nx, ny, nz + -nz % 8), grid.voxel_size_m, grid.T_world_grid)
    inside = _filled(mesh, padded, "winding")
    if isinstance(inside, str):
        yield inside
        return
    other = int(np.count_nonzero(unpack(inside)[:, :, :nz] != solid))
    if other > MOST_OTHER_SHARE * np.count_nonzero(solid):
        yield f"{other} voxels of 'solid' are not as {MESH} has them"
    occupied, empty = (Label.SURFACE, Label.INTERIOR), (Label.FREE, Label.OTHER)
    other = int(np.count_nonzero(np.isin(labels, occupied) & ~solid))
    other += int(np.count_nonzero(np.isin(labels, empty) & solid))
    if other:
        yield f"{other} voxels of 'solid' are not as 'labels' has them"


def _other_figures(
    grid: Grid, solid: Bools, labels: NDArray[np.integer], underside: Bools, quality: QualityFile
) -> Iterator[str]:
    """Yield a message if figures that `quality` states are not those of the volume."""
    if quality.labels is None:  # of no volume that this version made
        return
    cells, unknown = max(1, int(solid.sum())), labels == Label.UNKNOWN
    found: dict[str, object] = {
        "labels": LabelCounts(**{each.name.lower(): int((labels == each).sum()) for each in Label}),
        "volume_m3": round(int(solid.sum()) * grid.voxel_size_m**3, 6),
    }
    if quality.truth is None:  # of a reference mesh all is known
        shares = {"unknown_share": solid & unknown, "unknown_air_share": ~solid & unknown}
        shares |= {"underside_share": solid & underside} if underside.shape == solid.shape else {}
        found |= {key: round(int(which.sum()) / cells, SHARE_DECIMALS) for key, which in shares.items()}
    if other := [key for key, value in found.items() if getattr(quality, key) not in (None, value)]:
        yield f"another {', '.join(other)} than in {QualityFile.FILE}"


def _filled(mesh: TriangleMesh, grid: Grid, rule: str) -> Packed | str:
    """Return the grid cells that `rule` fills inside a mesh, or a text on why they cannot be computed.

    The mesh is untrusted: its vertices may be far from the grid, or its faces too many to fill.
    """
    cells = transform_points(grid.T_grid_world, mesh.vertices) / grid.voxel_size_m
    if not np.abs(cells).max() <= MAX_FAR_CELLS:
        return f"{MESH} has vertices far from it"
    for i, j in ACROSS[rule]:
        if costs_too_much(cells[:, (i, j)], mesh.faces, (grid.shape[i] + 1, grid.shape[j] + 1)):
            return f"{MESH} has {len(mesh.faces)} faces across each other, and is not compared"
    fill = voxelize_open if rule == "six-rays" else voxelize_solid
    return fill(mesh.vertices, mesh.faces, grid)


def truth_problems(pair: Pair, truth: ObjectTruth) -> Iterator[str]:
    """Yield a message for each grid of a pair (full, known, interior, said) that disagrees with its object.

    Args:
        pair: a pair whose matrices are rigid, and whose `voxel_size_m` is positive and finite.
        truth: the truth of its object.
    """
    if truth.mesh is not None:
        yield from _full_problems(pair, truth.mesh, recorded=truth.recorded)
    for name, stated in (("known", pair.known), ("interior", pair.interior), ("said", pair.said)):
        if stated is None or name not in truth.cells:
            continue
        expected = known_in(truth.cells[name], NOWHERE, pair.grid)
        # Outside the volume, a coarse grid that is not published determines the known cells.
        beyond = known_in(truth.cells["unknown"], NOWHERE, pair.grid) if name == "known" else ~expected
        if other := packed_count(expected & ~stated) + packed_count(beyond & stated):
            yield f"{other} cells of '{name}' are not as its {VOLUME} has them"


def _full_problems(pair: Pair, mesh: TriangleMesh, *, recorded: bool) -> Iterator[str]:
    """Yield a message if `full` is not the mesh filled by its `occupancy_rule`, or if that rule is wrong.

    `recorded` tells whether the object has a published volume. If so, the rule must be "winding".
    """
    rule = pair.occupancy_rule
    if rule not in ACROSS or (recorded and rule != "winding"):
        yield f"occupancy_rule is '{printable(rule)}', which is not that of such an object"
        return
    filled = _filled(mesh, pair.grid, rule)
    if isinstance(filled, str):
        yield f"'full' cannot be compared: {filled}"
        return
    other = packed_count(filled & ~pair.full if rule == "seeable" else filled ^ pair.full)
    cells = packed_count(pair.full)
    if other > MOST_OTHER_SHARE * cells:
        yield f"{other} of the {cells} cells of 'full' are not as its {MESH} has them"
    elif rule == "seeable" and (beyond := _beyond(pair, mesh)):
        yield f"{beyond} cells of 'full' lie beyond the box of its {MESH}"


def _beyond(pair: Pair, mesh: TriangleMesh) -> int:
    """Return the number of cells of `full` clearly outside the mesh's bounding box along the grid's axes."""
    corners = transform_points(pair.grid.T_grid_world, mesh.vertices) / pair.voxel_size_m
    first = np.ceil(corners.min(axis=0) - 0.5) - MOST_BEYOND_CELLS
    end = np.floor(corners.max(axis=0) + 0.5) + MOST_BEYOND_CELLS
    within = np.zeros((FULL_CELLS,) * 3, bool)
    x, y, z = (slice(max(0, int(a)), max(0, int(b))) for a, b in zip(first, end, strict=True))
    within[x, y, z] = True
    return packed_count(pair.full & ~pack(within))


@dataclass
class TruthCheck:
    """Check the truth of a release's pairs against their objects, with one object in memory at a time.

    So `lines` must be called for all pairs of one recording before those of the next.

    Attributes:
        contents: the release.
        whole: names of the files whose bytes are the published ones.
        metadata: content of benchmark.json; None if it is unreadable.
        visible_shares: {recording: `visible_share` of each of its pairs that was checked}.
        keys: {recording: {pair file: the keys that it holds}}.
        inputs: {pair file: hash of its `partial_256` and `T_world_camera`}.
    """

    contents: Contents
    whole: Collection[str]
    metadata: ReleaseInfo | None
    visible_shares: dict[str, list[float]] = field(default_factory=dict)
    keys: dict[str, dict[str, frozenset[str]]] = field(default_factory=dict)
    inputs: dict[str, str] = field(default_factory=dict)
    _last: tuple[str, ObjectTruth] = ("", ObjectTruth())

    def lines(self, recording: str, name: str, pair: Pair) -> list[str]:
        """Return messages on a pair's truth; for a recording's first pair, also messages on its object."""
        lines = list[str]()
        self.visible_shares.setdefault(recording, []).append(pair.visible_share)
        if self._last[0] != recording:
            self._last = recording, ObjectTruth()  # frees memory before the next is read
            info = self.metadata and self.metadata.of_this_version and self.metadata.recordings.get(recording)
            quality = info.quality if info else QualityFile()  # other versions count otherwise
            truth, lines = _object_truth(self.contents, recording, self.whole, quality)
            self._last = recording, truth
        return lines + [f"{name}: {problem}" for problem in truth_problems(pair, self._last[1])]

    def share_lines(self) -> Iterator[str]:
        """Yield a message for each recording whose `visible_share` is not the mean over its pairs."""
        is_new = self.metadata is not None and self.metadata.of_this_version
        for name, info in self.metadata.recordings.items() if self.metadata else ():
            shares = self.visible_shares.get(name, [])
            if (info.visible_share is None and not is_new) or len(shares) != info.pairs:
                continue
            if info.visible_share != (found := round(fmean(shares), SHARE_DECIMALS)):
                stated = f"its recordings.{printable(name)}.visible_share is {info.visible_share}"
                yield f"{BENCHMARK_JSON}: {stated} where its pairs have {found}"

    def key_lines(self) -> Iterator[str]:
        """Yield a message for each key that only some pairs of a recording hold: one run makes them all."""
        for recording, files in self.keys.items():
            for key in sorted(frozenset[str]().union(*files.values())):
                lack = [name for name, keys in files.items() if key not in keys]
                if lack:
                    count = f"{len(files) - len(lack)} of the {len(files)} pairs of {recording}"
                    yield f"{lack[0]}: without '{printable(key)}', which is in {count}"
