"""Check that a release's texts and metadata files agree with benchmark.json and targets.csv."""

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

from yaml import ScalarNode

from kinectbench.core import KinectBenchError, ReleaseError, SettingsError, StorageError, printable, quoted
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, UNSPECIFIED, ReleaseInfo
from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.provenance import LINEAGE_JSON, Lineage, LineageRecording
from kinectbench.core.artefacts.targets import (
    EARLIER_COLUMNS,
    SHA256SUMS,
    SPLITS,
    TARGETS_CSV,
    Target,
    targets_text,
)
from kinectbench.core.artefacts.views import ViewsFile
from kinectbench.engine.stages import STAGES
from kinectbench.release.check.figure_check import (
    floor_problems,
    frame_problems,
    gate_problems,
    lineage_problems,
    lineage_rows,
    own_problems,
    quality_problems,
    refused_problems,
)
from kinectbench.release.check.promises import hidden_files
from kinectbench.release.contents import (
    CARD,
    CITATION,
    CROISSANT,
    DATACITE,
    DATASHEET,
    LICENSE,
    MAX_READ_BYTES,
    PREVIEWS,
    ROWS,
    SPLIT_TARGETS,
    Contents,
    release_json,
)
from kinectbench.release.publish import card, datasheet
from kinectbench.release.publish.attribution import common_license, license_text, markdown_line
from kinectbench.release.publish.gate import left_out_line, look_line, poor_line
from kinectbench.release.publish.held_back import VIEW_KEYS, isolated_line
from kinectbench.release.publish.previews import row_picture, rows_text
from kinectbench.release.publish.reconstruction_attack import attack_line
from kinectbench.release.publish.schemas import schema_problems
from kinectbench.settings.yaml_nodes import compose, items

# Keys of each view in views.json, where its truth is public, beside `VIEW_KEYS`.
POSED_KEYS = ("frame", "stamp_ns", "T_world_camera")
# Matches a line of the card about a recording and the gate: the text after the recording's name.
OF_GATE = re.compile(
    " is left out: | is published all the same | is published, and a person should look at it: "
)
# Largest CITATION.cff: two thousand authors (PyYAML reads 0.1 MB a second). LICENSE and README.md may have as
# much beyond the texts that follow from benchmark.json, such as the words of a licence.
CITATION_BYTES = 256 << 10
# Bytes of README.md for a recording: its figures and a warning or two.
CARD_BYTES = 1 << 10


@dataclass(frozen=True)
class Stated:
    """Facts from three files of a release, for comparison with its other files.

    Attributes:
        targets: the lines of targets.csv.
        metadata: the content of benchmark.json.
        sums: {file: hash} of SHA256SUMS.
    """

    targets: tuple[Target, ...]
    metadata: ReleaseInfo
    sums: Mapping[str, str]

    @property
    def says_twice(self) -> bool:
        """Whether other files repeat facts of benchmark.json word for word, as in all but early releases."""
        return self.metadata.benchmark_sha256_version is not None

    def views_of(self, recording: str) -> set[str]:
        """Return the names of a recording's views that have a pair in targets.csv."""
        return self._views.get(recording, set())

    @cached_property
    def _views(self) -> dict[str, set[str]]:
        views: dict[str, set[str]] = {}
        for target in self.targets:
            views.setdefault(target.recording, set()).add(target.view)
        return views


# Takes a file's text; yields a clause for each contradiction.
Check = Callable[[str, Stated], Iterator[str]]


