"""A release as a dataset for training that loads only the requested parts of each pair."""

import io
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from kinectbench.core import PairError, SettingsError, printable, strict_json
from kinectbench.core.artefacts.targets import SPLITS
from kinectbench.core.store.address import unusable
from kinectbench.core.types import Arrays, FileArray
from kinectbench.core.voxels.npy import read_npy
from kinectbench.core.voxels.npz import UNREADABLE
from kinectbench.core.voxels.pair_file import (
    INPUT_KEYS,
    MAX_BYTES,
    NUMBERS,
    OPTIONAL,
    PACKED_SHAPES,
    TEXTS,
    Pair,
    checked_parts,
    keys_there,
    pair_keys,
    pair_parts,
    unknown_share,
    unpack,
)
from kinectbench.release import view_images
from kinectbench.release.release import Release, Target, open_release

OF_PAIR = tuple(field.name for field in fields(Pair))
OF_TRUTH = tuple(name for name in OF_PAIR if name not in INPUT_KEYS)
IMAGES: dict[str, Callable[[Release, Target], FileArray]] = {
    "depth": view_images.depth_m,
    "mask": view_images.mask,
    "color": view_images.color,
}
META = "meta"
KEYS = (*OF_PAIR, *IMAGES, META)
DEFAULT_KEYS = ("partial", "full", "known", META)
TARGET_KEYS = ("recording", "object", "view", "category", "split")
META_PARTS = ("voxel_size_m", "T_world_grid")

Item = dict[str, Any]


class Dataset:
    """The pairs of a release, or of one split, as a map-style dataset for torch's DataLoader.

    `dataset[i]` is a dict with the keys `pair_id` (`<recording>/<view>`), `partial` (64, 64, 64) bool, `full`
    and `known` (256, 256, 256) bool, and `meta`. `meta` has recording, object, view, category, split,
    voxel_size_m, T_world_grid and `unknown_share`, the share of cells of `full` that are not `known`. Where
    the truth is held back, there is no `full`, no `known` and no `unknown_share`. For other keys, see `load`.
    """

    def __init__(
        self,
        release: Release,
        targets: Sequence[Target],
        keys: Sequence[str] | None = None,
        transform: Callable[[Item], object] | None = None,
        packed: bool = False,
    ) -> None:
        """Make a dataset of the pairs `targets` of an opened release; other arguments as in `load`.

        Raises:
            SettingsError: unknown key.
        """
        self.release = release
        self.targets = tuple(targets)
        self.keys = checked_keys(keys)
        self.transform = transform
        self.packed = packed

    def split(self, name: str) -> "Dataset":
        """Return a dataset of the pairs of "train", "validation" or "test", with the same keys and transform.

        Raises:
            SettingsError: unknown split.
        """
        if name not in ("train", "validation", "test"):
            raise SettingsError(f"no split '{name}': choose train, validation or test")
        targets = [target for target in self.targets if target.split == name]
        return type(self)(self.release, targets, self.keys, self.transform, self.packed)

    def __len__(self) -> int:
        return len(self.targets)

    def __repr__(self) -> str:
        by_split = Counter(target.split for target in self.targets)
        counts = ", ".join(f"{by_split[split]} {split}" for split in SPLITS if by_split[split])
        return f"<Dataset {self.release.metadata.name}: {len(self)} pairs{f' ({counts})' if counts else ''}>"

    def __iter__(self) -> Iterator[Any]:
        return (self[index] for index in range(len(self)))

    def __getitem__(self, index: int) -> Any:
        """Read one pair, and check its SHA-256; the check takes a quarter of a millisecond.

        Raises:
            IndexError: there is no pair with this index.
            TypeError: the index is no whole number, but a slice for example.
            ReleaseError: the pair's file is missing, or differs from the published one.
            PairError: the published file is no valid pair.
        """
        if isinstance(index, slice):
            raise TypeError("a dataset gives one pair at a time: [dataset[i] for i in range(…)]")
        target = self.targets[index]
        names = wanted_parts(self.keys, target.split in self.release.metadata.inputs_only)
        parts = _read(self.release, target, names) if names else {}
        images = {key: IMAGES[key](self.release, target) for key in self.keys if key in IMAGES}
        item = item_of(vars(target), parts | images, self.keys, self.packed)
        return item if self.transform is None else self.transform(item)


