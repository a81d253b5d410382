"""Names and texts that steer a terminal, a spreadsheet, or take the name of a file of ours."""

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

from fuzz.releases import seal

from hostile_cases.case import POSIX, Case, in_turn, on
from hostile_cases.settings import with_yaml

EVIL = "a\x1b]0;pwned\x07\x1b[2Jb\nerror: all well\u202e"
JSON_EVIL = json.dumps(EVIL)[1:-1]
ON = "--benchmark release --jobs 1 --no-surface --no-baselines --no-gallery --out scored"
SCORE, CHECK = f"score predictions {ON}", "check predictions --benchmark release"
TABLES = "compare scores\nreport --benchmark release --scores scores --out page.html"
LATIN = {"LC_ALL": "en_US.ISO-8859-1", "PYTHONUTF8": "0", "PYTHONIOENCODING": "latin-1"}
OF_RELEASE = f"""verify release
{SCORE}
{CHECK}
load release
baseline partial --benchmark release --jobs 1 --out made
export exported --layout recgan --benchmark release
export exported --layout bop --benchmark release
export exported --layout webdataset --benchmark release
report --benchmark release --out page.html"""
METHODS = (
    "index.html",
    "scores.json",
    "Scores.CSV",
    "gallery.npz",
    "baselines",
    "=cmd|calc",
    "+a",
    "@a",
    "-a",
    "a" * 200,
    "é",
    EVIL.replace("\n", " "),
)


def cases() -> Iterator[Case]:
    for method in METHODS:
        group = "L" if method[0] in "=+@-" else "M5"
        yield from on(
            f"{SCORE}\n{CHECK}",
            Case(group, f"a method's folder {method!r}", "", _method(method), "release", (0, 1, 3)),
        )
        yield from on(
            f"{SCORE} --method {json.dumps(method)}",
            Case(group, f"--method {method!r}", "", whole="release", statuses=(1, 2)),
        )
    yield from on(
        f"{SCORE}\n{CHECK}",
        Case("M5", "a stray file that steers a terminal", "", _stray, "release", (0, 1, 3), errors=2),
    )
    yield from on(
        f"{SCORE}\n{CHECK}",
        Case("M5", "a folder that steers a terminal", "", _stray_folder, "release", (0, 1, 3), errors=3),
    )
    for key in ("method", "benchmark", "protocol", "category"):
        yield from on(
            TABLES,
            Case("M5", f"scores.json: a {key} that steers a terminal", "", _table(key), "release", (0, 1, 2)),
        )
    yield from on(
        TABLES,
        Case("M3", "scores.json of brackets", "", _deep_table, "release", (0, 1, 2)),
        Case("M3", "scores.json of a list", "", _list_table, "release", (0, 1, 2)),
    )
    yield from on(TABLES, Case("M6", "scores.json of 200,000 rows", "", _large_table, "release", (0, 1, 2)))
    thresholds = f"{SCORE} --thresholds thresholds.json"
    yield from on(
        thresholds,
        *(
            Case("M5", f"thresholds.json: {name}", "", _thresholds(text), "release", (0, 1, 2))
            for name, text in THRESHOLDS.items()
        ),
    )
    for file, key in (
        ("benchmark.json", '"name": "'),
        ("benchmark.json", '"license": "'),
        ("targets.csv", "chair_01,"),
        ("targets.csv", ",chair,"),
        ("views/chair_01/views.json", '"view": "'),
    ):
        yield from in_turn(
            OF_RELEASE,
            Case(
                "M5",
                f"{file}: {key} that steers a terminal",
                "",
                _released(file, key),
                "release",
                (0, 1, 3),
                errors=6,
            ),
            others=5,
        )
    for whole, pattern, before in (
        ("tum", "rgb.txt", "rgb/"),
        ("tum", "camera.json", '"fx'),
        ("nerfstudio", "transforms.json", '"file_path": "'),
        ("stray", "odometry.csv", ","),
        ("bop", "scene_camera.json", '"'),
    ):
        yield from on(
            "inspect r\ningest --jobs 1",
            Case(
                "M5",
                f"{whole}: {pattern} that steers a terminal",
                "",
                _recorded(pattern, before),
                whole,
                (0, 1, 3),
            ),
        )
    yield from on(
        "inspect recording\ningest --jobs 1\ninit --force .",
        Case("M5", "names of frames that steer a terminal", "", _frames, "tum", (0, 1, 3)),
    )
    yield Case("M5", "a recording's folder that steers a terminal", "init --force .", _renamed, "tum", (0, 1))
    for name, variables in (("POSIX", POSIX), ("Latin-1", LATIN)):
        commands = "publish\nreport\nscore\ncheck predictions"
        yield from on(
            commands,
            Case("M4", f"the locale {name}", "", _republish, "built", (0, 1, 3), variables=variables),
        )
        yield from on(
            OF_RELEASE,
            Case(
                "M4",
                f"a release of texts in the locale {name}",
                "",
                _texts,
                "release",
                (0, 1, 3),
                errors=6,
                variables=variables,
            ),
        )
        yield from on(
            "init --force .\ninspect größe\ningest --jobs 1",
            Case("M4", f"names in the locale {name}", "", _umlauts, "tum", (0, 1, 2, 3), variables=variables),
        )
    for name in (
        "publish.json",
        "index.html",
        "scores.json",
        "a.part",
        "baselines",
        "gallery.npz",
        ".lock",
        "CON",
    ):
        text = f"name: a\nrecordings: [{{id: {name}, path: recording, category: chair}}]\n"
        yield from on(
            "ingest --jobs 1", Case("M5", f"a recording called {name}", "", with_yaml(text), "tum", (0, 2))
        )


