"""The process in which the commands run on damaged inputs, and the judge of what they do.

A command ends well if it returns one of the documented statuses, prints nothing that could steer a terminal,
and its errors are single lines in its own words: no exception but the package's own, nothing that a library
writes. Linux only: the peak of memory is asked of /proc.
"""

import faulthandler
import os
import resource
import signal
import sys
import traceback
import unicodedata
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

STATUSES = (0, 1, 2, 3)
# Beyond what the process has when it starts: what it reserves, and what it uses of that.
MOST_RESERVED_MB = 2000
MOST_MB = 500
MOST_FILE_MB = 1000
LONGEST_LINE = 1000
# How each line of a command begins on standard error.
OWN_LINES = ("error: ", "warning: ", "note: ", "failed: ", "waiting: ", "[")
OWN_PARTS = (": error: ", ": warning: ", ": note: ", ": do this first: ")
# Runs a command's arguments; returns its exit status.
Call = Callable[[tuple[str, ...]], int]
STACK, OUT, ERR = "stack.txt", "out.txt", "err.txt"


@dataclass(frozen=True)
class Ran:
    """What became of one command.

    Attributes:
        status: its exit status.
        used_mb: most memory that it used beyond what was used before.
        fault: what is wrong, as a class: the same words for the same fault; "" if nothing.
        detail: what is to be known of the fault.
    """

    status: int
    used_mb: float
    fault: str = ""
    detail: str = ""


def serve(connection: Connection, told: Path, call: Call) -> None:
    """Run commands as they come until the connection ends: (folder, arguments) in, `Ran` out.

    Args:
        connection: to the engine; "limit" sets the limits of memory, from what is used at that time.
        told: a folder for what the commands print.
        call: runs a command; returns its exit status.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ["KINECTBENCH_DEBUG"] = "1"
    os.environ["TMPDIR"] = str(told)
    stack = (told / STACK).open("w", encoding="utf-8")
    faulthandler.register(signal.SIGUSR1, file=stack, all_threads=False)
    for name, descriptor in ((OUT, 1), (ERR, 2)):
        os.dup2(os.open(told / name, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND), descriptor)
    while True:
        try:
            message = connection.recv()
        except EOFError:
            return
        if message == "limit":
            _limit()
            connection.send(None)
        else:
            folder, arguments = message
            connection.send(_run(folder, arguments, told, call))


def _limit() -> None:
    size = 1024 * memory_kb("VmSize") + (MOST_RESERVED_MB << 20)
    resource.setrlimit(resource.RLIMIT_AS, (size, size))
    resource.setrlimit(resource.RLIMIT_FSIZE, (MOST_FILE_MB << 20, MOST_FILE_MB << 20))


def _run(folder: Path, arguments: tuple[str, ...], told: Path, call: Call) -> Ran:
    for descriptor in (1, 2):
        os.ftruncate(descriptor, 0)
    os.chdir(folder)
    before_kb = forget_peak()
    status, fault, detail = _called(call, arguments)
    used_mb = (memory_kb("VmHWM") - before_kb) / 1024
    sys.stdout.flush()
    sys.stderr.flush()
    os.chdir(told)
    if not fault:
        fault, detail = judged((told / OUT).read_bytes(), (told / ERR).read_bytes(), status)
    if not fault and used_mb > MOST_MB:
        fault, detail = "memory", f"{used_mb:.0f} MB"
    return Ran(status, used_mb, fault, detail)


def run_kinectbench(arguments: tuple[str, ...]) -> int:
    """Run a command of kinectbench, or `load`: what `kinectbench.load` does for whoever trains.

    Returns:
        The exit status.
    """
    from kinectbench.cli.main import main

    if arguments[0] == "load":
        return _load(arguments[1])
    sys.argv = ["kinectbench", *arguments]
    try:
        main()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def _load(release: str) -> int:
    import kinectbench
    from kinectbench.cli import console
    from kinectbench.core.errors import KinectBenchError

    try:
        for _ in kinectbench.load(release):
            pass
    except KinectBenchError as error:
        console.lines("error", [str(error)], "red")
        return error.exit_status
    return 0


def _called(call: Call, arguments: tuple[str, ...]) -> tuple[int, str, str]:
    """Status of a command, and the exception that it should not have raised, as a class and in detail."""
    try:
        return call(arguments), "", ""
    except BaseException as error:
        own = [f for f in traceback.extract_tb(error.__traceback__) if "/kinectbench/" in f.filename]
        where = f"{own[-1].filename.rpartition('/kinectbench/')[2]}:{own[-1].name}" if own else "?"
        detail = f"line {own[-1].lineno if own else 0}: {str(error)[:300]}"
        return 1, f"{type(error).__name__} in {where}", detail


def judged(out: bytes, err: bytes, status: int) -> tuple[str, str]:
    """What is wrong with what a command has printed, as a class and in detail."""
    if status not in STATUSES:
        return f"exit status {status}", ""
    for line in (out + err).decode(errors="replace").split("\n"):
        if any(unicodedata.category(c)[0] == "C" or c in "\u2028\u2029" for c in line):
            return "control characters", repr(line[:300])
        if len(line) > LONGEST_LINE:
            return f"a line of more than {LONGEST_LINE} characters", line[:100]
    lines = err.decode(errors="replace").splitlines()
    if any("internal error: " in line for line in lines):
        return "internal error", repr(lines[:3])
    foreign = [s for s in lines if s and not s.startswith(OWN_LINES) and not any(p in s for p in OWN_PARTS)]
    if foreign:
        return "words that are not the command's own", repr("\n".join(foreign)[:300])
    if status and not (out + err).strip():
        return "a failure without a word", f"status {status}"
    return "", ""


def forget_peak() -> int:
    """Let VmHWM, this process's peak of memory, start anew; returns what it has in memory now, kB."""
    Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")
    return memory_kb("VmRSS")


def memory_kb(name: str) -> int:
    """A figure of /proc/self/status, such as VmRSS."""
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(f"{name}:"))
