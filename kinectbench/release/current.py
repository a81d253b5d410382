"""Publishing a benchmark from its build folders, and knowing whether the release is still current."""

import contextlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from kinectbench import __version__
from kinectbench.config import BenchmarkSettings
from kinectbench.errors import ReleaseError
from kinectbench.locks import locked, sweep
from kinectbench.release.metadata import read_metadata, read_text
from kinectbench.release.publish import PRIVATE, PublishOptions, PublishSummary, publish
from kinectbench.workspace import (
    MANIFEST,
    canonical_json,
    pretty_json,
    replaced_file,
    sha256_text,
)

STAMP = "publish.json"


def publish_if_stale(
    settings: BenchmarkSettings,
    root: Path,
    recordings: Sequence[str],
    force: bool = False,
    options: PublishOptions | None = None,
    *,
    wait: bool = True,
    waiting: Callable[[str], None] | None = None,
) -> PublishSummary:
    """Publish `build/` as `benchmark/`, unless that is what lies there already.

    Args:
        settings: the benchmark's.
        root: the folder of benchmark.yaml.
        recordings: ids of those built without failure.
        force: publish anew in any case.
        options: what is asked for beyond the settings; None: what was asked for last time.
        wait: whether to wait for another run in this benchmark.
        waiting: called with who holds it, before waiting.

    Raises:
        ReleaseError: nothing was built, or `benchmark/` holds something else.
        StorageError: the release cannot be written, or another run is at work here (without `wait`).
    """
    build, out = root / "build", root / "benchmark"
    if not recordings:
        raise ReleaseError(f"{build}: no recording was built, so there is nothing to publish")
    with contextlib.ExitStack() as locks:
        # No other run may change a pair between its checks and its copy.
        for folder in (build, *(build / name for name in sorted(recordings))):
            locks.enter_context(locked(folder, wait=wait, waiting=waiting))
        for folder in (out, out.with_name(out.name + PRIVATE)):
            sweep(folder)
        stamp = _stamp(build)
        asked = _earlier_options(stamp) if options is None else options
        wanted = _fingerprint(settings, build, recordings, asked)
        summary = None if force else _published(stamp, out, wanted)
        if summary is None:
            summary = publish(settings, build, out, recordings, asked)
            with replaced_file(build / STAMP) as temporary:
                temporary.write_text(pretty_json(_stamped(wanted, asked, summary)))
    return summary


def scoring_folder(root: Path) -> Path:
    """The release below `root` that has the truth: `benchmark-private/` if `benchmark/` holds some back."""
    out = root / "benchmark"
    private = out.with_name(out.name + PRIVATE)
    try:
        wanted = read_metadata(out).private_benchmark_sha256
        if wanted is not None and read_metadata(private).benchmark_sha256 == wanted:
            return private
    except ReleaseError:  # whoever opens it will say so
        pass
    return out


def _fingerprint(
    settings: BenchmarkSettings, build: Path, recordings: Sequence[str], options: PublishOptions
) -> str:
    manifests = [read_text(build / name / "pairs" / MANIFEST) for name in recordings]
    return sha256_text(
        canonical_json([__version__, settings.model_dump(mode="json"), manifests, asdict(options)])
    )


def _stamp(build: Path) -> dict[str, Any]:
    """What was published last; empty if nothing was, or nobody knows."""
    try:
        stamp = json.loads((build / STAMP).read_text())
    except (OSError, ValueError):
        return {}
    return stamp if isinstance(stamp, dict) else {}


def _stamped(fingerprint: str, options: PublishOptions, summary: PublishSummary) -> dict[str, Any]:
    """The stamp of what was just published."""
    facts = {key: value for key, value in asdict(summary).items() if key not in ("folder", "private")}
    return {"fingerprint": fingerprint, "options": asdict(options), **facts}


def _earlier_options(stamp: Mapping[str, Any]) -> PublishOptions:
    try:
        options = stamp["options"]
        return PublishOptions(tuple(options["hold_back"]), options["thresholds"])
    except (KeyError, TypeError):
        return PublishOptions()


def _published(stamp: Mapping[str, Any], out: Path, wanted: str) -> PublishSummary | None:
    """What lies in `out`, if it is what the stamp says and the stamp is what is wanted."""
    try:
        private = out.with_name(out.name + PRIVATE) if stamp["private_sha256"] else None
        summary = PublishSummary(
            out,
            stamp["benchmark_sha256"],
            stamp["pairs"],
            tuple(stamp["recordings"]),
            tuple(stamp["warnings"]),
            private,
            stamp["private_sha256"],
            tuple(stamp["removed"]),
            tuple(stamp["unanswered"]),
        )
        there = read_metadata(out).benchmark_sha256 == summary.benchmark_sha256
        if private is not None:
            there = there and read_metadata(private).benchmark_sha256 == summary.private_sha256
        return summary if there and stamp["fingerprint"] == wanted else None
    except (KeyError, TypeError, ReleaseError):
        return None
