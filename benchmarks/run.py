"""The benchmarks: what there is, running them, and their figures beside the stored ones.

    python benchmarks/run.py                                lists them
    python benchmarks/run.py score_speed score_reference    runs these
    python benchmarks/run.py known --families mug           runs one, with options of its own
    python benchmarks/run.py --stored                       runs those that have baselines
    python benchmarks/run.py --store score_speed            runs it, and stores its figures as baselines

`baselines.json` has, for a benchmark, its options and figures, each with a tolerance: by how much it may
differ. A figure with a bar may be any amount better.
"""

import argparse
import ast
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from itertools import takewhile
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).resolve().parent
TESTS = ROOT.parent / "tests"
ROOMS = {
    "tracking": ROOT / "tracking",
    "truth": ROOT / "truth",
    "scoring": ROOT / "scoring",
    "speed": ROOT / "speed",
    "robustness": TESTS / "robustness",
}
# These are run by their paths: the list stays short.
NOT_LISTED = ("fuzzing", "hostile", "replica", "same_object", "sensitivity", "standing_alone")
BASELINES = ROOT / "baselines.json"
# Where modules are that benchmarks share.
IMPORTED = (ROOT, *ROOMS.values(), TESTS / "support")


def scripts() -> dict[str, Path]:
    """The benchmarks by name, in the order of the rooms: the scripts that can be run."""
    return {
        path.stem: path
        for room in ROOMS.values()
        for path in sorted(room.glob("*.py"))
        if path.stem not in NOT_LISTED and 'if __name__ == "__main__"' in path.read_text(encoding="utf-8")
    }


def listing() -> list[str]:
    """A line for each benchmark: its name, and the first line of what it says of itself."""
    stored, lines = baselines(), []
    found = scripts()
    for room, folder in ROOMS.items():
        lines.append(f"{room}:")
        for name, path in found.items():
            if path.parent == folder:
                text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
                lines.append(f"  {name:17} {'*' if name in stored else ' '} {text.splitlines()[0]}")
    return [*lines, "* has baselines; NAME --help lists the options of one"]


def baselines() -> dict[str, Any]:
    """What baselines.json has, by the name of the benchmark."""
    content: dict[str, Any] = json.loads(BASELINES.read_text(encoding="utf-8"))
    return content


def compared(figures: Sequence[Mapping[str, Any]], stored: Mapping[str, Any]) -> list[str]:
    """The stored figures that differ by more than their tolerance, or are missing, one line each.

    Args:
        figures: rows of a benchmark's JSON: `name`, `value` and `bar`.
        stored: `value` and `tolerance` by the name of the figure.
    """
    measured = {row["name"]: row for row in figures}
    problems = []
    for name, baseline in stored.items():
        if name not in measured:
            problems.append(f"{name}: not measured any more; stored is {baseline['value']:g}")
            continue
        value, bar = measured[name]["value"], measured[name]["bar"] or ""
        more = value - baseline["value"]
        better = (bar.startswith(">=") and more > 0) or (bar.startswith("<=") and more < 0)
        if abs(more) > baseline["tolerance"] and not better:
            text = f"{name}: {value:.4g}; stored is {baseline['value']:.4g} ± {baseline['tolerance']:.2g}"
            problems.append(text)
    return problems


def measured(name: str, options: Sequence[str]) -> tuple[int, list[dict[str, Any]]]:
    """Run a benchmark; its exit status, and its figures (none if it could not be run)."""
    paths = [*map(str, IMPORTED), *filter(None, [os.environ.get("PYTHONPATH")])]
    with TemporaryDirectory(prefix="kinectbench-figures-") as folder:
        file = Path(folder) / "figures.json"
        given = [] if "--json" in options else ["--json", str(file)]
        done = subprocess.run(
            [sys.executable, str(scripts()[name]), *options, *given],
            env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
            check=False,
        )
        rows = json.loads(file.read_text(encoding="utf-8"))["figures"] if file.is_file() else []
    return done.returncode, rows


def store(name: str, figures: Sequence[Mapping[str, Any]]) -> None:
    """Write the measured values in place of the stored ones; tolerances stay as they are."""
    content = baselines()
    values = {row["name"]: row["value"] for row in figures}
    for figure, baseline in content[name]["figures"].items():
        baseline["value"] = float(f"{values[figure]:.4g}")
    BASELINES.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def run(name: str, options: Sequence[str], *, storing: bool) -> list[str]:
    """Run a benchmark, compare its figures if it ran as stored, and return what is wrong."""
    baseline = baselines().get(name)
    as_stored = baseline is not None and not options
    print(f"== {name}", flush=True)
    status, figures = measured(name, baseline["options"] if baseline and as_stored else options)
    problems = [f"{name}: ended with status {status}"] if status else []
    if as_stored and baseline and figures:
        if storing:
            store(name, figures)
        else:
            problems += [f"{name}: {line}" for line in compared(figures, baseline["figures"])]
    return problems


def main(words: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--stored", action="store_true", help="run the benchmarks that have baselines")
    parser.add_argument("--store", action="store_true", help="store the figures as baselines")
    parser.add_argument("rest", nargs=argparse.REMAINDER, metavar="NAME ... [OPTIONS]")
    chosen = parser.parse_args(words)
    known = scripts()
    names = [*baselines()] if chosen.stored else [*takewhile(known.__contains__, chosen.rest)]
    options = chosen.rest[0 if chosen.stored else len(names) :]
    if not names and not options:
        print("\n".join(listing()))
        return 0
    if not names:
        parser.error(f"there is no benchmark {options[0]}; there are {', '.join(known)}")
    if options and len(names) > 1:
        parser.error(f"{options[0]}: options go to one benchmark; name one, or check the name")
    if chosen.store and (options or not set(names) <= {*baselines()}):
        parser.error(f"--store: name benchmarks of {BASELINES.name}, and no options")
    problems = [line for name in names for line in run(name, options, storing=chosen.store)]
    print(*problems, sep="\n", file=sys.stderr, end="\n" if problems else "")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
