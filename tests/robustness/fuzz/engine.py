"""Makes damaged inputs, gives them to a worker process, and keeps those that are a finding.

Case N of a seed is always the same input: `random.Random("seed:N")` draws all of it. A command may use 10 s
of a processor, wait 10 s for anything, and use 500 MB; `worker` says what else it must not do.
"""

import json
import multiprocessing
import os
import random
import re
import shutil
import signal
import stat
import tarfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from fuzz.worker import ERR, OUT, STACK, Call, Ran, run_kinectbench, serve

MOST_CPU_S = 10.0
MOST_IDLE_S = 10.0
# The first call of a command imports and compiles.
WARM_UP_S = 300.0
LOOK_EVERY_S = 0.05
# A process that has run as many commands is replaced: what leaks is not the next one's fault.
COMMANDS_A_WORKER = 2000
# Of one fault; more of them show nothing new.
KEPT_OF_A_FAULT = 3
# A larger input is told, not kept.
MOST_KEPT_BYTES = 64 << 20
# So many inputs are whole: what is refused in all ways at once would show nothing.
UNDAMAGED = 0.03


@dataclass(frozen=True)
class Command:
    """A command's arguments, relative to the folder of the input; `statuses` are those it may end with."""

    arguments: tuple[str, ...]
    statuses: tuple[int, ...] = (0, 1, 2, 3)


# How an input was damaged, in words, and what is run on it.
Damaged = tuple[list[str], list[Command]]


@dataclass(frozen=True)
class Fuzzer:
    """One kind of input.

    Attributes:
        name: in the plural.
        make: writes whole inputs into a folder, one folder each.
        whole: the commands for an input that is not damaged, and the statuses that they must end with.
        damage: damages a copy of such a folder.
    """

    name: str
    make: Callable[[Path], None]
    whole: Callable[[Path], list[Command]]
    damage: Callable[[random.Random, Path], Damaged]


@dataclass(frozen=True)
class Finding:
    """A fault, and the input that shows it."""

    case: int
    fault: str
    detail: str
    command: Command
    story: tuple[str, ...]

    def __str__(self) -> str:
        command = " ".join(self.command.arguments)
        return f"case {self.case}: {self.fault} ({self.detail}) by `{command}` on {'; '.join(self.story)}"


@dataclass
class Result:
    """What a run has done so far: inputs, commands by name and status, and findings."""

    inputs: int = 0
    seconds: float = 0.0
    most_mb: float = 0.0
    commands: Counter[str] = field(default_factory=Counter)
    findings: list[Finding] = field(default_factory=list)


class Worker:
    """A process that runs commands; it is replaced when it hangs, is killed, or has run many."""

    def __init__(
        self,
        warm_up: Sequence[tuple[Path, Sequence[Command]]] = (),
        call: Call = run_kinectbench,
        most_cpu_s: float = MOST_CPU_S,
        most_idle_s: float = MOST_IDLE_S,
    ) -> None:
        """No process yet.

        Args:
            warm_up: commands on whole inputs, run without limits in every new process: they load libraries.
            call: runs a command.
            most_cpu_s: what a command may use of a processor.
            most_idle_s: how long it may wait for anything.
        """
        self._warm_up, self._call = warm_up, call
        self._most_cpu_s, self._most_idle_s = most_cpu_s, most_idle_s
        self._told = TemporaryDirectory(prefix="kinectbench-fuzz-told-")
        self._process: multiprocessing.process.BaseProcess | None = None
        self._done = 0

    def run(self, folder: Path, command: Command) -> Ran:
        """Run a command in a folder."""
        if self._process is None or self._done >= COMMANDS_A_WORKER:
            self._start()
        self._done += 1
        ran = self._ask((folder, command.arguments), self._most_cpu_s, self._most_idle_s)
        if not ran.fault and ran.status not in command.statuses:
            return Ran(ran.status, ran.used_mb, f"status {ran.status}, not {command.statuses}", self.said())
        return ran

    def said(self) -> str:
        """The beginning of what the last command printed."""
        said = b"".join((Path(self._told.name) / name).read_bytes() for name in (OUT, ERR))
        return repr(said.decode(errors="replace")[:300])

    def end(self) -> None:
        """Stop the process, whatever it does."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._connection.close()
        self._process = None

    def close(self) -> None:
        """Stop the process, and remove what it has printed."""
        self.end()
        self._told.cleanup()

    def _start(self) -> None:
        self.end()
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(
            target=serve, args=(theirs, Path(self._told.name), self._call), daemon=True
        )
        self._process.start()
        theirs.close()
        self._done = 0
        for folder, commands in self._warm_up:
            with TemporaryDirectory(prefix="kinectbench-fuzz-") as scratch:
                copy = Path(scratch) / "case"
                shutil.copytree(folder, copy)
                for command in commands:
                    ran = self._ask((copy, command.arguments), WARM_UP_S, WARM_UP_S)
                    assert ran.status in command.statuses, (
                        f"whole {folder.name}: {command}: {ran} {self.said()}"
                    )
        self._connection.send("limit")
        self._connection.recv()

    def _ask(self, message: tuple[Path, tuple[str, ...]], most_cpu_s: float, most_idle_s: float) -> Ran:
        """The answer of the process; one that takes too long, or is killed, is ended."""
        assert self._process is not None and self._process.pid is not None
        pid = self._process.pid
        started_s = used_s = _cpu_s(pid)
        busy_at = time.monotonic()
        try:
            self._connection.send(message)
            while not self._connection.poll(LOOK_EVERY_S):
                now_s = _cpu_s(pid)
                if now_s > used_s:
                    used_s, busy_at = now_s, time.monotonic()
                if used_s - started_s > most_cpu_s:
                    return self._stopped(f"more than {most_cpu_s:g} s of a processor")
                if time.monotonic() - busy_at > most_idle_s:
                    return self._stopped("waits for ever")
            ran: Ran = self._connection.recv()
        except (EOFError, ConnectionError, OSError):
            self._process.join(5)
            code = self._process.exitcode
            detail = self.said()
            self.end()
            return Ran(-1, 0, f"the process ended with {code}", detail)
        return ran

    def _stopped(self, fault: str) -> Ran:
        """End the process; where it was is the end of the stack that it still can tell."""
        assert self._process is not None and self._process.pid is not None
        stack = Path(self._told.name) / STACK
        told = stack.stat().st_size if stack.is_file() else 0
        with suppress(ProcessLookupError):
            os.kill(self._process.pid, signal.SIGUSR1)
        time.sleep(0.5)
        with stack.open(encoding="utf-8") as file:
            file.seek(told)
            frames = re.findall(r'/kinectbench/([\w/]+\.py)", line (\d+) in (\w+)', file.read())
        self.end()
        where = f"{frames[0][0]}:{frames[0][2]}" if frames else "?"
        return Ran(-1, 0, f"{fault}, in {where}", f"line {frames[0][1]}" if frames else "")


def _cpu_s(pid: int) -> float:
    """Seconds of processors that a process has used; 0 if it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def fuzz(
    fuzzer: Fuzzer,
    seconds: float,
    seed: int,
    keep: Path,
    only: int | None = None,
    say: Callable[[str], None] = print,
    call: Call = run_kinectbench,
) -> Result:
    """Damage inputs for some seconds.

    Args:
        fuzzer: of which kind.
        seconds: from the first damaged input on.
        seed: of the cases.
        keep: a folder for inputs that are findings; made when there is one.
        only: run this case alone.
        say: told of each fault when it is found first.
        call: runs a command.
    """
    result = Result()
    with TemporaryDirectory(prefix="kinectbench-fuzz-") as scratch:
        corpus = Path(scratch) / "corpus"
        corpus.mkdir()
        fuzzer.make(corpus)
        wholes = sorted(corpus.iterdir())
        worker = Worker([(whole, fuzzer.whole(whole)) for whole in wholes[:1]], call)
        try:
            worker._start()
            began = time.monotonic()
            for number in _numbers(only):
                if time.monotonic() - began > seconds:
                    break
                _one(fuzzer, wholes, number, seed, Path(scratch), worker, result, keep, say)
            result.seconds = time.monotonic() - began
        finally:
            worker.close()
    return result


