"""Recordings in other files: whole ones to be damaged, and lists of names that nobody should write."""

from pathlib import Path
from random import Random

from fuzz.places import put

INCLUDING = "including.yaml"
HEAD = "name: fuzz\nlicense: CC0-1.0\n"
NAMED = """\
include: ["rooms/*.yaml", more.csv, more.parquet]
recordings:
  - {id: own, path: recordings/own, category: chair}
"""
# What is included; each holds two recordings.
FILES: dict[str, str] = {
    "rooms/a.yaml": "recordings:\n"
    "  - {id: a, path: recordings/a, category: table}\n"
    "  - {id: b, path: recordings/b, category: table, camera: {fx: 500, fy: 500}}\n",
    "more.csv": "id,path,category,camera.fx,floor.plane_world,license\n"
    '7,recordings/7,chair,525,"[0, 0, 1, -0.5]",\n'
    '8,"recordings/a, b",table,,,"CC BY\n4.0"\n',
}
PARQUET = "more.parquet"
NAMES = (
    *("including.yaml", "./including.yaml", "rooms/../including.yaml", "rooms/a.yaml", "more.csv", PARQUET),
    *("rooms", "rooms/", ".", "..", "../*.yaml", "/etc/passwd", "*", "**", "*/*/*/*", "[", "[!a]*"),
    *(
        "no.yaml",
        "",
        " ",
        "a" * 5000,
        "rooms/" * 900 + "a.yaml",
        "more.tsv",
        "s3:///x.yaml",
        "ftp://a/b.yaml",
    ),
    *("\0", "\x1b[2J", "\u2028", "{a: 1}", "3", "null", "~", "!!python/name:os.system", "*a", "&a x"),
)


def make_included(case: Path) -> None:
    """Write `including.yaml` and what it names."""
    import pyarrow
    from pyarrow import parquet

    for name, text in {INCLUDING: HEAD + NAMED, **FILES}.items():
        (case / name).parent.mkdir(exist_ok=True)
        (case / name).write_text(text, encoding="utf-8")
    columns = {
        "id": ["c", "d"],
        "path": ["recordings/c", "recordings/d"],
        "category": ["chair", "table"],
        "camera.fx": [525.0, None],
        "box.center_m": [None, [0.0, 0.0, 0.4]],
        "box.size_m": [None, [1.0, 1.0, 0.8]],
    }
    parquet.write_table(pyarrow.table(columns), case / PARQUET)


def of_names(draw: Random, case: Path) -> str:
    """Names of other things, a cycle, or a list in a list, in place of what is included."""
    chosen = draw.choices(NAMES, k=draw.choice((1, 1, 2, 5, 2000)))
    quoted = [name if draw.random() < 0.2 else '"' + _escaped(name) + '"' for name in chosen]
    depth = draw.choice((1, 1, 1, 1, 2, 50, 100_000))
    listed = "[" * depth + ", ".join(quoted) + "]" * depth
    put(case / INCLUDING, f"{HEAD}include: {listed}\n".encode())
    if draw.random() < 0.5:  # round in a circle, or deep
        name = draw.choice(tuple(FILES))
        again = draw.choice(("include: [including.yaml]\n", f"include: [{name}]\n", "recordings: &a [*a]\n"))
        put(case / name, again.encode())
    return f"{INCLUDING}: names {listed[:60]}"


def _escaped(name: str) -> str:
    return "".join(c if " " <= c <= "~" and c not in '"\\' else f"\\u{ord(c):04x}" for c in name)
