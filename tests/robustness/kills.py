"""SIGKILL at random moments of `build` and of `publish`: started again, does it make the same benchmark?

Every round begins with what its command begins with (`build`: recordings only; `publish`: what was built, and
every other time an older release), kills the command and all its processes once it has begun to write, and
runs `publish` to its end. A moment is drawn evenly over the time that the command takes from its first file
to its end; a command that was done before it was killed is tried again.
"""

import itertools
import os
import random
import signal
import subprocess
import sys
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from figures import Figure, arguments, equals, run, stated
from small_runs import OBJECTS, copied, leftovers, make_small, published, start

from kinectbench.core.errors import KinectBenchError

# What a command writes first; then it is killed.
FIRST_FILE = {"build": "build/*/.*.part", "publish": ".benchmark.*.part"}
LONGEST_S = 600.0
TRIES = 20


@dataclass(frozen=True)
class Round:
    """One kill.

    Attributes:
        command: `build` or `publish`.
        where: the stage, or release, that was being written (empty: none).
        sha256: of the release, after the restart.
        left: files that nobody cleared away.
        seconds: killing and starting again.
    """

    command: str
    where: str
    sha256: str
    left: int
    seconds: float


def options() -> ArgumentParser:
    parser = arguments(__doc__)
    parser.add_argument("--rounds", type=int, default=50, help="kills; default: 50")
    parser.add_argument("--recordings", type=int, default=1, choices=(1, 2), help="default: 1")
    parser.add_argument("--seed", type=int, default=0, help="draws the moments")
    return parser


def measure(chosen: Namespace) -> Iterator[Figure]:
    with TemporaryDirectory(prefix="kinectbench-kills-") as folder:
        undisturbed = make_small(Path(folder) / "undisturbed", [*OBJECTS][: chosen.recordings])
        wanted = published(undisturbed)
        rounds = list(
            kill_rounds(undisturbed, Path(folder) / "killed", chosen.rounds, random.Random(chosen.seed))
        )
    yield stated("benchmark_sha256, undisturbed", wanted)
    for command in FIRST_FILE:
        mine = [each for each in rounds if each.command == command]
        yield stated(f"{command}: killed while it wrote", counted(each.where for each in mine))
    yield equals("kills", len(rounds), chosen.rounds)
    yield equals(
        "same benchmark_sha256 after the restart", sum(r.sha256 == wanted for r in rounds), chosen.rounds
    )
    yield equals("temporary files left over", sum(each.left for each in rounds), 0)
    yield stated("a round, s (mean)", round(sum(each.seconds for each in rounds) / max(len(rounds), 1), 1))


def kill_rounds(undisturbed: Path, root: Path, count: int, moments: random.Random) -> Iterator[Round]:
    """So many kills, of `build` and of `publish` in turn; `undisturbed` is built and published."""
    lasts = {
        command: working_seconds(begun(undisturbed, root, command, 0), command) for command in FIRST_FILE
    }
    for number in range(count):
        command = list(FIRST_FILE)[number % 2]
        started = time.monotonic()
        for _ in range(TRIES):
            process = start(
                begun(undisturbed, root, command, number), command, "--jobs", str(1 + number // 2 % 2)
            )
            if killed(process, root, command, moments.uniform(0, lasts[command])):
                break
        else:
            raise KinectBenchError(
                f"{command} was always done before it could be killed; run this on a quieter machine"
            )
        where = ", ".join(sorted({path.name.split(".")[1] for path in leftovers(root)}))
        sha256 = published(root)
        seconds = time.monotonic() - started
        print(
            f"{number + 1} of {count}: {command}, writing {where or 'nothing'}, {seconds:.0f} s",
            file=sys.stderr,
        )
        yield Round(command, where, sha256, len(leftovers(root)), seconds)


def begun(undisturbed: Path, root: Path, command: str, number: int) -> Path:
    """The folder as the command finds it."""
    if command == "build":
        return copied(undisturbed, root)
    copied(undisturbed, root, "build", *(["benchmark"] if number // 2 % 2 else []))
    # What was published before is out of date: the command has something to do.
    (root / "build" / "publish.json").unlink()
    return root


def working_seconds(root: Path, command: str) -> float:
    """From the first file that a command writes to its end."""
    process = start(root, command, "--jobs", "1")
    wait_for_first_file(process, root, command)
    started = time.monotonic()
    process.communicate()
    return time.monotonic() - started


def killed(process: "subprocess.Popen[str]", root: Path, command: str, after_s: float) -> bool:
    """Kill a command and its workers so long after its first file; False if it had ended by then."""
    wait_for_first_file(process, root, command)
    time.sleep(after_s)
    hit = process.poll() is None
    if hit:
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    return hit and process.returncode == -signal.SIGKILL


def wait_for_first_file(process: "subprocess.Popen[str]", root: Path, command: str) -> None:
    end = time.monotonic() + LONGEST_S
    while process.poll() is None and next(root.glob(FIRST_FILE[command]), None) is None:
        if time.monotonic() > end:
            raise KinectBenchError(f"{command} wrote nothing in {LONGEST_S:.0f} s")
        time.sleep(0.001)


def counted(places: Iterator[str]) -> list[str]:
    """Such as `object: 3`, in the order of the alphabet."""
    groups = itertools.groupby(sorted(place or "nothing" for place in places))
    return [f"{place}: {len(list(group))}" for place, group in groups]


if __name__ == "__main__":
    chosen = options().parse_args()
    run(chosen, lambda: list(measure(chosen)))
