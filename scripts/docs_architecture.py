"""Make what docs/architecture.md takes from the code: the picture of the rooms, the list of stored files.

    .venv/bin/python scripts/docs_architecture.py

Same code, same bytes. `tests/docs/test_docs_architecture.py` fails where the picture has other rooms or
arrows than the code, or the list other files.
"""

import ast
import pkgutil
import textwrap
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from xml.sax.saxutils import escape

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "kinectbench"
PAGE = ROOT / "docs" / "architecture.md"
PICTURE = ROOT / "docs" / "pictures" / "architecture.svg"
# The list of stored files lies between these lines of the page.
BEGIN, END = "<!-- files: written by scripts/docs_architecture.py -->\n", "<!-- end of files -->\n"

# The stages in their order; other rooms have their packages by size.
_STAGES = "ingest track fuse segment sample_views pairs"
# A room's colour says which part of the house it belongs to.
GROUND, PIPELINE, RESULTS, LAB, DOOR = "#5b6b7b", "#2f6f9f", "#2c8a7a", "#b07d2b", "#a8505c"
COLOURS = {
    "core": GROUND, "settings": GROUND, "stages": PIPELINE, "doctor": PIPELINE, "engine": PIPELINE,
    "record": PIPELINE, "release": RESULTS, "scoring": RESULTS, "report": RESULTS, "networks": RESULTS,
    "lab": LAB, "cli": DOOR,
}  # fmt: skip
INK, SOFT, PAPER, FLOOR = "#1f2933", "#7b8794", "#ffffff", "#f4f6f8"

WIDTH, TOP, FLOOR_HEIGHT, BAR_HEIGHT = 1060, 70, 58, 34
NAMES_X, BARS_X, BARS_WIDTH, BUS_X, BUS_STEP = 30, 150, 470, 640, 44
# Sizes of a part's name in its bar, and the width of a letter; the first that fits is taken.
LETTERS_PX = ((12, 6.6), (10, 5.6))


def rooms() -> list[str]:
    """The rooms from the top down, as the contract in pyproject.toml has them."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    return [name for name in contracts[0]["layers"] if (PACKAGE / name).is_dir()]


def imports() -> Counter[tuple[str, str]]:
    """(importing room, imported room) -> how many pairs of files; imports inside functions count, too."""
    known = rooms()
    pairs = set()
    for path in PACKAGE.glob("*/**/*.py"):
        importer = path.relative_to(PACKAGE).parts[0]
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("kinectbench."):
                for name in node.names:
                    target = _file(f"{node.module}.{name.name}") or _file(node.module)
                    room = node.module.split(".")[1]
                    if room != importer and room in known:
                        pairs.add((importer, room, path, target))
    return Counter((importer, room) for importer, room, *_ in pairs)


def _file(module: str) -> Path | None:
    """The file of a module, if it is one."""
    path = ROOT.joinpath(*module.split("."))
    candidates = (path.with_suffix(".py"), path / "__init__.py")
    return next((candidate for candidate in candidates if candidate.is_file()), None)


def parts(room: str) -> dict[str, int]:
    """The packages in a room, and "" for the files beside them -> lines."""
    lines: Counter[str] = Counter()
    for path in sorted((PACKAGE / room).glob("**/*.py")):
        inner = path.relative_to(PACKAGE / room).parts
        lines[inner[0] if len(inner) > 1 else ""] += len(path.read_text().splitlines())
    return dict(sorted(lines.items(), key=lambda part: (_STAGES.find(part[0] or "."), -part[1])))


def picture(names: Sequence[str], arrows: Mapping[tuple[str, str], int]) -> str:
    """The picture: a floor for each room, its lines as a bar, and a line down to every room it imports."""
    sizes = {name: parts(name) for name in names}
    scale = BARS_WIDTH / max(sum(size.values()) for size in sizes.values())
    height = TOP + FLOOR_HEIGHT * len(names) + 46
    drawn = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" '
        'font-family="Inter, Segoe UI, Helvetica, Arial, sans-serif">',
        "<title>The rooms of kinectbench: each imports only those below it</title>",
        f'<rect width="{WIDTH}" height="{height}" rx="10" fill="{PAPER}"/>',
        _text(NAMES_X, 36, "The twelve rooms of kinectbench", 17, INK, weight=600),
        _text(BUS_X - 22, 36, "what each imports: down the lines, to the room they end at", 13, SOFT),
    ]
    for row, name in enumerate(names):
        drawn += _floor(row, name, sizes[name], scale)
    for column, imported in enumerate(names[1:]):
        drawn += _bus(column, imported, names, arrows)
    note = (
        "A bar's width is lines of code; packages are darker than the files beside them. "
        "A number counts files that import a file below."
    )
    drawn += [_text(NAMES_X, height - 18, note, 12, SOFT), "</svg>"]
    return "\n".join(drawn) + "\n"


def _middle(row: int) -> float:
    return TOP + FLOOR_HEIGHT * (row + 0.5)


def _text(
    x: float, y: float, text: str, size: int, colour: str, *, weight: int = 400, anchor: str = "start"
) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" font-weight="{weight}" fill="{colour}" '
        f'text-anchor="{anchor}">{escape(text)}</text>'
    )


def _floor(row: int, name: str, sizes: Mapping[str, int], scale: float) -> list[str]:
    """A room: its name and lines, and a bar of its parts."""
    middle, colour, total = _middle(row), COLOURS[name], sum(sizes.values())
    drawn = [
        f'<g id="room-{name}">',
        f'<rect x="16" y="{middle - FLOOR_HEIGHT / 2 + 3:.1f}" width="{WIDTH - 32}" '
        f'height="{FLOOR_HEIGHT - 6}" rx="7" fill="{FLOOR}"/>',
        _text(NAMES_X, middle + 1, name, 16, colour, weight=700),
        _text(NAMES_X, middle + 17, f"{total / 1000:.1f}k lines", 11, SOFT),
    ]
    x = float(BARS_X)
    for part, lines in sizes.items():
        width = lines * scale
        drawn.append(
            f'<rect x="{x:.1f}" y="{middle - BAR_HEIGHT / 2:.1f}" width="{max(width - 1.5, 1):.1f}" '
            f'height="{BAR_HEIGHT}" rx="3" fill="{colour}" fill-opacity="{0.9 if part else 0.55}"/>'
        )
        shown = part.replace("_", " ")
        fitting = [size for size, letter in LETTERS_PX if part and len(shown) * letter < width - 4]
        if fitting:
            drawn.append(_text(x + width / 2 - 0.7, middle + 4, shown, fitting[0], PAPER, anchor="middle"))
        x += width
    return [*drawn, "</g>"]


def _bus(
    column: int, imported: str, names: Sequence[str], arrows: Mapping[tuple[str, str], int]
) -> list[str]:
    """The line down to one room, with a joint at each floor that imports it; it ends at that room's floor."""
    importers = [name for name in names if (name, imported) in arrows]
    if not importers:
        return []
    x, end, colour = BUS_X + BUS_STEP * column, names.index(imported), COLOURS[imported]
    top, bottom = _middle(names.index(importers[0])), _middle(end)
    drawn = [
        f'<path d="M{x} {top:.1f} V{bottom - 10:.1f} q0 10 -10 10 H{x - 24}" fill="none" stroke="{colour}" '
        'stroke-width="2" stroke-opacity="0.6"/>',
        f'<path d="M{x - 30} {bottom:.1f} l9 -5 v10 z" fill="{colour}"/>',
        _text(x - 36, bottom + 4, imported, 12, colour, weight=600, anchor="end"),
    ]
    for importer in importers:
        count, middle = arrows[importer, imported], _middle(names.index(importer))
        drawn += [
            f'<g id="arrow-{importer}-{imported}">',
            f'<circle cx="{x}" cy="{middle:.1f}" r="{9 + count**0.5 * 0.75:.1f}" fill="{colour}"/>',
            _text(x, middle + 4, str(count), 11, PAPER, weight=600, anchor="middle"),
            "</g>",
        ]
    return drawn


