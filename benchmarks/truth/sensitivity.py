"""How much each constant of a stage matters: it is moved by a fifth, and the stage is made with it.

    python benchmarks/truth/sensitivity.py --stages track segment --draw 40 --build DIR --jobs 2

Constants are the numbers that modules of `stages/` name at their top. A trial edits one of them in a copy of
the package, and makes the stage of a few simulated objects in a process of its own. Its files and figures are
compared with those of the package as it is: the table has the largest change of each figure. What lies in
--build is not made again, so an interrupted run goes on.
"""

import argparse
import ast
import hashlib
import json
import os
import random
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from typing import Any

from rich.console import Console
from rich.table import Table

for room in (".", "tracking"):
    sys.path.append(str(Path(__file__).resolve().parents[1] / room))

PACKAGE = Path(__file__).resolve().parents[2] / "kinectbench"
STAGES = ("track", "fuse", "segment")
FACTORS = (0.8, 1.25)
# Of families looked at: furniture on legs, and a small open thing that is recorded from near.
OBJECTS = ("chair:31", "mug:31")
NEAR = ("mug",)
FRAMES = 40
# Changes of less are those of rounding: of a share, or of metres.
SAME = 1e-4
AT_5_MM = 0
NOTHING = "no byte"


@dataclass(frozen=True)
class Number:
    """A literal of a constant.

    Attributes:
        stage: whose it is.
        path: of its module, below the package.
        name: of the constant, with the place in it where it has several numbers.
        line: from 1.
        columns: of the literal, first and one past the last.
        value: as it stands there.
    """

    stage: str
    path: str
    name: str
    line: int
    columns: tuple[int, int]
    value: float

    def moved(self, factor: float) -> float:
        """The value times the factor; of whole numbers at least one off."""
        if not isinstance(self.value, int):
            return float(f"{self.value * factor:.6g}")
        off = max(1, round(abs(self.value * (factor - 1))))
        return self.value + (off if factor > 1 else -off)