def _method(name: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        shutil.copytree(folder / "predictions", folder / "p" / name)
        (folder / "predictions").rename(folder / "p" / "other")
        (folder / "p").rename(folder / "predictions")

    return make


def _stray(folder: Path) -> None:
    (folder / "predictions/chair_01" / f"{EVIL}.npy").touch()


def _stray_folder(folder: Path) -> None:
    (folder / "predictions" / EVIL).mkdir()
    (folder / "predictions" / EVIL / "000.npy").touch()


def _table(key: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        import re

        path = folder / "scores/a/scores.json"
        text = path.read_text(encoding="utf-8")
        path.write_text(
            re.sub(rf'"{key}": "[^"]*"', lambda _: f'"{key}": "{JSON_EVIL}"', text), encoding="utf-8"
        )

    return make


def _deep_table(folder: Path) -> None:
    (folder / "scores/a/scores.json").write_text("[" * 100_000, encoding="utf-8")


def _list_table(folder: Path) -> None:
    (folder / "scores/a/scores.json").write_text("[1, 2]", encoding="utf-8")


def _large_table(folder: Path) -> None:
    path = folder / "scores/a/scores.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    rows = content["rows"]
    content["rows"] = [dict(rows[n % len(rows)], recording=f"r{n}") for n in range(200_000)]
    path.write_text(json.dumps(content), encoding="utf-8")


THRESHOLDS = {
    "brackets": "[" * 100_000,
    "a list": "[]",
    "a text that steers a terminal": '{"method": "' + JSON_EVIL + '"}',
    "a long number": '{"format_version": ' + "9" * 100_000 + "}",
    "300 MB": "",
}


def _thresholds(text: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        import os

        (folder / "thresholds.json").write_text(text, encoding="utf-8")
        if not text:
            os.truncate(folder / "thresholds.json", 300 << 20)

    return make


def _released(file: str, key: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        path = folder / "release" / file
        text = path.read_text(encoding="utf-8")
        evil = JSON_EVIL if file.endswith("json") else EVIL.replace("\n", " ")
        path.write_text(
            text.replace(key, key[:-1] + evil + key[-1] if key.endswith(",") else key + evil, 1),
            encoding="utf-8",
        )
        seal(folder / "release")

    return make


def _recorded(pattern: str, before: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        path = folder / "recording" / pattern
        text = path.read_text(encoding="utf-8")
        evil = JSON_EVIL if pattern.endswith("json") else EVIL.replace("\n", " ")
        assert before in text
        path.write_text(text.replace(before, before + evil), encoding="utf-8")

    return make


def _frames(folder: Path) -> None:
    for path in (folder / "recording/depth").iterdir():
        path.rename(path.with_name(EVIL + path.name))


def _renamed(folder: Path) -> None:
    (folder / "recording").rename(folder / EVIL)


def _republish(folder: Path) -> None:
    (folder / "build/publish.json").unlink()
    path = folder / "benchmark.yaml"
    text = path.read_text(encoding="utf-8").replace("license: CC0-1.0", "license: Größe σ … 椅子")
    path.write_text(text, encoding="utf-8")
    (folder / "predictions").mkdir()


def _texts(folder: Path) -> None:
    path = folder / "release/benchmark.json"
    content = json.loads(path.read_text(encoding="utf-8")) | {"license": "Größe σ …", "title": "椅子"}
    path.write_text(json.dumps(content, ensure_ascii=False), encoding="utf-8")
    seal(folder / "release")


def _umlauts(folder: Path) -> None:
    (folder / "recording").rename(folder / "größe")
    path = folder / "benchmark.yaml"
    path.write_text(path.read_text(encoding="utf-8").replace("recording,", "größe,"), encoding="utf-8")