# Files whose owner is no model in core/artefacts: name, what writes and reads it, and its module.
OTHER_FILES = (
    ("<view>.npz", "Pair", "core/voxels/pair_file.py"),
    ("volume.npz", "write_reconstruction", "stages/fuse/reconstruction.py"),
    ("trajectory.txt", "write_trajectory", "core/trajectory/trajectory.py"),
    ("<view>.mask.png", "write_views", "stages/sample_views/views.py"),
    ("mesh.ply", "write_ply", "core/geometry/mesh.py"),
    (".counted.jsonl", "CountedPair", "core/artefacts/counted.py"),
    (".predicted.jsonl", "PredictedFile", "core/artefacts/method.py"),
    ("gallery.npz", "Gallery", "core/artefacts/gallery.py"),
    ("rows.npz", "write_rows", "core/artefacts/score_columns.py"),
    ("targets.csv", "Target", "core/artefacts/targets.py"),
)


def files_list() -> str:
    """A line for each module that owns files: the module, and each file with its class or function."""
    owned: dict[str, list[str]] = {}
    folder = PACKAGE / "core" / "artefacts"
    for module in sorted(info.name for info in pkgutil.iter_modules([str(folder)])):
        held = vars(import_module(f"kinectbench.core.artefacts.{module}")).values()
        for kind in held:
            if isinstance(kind, type) and kind.__module__.endswith(f".{module}") and "FILE" in vars(kind):
                files = owned.setdefault(f"core/artefacts/{module}.py", [])
                files.append(f"`{vars(kind)['FILE']}` (`{kind.__name__}`)")
    for name, owner, of in OTHER_FILES:
        owned.setdefault(of, []).append(f"`{name}` (`{owner}`)")
    lines = (f"- `kinectbench/{module}`: {', '.join(files)}" for module, files in owned.items())
    return "".join("\n".join(textwrap.wrap(line, 110, subsequent_indent="  ")) + "\n" for line in lines)


def with_list(page: str, lines: str) -> str:
    """The page's text with this list in place of the one between the two comments."""
    head, _, rest = page.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return f"{head}{BEGIN}\n{lines}\n{END}{tail}"


def main() -> None:
    PICTURE.write_text(picture(rooms(), imports()))
    PAGE.write_text(with_list(PAGE.read_text(), files_list()))


if __name__ == "__main__":
    main()
