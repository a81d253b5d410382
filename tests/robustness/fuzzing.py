"""Damage what strangers send at random and see that every command ends in time and in its own words.

    python tests/robustness/fuzzing.py recordings --minutes 20

Inputs that are a finding are kept in a folder that is named at the end, three of each fault; `--case N` makes
one input of a seed again and runs it alone, `--again FILE` runs a kept one. The exit status is 1 if there is
a finding.
"""

import argparse
import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

from fuzz.engine import Fuzzer, Result, Worker, again, fuzz
from fuzz.predictions import PREDICTIONS_FUZZER
from fuzz.recordings import RECORDINGS
from fuzz.releases import RELEASES
from fuzz.tables import TABLES_FUZZER

FUZZERS: dict[str, Fuzzer] = {
    one.name: one for one in (RECORDINGS, RELEASES, PREDICTIONS_FUZZER, TABLES_FUZZER)
}


def told(name: str, result: Result, keep: Path) -> list[str]:
    """What a run has found, in lines."""
    rate = result.inputs / result.seconds if result.seconds else 0
    commands = ", ".join(f"{what}: {count}" for what, count in sorted(result.commands.items()))
    faults = Counter(finding.fault for finding in result.findings)
    return [
        f"{name}: {result.inputs} inputs in {result.seconds:.0f} s, {rate:.1f} a second; "
        f"{len(result.findings)} findings of {len(faults)} faults; most memory {result.most_mb:.0f} MB",
        f"{name}: commands and their exit statuses: {commands}",
        *(f"{name}: {count} x {fault}" for fault, count in faults.most_common()),
        *([f"{name}: inputs that are findings: {keep}"] if faults else []),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("name", nargs="?", choices=FUZZERS, help="what is damaged")
    parser.add_argument("--minutes", type=float, default=1, help="how long (default: 1)")
    parser.add_argument("--seed", type=int, default=0, help="of the cases (default: 0)")
    parser.add_argument("--case", type=int, help="run this case alone")
    parser.add_argument("--keep", type=Path, default=Path("fuzz-findings"), help="default: fuzz-findings/")
    parser.add_argument("--again", type=Path, nargs="+", help="run inputs that were kept")
    options = parser.parse_args()
    if options.again:
        return _again(options.again)
    if options.name is None:
        parser.error(f"name what is damaged: {', '.join(FUZZERS)}")
    fuzzer = FUZZERS[options.name]
    result = fuzz(fuzzer, 60 * options.minutes, options.seed, options.keep, options.case)
    print("\n".join(told(fuzzer.name, result, options.keep)), flush=True)
    return 1 if result.findings else 0


def _again(archives: list[Path]) -> int:
    worker, findings = Worker(), 0
    try:
        for archive in archives:
            with TemporaryDirectory() as folder:
                ran = again(archive, worker, Path(folder))
            findings += bool(ran.fault)
            fault = f"{ran.fault} ({ran.detail})" if ran.fault else f"well, status {ran.status}"
            print(f"{archive.name}: {fault}")
    finally:
        worker.close()
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
