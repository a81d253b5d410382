"""Releases of a publisher who means no good: damaged, with or without all checksums made right again."""

import hashlib
import re
import shutil
import sys
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from random import Random

from fuzz.damage import of_content
from fuzz.engine import Command, Damaged, Fuzzer
from fuzz.places import of_folder, put
from kinectbench.core.artefacts.targets import benchmark_sha256

sys.path.append(str(Path(__file__).resolve().parents[2] / "support"))
# One test pair, one of validation.
WANTED = (("chair_01", "chair", "red", "test", 1), ("chair_02", "chair", "blue", "validation", 1))
RELEASE, PREDICTIONS, SUMS = "release", "predictions", "SHA256SUMS"
SEALED, PACKED = 0.6, 0.25
HUGE_BYTES = 128 << 20
ON_RELEASE = ("--benchmark", RELEASE, "--jobs", "1")
SCORE = (
    "score",
    PREDICTIONS,
    *ON_RELEASE,
    "--no-surface",
    "--no-baselines",
    "--no-gallery",
    "--out",
    "scores",
)
LAYOUTS = ("recgan", "bop", "webdataset", "rgbd")
COMMANDS: tuple[tuple[str, ...], ...] = (
    ("load", RELEASE),
    SCORE,
    ("check", PREDICTIONS, *ON_RELEASE),
    ("baseline", "empty", "partial", *ON_RELEASE, "--out", "baselines"),
    ("report", *ON_RELEASE, "--out", "page.html"),
    *(("export", "exported", "--layout", layout, *ON_RELEASE) for layout in LAYOUTS),
)


def make_release(folder: Path) -> None:
    """`release/` and `predictions/`, which holds small grids for its pairs."""
    import numpy as np
    from analytic_release import write_analytic_build
    from synthetic_release import synthetic_settings

    from kinectbench.release.publish.publish import publish

    build = folder / "build"
    write_analytic_build(build, WANTED)
    publish(synthetic_settings(WANTED), build, folder / RELEASE, [name for name, *_ in WANTED])
    shutil.rmtree(build)
    for name, *_ in WANTED:
        (folder / PREDICTIONS / name).mkdir(parents=True)
        np.save(folder / PREDICTIONS / name / "000.npy", np.full((8, 8, 8), 0.5, np.float16))


def make(folder: Path) -> None:
    (folder / "whole").mkdir()
    make_release(folder / "whole")


def whole(case: Path) -> list[Command]:
    return [Command(words, (0,)) for words in (("verify", RELEASE), *COMMANDS)]


def damage(draw: Random, case: Path) -> Damaged:
    release = case / RELEASE
    before = {path: path.read_bytes() for path in listed(release)}
    by_place = draw.choice((0.0, 0.3))
    story = of_folder(draw, release, by_place)
    changed = by_place == 0 and any(path.read_bytes() != content for path, content in before.items())
    if draw.random() < SEALED:
        seal(release)
        changed = False
        story.append("sealed")
    if draw.random() < PACKED:
        name, said = pack(draw, release)
        return [*story, said], [Command(("verify", name))]
    verify = Command(("verify", RELEASE), (1, 2) if changed else (0, 1, 2))
    return story, [verify, Command(draw.choice(COMMANDS))]


def listed(release: Path) -> list[Path]:
    """Every plain file that is not huge, in order."""
    plain = (path for path in sorted(release.rglob("*")) if path.is_file() and not path.is_symlink())
    return [path for path in plain if path.stat().st_size < HUGE_BYTES]


def _is_listed(path: Path) -> bool:
    return path.is_file() and not path.is_symlink() and path.stat().st_size < HUGE_BYTES


def seal(release: Path) -> None:
    """Make every checksum right again, whatever the files hold now: as texts, not as what they should be."""
    _with_hashes(
        release, (*release.glob("targets*/*.csv"), release / "targets.csv", release / "croissant.json")
    )
    names = [
        path.relative_to(release).as_posix() for path in listed(release) if path.stat().st_size < 1 << 28
    ]
    lines = {
        name: f"{_sha256(release / name)}  {name}\n" for name in names if name not in (SUMS, "benchmark.json")
    }
    benchmark = release / "benchmark.json"
    if _is_listed(benchmark):
        content, said = benchmark.read_bytes(), "".join(lines[name] for name in sorted(lines))
        try:
            whole = benchmark_sha256(said, content.decode()).encode()
        except (ValueError, RecursionError, AttributeError):  # no JSON any more, or no object
            whole = b"0" * 64
        put(benchmark, re.sub(rb'("benchmark_sha256": *")[0-9a-f]{64}', rb"\g<1>" + whole, content))
        lines[benchmark.name] = f"{_sha256(benchmark)}  {benchmark.name}\n"
    if _is_listed(release / SUMS):
        put(release / SUMS, "".join(lines[name] for name in sorted(lines)).encode(errors="replace"))


def _with_hashes(release: Path, tables: tuple[Path, ...]) -> None:
    """Put the hashes that pairs have now into tables, in place of those that stand behind their names."""
    for table in tables:
        if not _is_listed(table):
            continue
        content = table.read_bytes()
        for path in listed(release):
            if path.suffix == ".npz" or path.name == "targets.csv":
                name = re.escape(path.relative_to(release).as_posix().encode())
                content = re.sub(
                    rb"(" + name + rb"[^\n]{0,300}?)\b[0-9a-f]{64}\b",
                    rb"\g<1>" + _sha256(path).encode(),
                    content,
                )
        put(table, content)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def pack(draw: Random, release: Path) -> tuple[str, str]:
    """Put the release into an archive, which may be damaged itself; its name, and what was done."""
    name = draw.choice(("release.zip", "release.tar", "release.tar.gz"))
    path = release.with_name(name)
    packers: dict[str, Callable[[Path, Path], None]] = {
        "release.zip": _zip,
        "release.tar": _tar,
        "release.tar.gz": _tar,
    }
    packers[name](release, path)
    if draw.random() < 0.3:
        return name, name
    content, said = of_content(draw, name, path.read_bytes())
    path.write_bytes(content)
    return name, f"{name}: {said}"


def _zip(release: Path, path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, strict_timestamps=False) as archive:
        for file in listed(release):
            archive.write(file, file.relative_to(release).as_posix().encode(errors="replace").decode())


def _tar(release: Path, path: Path) -> None:
    with tarfile.open(path, "w:gz" if path.suffix == ".gz" else "w") as archive:
        for file in sorted(release.rglob("*")):
            if not file.is_file() or file.stat().st_size < HUGE_BYTES:
                archive.add(file, f"furniture-1.0/{file.relative_to(release)}", recursive=False)


RELEASES = Fuzzer("releases", make, whole, damage)
