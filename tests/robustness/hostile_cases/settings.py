"""benchmark.yaml of strangers, thousands of recordings, options, and limits of the machine."""

from collections.abc import Callable, Iterator
from pathlib import Path

from hostile_cases.case import Case, in_turn, on
from hostile_cases.releases import bomb_yaml, merge_bomb

READ = "ingest --jobs 1\nbuild --jobs 1\ninspect r\npublish\nreport\nverify release --rebuild benchmark.yaml"
HEAD = "name: a\n"
ONE = "name: a\nrecordings: [{{id: {}, path: {}, category: chair}}]\n"
WRONG = (1, 2)
# Each error of benchmark.yaml has a line; the first twenty are shown.
SHOWN = 22


def with_yaml(text: str | Callable[[], str]) -> Callable[[Path], None]:
    """The folder with another benchmark.yaml."""

    def make(folder: Path) -> None:
        (folder / "benchmark.yaml").write_text(text if isinstance(text, str) else text(), encoding="utf-8")

    return make


def cases() -> Iterator[Case]:
    for name, (group, text) in TEXTS.items():
        yield from in_turn(
            READ,
            Case(group, f"benchmark.yaml: {name}", "", with_yaml(text), "release", WRONG, errors=SHOWN),
            others=2,
        )
    for name, text in DATES.items():
        commands = "ingest --jobs 1\npublish --set publish.citation.date_released=x"
        yield from on(
            commands, Case("L", f"date_released: {name}", "", with_yaml(text), "tum", (2,), errors=3)
        )
    yield from on(
        MANY,
        Case(
            "M6",
            "5,000 recordings",
            "",
            with_yaml(lambda: _recordings(5000)),
            statuses=(0, 1, 2, 3),
            errors=5001,
        ),
    )
    yield Case("M6", "5,000 recordings", "--help", with_yaml(lambda: _recordings(5000)), statuses=(0,))
    yield from on(
        "ingest r7 --jobs 1\ninspect r7",
        Case("M6", "100,000 recordings", "", with_yaml(lambda: _recordings(100_000)), statuses=(0, 1, 2, 3)),
    )
    yield from on("init .", Case("M6", "a folder of 5,000 recordings", "", _folders, statuses=(0, 1)))
    yield from on(
        READ,
        Case(
            "L",
            "a path of 5,000 characters",
            "",
            with_yaml(ONE.format("r", "x/" * 2500)),
            "release",
            (1, 2, 3),
        ),
    )
    yield from on(
        READ,
        Case(
            "L",
            "a path that steers a terminal",
            "",
            with_yaml(ONE.format("r", r'"a\e[2Jb\n"')),
            "release",
            (1, 2, 3),
        ),
    )
    yield from on(
        READ,
        Case(
            "L",
            "an id of 100,000 characters",
            "",
            with_yaml(ONE.format("k" * 100_000, "r")),
            "release",
            WRONG,
        ),
    )
    yield from on(
        READ,
        Case(
            "L", "an id of two lines", "", with_yaml(ONE.format(r'"a\nerror: b\e[2J"', "r")), "release", WRONG
        ),
    )
    yield from on(
        OPTIONS, Case("L", "options of strangers", "", with_yaml(ONE.format("r", "r")), "release", WRONG)
    )
    limit = "prlimit --fsize=100000"
    yield from on(
        "publish\nscore --out scored\nreport --out page.html\nexport out --layout bop --benchmark benchmark",
        Case("L", "files may not grow", "", _unpublished, "built", (1, 3), before=limit),
    )


FAR = HEAD + "recordings: [{id: r, path: r, category: chair, %s}]\n"
TEXTS: dict[str, tuple[str, str | Callable[[], str]]] = {
    "a billion laughs": ("H1", HEAD + bomb_yaml()),
    "a billion laughs as recordings": ("H1", HEAD + bomb_yaml("recordings")),
    "merged maps without end": ("H1", HEAD + merge_bomb()),
    "itself": ("H1", HEAD + "recordings: &a [*a]\n"),
    "a Python tag": ("M3", HEAD + "license: !!python/object/apply:os.system [id]\n"),
    "100,000 brackets": ("M3", HEAD + "license: " + "[" * 100_000),
    "a map as a key": ("M3", HEAD + "? {a: 1}\n: 1\n"),
    "200,000 unknown keys": ("M6", lambda: HEAD + "".join(f"k{n}: 1\n" for n in range(200_000))),
    "200,000 keys that stand twice": (
        "M6",
        lambda: HEAD + "".join(f"k{n}: 1\nk{n}: 2\n" for n in range(100_000)),
    ),
    "200,000 unknown keys of a recording": (
        "M6",
        lambda: HEAD + "recordings:\n- id: r\n" + "".join(f"  k{n}: 1\n" for n in range(200_000)),
    ),
    "200,000 wrong recordings": ("M6", lambda: HEAD + "recordings:\n" + "- {id: a/b}\n" * 200_000),
    "a comment of 10 MB": ("M6", lambda: HEAD + "#" * (10 << 20) + "\n"),
    "a text of 10 MB": ("M6", lambda: HEAD + "license: '" + "x" * (10 << 20) + "'\n"),
    "40 MB": ("M6", lambda: HEAD + "#" * (40 << 20) + "\n"),
    "a box of 1e300 m": ("L", FAR % "box: {center_m: [0, 0, 0], size_m: [1e300, 1, 1]}"),
    "a plane at 1e300 m": ("L", FAR % "floor: {plane_world: [0, 0, 1, 1e300]}"),
    "a delay of 1e300 s": ("L", FAR % "camera: {trajectory_delay_s: 1e300}"),
    "escapes": ("M5", HEAD + '"a\\e[2Jb\\nerror: x": 1\n'),
    "not UTF-8 as it says": ("M3", "%YAML 9.9\n---\nname: \x85\u2028\n"),
}
PLAIN = ONE.format("r", "recording") + "publish: {citation: {date_released: %s}}\n"
DATES = {
    name: PLAIN % value
    for name, value in {
        "Arabic digits": '"٢٠٢٤-01-01"',
        "wide digits": '"２０２４-01-01"',
        "a month of 13": '"2024-13-01"',
        "30 February": '"2024-02-30"',
        "a date and a line": '"2024-01-01\\n"',
        "a year of 99999": '"99999-01-01"',
    }.items()
}
MANY = """build r00007 --jobs 1
ingest r00007 --jobs 1
inspect r00007
build --jobs 1
report
ingest no_such"""
OPTIONS = """build --set recordings.r.path=../../etc
build --set recordings.no.path=x
build --set a.b.c.d=1
build --set "\x1b[2J=1"
ingest "\x1b[2J"
build --set views.count=99999999999999999999
build --set license=!!python/object/apply:os.system"""


def _recordings(count: int) -> str:
    rows = "".join(f"  - {{id: r{n:05d}, path: in/r{n}, category: chair}}\n" for n in range(count))
    return f"name: many\nrecordings:\n{rows}"


def _folders(folder: Path) -> None:
    for number in range(5000):
        (folder / f"r{number:04d}").mkdir()
        for file in ("rgb.txt", "depth.txt"):
            (folder / f"r{number:04d}" / file).touch()


def _unpublished(folder: Path) -> None:
    (folder / "build/publish.json").unlink()
