"""What becomes of a benchmark that is built in another way, or disturbed: a row of `cluster_faults.py`."""

import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from figures import Figure
from small_runs import leftovers, make_small, published, start

from kinectbench.core.errors import KinectBenchError

LONGEST_S = 600.0
BAR = "same bytes, nothing left over, told in a line"
# What commands write on the terminal beside errors: progress, and remarks of recordings.
EXPECTED = re.compile(
    r"\[ *\d+ s\] |cluster: \d+ workers? at |([\w-]+: )?(warning|error|note): |failed: \d+ of \d+ |stopped; "
    r"|waiting: for a worker, "
)
# Files that say when something was made, or by whom.
NOT_MADE = (".lock", "timing.json", "sources.json")


@dataclass(frozen=True)
class Bench:
    """What everything is held against.

    Attributes:
        whole: a benchmark of two recordings that one process built, published, predicted and scored.
        sha256: of its release.
        folder: for copies.
    """

    whole: Path
    sha256: str
    folder: Path

    @property
    def scores(self) -> bytes:
        return (self.whole / "scores" / "scores.json").read_bytes()


@dataclass
class Became:
    """What became of a benchmark.

    Attributes:
        same: files that were held against the undisturbed one's; those that differ stand in `wrong`, too.
        wrong: whatever is not as it should be, one line each.
        told: what the commands said, beside progress and remarks.
        notes: what else the row tells.
    """

    same: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    told: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, other: "Became") -> "Became":
        """What became of it in another regard, too."""
        self.same += other.same
        self.wrong += other.wrong
        self.told += other.told
        self.notes += other.notes
        return self

    def need(self, well: object, otherwise: str) -> None:
        """Something else that must be so."""
        if not well:
            self.wrong.append(otherwise)

    def figure(self, name: str) -> Figure:
        well = bool(self.same) and not self.wrong
        same = " and ".join(dict.fromkeys(self.same))
        lines = [f"same {same}, nothing left over"] if well else self.wrong
        said = list(dict.fromkeys(f"told: {line}" for line in self.told))
        return Figure(name, [*lines, *self.notes, *said], BAR, well)


Row = Callable[[Bench], Became]


class NotHereError(KinectBenchError):
    """This machine lacks what a row needs."""


@dataclass(frozen=True)
class Run:
    """A command that ended."""

    status: int
    out: str
    err: str


def make_bench(folder: Path) -> Bench:
    """Build, publish, predict and score in one process."""
    whole = make_small(folder / "whole")
    sha256 = published(whole)
    for words in (("baseline", "partial", "--jobs", "1"), SCORE):
        check(ended(start(whole, *words)), words)
    return Bench(whole, sha256, folder)


SCORE = ("score", "predictions", "--benchmark", "benchmark", "--no-baselines", "--no-gallery", "--jobs", "1")


def ended(process: "subprocess.Popen[str]") -> Run:
    """Wait for a command; it is killed if it takes for ever."""
    try:
        out, err = process.communicate(timeout=LONGEST_S)
    except subprocess.TimeoutExpired:
        process.kill()
        out, err = process.communicate()
        err += f"\nno end within {LONGEST_S:.0f} s"
    return Run(process.returncode, out, err)


def check(run: Run, words: Sequence[str]) -> None:
    """Raise KinectBenchError if a command that must succeed did not."""
    if run.status:
        raise KinectBenchError(f"{' '.join(words)}: status {run.status}: {run.err.strip()[-400:]}")


def held_against(bench: Bench, root: Path, *runs: tuple[Run, Sequence[int]]) -> Became:
    """Publish what was built, one process building what is missing, and hold it against the bench.

    Args:
        bench: undisturbed.
        root: of the other benchmark.
        runs: what was said while it was built, and the statuses that it may have ended with.
    """
    became = Became()
    for run, statuses in runs:
        became.add(told_by(run, statuses))
    if all(run.status == 0 for run, _ in runs):
        became.need(
            ended(start(root, "build", "--status")).status == 0, "build ended well, and something is missing"
        )
    try:
        became.add(same_release(bench, published(root)))
    except KinectBenchError as error:
        became.wrong.append(f"not published: {error}")
    left = [f"{path.relative_to(root)} is left over" for path in leftovers(root)]
    more = made(root) - made(bench.whole)
    became.wrong += [*left, *(f"{name} is more than there should be" for name in sorted(more))]
    return became


def same_release(bench: Bench, sha256: str) -> Became:
    if sha256 == bench.sha256:
        return Became(same=["benchmark_sha256"])
    return Became(wrong=[f"another benchmark_sha256: {sha256}"])


def same_scores(bench: Bench, root: Path) -> Became:
    """Whether `scores/scores.json` has the same bytes, and nothing is left of its parts."""
    scores = root / "scores" / "scores.json"
    wrong = [f"scores/{path.name} is left over" for path in scores.parent.glob(".*")]
    if not scores.is_file() or scores.read_bytes() != bench.scores:
        wrong.append("another scores.json")
    return Became(same=["scores.json"], wrong=wrong)


def made(root: Path) -> set[str]:
    """Names of all files that were made of the recordings."""
    return {
        path.relative_to(root).as_posix()
        for name in ("build", "benchmark")
        for path in (root / name).rglob("*")
        if path.is_file() and not path.name.endswith(NOT_MADE)
    }


def told_by(run: Run, statuses: Sequence[int]) -> Became:
    """What a command said; wrong are a traceback, another status, no line or several about one error."""
    lines = run.err.splitlines()
    errors = [line for line in lines if "error: " in line]
    became = Became(told=[*errors, *(line for line in lines if line.startswith("warning: "))])
    strange = [line for line in lines if line and not EXPECTED.match(line)]
    became.need(not strange, f"strange lines: {' / '.join(strange)[-400:]}")
    became.need("internal error" not in run.err, "an internal error")
    became.need(run.status in statuses, f"status {run.status}: {run.err.strip()[-200:]}")
    of_whom = [line.partition("error: ")[0] for line in errors]  # one line about all, or about a recording
    became.need(len(of_whom) == len({*of_whom}), f"{len(errors)} lines for one error")
    became.need(errors or run.status not in (1, 3), "no line for an error")
    return became


def figures_of(rows: Mapping[str, Row], only: Sequence[str], bench: Bench) -> list[Figure]:
    """A figure for each row that is wanted; what this machine cannot do is told."""
    found = []
    for name in only:
        started = time.monotonic()
        try:
            figure = rows[name](bench).figure(name)
        except NotHereError as error:
            figure = Figure(name, f"not here: {error}")
        print(f"{name}: {figure.met}, {time.monotonic() - started:.0f} s", file=sys.stderr, flush=True)
        if figure.met is False:
            print(*figure.value, sep="\n  ", file=sys.stderr, flush=True)
        found.append(figure)
    return found


@contextmanager
def variables_set(variables: Mapping[str, str]) -> Iterator[None]:
    """The environment has these, too, for as long as the block runs; then it is what it was."""
    before = dict(os.environ)
    os.environ.update(variables)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