def agreement_problems(contents: Contents, stated: Stated, damaged: Mapping[str, str]) -> Iterator[str]:
    """Yield a message for each contradiction between another file and benchmark.json or targets.csv.

    Every JSON file is checked against its schema. Missing files are not reported: earlier versions and other
    commands write releases with fewer files. Damaged files are skipped.

    Args:
        contents: the release.
        stated: the facts that the files must agree with.
        damaged: {file: message} of the files whose SHA-256 differs from SHA256SUMS.
    """
    whole = contents.entries.keys() - damaged.keys()
    for name in sorted(whole):
        if name.endswith(".json") and name != BENCHMARK_JSON:
            try:
                text = contents.text(name)
                release_json(text, name)
                yield from (f"{name}: {fault}" for fault in schema_problems(name, text))
            except ReleaseError as error:
                yield str(error)
                whole.remove(name)
    checks: dict[str, Check] = {
        CARD: _card_problems,
        LICENSE: _license_problems,
        CITATION: _citation_problems,
        CROISSANT: _croissant_problems,
        DATACITE: _datacite_problems,
        LINEAGE_JSON: _lineage_problems,
    }
    checks |= {f"{SPLIT_TARGETS}/{split}.csv": partial(_split_problems, split) for split in SPLITS}
    if stated.says_twice:
        yield from own_problems(stated.metadata)
        yield from gate_problems(stated.metadata)
        lines = datasheet.datasheet_figures(stated.metadata.recordings)
        checks[DATASHEET] = lambda text, _: _missing(text, lines, f"the line '{{}}' of {BENCHMARK_JSON}")
    checks |= {f"{PREVIEWS}/{split}/{ROWS}": partial(_rows_problems, split) for split in SPLITS}
    lineage = lineage_rows(contents, whole)
    checks |= {
        f"views/{name}/views.json": partial(_views_problems, name, lineage.get(name))
        for name in stated.metadata.recordings
    }
    limits = _limits(stated.metadata)
    for name, check in checks.items():
        if name in whole:
            try:
                text = contents.text(name, limits.get(name, MAX_READ_BYTES))
                yield from (f"{name}: {fault}" for fault in check(text, stated))
            except (ReleaseError, SettingsError) as error:
                yield str(error)
            except (StorageError, KeyError, TypeError, AttributeError, ValueError):
                yield f"{name}: does not have the keys that it should"
    if stated.says_twice:
        for name, info in stated.metadata.recordings.items():
            if (file := f"objects/{name}/{QualityFile.FILE}") in whole:
                try:
                    yield from quality_problems(file, contents.text(file), info)
                except (KinectBenchError, ValueError) as error:
                    yield str(error)
    yield from floor_problems(contents, stated.metadata, whole)
    yield from hidden_files(stated.metadata, contents.entries)


