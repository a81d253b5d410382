"""Publish a benchmark from its build folders, unless the release is still current."""

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path

from kinectbench.core import ReleaseError, canonical_json, replaced_file, sha256_text
from kinectbench.core.artefacts.benchmark import PublishOptions, PublishStamp, ReleaseInfo
from kinectbench.core.artefacts.manifest import Manifest
from kinectbench.engine.artefact import VERSIONS
from kinectbench.engine.locks import locked, sweep
from kinectbench.release.publish.publish import NO_OPTIONS, PRIVATE, PublishSummary, publish
from kinectbench.release.published import release_text
from kinectbench.release.triage.rules import current_reference, failure
from kinectbench.settings.models import BenchmarkSettings


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
    """Publish `build/` as `benchmark/`, unless the same release is there already; return its summary.

    Args:
        settings: the benchmark's settings.
        root: the folder that holds benchmark.yaml.
        recordings: ids of the recordings built without failure.
        force: publish again in any case.
        options: options beyond the settings; None: the options of the last publication.
        wait: whether to wait if another run has locked the build.
        waiting: called before waiting, with the name of the run that has locked it.

    Raises:
        ReleaseError: nothing was built, or as in `publish`.
        SettingsError: as in `publish`.
        StorageError: as in `publish`, or (without `wait`) another run has locked the build.
    """
    build, out = root / "build", root / "benchmark"
    if not recordings:
        raise ReleaseError(
            f"{build}: no recording was built, so there is nothing to publish", what="not-built"
        )
    with contextlib.ExitStack() as locks:
        # No other run may change a pair between its check and its copy.
        for folder in (build, *(build / name for name in sorted(recordings))):
            locks.enter_context(locked(folder, wait=wait, waiting=waiting))
        for folder in (out, out.with_name(out.name + PRIVATE)):
            sweep(folder)
        stamp = _stamp(build)
        asked = options or (stamp.options if stamp else NO_OPTIONS)
        wanted = _fingerprint(settings, build, recordings, asked)
        summary = None if force else _published(stamp, out, wanted)
        if summary is None:
            summary = publish(settings, build, out, recordings, asked)
            with replaced_file(build / PublishStamp.FILE) as temporary:
                facts = {key: fact for key, fact in vars(summary).items() if key not in ("folder", "private")}
                temporary.write_text(
                    PublishStamp(fingerprint=wanted, options=asked, **facts).text(), encoding="utf-8"
                )
    return summary


def already_published(
    settings: BenchmarkSettings, root: Path, recordings: Sequence[str], options: PublishOptions | None
) -> PublishSummary | None:
    """Return the summary of the present release if `publish_if_stale` would keep it, else None."""
    build, out = root / "build", root / "benchmark"
    stamp = _stamp(build)
    asked = options or (stamp.options if stamp else NO_OPTIONS)
    return _published(stamp, out, _fingerprint(settings, build, recordings, asked))


def scoring_folder(root: Path) -> Path:
    """Return `benchmark-private/` if it is the private part of `benchmark/`, else `benchmark/`."""
    out = root / "benchmark"
    private = out.with_name(out.name + PRIVATE)
    try:
        wanted = ReleaseInfo.read(out).private_benchmark_sha256
        if wanted is not None and ReleaseInfo.read(private).benchmark_sha256 == wanted:
            return private
    except ReleaseError:  # whoever opens it reports it
        pass
    return out


def _fingerprint(
    settings: BenchmarkSettings, build: Path, recordings: Sequence[str], options: PublishOptions
) -> str:
    manifests = [release_text(build / name / "pairs" / Manifest.FILE) for name in recordings]
    # Their figures are published, and decide what a person should look at.
    references = [
        None if (found := current_reference(build / name)) is None else found.json_value()
        for name in recordings
    ]
    failures = [failure(build / each.id) for each in settings.recordings if each.id not in recordings]
    content = [
        VERSIONS["publish"],
        settings.model_dump(mode="json"),
        manifests,
        failures,
        references,
        options.json_value(),
    ]
    return sha256_text(canonical_json(content))


def _stamp(build: Path) -> PublishStamp | None:
    """Read the record of the last publication; None if there is none or it is unreadable."""
    try:
        return PublishStamp.read_if_there(build)
    except ReleaseError:
        return None


def _published(stamp: PublishStamp | None, out: Path, wanted: str) -> PublishSummary | None:
    """Return the summary of the release in `out` if it is current, else None.

    It is current if `stamp`, the record of its publication, has the fingerprint `wanted`, and its parts have
    the hashes stated there.
    """
    if stamp is None or stamp.fingerprint != wanted:
        return None
    private = out.with_name(out.name + PRIVATE) if stamp.private_sha256 else None
    parts = {out: stamp.benchmark_sha256} | ({private: stamp.private_sha256} if private else {})
    try:
        is_there = all(ReleaseInfo.read(part).benchmark_sha256 == sha256 for part, sha256 in parts.items())
    except ReleaseError:
        return None
    facts = {key: fact for key, fact in vars(stamp).items() if key not in ("fingerprint", "options")}
    return PublishSummary(folder=out, private=private, **facts) if is_there else None