def numbers(stage: str) -> list[Number]:
    """The numbers of a stage's constants, module by module."""
    found = []
    for path in sorted((PACKAGE / "stages" / stage).rglob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                target = node.targets[0] if isinstance(node, ast.Assign) else node.target
                name = ast.unparse(target).strip("()")
                if name.replace(", ", "").replace("_", "").isupper():
                    literals = [one for one in ast.walk(node.value) if _is_number(one)]
                    found += [
                        Number(
                            stage,
                            path.relative_to(PACKAGE).as_posix(),
                            name if len(literals) == 1 else f"{name} [{n}]",
                            one.lineno,
                            (one.col_offset, one.end_col_offset or 0),
                            one.value,
                        )
                        for n, one in enumerate(literals)
                    ]
    return found


def _is_number(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value != 0


# --- one trial, in a process of its own -------------------------------------------------------------------


def trial(root: Path, stage: str) -> dict[str, Any]:
    """Make a stage of every object; by object its error, or the hash of its files and its figures.

    The figures of files that are those of the package as it is are not measured again.
    """
    from kinectbench.engine.parallel import build
    from kinectbench.lab.evaluate.build import read_build
    from kinectbench.lab.evaluate.evaluation import evaluate
    from kinectbench.lab.simulate.truth import read_truth, truth_folder

    as_it_is = root / f"{stage}.json"
    known = json.loads(as_it_is.read_text()) if as_it_is.is_file() else {}
    made = {}
    for job, outcome in zip(jobs := _jobs(root), build(jobs, upto=stage, force=(stage,)), strict=True):
        name = job.recording.id
        if outcome.error:
            made[name] = {"error": outcome.error}
        elif (found := _hash(job.build / _folders()[stage])) == known.get(name, {}).get("sha256"):
            made[name] = known[name]
        else:
            evaluation = evaluate(read_build(job.build), read_truth(truth_folder(job.source)))
            made[name] = {"sha256": found, "figures": _figures(evaluation)}
    return made


def _folders() -> dict[str, str]:
    from kinectbench.engine.stages import STAGES as MADE

    return {stage.name: stage.folder for stage in MADE}


def _jobs(root: Path) -> list[Any]:
    from kinectbench.engine.stages import Job
    from kinectbench.settings.models import BenchmarkSettings

    settings = BenchmarkSettings.model_validate_json((root / "settings.json").read_text(encoding="utf-8"))
    return [Job(settings, recording, root) for recording in settings.recordings]


def _hash(folder: Path) -> str:
    """Over the files that a stage wrote, but for how long it took and its pictures."""
    found = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name not in ("timing.json", "manifest.json") and path.suffix != ".png":
            found.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
    return found.hexdigest()


def _figures(found: Any) -> dict[str, float | None]:
    """Of what an evaluation has: metres and shares."""
    poses, scene, solid = found.trajectory, found.scene, found.solid
    error = poses.error if poses else None
    return {
        "ate_m": error.ate_m.rmse if error else None,
        "tracked": poses.tracked_share if poses else None,
        "scene_f": scene.visible.scores[AT_5_MM].f if scene else None,
        "iou": solid.fine.iou if solid else None,
        "known_iou": solid.fine.known_iou if solid else None,
        "known_gross": solid.known_gross_share if solid else None,
        "not_known": solid.fine.true_unknown_share if solid else None,
        "estimated": solid.estimated_iou if solid else None,
    }


# --- all trials -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Bench:
    """A copy of the package and of the builds, in which one trial runs at a time."""

    folder: Path

    def run(self, stage: str, number: Number | None, factor: float) -> dict[str, Any]:
        """A trial with a number moved, or as it is."""
        with TemporaryDirectory(prefix="kinectbench-") as fresh:
            caches = {}
            if number is not None:
                _write_moved(self.folder, number, factor)
                if _reaches_a_kernel(number):  # compiled loops keep the constants of other modules
                    caches = {"NUMBA_CACHE_DIR": fresh}
            done = subprocess.run(
                [sys.executable, __file__, "--trial", stage, str(self.folder)],
                env=os.environ | caches | {"PYTHONPATH": str(self.folder)},
                capture_output=True,
                text=True,
                check=False,
            )
        if number is not None:
            shutil.copy2(PACKAGE / number.path, self.folder / "kinectbench" / number.path)
        if done.returncode:
            return {"error": done.stderr.strip().splitlines()[-1:]}
        found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
        return found


def _write_moved(folder: Path, number: Number, factor: float) -> None:
    path = folder / "kinectbench" / number.path
    lines = (PACKAGE / number.path).read_text(encoding="utf-8").splitlines(keepends=True)
    text, (begin, end) = lines[number.line - 1].encode(), number.columns
    value = repr(number.moved(factor)).encode()
    lines[number.line - 1] = (text[:begin] + value + text[end:]).decode()
    path.write_text("".join(lines), encoding="utf-8")


def _reaches_a_kernel(number: Number) -> bool:
    """Whether a module with compiled loops uses one of the constant's names."""
    names = re.compile(r"\b(" + "|".join(re.findall(r"[A-Z_0-9]{2,}", number.name)) + r")\b")
    texts = (path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py"))
    return any("njit" in text and names.search(text) for text in texts)


def trials(
    root: Path, stage: str, tasks: Sequence[tuple[Number, float]], workers: int
) -> Iterator[dict[str, Any]]:
    """What is made with each number moved, in their order; what `root` has of an earlier run is taken."""
    log = root / f"{stage}.jsonl"
    rows = [json.loads(line) for line in log.read_text().splitlines()] if log.is_file() else []
    done = {tuple(row["key"]): row["made"] for row in rows}
    benches: SimpleQueue[Bench] = SimpleQueue()
    for n in range(workers):
        benches.put(_bench(root, stage, n))

    def tried(task: tuple[Number, float]) -> dict[str, Any]:
        bench = benches.get()
        try:
            return bench.run(stage, *task)
        finally:
            benches.put(bench)

    with ThreadPoolExecutor(workers) as pool:
        made = pool.map(tried, [task for task in tasks if _key(*task) not in done])
        for task in tasks:
            key = _key(*task)
            if key not in done:
                done[key] = next(made)
                with log.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({"key": key, "made": done[key]}) + "\n")
            yield done[key]


def _key(number: Number, factor: float) -> tuple[str, str, str, float, float]:
    return _package_sha256(), number.path, number.name, number.value, factor


@cache
def _package_sha256() -> str:
    """Over all code: of another package nothing that was tried is taken."""
    paths = sorted(PACKAGE.rglob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()[:16]


def _bench(root: Path, stage: str, n: int) -> Bench:
    """A copy of the package, its compiled loops too, and of what was built before the stage."""
    bench = Bench(root / f"bench-{n}")
    shutil.rmtree(bench.folder, ignore_errors=True)
    shutil.copytree(PACKAGE, bench.folder / "kinectbench")
    for name in ("settings.json", f"{stage}.json"):
        if (root / name).is_file():
            shutil.copy2(root / name, bench.folder)
    made = list(_folders().items())
    before = made[: [name for name, _ in made].index(stage)]
    for job in _jobs(root):
        for _, folder in before:
            shutil.copytree(job.build / folder, bench.folder / "build" / job.recording.id / folder)
    return bench


def as_it_is(root: Path, stage: str) -> dict[str, Any]:
    """What the package makes with every number as it stands; ends the script where it makes nothing."""
    found = _bench(root, stage, 0).run(stage, None, 1.0)
    if "error" in found or any("error" in one for one in found.values()):
        sys.exit(f"error: {stage}: {found}")
    (root / f"{stage}.json").write_text(json.dumps(found))
    return found


def prepare(root: Path, objects: Sequence[str]) -> None:
    """Simulate the objects, and build them as far as their solids."""
    from builds import CORES
    from tracking_recordings import simulated

    from kinectbench.engine.parallel import build
    from kinectbench.lab.simulate.presets import preset_spec

    recordings = []
    for one in objects:
        family, _, seed = one.partition(":")
        changes = {"object": f"{family}:seed={seed}", "seed": int(seed), "save_depth": False}
        preset = "near-v1" if family in NEAR else "known-v1"
        spec = preset_spec(
            preset, changes, [f"path.frames={FRAMES}", "path.rate_hz=4", "given.trajectory=none"]
        )
        place = simulated(spec, root / "recordings" / f"{family}{seed}")
        recordings.append({"id": f"{family}{seed}", "path": str(place.resolve()), "category": family})
    root.joinpath("settings.json").write_text(json.dumps({"name": "sensitivity", "recordings": recordings}))
    for outcome in build(_jobs(root), upto="segment", workers=CORES):
        if outcome.error:
            sys.exit(f"error: {outcome.recording}: {outcome.error}")


# --- what is printed --------------------------------------------------------------------------------------


def largest(made: Mapping[str, Any], base: Mapping[str, Any]) -> dict[str, float] | str:
    """The largest change of each figure; in words where nothing was made, or no byte changed."""
    if "error" in made or any("error" in one for one in made.values()):
        return f"fails: {made.get('error') or next(one['error'] for one in made.values() if 'error' in one)}"
    if all(made[name]["sha256"] == base[name]["sha256"] for name in base):
        return NOTHING
    off: dict[str, float] = {}
    for name, one in base.items():
        for figure, value in one["figures"].items():
            other = made[name]["figures"][figure]
            if (value is None) != (other is None):
                return f"{name}: {figure} {'appears' if value is None else 'is lost'}"
            if value is not None and other is not None and abs(other - value) > abs(off.get(figure, 0)):
                off[figure] = other - value
    return {figure: by for figure, by in off.items() if abs(by) >= SAME}


Row = tuple[Number, list[dict[str, float] | str]]


def print_table(stage: str, rows: Sequence[Row]) -> None:
    """A line for each number: what changes if it is moved down, and up."""
    table = Table("module", "constant", "value", *(f"x {factor:g}" for factor in FACTORS), title=stage)
    for number, found in rows:
        table.add_row(Path(number.path).stem, number.name, f"{number.value:g}", *map(_text, found))
    console = Console()
    if not console.is_terminal:
        console.width = 200
    console.print(table)
    quiet = sum(all(one == NOTHING for one in found) for _, found in rows)
    alike = sum(all(one in (NOTHING, {}) for one in found) for _, found in rows) - quiet
    console.print(f"{stage}: of {len(rows)} numbers {quiet} change no byte, {alike} more no figure")


def _text(found: dict[str, float] | str) -> str:
    if isinstance(found, str):
        return found[:60]
    return ", ".join(f"{figure} {by:+.4f}" for figure, by in found.items()) or "bytes"


def main() -> None:
    """Prepare, try and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--stages", nargs="+", choices=STAGES, default=list(STAGES))
    parser.add_argument("--objects", nargs="+", default=list(OBJECTS), metavar="FAMILY:SEED")
    parser.add_argument("--draw", type=int, metavar="N", help="only so many numbers of each stage, at random")
    parser.add_argument("--build", type=Path, metavar="DIR", help="what was tried is kept there")
    parser.add_argument("--jobs", type=int, default=1, help="trials at a time")
    parser.add_argument("--trial", nargs=2, metavar=("STAGE", "FOLDER"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.trial:
        print(json.dumps(trial(Path(options.trial[1]), options.trial[0])))
        return
    from builds import build_root

    with build_root(options.build) as root:
        prepare(root, options.objects)
        for stage in options.stages:
            base, chosen = as_it_is(root, stage), numbers(stage)
            if options.draw:
                drawn = set(random.Random(0).sample(range(len(chosen)), min(options.draw, len(chosen))))
                chosen = [number for n, number in enumerate(chosen) if n in drawn]
            made = trials(root, stage, [(one, factor) for one in chosen for factor in FACTORS], options.jobs)
            rows = [(one, [largest(next(made), base) for _ in FACTORS]) for one in chosen]
            print_table(stage, rows)


if __name__ == "__main__":
    main()
