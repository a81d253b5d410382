"""Options of `publish`, checked before anything is built or written."""

from collections.abc import Sequence
from pathlib import Path
from typing import get_args

from kinectbench.config import BenchmarkSettings, Split
from kinectbench.errors import SettingsError
from kinectbench.release.publish import PublishOptions
from kinectbench.scoring.thresholds import read_thresholds


def publish_options(
    settings: BenchmarkSettings, hold_back: Sequence[str], thresholds: Path | None
) -> PublishOptions:
    """The options as a value.

    Args:
        settings: the benchmark's.
        hold_back: splits.
        thresholds: a threshold file, or None.

    Raises:
        SettingsError: no such split, or an unusable threshold file.
    """
    for split in hold_back:
        if split not in get_args(Split):
            raise SettingsError(f"--hold-back {split}: choose among {', '.join(get_args(Split))}")
    if thresholds is None:
        return PublishOptions(tuple(sorted(set(hold_back))))
    test = [recording for recording in settings.recordings if recording.split == "test"]
    categories = sorted({recording.category for recording in test})
    read_thresholds(thresholds, categories, frozenset(recording.object_name for recording in test))
    return PublishOptions(tuple(sorted(set(hold_back))), thresholds.read_text())
