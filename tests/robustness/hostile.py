"""Strangers' files through the command line: each ends in a line, a documented status, in time and memory.

    python tests/robustness/hostile.py [--only WORDS] [--keep FOLDER]

A case is ok if the command ends with a status that docs/commands.md lists, says at most one line of errors
(those that name everything, a few), writes nothing but its output, and takes no more than 10 s of a processor
and 500 MB. Linux only: memory is asked of the kernel.
"""

import argparse
import json
import multiprocessing
import os
import shutil
import stat
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))

from hostile_cases import (
    bags,
    forged,
    meshes,
    methods,
    names,
    odd_files,
    outside,
    pairs,
    pictures,
    releases,
    servers,
    settings,
)
from hostile_cases.case import Case
from hostile_cases.process import Ended, run_case
from hostile_cases.wholes import make_wholes, put_whole

from kinectbench.core.untrusted import printable

GROUPS = (
    meshes,
    releases,
    bags,
    odd_files,
    outside,
    pairs,
    pictures,
    names,
    settings,
    methods,
    forged,
    servers,
)
SAID = 110


def cases() -> Iterator[Case]:
    """Every case, group by group."""
    for group in GROUPS:
        yield from group.cases()


def tried(case: Case, wholes: Path, scratch: Path) -> Ended:
    """Write the input of a case, in a process of its own whose memory is not counted, and run its command."""
    folder = scratch / "case"
    folder.mkdir()
    put_whole(wholes, case.whole, folder / "work")
    maker = multiprocessing.get_context("fork").Process(target=case.make, args=(folder / "work",))
    maker.start()
    maker.join()
    if maker.exitcode:
        ended = Ended(-1, 0, 0, 0, "", ("its input could not be written",))
    else:
        ended = run_case(case, folder)
    remove(folder)
    return ended


def remove(folder: Path) -> None:
    """Remove a folder, also what has no permissions."""
    for place, folders, _ in os.walk(folder):
        for name in folders:
            path = Path(place, name)
            if not path.is_symlink():
                path.chmod(path.stat().st_mode | stat.S_IRWXU)
    shutil.rmtree(folder)


def row(case: Case, ended: Ended) -> str:
    """A line of the table."""
    verdict = "ok " if not ended.faults else "NOT"
    said = printable(ended.said, SAID)
    figures = f"{ended.status:3} {ended.cpu_s:5.1f} s {ended.wall_s:5.1f} s {ended.peak_mb:5.0f} MB"
    faults = "".join(f"\n      {printable(fault, 400)}" for fault in ended.faults)
    return f"{verdict} {case.group:2} {figures}  {case.name}: {printable(case.command, 60)} | {said}{faults}"


def summary(done: list[tuple[Case, Ended]]) -> str:
    """How many are ok, and the worst of them."""
    ok = sum(not ended.faults for _, ended in done)
    slow = max(done, key=lambda one: one[1].cpu_s)
    large = max(done, key=lambda one: one[1].peak_mb)
    return (
        f"{ok} of {len(done)} cases ok; slowest {slow[1].cpu_s:.1f} s of a processor ({slow[0].name}: "
        f"{slow[0].command.split()[0]}); largest {large[1].peak_mb:.0f} MB ({large[0].name}: "
        f"{large[0].command.split()[0]})"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--groups", nargs="*", help="such as H0 M1; default: all")
    parser.add_argument("--only", default="", help="cases whose name or command has these words")
    parser.add_argument("--wholes", type=Path, help="keep the undamaged inputs here, and use them again")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows there too")
    chosen = parser.parse_args()
    done = list[tuple[Case, Ended]]()
    with TemporaryDirectory(prefix="kinectbench-hostile-") as scratch:
        wholes = chosen.wholes or Path(scratch) / "wholes"
        if not wholes.is_dir():
            wholes.mkdir()
            maker = multiprocessing.get_context("fork").Process(target=make_wholes, args=(wholes,))
            maker.start()
            maker.join()
        for case in cases():
            if chosen.groups and case.group not in chosen.groups:
                continue
            if chosen.only in f"{case.name}: {case.command}":
                done.append((case, tried(case, wholes, Path(scratch))))
                print(row(*done[-1]), flush=True)
    if not done:
        sys.exit(f"no case has '{chosen.only}'")
    print(summary(done))
    if chosen.json:
        rows = [{"group": c.group, "name": c.name, "command": c.command, **asdict(e)} for c, e in done]
        chosen.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    sys.exit(any(ended.faults for _, ended in done))


if __name__ == "__main__":
    main()
