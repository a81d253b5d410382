"""Ways to damage a folder, drawn at random: what files hold, and what else may lie in their place."""

import os
import shutil
import socket
import tempfile
from collections.abc import Callable
from pathlib import Path
from random import Random

from fuzz.damage import TEXT_BYTES, of_content

NAMES = (
    "a\nb",
    "\x1b[2Jx",
    "-rf",
    "x" * 200,
    "index.html",
    ".hidden",
    "ä ö",
    "a,b",
    "=1+1",
    "con",
    "x.png",
    "'\"",
)
# A release of so many pairs more is verified within ten seconds.
MANY = 500


def put(path: Path, content: bytes) -> None:
    """Write a file anew: the one that was there may be the corpus's."""
    path.unlink()
    path.write_bytes(content)


def of_place(draw: Random, path: Path, root: Path) -> str:
    """Something else in a file's place, or beside it."""
    kind = draw.choice(tuple(PLACES))
    try:
        PLACES[kind](draw, path, root)
    except OSError as error:
        return f"{kind}, not done: {error.strerror}"
    return kind


def _without(path: Path) -> Path:
    path.unlink()
    return path


def _renamed(draw: Random, path: Path, root: Path) -> None:
    del root
    path.rename(path.with_name(draw.choice(NAMES) + draw.choice(("", path.suffix))))


def _doubled(draw: Random, path: Path, root: Path) -> None:
    del root
    double = path.with_name(draw.choice((*NAMES, f"0{path.name}", path.name.upper())))
    if double.is_file():
        put(double, path.read_bytes())
    else:
        shutil.copy(path, double)


def _socket(draw: Random, path: Path, root: Path) -> None:
    del draw, root
    path.unlink()
    with tempfile.TemporaryDirectory() as short:  # the names of sockets are short
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(f"{short}/s")
        Path(short, "s").rename(path)


def _oversized(draw: Random, path: Path, root: Path) -> None:
    del root
    content = path.read_bytes()
    put(path, content)
    os.truncate(path, draw.choice((300 << 20, 3 << 30, 1 << 40)))


def _outside(draw: Random, path: Path, root: Path) -> None:
    elsewhere = root.parent / f"elsewhere{path.suffix}"
    path.rename(elsewhere)
    path.symlink_to(draw.choice((str(elsewhere), os.path.relpath(elsewhere, path.parent))))


def _many(draw: Random, path: Path, root: Path) -> None:
    del root
    for number in range(MANY):
        other = path.with_name(f"{number:06d}{draw.choice((path.suffix, '.x'))}")
        if not other.exists():
            os.link(path, other)


def _deep(draw: Random, path: Path, root: Path) -> None:
    del draw, root
    folder = path.parent
    for _ in range(100):
        folder = folder / "d"
    folder.mkdir(parents=True)
    (folder / path.name).write_bytes(b"x")


PLACES: dict[str, Callable[[Random, Path, Path], object]] = {
    "no file": lambda draw, path, root: path.unlink(),
    "an empty file": lambda draw, path, root: put(path, b""),
    "a pipe": lambda draw, path, root: os.mkfifo(_without(path)),
    "a pipe beside it": lambda draw, path, root: os.mkfifo(path.with_name(f"x{path.suffix}")),
    "a socket": _socket,
    "a folder": lambda draw, path, root: _without(path).mkdir(),
    "a link to a device": lambda draw, path, root: _without(path).symlink_to(
        draw.choice(("/dev/zero", "/dev/tty"))
    ),
    "a link to a device beside it": lambda draw, path, root: path.with_name(f"x{path.suffix}").symlink_to(
        "/dev/zero"
    ),
    "a link to itself": lambda draw, path, root: _without(path).symlink_to(path.name),
    "a link to everything": lambda draw, path, root: path.with_name("x").symlink_to(
        draw.choice(("/", "..", "/proc"))
    ),
    "a link to nothing": lambda draw, path, root: _without(path).symlink_to("nowhere"),
    "a link out": _outside,
    "a huge file": _oversized,
    "another name": _renamed,
    "a second one": _doubled,
    "many more": _many,
    "a deep folder": _deep,
}


def of_folder(draw: Random, root: Path, by_place: float = 0.2) -> list[str]:
    """One to three damages of a folder's files; each kind of file is as likely as another.

    Args:
        draw: of random numbers.
        root: the folder, or a file.
        by_place: the share of damages that put something else in a file's place.

    Returns:
        What was done, in words.
    """
    story = []
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        path = any_file(draw, root)
        if path is None:
            break
        name = path.relative_to(root.parent).as_posix()
        if draw.random() < by_place:
            story.append(f"{name}: {of_place(draw, path, root)}")
        else:
            content, said = of_content(draw, path.name, path.read_bytes())
            put(path, content)
            story.append(f"{name}: {said}")
    return story


def any_file(draw: Random, root: Path) -> Path | None:
    """A file below a folder: first one of its kinds is drawn, then one of these."""
    if root.is_file():
        return root
    kinds: dict[tuple[str, str], list[Path]] = {}
    for path in sorted(root.rglob("*")):
        if path.is_file() and not path.is_symlink() and path.stat().st_size < TEXT_BYTES * 64:
            kinds.setdefault((path.parent.name, path.suffix or path.name), []).append(path)
    return draw.choice(kinds[draw.choice(sorted(kinds))]) if kinds else None
