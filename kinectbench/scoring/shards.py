"""Turn samples of WebDataset shards into items of a dataset."""

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from kinectbench.core import PairError, printable, strict_json
from kinectbench.core.types import Arrays, FileArray
from kinectbench.core.voxels.npy import read_npy
from kinectbench.core.voxels.npz import UNREADABLE
from kinectbench.core.voxels.pair_file import (
    MAX_BYTES,
    OPTIONAL,
    PACKED_SHAPES,
    checked_parts,
    pair_keys,
    pair_parts,
)
from kinectbench.scoring.dataset import IMAGES, TARGET_KEYS, Item, checked_keys, item_of, wanted_parts

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
