"""gallery.npz beside scores.json: some predictions of a method at 64^3, which the page shows in 3-D."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.errors import StorageError
from kinectbench.core.storage import replaced_file, sha256_file
from kinectbench.core.voxels.npz import UNREADABLE, load_arrays, npz_bytes
from kinectbench.core.voxels.pair_file import PARTIAL_CELLS, Packed

GALLERY = "gallery.npz"
FORMAT_VERSION = 1
CELLS_SHAPE = (PARTIAL_CELLS, PARTIAL_CELLS, PARTIAL_CELLS // 8)
MAX_PAIRS = 256
MAX_BYTES = 16 << 20
# Predictions of one method, {`<recording>/<view>`: (64, 64, 8) uint8, packed}: where each is above its
# threshold.
Gallery = Mapping[str, Packed]


def write_gallery(cells: Gallery, scores: Path) -> None:
    """Write packed predictions by pair to gallery.npz beside a scores.json, with the SHA-256 of that file.

    Raises:
        StorageError: the disk is full or read-only.
    """
    names = sorted(cells)
    grids = [cells[name] for name in names]
    arrays: dict[str, NDArray[np.generic]] = {
        "format_version": np.asarray(FORMAT_VERSION),
        "scores_sha256": np.asarray(sha256_file(scores)),
        "pairs": np.array(names, dtype=np.str_),
        "cells": np.array(grids, np.uint8).reshape(-1, *CELLS_SHAPE),
    }
    with replaced_file(scores.parent / GALLERY) as temporary:
        temporary.write_bytes(npz_bytes(arrays))


def read_gallery(scores: Path) -> Gallery | None:
    """Read the untrusted gallery.npz beside a scores.json.

    Returns:
        The packed predictions by pair; None if there is no gallery, or only that of another scores.json.

    Raises:
        StorageError: the file is damaged, too large, or not a gallery.
    """
    path = scores.parent / GALLERY
    if not path.is_file():
        return None
    try:
        values = load_arrays(path, MAX_BYTES)
        pairs, cells = values["pairs"], values["cells"]
        if values["format_version"].shape != () or values["format_version"].item() != FORMAT_VERSION:
            raise ValueError("another format version")
        count = len(pairs)
        fits = pairs.shape == (count,) and pairs.dtype.kind == "U" and count <= MAX_PAIRS
        if not fits or cells.shape != (count, *CELLS_SHAPE) or cells.dtype != np.uint8:
            raise ValueError("not the arrays of a gallery")
        current = str(values["scores_sha256"]) == sha256_file(scores)
    except (*UNREADABLE, TypeError) as error:
        raise StorageError(f"{path}: not a readable gallery ({error}); score again, or delete it") from error
    return dict(zip(pairs.tolist(), cells, strict=True)) if current else None
