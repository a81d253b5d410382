"""A release as WebDataset shards: tar files that training reads sequentially.

`kinectbench.decode_sample` (scoring/dataset.py) reads the samples back.
"""

import io
import json
import tarfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from kinectbench.core import SettingsError
from kinectbench.core.artefacts.targets import SPLITS, Target
from kinectbench.core.types import Progress, no_progress
from kinectbench.core.voxels.pair_file import Pair, PairInput, checked_pair, pair_values
from kinectbench.release.exchange.layouts import new_folder, pair_record, write_export_json
from kinectbench.release.release import Release

# At 0.3 to 0.9 MB a pair a shard has about 60 MB; each worker process needs its own shard.
PAIRS_PER_SHARD = 100


def export_webdataset(
    release: Release, out: Path, progress: Progress = no_progress, pairs_per_shard: int = PAIRS_PER_SHARD
) -> int:
    """Write the pairs of each split as shards `<split>-000000.tar` and so on; the bytes are reproducible.

    A sample `<recording>_<view>` has two files: `npz`, the published pair file, and `json`: names, transforms
    and numbers. WebDataset's keys end at the first dot, so a dot in a recording's name becomes `-`. If the
    truth is held back, a sample has only the input.

    Args:
        release: the opened release.
        out: a new folder, or an earlier export, which is replaced.
        progress: called with (pairs done, pairs in all).
        pairs_per_shard: largest number of pairs in one file.

    Returns:
        The number of pairs.

    Raises:
        SettingsError: `out` holds something else, or two recordings would get the same keys.
        ReleaseError, PairError: a pair is missing or damaged.
        StorageError: the disk is full or read-only.
    """
    _check_keys(release.targets)
    shards: dict[str, int] = {}
    done = 0
    with new_folder(out) as folder:
        for name, targets in _shards(release, pairs_per_shard):
            with tarfile.open(folder / name, "w", format=tarfile.USTAR_FORMAT) as shard:
                for target in targets:
                    content = release.pair_content(target)
                    row = pair_record(target, _read(release, target, content))
                    _add(shard, f"{_sample_key(target)}.npz", content)
                    _add(shard, f"{_sample_key(target)}.json", json.dumps(row, allow_nan=False).encode())
                    done += 1
                    progress(done, len(release.targets))
            shards[name] = len(targets)
        write_export_json(folder, release, {"layout": "webdataset", "shards": shards})
    return done


def _sample_key(target: Target) -> str:
    """Return the key of a pair's sample in a shard, `<recording>_<view>`, with dots replaced by `-`."""
    return f"{target.recording.replace('.', '-')}_{target.view}"


def _check_keys(targets: Sequence[Target]) -> None:
    """Raise an error if two recordings would get the same keys, as `a.b` and `a-b` would."""
    recordings: dict[str, str] = {}
    for target in targets:
        first = recordings.setdefault(_sample_key(target), target.recording)
        if first != target.recording:
            raise SettingsError(
                f"'{first}' and '{target.recording}' would have the same keys in WebDataset; rename one"
            )


def _shards(release: Release, size: int) -> Iterator[tuple[str, tuple[Target, ...]]]:
    """Yield (file name, pairs) of each shard, split by split; pairs are in the order of targets.csv."""
    for split in SPLITS:
        targets = release.split(split)
        for number, first in enumerate(range(0, len(targets), size)):
            yield f"{split}-{number:06d}.tar", targets[first : first + size]


def _read(release: Release, target: Target, content: bytes) -> Pair | PairInput:
    """Parse and check a pair file: return the pair, or its input if the truth is held back."""
    values = pair_values(content, target.file)
    if target.split in release.metadata.inputs_only:
        return checked_pair(PairInput, values, target.file)
    return checked_pair(Pair, values, target.file)


def _add(shard: tarfile.TarFile, name: str, content: bytes) -> None:
    """Add a file to a shard without owner and time, so that the shard's bytes are reproducible."""
    entry = tarfile.TarInfo(name)
    entry.size, entry.mode = len(content), 0o644
    shard.addfile(entry, io.BytesIO(content))
