"""Forty simulated scans in Redwood's layout, from a server to scores by the commands of a recipe's README.

A server lies, `fetch` is killed twice; then the scans are built, sorted, published, verified and scored. The
decisions of triage are held against the truth, and time and disk are counted for each part.
"""

import argparse
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))

from figures import Figure, arguments, at_least, at_most, equals, run, stated
from replica_scans import BENCHMARK, Scan, forty, four, make, served, sources_yaml, state_undersides
from scan_server import Fault, ScanServer

from kinectbench.core.artefacts.triage import TriageFile, TriageRow
from kinectbench.lab.evaluate.build import read_build, register_build
from kinectbench.lab.evaluate.measured import measured_surface
from kinectbench.lab.evaluate.solid import solid_figures
from kinectbench.lab.simulate.truth import read_truth

# The bars of triage: from which IoU on known voxels a scan ought to be accepted, and how many of these; which
# known-and-wrong share few of the accepted may have; how many of the published may be left to a person.
GOOD_KNOWN, GOOD_ACCEPTED, WRONG, MOST_WRONG, MOST_LOOK = 0.85, 0.8, 0.005, 0.05, 0.2
# Scans of the recipe's furniture, and of the whole data set (its own lists).
FURNITURE, ALL = 1071, 10_933
# What an hour of a core costs on demand, in dollars: four (AWS' m7i.xlarge, us-east-1) had the list price of
# 0.2016 in 2025.
CORE_HOUR_USD = 0.05
# A scan of Redwood's has 0.37 GB on average (recipes/redwood-furniture/README.md).
SCAN_GB = 0.37
# Of each recording, so that the pairs of so many take minutes.
VIEWS = "views: {count: 3}\n"
# `fetch` is killed when so many scans came.
KILLED_AT = (0.2, 0.6)


