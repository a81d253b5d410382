"""Write a commented benchmark.yaml for the recordings of a folder, with comments taken from the models."""

import os
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import yaml

from kinectbench.core import SettingsError, name_problem, read_plain_text
from kinectbench.settings import edit, yaml_nodes
from kinectbench.settings.base import Settings
from kinectbench.settings.file import nodes_of, parse_benchmark
from kinectbench.settings.models import BenchmarkSettings, CategorySettings, RecordingSettings
from kinectbench.settings.pick import PICK_BYTES, PICK_FILE, PickSettings
from kinectbench.settings.words import field_range, model_of

# `category` until a person sets it; `build` and `publish` warn about it.
UNKNOWN_CATEGORY = "unknown"
ASK_CATEGORY = "fill in what it is, such as chair or table"
ASK_OBJECT = "fill in the same name wherever the same thing is recorded again"
# Keys for which each recording gets a line, with a value or a question.
OF_EACH = ("split", "object", "underside", "trajectory")

HEADER = """\
# What this benchmark is built from, and with which settings.
# A line that begins with '#' inside a section shows a default: remove the '#' to change it.
"""


def init_benchmark(folder: Path, recordings: Sequence[tuple[str, str]], suffixes: Sequence[str]) -> str:
    """Write the text of a valid benchmark.yaml for the recordings found in a folder.

    The folder's name becomes the benchmark's. Of each recording, `recordings` has the path relative to the
    folder, and the format's name. Suffixes of paths, such as ".bag", are dropped from ids.

    Raises:
        SettingsError: there are no recordings.
    """
    if not recordings:
        raise SettingsError(
            f"{folder}: no recording of a known format in it; `kinectbench inspect FOLDER` says of one why, "
            "and `kinectbench formats` what is read; put one there and try again",
            what="no-recording",
        )
    first, *others = _entries(folder, recordings, suffixes)
    lines = [HEADER.rstrip(), "", *_top_level(folder.resolve().name), "", "recordings:"]
    lines += [*first, *_recording_options(), *(line for entry in others for line in entry)]
    lines += ["", *_categories()]
    for section, field in BenchmarkSettings.model_fields.items():
        if isinstance(field.default, Settings):
            lines += ["", *_section(section, field.default)]
    return "\n".join(lines) + "\n"


class Extended(NamedTuple):
    """A benchmark.yaml to which missing recordings were added.

    Attributes:
        text: new text of the file; the old content stays.
        added: number of added recordings.
        missing: ids of recordings whose path does not exist.
    """

    text: str
    added: int
    missing: tuple[str, ...]


def extended_benchmark(
    config: Path, text: str, recordings: Sequence[tuple[str, str]], suffixes: Sequence[str]
) -> Extended:
    """Append to a benchmark.yaml those recordings of its folder that it lacks.

    Of each recording, `recordings` has the path relative to the file's folder, and the format's name.
    Suffixes of paths, such as ".bag", are dropped from ids.

    Raises:
        SettingsError: the old or the new text has an error, or the file cannot be changed safely.
    """
    source = str(config)
    listed = yaml_nodes.items(nodes_of(text, source, config)).get("recordings")
    empty = listed is None or listed.tag == yaml_nodes.NULL_TAG or not listed.value
    if not empty:
        parse_benchmark(text, source, config=config)
    entries = listed.value if isinstance(listed, yaml.SequenceNode) else []
    rows = [yaml_nodes.items(entry) for entry in entries]
    known = [(str(row["id"].value), _place(config, str(row["path"].value))) for row in rows]
    ids, places = [name for name, _ in known], {place for _, place in known}
    new = [each for each in recordings if _place(config, each[0]) not in places]
    lines = [line for entry in _entries(config.parent, new, suffixes, ids) for line in entry]
    missing = tuple(name for name, place in known if not os.path.exists(place))  # noqa: PTH110 - never raises
    changed = edit.with_recordings(text, source, lines)
    if empty:
        parse_benchmark(changed, source, config=config)
    return Extended(changed, len(new), missing)


def _place(config: Path, path: str) -> str:
    """Return the absolute path of a recording, with links resolved."""
    return os.path.realpath(config.parent / path)


def _entries(
    folder: Path, recordings: Sequence[tuple[str, str]], suffixes: Sequence[str], taken: Iterable[str] = ()
) -> list[list[str]]:
    """Return the lines of each recording's entry; its id differs from all ids in `taken`.

    If the folder itself is a recording, the recording gets the folder's name.
    """
    paths = [folder.resolve().name if path == "." else path for path, _ in recordings]
    names = _unique_ids(paths, suffixes, taken)
    return [
        _recording(name, path, kind) + _picked(folder / path)
        for name, (path, kind) in zip(names, recordings, strict=True)
    ]


def _top_level(folder_name: str) -> list[str]:
    """Return the lines with name, licence and source."""
    fields = BenchmarkSettings.model_fields
    values = {key: fields[key].default for key in ("license", "source")}
    values = {"name": _safe(folder_name, "benchmark"), **values}
    return [
        _commented(f"{key}: {yaml_text(value)}", fields[key].description) for key, value in values.items()
    ]