def item_of(
    target: Mapping[str, object], parts: Mapping[str, FileArray], keys: Sequence[str], packed: bool
) -> Item:
    """Return the item of a pair.

    `parts` are arrays as they are stored, and images; the item has the keys in their order.
    """
    item: Item = {"pair_id": f"{target['recording']}/{target['view']}"}
    for key in keys:
        if key == META:
            item[META] = _meta(target, parts)
        elif key in parts:
            item[key] = _value(key, parts[key], packed)
    return item


def _value(key: str, stored: FileArray, packed: bool) -> object:
    """Convert a stored value to an item's value: a number, a text, an array or a grid."""
    if key in (*NUMBERS, *TEXTS):
        return stored.item()
    return stored if packed or key not in PACKED_SHAPES else unpack(stored)


def wanted_parts(keys: Sequence[str], hidden: bool) -> list[str]:
    """Return the arrays of a pair file that the keys need; without the truth's arrays if it is `hidden`."""
    wanted = dict.fromkeys(key for key in keys if key in OF_PAIR)
    if META in keys:
        wanted |= dict.fromkeys((*META_PARTS, "full", "known"))
    return [key for key in wanted if not (hidden and key in OF_TRUTH)]


def load(
    path: str | Path,
    *,
    keys: Sequence[str] | None = None,
    transform: Callable[[Item], object] | None = None,
    packed: bool = False,
) -> Dataset:
    """Open a release as a dataset; if torch is installed, it is also a `torch.utils.data.Dataset`.

    Args:
        path: the release's folder, a .zip, .tar or .tar.gz of it, or its URL (docs/stores.md); it is read in
            place.
        keys: what an item holds beside `pair_id`; nothing else is unpacked. Grids, bool: `partial` (64, 64,
            64); `partial_256`, `full`, `shell`, `known`, `seen` (256, 256, 256); and `interior` and `said`
            where a pair has them. Matrices, float64: `T_world_grid`, `T_world_camera` (4, 4), metres; `K` (3,
            3), pixels. Numbers: `voxel_size_m`, `surface_sigma_m`. Texts: `framing`, `partial_rule`,
            `occupancy_rule`. Images of the view: `depth` (height, width) float32, metres, 0 = no measurement;
            `mask` (height, width) bool; `color` (height, width, 3) uint8 RGB. Also `meta`. Default:
            `partial`, `full`, `known`, `meta`. Keys of the truth are missing in items whose truth is held
            back.
        transform: called with each item; its result replaces the item. It must be picklable if worker
            processes are spawned.
        packed: leave the grids as they are stored: uint8, 8 cells per byte along the last axis.
            `numpy.unpackbits(grid, axis=-1)` unpacks them.

    Raises:
        ReleaseError: there is no release, or it was changed.
        SettingsError: unknown key, or an unusable URL.
    """
    if problem := unusable(str(path)):
        raise SettingsError(problem, what="bad-url")
    release = open_release(Path(path))
    return _dataset(release, release.targets, keys, transform, packed)


def checked_keys(keys: Sequence[str] | None) -> tuple[str, ...]:
    """Return the requested keys, or the default keys.

    Raises:
        SettingsError: unknown key.
    """
    if keys is None:
        return DEFAULT_KEYS
    wanted = (keys,) if isinstance(keys, str) else tuple(keys)
    for key in wanted:
        if key not in (*KEYS, "pair_id"):
            raise SettingsError(f"no key {key!r}: choose some of {', '.join(KEYS)}")
    return wanted


def _read(release: Release, target: Target, names: Sequence[str]) -> Arrays:
    """Read and check the arrays `names` of a pair file; return them by key."""
    content, where = release.pair_content(target), release.pair_path(target)
    try:
        present = keys_there(names, content)
        return dict(zip(present, pair_parts(content, present), strict=True))
    except UNREADABLE as error:
        raise PairError(f"{where}: cannot be read as a pair file ({error}); make it again") from error


