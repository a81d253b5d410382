"""Check the texts of a release of recordings: write them again from its other files, and compare.

Pictures in pages are not compared, because their bytes depend on the machine. Only releases of this package
version are checked, because other versions use other words.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain

from pydantic import ValidationError

from kinectbench.core import KinectBenchError, ReleaseError, printable
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, ReleaseInfo
from kinectbench.core.artefacts.provenance import LINEAGE_JSON, PRIVACY_JSON, Lineage, Privacy
from kinectbench.core.artefacts.targets import SHA256SUMS, Target, by_recording, columns_of, parse_sums
from kinectbench.release.contents import CARD, CROISSANT, Contents, release_json
from kinectbench.release.publish.croissant import LATER, described_files
from kinectbench.release.publish.gate import ADVICE
from kinectbench.release.publish.index_page import NO_PICTURE
from kinectbench.release.publish.schemas import schema_texts
from kinectbench.release.publish.texts import release_facts, release_texts, stated_warnings
from kinectbench.settings.models import BenchmarkSettings

# A picture in a page.
PICTURE = re.compile(r"data:image/(?:jpeg|png);base64,[A-Za-z0-9+/=]*")
# Keys of JSON files on the software that made them; not compared.
OF_THIS_RUN = ("package_version", "packages", "fingerprint")
# Characters of a line or value in a message.
SHOWN = 120


def release_settings(metadata: ReleaseInfo) -> BenchmarkSettings:
    """Return the settings that a release of recordings states; its recordings have no path.

    Raises:
        ReleaseError: the release was not made from recordings, or by a version with other settings.
    """
    values = metadata.settings.json_value()
    if not values.get("recordings"):
        raise ReleaseError(
            f"{BENCHMARK_JSON}: this release was not made from recordings", what="not-rebuildable"
        )
    rows = [{**row, "path": "."} for row in values["recordings"]]
    values |= {"name": metadata.name, "license": metadata.license, "recordings": rows}
    try:
        return BenchmarkSettings.model_validate_json(json.dumps(values))
    except ValidationError as error:
        key = ".".join(str(part) for part in error.errors()[0]["loc"])
        raise ReleaseError(
            f"{BENCHMARK_JSON}: this version does not know the setting '{key}' as it is there; install "
            f"kinectbench {metadata.package_version}, which made the release",
            what="other-version",
        ) from error


def text_problems(contents: Contents, metadata: ReleaseInfo, targets: Sequence[Target]) -> list[str]:
    """Return a message for each text that differs from the text made of the release's other files.

    Missing texts are skipped. Not checked are the settings, and parts of texts that no other file contains.
    The release's other files have passed all checks.
    """
    if not metadata.of_this_version:
        return []
    if not {CARD, PRIVACY_JSON, LINEAGE_JSON} <= contents.entries.keys():
        return []
    try:
        return [*_other_texts(contents, metadata, targets)]
    except KinectBenchError as error:
        return [str(error)]


def _other_texts(contents: Contents, metadata: ReleaseInfo, targets: Sequence[Target]) -> Iterator[str]:
    if without := sorted(metadata.recordings.keys() - by_recording(targets).keys()):
        yield f"{BENCHMARK_JSON}: its recording {printable(without[0])} has no pair"
        return
    settings = release_settings(metadata)
    warnings = stated_warnings(metadata, settings, targets, contents.text(CARD))
    color = Privacy.parse(contents.text(PRIVACY_JSON), PRIVACY_JSON).color
    texts = release_texts(metadata, settings, targets, warnings, color)
    for name, wanted in chain(texts, schema_texts(contents.entries, columns_of(targets))):
        if name in contents.entries:
            yield from text_difference(name, _plain(contents.text(name)), _plain(wanted))
    lineage = Lineage.parse(contents.text(LINEAGE_JSON), LINEAGE_JSON)
    sums = parse_sums(contents.text(SHA256SUMS), SHA256SUMS)
    listed = {name: sha256 for name, sha256 in sums.items() if name not in LATER}
    all_facts = release_facts(metadata, settings, warnings, lineage)
    all_facts[CROISSANT].update(described_files(listed, columns_of(targets)))
    for name, facts in all_facts.items():
        if name in contents.entries:
            stated = release_json(said_without_advice(contents.text(name)), name)
            yield from value_differences(name, {key: stated.get(key) for key in facts}, facts)


def said_without_advice(text: str) -> str:
    """Return a text without the advice on left-out recordings, which cannot be derived from other files."""
    return text.replace(ADVICE, "")


def _plain(text: str) -> str:
    return said_without_advice(PICTURE.sub(NO_PICTURE, text))


def text_difference(name: str, stated: str, wanted: str) -> Iterator[str]:
    """Yield a message on the first line of a text that differs from `wanted`; `name` is the file's name."""
    if stated == wanted:
        return
    lines, others = stated.split("\n"), wanted.split("\n")
    length = max(len(lines), len(others))
    old, new = (each + [""] * (length - len(each)) for each in (lines, others))
    at = next(number for number in range(length) if old[number] != new[number])
    begin = next((n for n, (a, b) in enumerate(zip(old[at], new[at], strict=False)) if a != b), 0)
    said, should = (printable(each[at][max(0, begin - SHOWN // 2) :], SHOWN) for each in (old, new))
    yield f"{name}: line {at + 1} is '{said}', which should be '{should}'"


def _value(value: object) -> str:
    return printable(json.dumps(value, ensure_ascii=False), SHOWN)


def value_differences(name: str, stated: object, wanted: object, key: str = "") -> Iterator[str]:
    """Yield a message for each key of the JSON file `name` whose value differs from `wanted`.

    Keys in `OF_THIS_RUN` are skipped. Lists of equal length are compared entry by entry.
    """
    if isinstance(stated, Mapping) and isinstance(wanted, Mapping):
        for part in {**wanted, **stated}:
            if part not in OF_THIS_RUN:
                yield from value_differences(name, stated.get(part), wanted.get(part), f"{key}.{part}")
    elif isinstance(stated, list | tuple) and isinstance(wanted, list | tuple) and len(stated) == len(wanted):
        for number, (old, new) in enumerate(zip(stated, wanted, strict=True)):
            yield from value_differences(name, old, new, f"{key}.{number}")
    elif stated != wanted:
        said = printable(key.removeprefix("."), SHOWN)
        yield f"{name}: {said} is {_value(stated)}, which should be {_value(wanted)}"
