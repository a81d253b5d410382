"""A release as files of the paper's authors, so that existing networks read it unchanged."""

from collections import Counter
from pathlib import Path

from kinectbench.core.artefacts.targets import Target
from kinectbench.core.types import Progress, counted
from kinectbench.core.voxels.pair_file import Pair, checked_pair, pair_values, unpack
from kinectbench.core.voxels.recgan_file import recgan_file_bytes
from kinectbench.release.exchange.layouts import (
    SPLIT_NAMES,
    new_folder,
    pair_row,
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
    with new_folder(out) as folder:
        for target in counted(release.targets, progress):
            values = pair_values(release.content(target.file), target.file)
            pair = checked_pair(Pair, values, target.file)
            names = {kind: recgan_name(target, kind, views) for kind in ("25d", "3d")}
            for kind, cells in (("25d", pair.partial_256), ("3d", pair.full)):
                path = folder / names[kind]
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(recgan_file_bytes(unpack(cells)))
            rows.append(pair_row(target, pair, file_25d=names["25d"], file_3d=names["3d"]))
        write_export_json(folder, release, {"pairs": rows})
    return len(rows)


def recgan_name(target: Target, kind: str, views: int) -> str:
    """`P1_<synset>_<category>/<split>_<views>_<kind>_vox256/<recording>_<view>_0_0.npz`."""
    group = f"{SPLIT_NAMES[target.split]}_{views}_{kind}_vox256"
    folder = f"P1_{synset_of(target.category)}_{target.category}"
    return f"{folder}/{group}/{target.recording}_{int(target.view)}_0_0.npz"