def _recording(name: str, path: str, kind: str) -> list[str]:
    """Return the lines of one recording of the format `kind`; comments ask the user to fill in keys."""
    fields = RecordingSettings.model_fields
    underside = CategorySettings.model_fields["underside"]
    return [
        f"  - id: {yaml_text(name)}",
        _commented(f"    path: {yaml_text(path)}", kind),
        _commented(f"    category: {UNKNOWN_CATEGORY}", ASK_CATEGORY),
        _commented("    # object: …", ASK_OBJECT),
        _commented(f"    # underside: {underside.default}", f"say what you know; {underside.description}"),
        _commented(f"    split: {fields['split'].default}", fields["split"].description),
        _option("trajectory"),
    ]


def _picked(recording: Path) -> list[str]:
    """Return the line `pick:` with the point clicked while recording; [] if there is no such point.

    If the point's file is unreadable, return a comment that says so.
    """
    try:
        picked = PickSettings.model_validate_json(read_plain_text(recording / PICK_FILE, PICK_BYTES))
    except (FileNotFoundError, NotADirectoryError):  # the latter where the recording is one file
        return []
    except (OSError, ValueError):
        return [f"    # {PICK_FILE} beside it holds no click that can be read: it is not used"]
    return [_commented(f"    pick: {yaml_text(picked.model_dump(mode='json'))}", "clicked while recording")]


def _recording_options() -> list[str]:
    """Return the optional keys of a recording, as comments to put below the first recording."""
    lines = ["    # each recording may also have:"]
    fields = RecordingSettings.model_fields
    return lines + [_option(key) for key in fields if not (fields[key].is_required() or key in OF_EACH)]


def _option(key: str) -> str:
    """Return an optional key of a recording, as a comment."""
    field = RecordingSettings.model_fields[key]
    model = model_of(field.annotation)
    value = f"{{{', '.join(f'{name}: …' for name in model.model_fields)}}}" if model else "…"
    words = "; ".join(part for part in (field_range(field), field.description) if part)
    return _commented(f"    # {key}: {value}", words)


def _categories() -> list[str]:
    """Return a section on categories as comments: a category without recordings would be refused."""
    about = (CategorySettings.__doc__ or "").splitlines()[0]
    inner = ", ".join(
        f"{key}: {yaml_text(field.default)}" for key, field in CategorySettings.model_fields.items()
    )
    return [_commented("# categories:", about), f"#   chair: {{{inner}}}"]


def _section(name: str, defaults: Settings) -> list[str]:
    """Return the lines of a section: its keys with their defaults, as comments."""
    about = (type(defaults).__doc__ or "").splitlines()[0]
    lines = [f"{name}:  # {about}"]
    for key, field in type(defaults).model_fields.items():
        limits = field_range(field)
        words = f"{field.description} ({limits})" if limits else field.description
        value = getattr(defaults, key)
        shown = value.model_dump() if isinstance(value, Settings) else value
        lines.append(_commented(f"  # {key}: {yaml_text(shown)}", words))
    return lines


def _commented(text: str, comment: str | None) -> str:
    """Append a comment to a line, aligned in a column."""
    return f"{text:<34}  # {comment}" if comment else text


def yaml_text(value: object) -> str:
    """Write a value as YAML on one line, with quotes if needed."""
    if isinstance(value, str) and not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_./-]*", value):
        return yaml.dump(value, default_style='"', allow_unicode=True, width=10**9).strip()
    return (
        yaml.dump(value, default_flow_style=True, sort_keys=False, width=10**9).removesuffix("...\n").strip()
    )


def _safe(text: str, otherwise: str) -> str:
    """Turn a text into a valid id that resembles it; if none of its characters is valid, use `otherwise`."""
    ascii_text = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    name = re.sub(r"[^A-Za-z0-9._-]+", "_", ascii_text).strip("._-")[:60].rstrip("._-") or otherwise
    return f"{name}_" if name_problem(name) else name


def _unique_ids(paths: Sequence[str], suffixes: Sequence[str], others: Iterable[str] = ()) -> list[str]:
    """Return an id for each path; the ids differ from each other and from `others`.

    An id is the last part of the path without suffix. If several have the same last part, it is the whole
    path. A number is added if needed.
    """
    taken = {name.lower() for name in others}
    ending = re.compile(f"({'|'.join(map(re.escape, suffixes))})+$", re.IGNORECASE)
    whole = [ending.sub("", path.strip("/")) for path in paths]
    last = [path.rsplit("/", 1)[-1] for path in whole]
    times = Counter([name.lower() for name in last] + list(taken))
    ids, numbers = list[str](), Counter[str]()
    for path, name in zip(whole, last, strict=True):
        base = candidate = _safe(name if times[name.lower()] == 1 else path, "recording")
        while candidate.lower() in taken:
            numbers[base.lower()] += 1
            candidate = f"{base}_{numbers[base.lower()] + 1}"
        ids.append(candidate)
        taken.add(candidate.lower())
    return ids
