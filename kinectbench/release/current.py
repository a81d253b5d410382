"""Publishing a benchmark from its build folders, and knowing whether the release is still current."""

import contextlib
import json
from collections.abc import Callable, Sequence
from pathlib import Path

from kinectbench import __version__
from kinectbench.config import BenchmarkSettings
from kinectbench.errors import ReleaseError
from kinectbench.locks import locked, sweep
from kinectbench.release.metadata import read_metadata, read_text
from kinectbench.release.publish import PublishSummary, publish
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
        wait: whether to wait for another run in this benchmark.
        waiting: called with who holds it, before waiting.

    Raises:
        ReleaseError: nothing was built.
        StorageError: the release cannot be written, or another run is at work here (without `wait`).
    """
    build, out = root / "build", root / "benchmark"
    if not recordings:
        raise ReleaseError(f"{build}: no recording was built, so there is nothing to publish")
    with contextlib.ExitStack() as locks:
        # No other run may change a pair between its checks and its copy.
        for folder in (build, *(build / name for name in sorted(recordings))):
            locks.enter_context(locked(folder, wait=wait, waiting=waiting))
        sweep(out)
        wanted = _fingerprint(settings, build, recordings)
        summary = None if force else _published(build, out, wanted)
        if summary is None:
            summary = publish(settings, build, out, recordings)
            stamp = {
                "fingerprint": wanted,
                "benchmark_sha256": summary.benchmark_sha256,
                "pairs": summary.pairs,
                "recordings": list(summary.recordings),
                "warnings": list(summary.warnings),
            }
            with replaced_file(build / STAMP) as temporary:
                temporary.write_text(pretty_json(stamp))
    return summary


def _fingerprint(settings: BenchmarkSettings, build: Path, recordings: Sequence[str]) -> str:
    manifests = [read_text(build / name / "pairs" / MANIFEST) for name in recordings]
    return sha256_text(canonical_json([__version__, settings.model_dump(mode="json"), manifests]))


def _published(build: Path, out: Path, wanted: str) -> PublishSummary | None:
    """What lies in `out`, if it is what the stamp says and the stamp is what is wanted."""
    try:
        stamp = json.loads((build / STAMP).read_text())
        if stamp["fingerprint"] != wanted or read_metadata(out).benchmark_sha256 != stamp["benchmark_sha256"]:
            return None
        return PublishSummary(
            out,
            stamp["benchmark_sha256"],
            stamp["pairs"],
            tuple(stamp["recordings"]),
            tuple(stamp["warnings"]),
        )
    except (OSError, ValueError, KeyError, TypeError, ReleaseError):
        return None
