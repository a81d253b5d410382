"""Runs a command as a process of its own, measures it, and judges how it ended. Linux only.

Nothing is killed for being slow on a machine in use: the limit is on seconds of a processor, and on seconds
in which a process does nothing at all.
"""

import os
import re
import resource
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from fuzz.worker import judged

from hostile_cases.case import Case

MOST_S = 10.0
# What no command may reach: the machine would suffer.
ENDED_AT_MB = 1500.0
LOOK_EVERY_S = 0.02
SECRET = b"SECRET-of-somebody-else"
LOAD = """
import sys
import kinectbench
from kinectbench.core.errors import KinectBenchError
try:
    for _ in kinectbench.load(sys.argv[1]):
        pass
except KinectBenchError as error:
    print(f"error: {error}", file=sys.stderr)
    sys.exit(error.exit_status)
"""


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Attributes:
        status: its exit status; -9 where it was ended.
        wall_s: seconds by the clock.
        cpu_s: seconds of processors, with those of its workers.
        peak_mb: of the largest of its processes.
        said: its first line of errors, or else of output.
        faults: what is wrong with it; empty if all is well.
    """

    status: int
    wall_s: float
    cpu_s: float
    peak_mb: float
    said: str
    faults: tuple[str, ...]


def run_case(case: Case, folder: Path) -> Ended:
    """Run a case's command in a folder `folder/work` that holds its input."""
    work, told = folder / "work", folder / "told"
    (told / "tmp").mkdir(parents=True)
    before = _paths(folder)
    words = shlex.split(case.command)
    python = [sys.executable, "-c", LOAD] if words[0] == "load" else [sys.executable, "-m", "kinectbench"]
    command = [*shlex.split(case.before), *python, *(words[1:] if words[0] == "load" else words)]
    variables = {"COLUMNS": "200", "TMPDIR": str(told / "tmp"), **case.variables}
    with (told / "out").open("wb") as out, (told / "err").open("wb") as err:
        started = time.monotonic()
        process = subprocess.Popen(
            command,
            cwd=work,
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            start_new_session=True,
            env={k: v for k, v in os.environ.items() if k != "KINECTBENCH_DEBUG"} | variables,
        )
        status, cpu_s, peak_mb = _waited(process.pid, case.most_idle_s)
        process.returncode = status
        wall_s = time.monotonic() - started
    out_bytes, err_bytes = (told / "out").read_bytes(), (told / "err").read_bytes()
    faults = _faults(case, status, out_bytes, err_bytes)
    faults += [f"{cpu_s:.1f} s of a processor"] if cpu_s > MOST_S else []
    faults += [f"{peak_mb:.0f} MB"] if peak_mb > case.most_mb else []
    new = _paths(folder) - before
    faults += [
        f"wrote {path}" for path in sorted(new) if not path.startswith(("work/", "told/out", "told/err"))
    ]
    faults += [
        f"{path} holds what is not the stranger's" for path in sorted(new) if _is_secret(folder / path)
    ]
    lines = [
        line for line in (err_bytes + b"\n" + out_bytes).decode(errors="replace").splitlines() if line.strip()
    ]
    return Ended(status, wall_s, cpu_s, peak_mb, lines[0] if lines else "", tuple(faults))


def _faults(case: Case, status: int, out: bytes, err: bytes) -> list[str]:
    """What is wrong with the status and with what was printed."""
    faults = []
    if status not in case.statuses:
        faults.append(f"status {status}, not {' or '.join(map(str, case.statuses))}")
    fault, detail = judged(out, err, max(status, 0))
    if fault and status >= 0:
        faults.append(f"{fault} {detail}".strip())
    said = (out + err).decode(errors="replace")
    if "Traceback" in said or "internal error" in said:
        faults.append("an internal error")
    errors = [line for line in said.splitlines() if re.match(r"(.{0,80}: )?error: ", line)]
    if len(errors) > case.errors:
        faults.append(f"{len(errors)} lines of errors")
    if case.says and not re.search(case.says, said):
        faults.append(f"does not say '{case.says}'")
    if SECRET in out + err:
        faults.append("prints what is not the stranger's")
    return faults


def _waited(pid: int, most_idle_s: float) -> tuple[int, float, float]:
    """Status, seconds of processors and peak of memory of a process that is ended if it takes too much."""
    used_s, most_mb, busy_at = 0.0, 0.0, time.monotonic()
    while True:
        ended, status, usage = os.wait4(pid, os.WNOHANG)
        if ended:
            used_s = usage.ru_utime + usage.ru_stime
            return os.waitstatus_to_exitcode(status), used_s, _peak_mb(usage, most_mb)
        now_s, now_mb = _used(pid)
        most_mb = max(most_mb, now_mb)
        if now_s > used_s:
            used_s, busy_at = now_s, time.monotonic()
        idle_s = time.monotonic() - busy_at
        if now_s > 2 * MOST_S or idle_s > most_idle_s or now_mb > ENDED_AT_MB:
            os.killpg(pid, signal.SIGKILL)
            _, _, usage = os.wait4(pid, 0)
            return -9, max(now_s, idle_s), _peak_mb(usage, most_mb)
        time.sleep(LOOK_EVERY_S)


def _peak_mb(usage: resource.struct_rusage, seen_mb: float) -> float:
    """The peak of a process that has ended; where it is not told, the most that was seen of it.

    Linux counts what this process, which started it, had in memory as the other's.
    """
    own_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return usage.ru_maxrss / 1024 if usage.ru_maxrss > own_kb else seen_mb


def _used(group: int) -> tuple[float, float]:
    """Seconds of processors and the largest memory, MB, of the processes of a group that are alive."""
    seconds = most_mb = 0.0
    for path in Path("/proc").iterdir():
        if path.name.isdecimal():
            try:
                fields = (
                    (path / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
                )
            except OSError:
                continue
            if int(fields[2]) == group:
                seconds += sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
                most_mb = max(most_mb, int(fields[21]) * os.sysconf("SC_PAGE_SIZE") / 2**20)
    return seconds, most_mb


def _paths(folder: Path) -> set[str]:
    """Everything below a folder; links are not followed, folders without permission not looked into."""
    return {
        os.path.relpath(Path(place, name), folder)
        for place, folders, files in os.walk(folder)
        for name in (*folders, *files)
    }


def _is_secret(path: Path) -> bool:
    return path.is_file() and not path.is_symlink() and SECRET in path.read_bytes()
