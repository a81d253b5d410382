"""A release as files of the paper's authors, so that existing networks read it unchanged."""

from collections import Counter
from pathlib import Path
from typing import Any

from kinectbench.core.artefacts.targets import Target
from kinectbench.core.types import Progress
from kinectbench.core.voxels.pair_file import Pair, checked_pair, pair_values, unpack
from kinectbench.core.voxels.recgan_file import recgan_file_bytes
from kinectbench.release.exchange.layouts import (
    MATRICES,
    NUMBERS,
    SPLIT_NAMES,
    export_folder,
    synset_of,
    write_export_json,
)
from kinectbench.release.release import Release


def export_recgan(release: Release, out: Path, progress: Progress | None = None) -> int:
    """Write every pair of a release as two files, what is seen (`25d`) and the full shape (`3d`).

    Nothing is cropped: their readers centre the grids in 256, so they stay where they are. `export.json`
    holds what the files do not: names and transforms. `known`, `seen` and `shell` are not exported.

    Args:
        release: opened.
        out: a new folder, or an earlier export, which is replaced.
        progress: called with (pairs done, pairs in all).

    Returns:
        The number of pairs.

    Raises:
        SettingsError: `out` holds something else.
        ReleaseError, PairError: a pair is missing or damaged, or truth is held back.
        StorageError: the disk is full or read-only.
    """
    release.require_truth(SPLIT_NAMES)
    views = max(Counter(target.recording for target in release.targets).values())
    rows = []
    with export_folder(out) as folder:
        for done, target in enumerate(release.targets, start=1):
            values = pair_values(release.content(target.file), target.file)
            pair = checked_pair(Pair, values, target.file)
            names = {kind: recgan_name(target, kind, views) for kind in ("25d", "3d")}
            for kind, cells in (("25d", pair.partial_256), ("3d", pair.full)):
                path = folder / names[kind]
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(recgan_file_bytes(unpack(cells)))
            rows.append(_row(target, names, pair))
            if progress:
                progress(done, len(release.targets))
        write_export_json(folder, release, {"pairs": rows})
    return len(rows)


def recgan_name(target: Target, kind: str, views: int) -> str:
    """`P1_<synset>_<category>/<split>_<views>_<kind>_vox256/<recording>_<view>_0_0.npz`."""
    group = f"{SPLIT_NAMES[target.split]}_{views}_{kind}_vox256"
    folder = f"P1_{synset_of(target.category)}_{target.category}"
    return f"{folder}/{group}/{target.recording}_{int(target.view)}_0_0.npz"


def _row(target: Target, names: dict[str, str], pair: Pair) -> dict[str, Any]:
    """What the two files of a pair do not hold."""
    row: dict[str, Any] = {
        "recording": target.recording,
        "object": target.object,
        "view": target.view,
        "category": target.category,
        "split": target.split,
        "file_25d": names["25d"],
        "file_3d": names["3d"],
    }
    row |= {name: getattr(pair, name) for name in NUMBERS}
    return row | {name: getattr(pair, name).tolist() for name in MATRICES}
