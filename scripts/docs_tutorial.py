"""The tutorial's commands, run in their order, and what they print put below each, in docs/tutorial.md.

A line `$ kinectbench …` in a block of the tutorial is a command. The lines below it are what it printed,
without how far it was (of `build` with it), tables of `segment`, and what follows a box's `anchor_frame`.
docs/tutorial.json keeps these lines, the figures that sentences state, and each picture's SHA-256. A
test holds the text and the pictures to it: both are of one run.
"""

import hashlib
import json
import re
import shlex
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "tutorial.md"
PICTURES = PAGE.parent / "pictures"
KEPT = PAGE.parent / "tutorial.json"
NAME, BIN = "my_chair", "bin"
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SIMULATE, COMMAND = "kinectbench simulate ", "$ "
# A bin that is recorded from the side only: what its opening leads to is not seen.
SIDE_ONLY = "kinectbench simulate recordings/bin --object bin:seed=3 --frames 60 --set given.trajectory=none "
SIDE_ONLY += "--set path.rate_hz=4 --set path.elevation_rad=0.25 --set path.swing_rad=0.1 "
SIDE_ONLY += "--set sensor.width=320 --set sensor.height=240"
BIN_YAML = """\
name: bins
recordings:
  - {id: bin, path: recordings/bin, category: bin, underside: closed}
"""
PROGRESS = re.compile(r"\[ *\d+ s\] ")
TABLE = "┏┃┡│├└"
ANCHOR = re.compile(r"(anchor_frame: ).*}")


def printed(text: str) -> dict[str, list[str]]:
    """Command -> the lines below it in the tutorial, in their order."""
    found: dict[str, list[str]] = {}
    for _, block in BLOCK.findall(text):
        below: list[str] | None = None
        for line in block.splitlines():
            if line.startswith(COMMAND):
                below = found[line.removeprefix(COMMAND)] = []
            elif below is not None:
                below.append(line)
    return found


def retold(text: str, outputs: Mapping[str, list[str]]) -> str:
    """The tutorial with these lines below its commands."""

    def block(match: re.Match[str]) -> str:
        commands = [line for line in match[2].splitlines() if line.startswith(COMMAND)]
        if not commands:
            return match[0]
        lines = [line for each in commands for line in (each, *outputs[each.removeprefix(COMMAND)])]
        return "\n".join([f"```{match[1]}", *lines, "```"])

    return BLOCK.sub(block, text)


def prose(text: str) -> str:
    """The tutorial without its blocks."""
    return BLOCK.sub("", text)


def pictures_of(text: str) -> list[str]:
    """The names of the pictures that the tutorial shows."""
    return sorted(set(re.findall(r"\]\(pictures/([^)]+)\)", text)))


def run_all(work: Path) -> dict[str, list[str]]:
    """Run the tutorial in `work/my_chair`, and its command on a bin in `work/bin`; what each printed."""
    blocks = BLOCK.findall(PAGE.read_text(encoding="utf-8"))
    chair, side_only = work / NAME, work / BIN
    (first,) = (block for _, block in blocks if block.startswith(SIMULATE))
    (settings,) = (block for language, block in blocks if language == "yaml")
    run(first.replace("\\\n", " "), chair)
    run(SIDE_ONLY, side_only)
    (side_only / "benchmark.yaml").write_text(BIN_YAML, encoding="utf-8")
    outputs = {}
    for command in printed(PAGE.read_text(encoding="utf-8")):
        of_bin = BIN in shlex.split(command)
        if of_bin:
            run(command, side_only)  # the text shows what a second run says
        outputs[command] = run(command, side_only if of_bin else chair)
        if command.startswith("kinectbench init"):
            (chair / "benchmark.yaml").write_text(settings, encoding="utf-8")
    return outputs


def run(command: str, folder: Path) -> list[str]:
    """The lines of a command as the tutorial shows them: messages first, then what was asked for."""
    folder.mkdir(parents=True, exist_ok=True)
    words = shlex.split(command)
    done = subprocess.run(
        [sys.executable, "-m", *words], cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode:
        sys.exit(f"{command}: {done.stderr}")
    lines = (done.stderr + done.stdout).replace(str(folder), "...").splitlines()
    if words[1] != "build":
        lines = [line for line in lines if not PROGRESS.match(line)]
    if words[1] == "segment":
        lines = [line for line in lines if line[:1] not in TABLE]
    return [ANCHOR.sub(r"\1…}", line) for line in lines]


def keep(outputs: Mapping[str, list[str]], work: Path) -> None:
    """Write the tutorial again, and tutorial.json; the pictures are there already."""
    text = PAGE.read_text(encoding="utf-8")
    camera = json.loads((work / NAME / "build" / NAME / "sequence" / "camera.json").read_text())
    release = json.loads((work / NAME / "benchmark" / "benchmark.json").read_text())
    value = {
        "figures": {key: camera[key] for key in ("frames", "width", "height")}
        | {"pairs": release["recordings"][NAME]["pairs"]},
        "outputs": outputs,
        "pictures": {name: digest(PICTURES / name) for name in pictures_of(text)},
    }
    KEPT.write_text(json.dumps(value, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    PAGE.write_text(retold(text, outputs), encoding="utf-8")


def digest(path: Path) -> str:
    """The SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
