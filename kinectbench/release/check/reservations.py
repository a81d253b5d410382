"""Caveats on a release in which `verify` finds no fault, such as checks that could not be made."""

from pathlib import Path

from kinectbench.core import listed, printable
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, ReleaseInfo
from kinectbench.core.artefacts.targets import SHA256SUMS, parse_sums
from kinectbench.release.check.view_check import image_names, no_decoder
from kinectbench.release.contents import OBJECT_FILES
from kinectbench.release.opening import open_contents


def reservations(path: Path, *, checksums_only: bool = False) -> list[str]:
    """Return the caveats on a release in which `verify` finds no fault; the arguments are those of `verify`.

    There is a message for each check that could not be made, and one that names the recordings published
    although they violate limits of `publish.gate`.

    Raises:
        ReleaseError: benchmark.json or SHA256SUMS cannot be read.
    """
    with open_contents(path) as contents:
        info = ReleaseInfo.parse(contents.text(BENCHMARK_JSON), BENCHMARK_JSON)
        sums = parse_sums(contents.text(SHA256SUMS), SHA256SUMS)
    clauses = list[str]()
    if poor := [name for name, recording in info.recordings.items() if recording.poor]:
        clauses.append(f"published below its own limits: {printable(listed(poor), 300)}")
    if info.settings.recordings and not (info.of_this_version or checksums_only):
        stage = "" if info.publish_version is None else f", publish version {info.publish_version},"
        version = printable(info.package_version) + stage
        clauses.append(f"no text was written again: kinectbench {version} wrote them")
    if info.benchmark_sha256_version is None:
        clauses.append(
            "its benchmark_sha256 is of version 1: of the files alone, not of what benchmark.json says"
        )
    pairs = [name for name in sums if name.startswith("pairs/")]
    without = sum(not sums.keys() >= set(image_names(name)) for name in pairs)
    if checksums_only or not pairs:
        return clauses
    solids = [name.split("/")[1] for name in pairs if info.has_solid(name.split("/")[1])]
    if bare := sum(f"objects/{recording}/{OBJECT_FILES[0]}" not in sums for recording in solids):
        clauses.append(
            f"{bare} of {len(pairs)} shapes could not be compared with a mesh: the release has none"
        )
    if without < len(pairs) and (missing := no_decoder()):
        clauses.append(f"no partial was compared with its view's depth: {missing}")
    elif without:
        clauses.append(
            f"{without} of {len(pairs)} partials could not be compared with depth: the release has none"
        )
    return clauses
