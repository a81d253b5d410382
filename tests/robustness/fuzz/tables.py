"""Tables and settings: scores, thresholds, targets.csv, benchmark.json, benchmark.yaml, what it includes."""

from pathlib import Path
from random import Random

from fuzz.damage import of_content
from fuzz.engine import Command, Damaged, Fuzzer
from fuzz.includes import FILES, INCLUDING, PARQUET, make_included, of_names
from fuzz.places import of_place, put
from fuzz.releases import ON_RELEASE, PREDICTIONS, RELEASE, SCORE, make_release, seal

THRESHOLDS = "thresholds.json"
YAML = "benchmark.yaml"
SETTINGS = """\
name: fuzz
title: A benchmark of chairs
license: CC0-1.0
recordings:
  - {id: a, path: recordings/a, category: chair, object: red}
  - {id: b, path: recordings/b.bag, category: table, split: validation, camera: {fx: 500, fy: 500}}
fusion: {voxel_size_m: 0.01}
views: {count: 3, min_pixels: 100}
"""
COMPARE = ("compare", "scores")
REPORT = ("report", *ON_RELEASE, "--scores", "scores", "--out", "page.html")
WITH_THRESHOLDS = (*SCORE[:-1], "scored", "--thresholds", THRESHOLDS)
INGEST = ("ingest", "-c", YAML, "--jobs", "1")
STATUS = ("build", "--status", "-c", INCLUDING)
CHECK = ("check", PREDICTIONS, *ON_RELEASE)
VERIFY = ("verify", RELEASE)
# What is damaged, and what reads it.
TABLES: dict[str, tuple[tuple[str, ...], ...]] = {
    "scores/a/scores.json": (COMPARE, REPORT),
    "scores/a/scores.csv": (COMPARE, REPORT),
    "scores/a/gallery.npz": (REPORT,),
    THRESHOLDS: (WITH_THRESHOLDS,),
    f"{RELEASE}/targets.csv": (CHECK, VERIFY, SCORE, REPORT),
    f"{RELEASE}/benchmark.json": (CHECK, VERIFY, SCORE, REPORT),
    YAML: (INGEST,),
    **dict.fromkeys((INCLUDING, *FILES, PARQUET), (STATUS,)),
}
BY_PLACE, BY_NAMES = 0.1, 0.5


def make(folder: Path) -> None:
    from kinectbench.release.release import open_release
    from kinectbench.report.run import write_galleries
    from kinectbench.scoring.score import score_methods

    case = folder / "whole"
    case.mkdir()
    make_release(case)
    release = open_release(case / RELEASE)
    for method in ("a", "b"):
        out = case / "scores" / method
        tables = score_methods(
            release,
            case / PREDICTIONS,
            out,
            method=method,
            surface=False,
            save_thresholds=case / THRESHOLDS,
        )
        write_galleries(release, case / PREDICTIONS, tables, out, "half-pixel")
    (case / YAML).write_text(SETTINGS, encoding="utf-8")
    make_included(case)


def whole(case: Path) -> list[Command]:
    sound = (COMPARE, REPORT, WITH_THRESHOLDS, CHECK, VERIFY)
    return [*(Command(words, (0,)) for words in sound), Command(STATUS, (3,))]


def damage(draw: Random, case: Path) -> Damaged:
    name = draw.choice(tuple(TABLES))
    path = case / name
    if not path.is_file():
        return [f"no {name}"], [Command(words) for words in TABLES[name]]
    if name == INCLUDING and draw.random() < BY_NAMES:
        return [of_names(draw, case)], [Command(STATUS)]
    story = []
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        if draw.random() < BY_PLACE or not path.is_file() or path.is_symlink():
            story.append(f"{name}: {of_place(draw, path, path.parent)}" if path.is_file() else "no more")
            break
        suffixed = "benchmark.json" if name.endswith(".json") else name
        content, said = of_content(draw, suffixed, path.read_bytes())
        put(path, content)
        story.append(f"{name}: {said}")
    if name.startswith(RELEASE) and draw.random() < 0.7:
        seal(case / RELEASE)
        story.append("sealed")
    return story, [Command(words) for words in draw.sample(TABLES[name], min(2, len(TABLES[name])))]


TABLES_FUZZER = Fuzzer("tables", make, whole, damage)