def _meta(target: Mapping[str, object], parts: Mapping[str, FileArray]) -> dict[str, object]:
    """Return the item's `meta` of a pair; `target` and `parts` as in `item_of`."""
    meta: dict[str, object] = {name: target[name] for name in TARGET_KEYS}
    meta |= {"voxel_size_m": parts["voxel_size_m"].item(), "T_world_grid": parts["T_world_grid"]}
    if "full" in parts:
        meta["unknown_share"] = unknown_share(parts["full"], parts["known"])
    return meta


def _dataset(release: Release, targets: Sequence[Target], *options: Any) -> Dataset:
    return _dataset_class()(release, targets, *options)


def _dataset_class() -> type[Dataset]:
    try:
        from torch.utils.data import Dataset as TorchDataset
    except ImportError:
        return Dataset

    def reduce(self: Dataset) -> tuple[object, ...]:  # so that worker processes make the class again
        return _dataset, (self.release, self.targets, self.keys, self.transform, self.packed)

    return type("TorchDataset", (Dataset, TorchDataset), {"__reduce__": reduce})


NPZ, JSON, NPY = "npz", "json", ".npy"


def decode_sample(
    sample: Mapping[str, Any], *, keys: Sequence[str] | None = None, packed: bool = False
) -> Item:
    """Turn a sample of `kinectbench export --layout webdataset` into an item, as `load(…)[i]` returns it.

    Use it as `webdataset.WebDataset(urls).map(kinectbench.decode_sample)`; pass keys by `functools.partial`.
    Samples of earlier versions, which have a `.npy` file for each grid, are read too; their only grids are
    `partial`, `full`, `known` and `seen`.

    Args:
        sample: {suffix: bytes of the file}, with the suffixes `npz` and `json`, as webdataset gives it before
            decoding.
        keys: as in `load`, without images.
        packed: as in `load`.

    Raises:
        SettingsError: unknown key.
        PairError: the sample is damaged, or lacks a requested key.
    """
    where = printable(str(sample.get("__key__", "sample")))
    wanted = checked_keys(keys)
    if images := [key for key in wanted if key in IMAGES]:
        raise PairError(f"{where}: a shard holds no images, so there is no '{images[0]}'")
    try:
        row = strict_json(sample[JSON].decode())
        names = {name: str(row[name]) for name in TARGET_KEYS}
        parts = _parts(sample, row, wanted)
    except (*UNREADABLE, AttributeError, TypeError, RecursionError) as error:
        raise PairError(f"{where}: cannot be read as a pair ({error}); export it again") from error
    return item_of(names, parts, wanted, packed)


def _parts(sample: Mapping[str, bytes], row: Mapping[str, object], keys: Sequence[str]) -> Arrays:
    """Return the arrays that the keys need (those of the truth if the sample has it); `row` is its JSON."""
    given = pair_keys(sample[NPZ]) if NPZ in sample else [name.removesuffix(NPY) for name in sample]
    names = [n for n in wanted_parts(keys, hidden="full" not in given) if n in given or n not in OPTIONAL]
    if NPZ in sample:
        return dict(zip(names, pair_parts(sample[NPZ], names), strict=True))
    return checked_parts({name: _earlier(sample, row, name) for name in names}, names)


def _earlier(sample: Mapping[str, bytes], row: Mapping[str, object], name: str) -> FileArray:
    """Read the array `name` of a pair from a sample that an earlier version wrote.

    Such a sample has a .npy file for each grid, and all other values in its JSON row (`row`).
    """
    if name in PACKED_SHAPES:
        content = sample[name + NPY]
        if len(content) > MAX_BYTES:
            raise ValueError(f"'{name}' is larger than a grid")
        return read_npy(io.BytesIO(content), len(content))
    value = row[name]
    return np.asarray(value, None if isinstance(value, str) else np.float64)