def _numbers(only: int | None) -> Iterator[int]:
    if only is not None:
        yield only
        return
    number = 0
    while True:
        yield number
        number += 1


def _one(
    fuzzer: Fuzzer, wholes: list[Path], number: int, seed: int, scratch: Path, worker: Worker, result: Result,
    keep: Path, say: Callable[[str], None],
) -> None:  # fmt: skip
    case = scratch / "case"
    story, commands = plant(fuzzer, wholes, number, seed, case)
    result.inputs += 1
    for command in commands:
        ran = worker.run(case, command)
        name = "/".join(word for word in command.arguments[:1])
        result.commands[f"{name} {ran.status}"] += 1
        result.most_mb = max(result.most_mb, ran.used_mb)
        if ran.fault:
            finding = Finding(number, ran.fault, ran.detail, command, tuple(story))
            same = sum(one.fault == ran.fault for one in result.findings)
            result.findings.append(finding)
            if not same:
                say(f"{fuzzer.name}: {finding}")
            if same < KEPT_OF_A_FAULT:
                remove(case)
                plant(fuzzer, wholes, number, seed, case)
                kept(case, finding, keep / f"{fuzzer.name}-{seed}-{number}.tar.gz")
            break
    remove(case)


def plant(
    fuzzer: Fuzzer, wholes: list[Path], number: int, seed: int, case: Path
) -> tuple[list[str], list[Command]]:
    """Make the folder of a case: how it is damaged, and what is to be run on it."""
    draw = random.Random(f"{seed}:{number}")
    whole = draw.choice(wholes)
    shutil.copytree(whole, case, copy_function=os.link)
    if draw.random() < UNDAMAGED:
        return [whole.name, "whole"], fuzzer.whole(case)
    story, commands = fuzzer.damage(draw, case)
    return [whole.name, *story], commands


def kept(case: Path, finding: Finding, archive: Path) -> None:
    """Keep an input as an archive: its folder, and case.json with the command and the fault."""
    size = sum(p.lstat().st_size for p in case.rglob("*") if stat.S_ISREG(p.lstat().st_mode))
    if size > MOST_KEPT_BYTES:
        return
    archive.parent.mkdir(parents=True, exist_ok=True)
    words = {"arguments": finding.command.arguments, "fault": finding.fault, "detail": finding.detail}
    text = json.dumps({**words, "story": finding.story}, indent=1)
    (case / "case.json").write_text(text, encoding="utf-8")
    with tarfile.open(archive, "w:gz") as file:
        file.add(case, "case")


def again(archive: Path, worker: Worker, folder: Path) -> Ran:
    """Run the command of a kept input on it."""
    with tarfile.open(archive) as file:
        file.extractall(folder, filter="fully_trusted")
    case = folder / "case"
    words = json.loads((case / "case.json").read_text(encoding="utf-8"))
    ran = worker.run(case, Command(tuple(words["arguments"])))
    remove(case)
    return ran


def remove(folder: Path) -> None:
    """Remove a folder, if it is there."""
    if folder.exists():
        shutil.rmtree(folder)