class Commands:
    """The commands of a recipe's README, each a process, with its seconds."""

    def __init__(self, root: Path, jobs: int) -> None:
        self.root, self.jobs = root, jobs
        self.seconds: dict[str, float] = {}

    def __call__(self, *words: str, allowed: Sequence[int] = (0,)) -> str:
        begin = time.monotonic()
        done = subprocess.run(self.line(*words), cwd=self.root, capture_output=True, text=True, env=env())
        took_s = time.monotonic() - begin
        self.seconds[words[0]] = self.seconds.get(words[0], 0.0) + took_s
        print(words[0], f"{took_s:.1f} s", flush=True)
        if done.returncode not in allowed or "Traceback" in done.stderr:
            raise RuntimeError(f"{' '.join(words)}: status {done.returncode}\n{done.stderr[-2000:]}")
        return done.stdout

    def line(self, *words: str) -> list[str]:
        jobs = ["--jobs", str(self.jobs)] if words[0] in ("build", "publish", "triage", "score") else []
        return [sys.executable, "-m", "kinectbench", *words, *jobs]

    def fetch_and_be_killed(self, count: int, at: float) -> None:
        """Fetch until a share of the scans came, then be killed."""
        process = subprocess.Popen(
            self.line("fetch", "."),
            cwd=self.root,
            env=env(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        while process.poll() is None and len(list((self.root / "scans").glob("0*.zip"))) < at * count:
            time.sleep(0.01)
        process.kill()
        process.wait()


def env() -> dict[str, str]:
    return os.environ | {"no_proxy": "*", "KINECTBENCH_STORE_PATIENCE_S": "2"}


def slowly(number: int, path: str) -> Fault:
    """Each answer takes a while, so that a kill finds some scans and not all."""
    time.sleep(0.1)
    return ""


def the_whole_way(
    commands: Commands, scans: Sequence[Scan], files: dict[str, bytes], more: str = VIEWS, **sources: str
) -> dict[str, int]:
    """From a server to scores; the bytes on the disk after each part.

    Args:
        commands: in an empty folder.
        scans: that the server has.
        files: by their paths on it.
        more: lines of benchmark.yaml.
        sources: as `sources_yaml` takes them.
    """
    bytes_: dict[str, int] = {}
    with ScanServer(files, lambda number, path: "lie") as lying, ScanServer(files, slowly) as server:
        (commands.root / "sources.yaml").write_text(sources_yaml(lying.url, server.url, **sources))
        (commands.root / "benchmark.yaml").write_text(BENCHMARK + more)
        for at in KILLED_AT:
            commands.fetch_and_be_killed(len(scans), at)
        commands("fetch", ".", allowed=(0, 3))
    state_undersides(scans, commands.root / "recordings.yaml")
    bytes_["scans"] = size(commands.root / "scans")
    commands("build", allowed=(0, 3))
    bytes_["build"] = size(commands.root / "build")
    commands("triage", allowed=(0, 3))
    commands("publish", allowed=(0, 3))
    commands("verify", "benchmark")
    bytes_["release"] = size(commands.root / "benchmark")
    commands("baseline")
    commands("score", "predictions", "--benchmark", "benchmark")
    return bytes_


def size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def evaluated(build: Path, truth: Path) -> dict[str, Any]:
    """The figures of a built solid beside its truth, as `evaluate` has them below `solid`."""
    built = read_build(build)
    true = replace(read_truth(truth), limits=built.limits)
    registration = register_build(built, true)
    assert built.model is not None
    samples = measured_surface(built, true, registration)
    return asdict(solid_figures(built.model, true, registration, samples))


def of_triage(commands: Commands, scans: Sequence[Scan], made: Path) -> Iterator[Figure]:
    """The decisions beside the truth."""
    kinds = {scan.name: scan.kind for scan in scans}
    triage = TriageFile.read(commands.root / "triage")
    rows, found = {row.recording: row for row in triage.rows}, {}
    for name, row in rows.items():
        if row.built:
            found[name] = evaluated(commands.root / "build" / name, made / f"{name}.zip.truth")
        of = found.get(name, {})
        figures = [of.get("fine", {}).get(key) for key in ("iou", "known_iou")]
        print(name, kinds[name], row.decision, figures, of.get("known_gross_share"), row.estimated_iou_low,
              *row.reasons[:1], sep=" | ", flush=True)  # fmt: skip
    for decision in ("accept", "look", "reject"):
        kind = Counter(kinds[name] for name, row in rows.items() if row.decision == decision)
        yield stated(decision, ", ".join(f"{count} {name}" for name, count in kind.most_common()))
    yield stated("not fetched", [scan.name for scan in scans if scan.name not in rows])
    yield stated("named as one object", [pair.recordings for pair in triage.same_object])
    yield from bars(rows, found)


def bars(rows: Mapping[str, TriageRow], found: Mapping[str, Mapping[str, Any]]) -> Iterator[Figure]:
    """The bars of triage: its rows, and the figures of what is built beside the truth, by recording."""
    accepted, look = (
        [name for name, row in rows.items() if row.decision == decision] for decision in ("accept", "look")
    )
    below = [n for n in accepted if found[n]["fine"]["iou"] < (rows[n].estimated_iou_low or 0.0)]
    good = [name for name, of in found.items() if of["fine"]["known_iou"] >= GOOD_KNOWN]
    wrong = [name for name in accepted if (found[name]["known_gross_share"] or 0.0) > WRONG]
    yield stated("accepted, and known and wrong", wrong)
    yield stated(
        f"IoU on known >= {GOOD_KNOWN}, and not accepted", [name for name in good if name not in accepted]
    )
    yield equals("accepted, and below the low end of the estimate", below, [])
    yield at_most(
        "share of the published that a person should look at",
        len(look) / max(1, len(accepted) + len(look)),
        MOST_LOOK,
    )
    yield at_least(
        f"share of those of IoU on known >= {GOOD_KNOWN} that are accepted",
        sum(name in accepted for name in good) / max(1, len(good)),
        GOOD_ACCEPTED,
    )
    yield at_most(
        f"share of the accepted of which more than {WRONG:.1%} is known and wrong",
        len(wrong) / max(1, len(accepted)),
        MOST_WRONG,
    )


def measure(options: argparse.Namespace, folder: Path) -> Iterator[Figure]:
    scans = four() if options.four else forty(options.seeds)[:: options.every]
    made, root = folder / "made", folder / "recipe"
    made.mkdir(parents=True, exist_ok=True)
    root.mkdir(exist_ok=True)
    missing = [scan for scan in scans if not (made / f"{scan.name}.zip").exists()]
    with ProcessPoolExecutor(options.jobs) as pool:
        list(pool.map(partial(make, folder=made), missing))
    commands = Commands(root, options.jobs)
    bytes_ = the_whole_way(commands, scans, served(scans, made))
    for name, seconds in commands.seconds.items():
        yield stated(f"{name}, seconds", round(seconds, 1))
    for name, count in bytes_.items():
        yield stated(f"{name}, MB a scan", round(count / 1e6 / len(scans), 2))
    yield from of_triage(commands, scans, made)
    build_s = commands.seconds["build"] * options.jobs / len(scans)
    for count in (FURNITURE, ALL):
        hours = count * build_s / 3600
        yield stated(
            f"{count} scans of this size: core hours, dollars, TB of scans, GB of release",
            f"{hours:.0f}, {hours * CORE_HOUR_USD:.0f}, {count * SCAN_GB / 1000:.1f}, "
            f"{count * bytes_['release'] / len(scans) / 1e9:.0f}",
        )


if __name__ == "__main__":
    parser = arguments(__doc__)
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--four", action="store_true", help="only four scans")
    parser.add_argument("--every", type=int, default=1, help="every so many of the forty")
    parser.add_argument("--seeds", type=int, default=0, help="other objects: added to their seeds")
    parser.add_argument("--folder", type=Path, help="keep all here; scans that are there are used again")
    options = parser.parse_args()
    with TemporaryDirectory() as temporary:
        run(options, lambda: [*measure(options, options.folder or Path(temporary))])