def _limits(metadata: ReleaseInfo) -> dict[str, int]:
    """Return {file: maximum number of bytes to read} for CITATION.cff, LICENSE and README.md."""
    license_words = license_text(metadata.name, metadata.license, metadata.recordings)
    of_license = CITATION_BYTES + len(license_words.encode("utf-8", "replace"))
    of_card = of_license + CARD_BYTES * len(metadata.recordings)
    return {CITATION: CITATION_BYTES} | {
        name: min(most, MAX_READ_BYTES) for name, most in ((LICENSE, of_license), (CARD, of_card))
    }


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Yield (offset in the text, line), one line at a time to save memory."""
    begin = 0
    while (end := text.find("\n", begin)) >= 0:
        yield begin, text[begin:end]
        begin = end + 1
    yield begin, text[begin:]


def _card_problems(text: str, stated: Stated) -> Iterator[str]:
    for what, stated_value in (
        ("name", stated.metadata.name),
        ("licence", common_license(stated.metadata.recordings, stated.metadata.license)),
    ):
        if stated_value not in text and markdown_line(stated_value) not in text:
            yield f"does not state the {what} '{printable(stated_value)}' of {BENCHMARK_JSON}"
    yield from _missing(
        text, card.counts_table(stated.targets), f"the row '{{}}', which {TARGETS_CSV} counts"
    )
    if stated.says_twice:
        metadata = stated.metadata
        tables = (
            card.card_figures(metadata),
            card.origins_table(metadata.recordings),
            card.flow_section(metadata),
        )
        rows = "\n".join(tables)
        yield from _missing(text, rows, f"the row '{{}}' of {BENCHMARK_JSON}")
        yield from _other_figures(text, tables, {target.category for target in stated.targets})
        yield from _gate_missing(text, metadata)
        yield from _held_back_missing(text, metadata)


def _other_figures(text: str, tables: Sequence[str], categories: Collection[str]) -> Iterator[str]:
    """Yield a message for each table row of README.md that states other figures of a recording.

    `tables` are the expected tables, made from benchmark.json; the first has the figures of all recordings.
    Its rows are recognised in `text` by their first cell, the recording's name. If a category has this name
    too, the number of cells distinguishes them. `_missing` reports missing rows.
    """
    rows = (row for row in tables[0].splitlines()[2:] if f"\n{row}\n" in f"\n{text}\n")
    wanted = {cells[0]: cells for cells in map(_cells, rows)}
    stated = {line for table in tables for line in table.splitlines()}
    for _, line in _lines(text):
        cells = _cells(line) if "|" in line and line not in stated else []
        expected = wanted.get(cells[0], cells) if cells else cells
        if cells != expected and (cells[0] not in categories or len(cells) == len(expected)):
            yield f"has the row '{printable(line, 200)}', which {BENCHMARK_JSON} does not have"


def _cells(row: str) -> list[str]:
    return [cell.strip(" *_`") for cell in row.strip(" |").split("|")]


def _held_back_missing(text: str, metadata: ReleaseInfo) -> Iterator[str]:
    """Yield a message for each fact on held-back truth in benchmark.json that README.md does not state."""
    if not metadata.held_back:
        return
    sentences = {
        "isolated": isolated_line(metadata.isolated) if metadata.isolated else None,
        "rebuilt_iou": None if metadata.isolated else attack_line(metadata.recordings),
    }
    for key, line in sentences.items():
        if line and line not in text:
            yield f"says otherwise than `{key}` of {BENCHMARK_JSON}"


def _gate_missing(text: str, metadata: ReleaseInfo) -> Iterator[str]:
    """Yield a message for each recording on which README.md contradicts benchmark.json.

    Both files state which recordings are left out, published although poor, or to be reviewed, and why.
    """
    wanted = {name: left_out_line(name, why) for name, why in (metadata.left_out or {}).items()}
    for name, info in metadata.recordings.items():
        if info.poor:
            wanted[name] = poor_line(name, info.poor, info.accepted or "")
        elif info.look:
            wanted[name] = look_line(name, info.look)
    lines = (line.removeprefix("- ") for _, line in _lines(text) if line.startswith("- "))
    expected = {ids[0]: line for line in lines if len(ids := OF_GATE.split(line, maxsplit=1)) == 2}
    for name in sorted(wanted.keys() | expected.keys()):
        # Advice may follow the expected text.
        if name not in wanted or not expected.get(name, "").startswith(wanted[name]):
            yield f"says otherwise than {BENCHMARK_JSON} whether {printable(name)} is left out or poor"


def _missing(text: str, wanted: str, subject: str) -> Iterator[str]:
    """Yield a message for each line of `wanted` that is not in `text`; `subject` is a format for the line."""
    rows = dict.fromkeys(wanted.splitlines())
    present = {line for _, line in _lines(text) if line in rows}
    for row in rows:
        if row not in present:
            yield f"does not have {subject.format(printable(row, 200))}"


def _license_problems(text: str, stated: Stated) -> Iterator[str]:
    expected = {
        name: f"{name}\n  licence: {info.license}\n  source: {' '.join(info.source.split())}\n"
        for name, info in stated.metadata.recordings.items()
    }
    present = {line for at, line in _lines(text) if line in expected and text.startswith(expected[line], at)}
    for name in expected:
        if name not in present:
            yield f"does not state licence and source of {printable(name)} as {BENCHMARK_JSON} does"


def _citation_problems(text: str, stated: Stated) -> Iterator[str]:
    # Nodes instead of values, so that aliases are never expanded.
    version = items(compose(text, CITATION)).get("version")
    wanted = stated.metadata.version
    if wanted is not None and not (isinstance(version, ScalarNode) and version.value == wanted):
        words = f"version '{printable(version.value)}'" if isinstance(version, ScalarNode) else "no version"
        yield f"{words} where {BENCHMARK_JSON} has '{printable(wanted)}'"


def _croissant_problems(text: str, stated: Stated) -> Iterator[str]:
    croissant = release_json(text, CROISSANT)
    name = croissant["name"]
    if name != stated.metadata.name:
        stated_as = f"name '{printable(name)}'" if isinstance(name, str) else "no name"
        yield f"{stated_as} where {BENCHMARK_JSON} has '{printable(stated.metadata.name)}'"
    for file in croissant["distribution"]:
        url = file.get("contentUrl")
        if "sha256" in file and file["sha256"] != stated.sums.get(url):
            yield f"another SHA-256 for {printable(str(url))} than in {SHA256SUMS}"


def _datacite_problems(text: str, stated: Stated) -> Iterator[str]:
    content = release_json(text, DATACITE)
    license = common_license(stated.metadata.recordings, stated.metadata.license)
    rights = content.get("rightsList") or [{}]
    for what, said, wanted in (
        ("version", content.get("version"), stated.metadata.version),
        ("licence", rights[0].get("rights"), None if license == UNSPECIFIED else license),
    ):
        if said != wanted:
            stated_as = f"no {what}" if said is None else f"{what} {quoted(said)}"
            yield f"{stated_as} where {BENCHMARK_JSON} has {'none' if wanted is None else quoted(wanted)}"


def _lineage_problems(text: str, stated: Stated) -> Iterator[str]:
    lineage = Lineage.parse(text, LINEAGE_JSON)
    recordings = lineage.recordings
    for name in sorted(set(recordings) ^ set(stated.metadata.recordings)):
        what = "has no" if name in stated.metadata.recordings else "has a"
        yield f"{what} recording {printable(name)}"
    for name, row in recordings.items():
        views = stated.views_of(name)
        if row.views is not None and {view.view for view in row.views} != views:
            yield f"other views of {printable(name)} than in {TARGETS_CSV}"
        if stated.metadata.isolates(name) and (row.files or row.files_sha256 or row.stages or row.views):
            yield f"says how {printable(name)} was made, of which one view alone is published"
        elif stated.metadata.of_this_version and not stated.metadata.isolates(name):
            if absent := [stage.name for stage in STAGES if stage.name not in row.stages]:
                yield f"does not say how {', '.join(absent)} of {printable(name)} was made"
            if not (row.files or row.files_sha256):
                yield f"does not name the files of {printable(name)}"
            if row.views is None and not stated.metadata.hides(name):
                yield f"does not name the views of {printable(name)}"
    if stated.says_twice:
        yield from lineage_problems(lineage, stated.metadata)


def _split_problems(split: str, text: str, stated: Stated) -> Iterator[str]:
    of_split = tuple(target for target in stated.targets if target.split == split)
    expected = [targets_text(of_split)]
    if all(target.unknown_share is None for target in stated.targets):
        expected.append(targets_text(of_split, EARLIER_COLUMNS))
    if text not in expected:
        yield f"not the lines of {TARGETS_CSV} whose split is {split}"


def _rows_problems(split: str, text: str, stated: Stated) -> Iterator[str]:
    """Yield a message for each fault of a split's folder in previews/, whose metadata.jsonl is `text`.

    There must be exactly one row and one picture for each pair of the split, except those of isolated
    recordings.
    """
    isolates = stated.metadata.isolates
    of_split = [t for t in stated.targets if t.split == split and not isolates(t.recording)]
    if text != rows_text(of_split):
        yield f"not the lines of {TARGETS_CSV} whose split is {split}"
    folder = f"{PREVIEWS}/{split}/"
    listed = {name.removeprefix(folder) for name in stated.sums if name.startswith(folder)} - {ROWS}
    odd = sorted(listed ^ {row_picture(target) for target in of_split})
    if odd:
        yield f"{printable(odd[0], 200)} and the pairs of {TARGETS_CSV} do not agree"


def _views_problems(
    recording: str, lineage: LineageRecording | None, text: str, stated: Stated
) -> Iterator[str]:
    """Yield a message for each fault of a recording's views.json, whose content is `text`.

    Faults are: views with a pair that differ from targets.csv, a view that is there twice or lacks keys, a
    number of refused frames and views that differs from benchmark.json, and keys that reveal held-back truth.
    """
    views = ViewsFile.parse(text, ViewsFile.FILE)
    rows = views.views
    yield from frame_problems(views, lineage)
    if stated.says_twice and not stated.metadata.hides(recording):
        yield from refused_problems(views, stated.metadata.recordings[recording])
    listed = {row.view for row in rows if row.pair is not False}
    own_views = stated.views_of(recording)
    if own_views - listed or (listed - own_views and any(row.pair is not None for row in rows)):
        yield f"other views with a pair than in {TARGETS_CSV}"
    names = [f"view {row.view}" for row in rows]
    names += [f"frame {row.frame}" for row in rows if row.pair and row.frame is not None]
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        yield f"has {printable(twice[0])} twice"
    needed = VIEW_KEYS if stated.metadata.hides(recording) else (*VIEW_KEYS, *POSED_KEYS)
    absent = [key for key in needed if any(getattr(row, key) is None for row in rows)]
    if absent and stated.metadata.of_this_version:
        yield f"has views without {', '.join(absent)}"
    stated_as = {key for row in rows for key in row.json_value()} - set(VIEW_KEYS)
    if stated.metadata.hides(recording) and stated_as:
        yield f"holds {printable(', '.join(sorted(stated_as)))}, which is held back"
