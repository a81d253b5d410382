"""`python tests/support/pin_stages.py`: pin what every stage writes today, after its version was raised.

The pins are digests, compared with tolerances (`stage_digests.py`). A stage that writes something else
than its version did before is refused here as in the test, unless one that it stands on does so, too.
"""

import json
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stage_digests import Digest, difference, file_digest, from_json, to_json
from stage_sample import REPOSITORY, Sample, make_sample

from kinectbench.core.storage import canonical_json
from kinectbench.engine import artefact
from kinectbench.engine.artefact import VERSIONS

PINS = Path(__file__).with_name("stage_pins.json")
COMMAND = "python tests/support/pin_stages.py"
# {stage: {"version": number, "files": {name: digest as JSON}}}
Pins = Mapping[str, Mapping[str, Any]]


def read_pins() -> Pins:
    """What is pinned; nothing if there is no such file yet."""
    if not PINS.is_file():
        return {}
    pins: Pins = json.loads(PINS.read_text())
    return pins


def digests(sample: Sample) -> dict[str, dict[str, Digest]]:
    """{stage: {name of a file: its digest}}."""
    return {
        stage: {name: file_digest(path) for name, path in written.files.items()}
        for stage, written in sample.items()
    }


def changes(pins: Pins, sample: Sample, found: Mapping[str, Mapping[str, Digest]]) -> dict[str, str]:
    """{stage: the first thing that it writes differently}, of stages whose inputs are as they were."""
    differ = {stage: _first(pins[stage]["files"], found[stage]) for stage in sample if stage in pins}
    return {
        stage: what
        for stage, what in differ.items()
        if what and not any(differ.get(stage_input) for stage_input in sample[stage].inputs)
    }


def _first(pinned: Mapping[str, Any], found: Mapping[str, Digest]) -> str:
    for name in dict.fromkeys((*pinned, *found)):
        if name not in pinned or name not in found:
            return f"{name} {'is new' if name in found else 'is gone'}"
        if what := difference(from_json(pinned[name]), found[name]):
            return f"{name}: {what}"
    return ""


def unraised(pins: Pins, changed: Mapping[str, str]) -> list[str]:
    """A line for each stage that writes something else under the version that is pinned."""
    file = Path(artefact.__file__).resolve().relative_to(REPOSITORY)
    return [
        f"stage `{stage}` writes something else than version {VERSIONS[stage]} did ({what}): if that is "
        f"meant, raise its version in {file} and run `{COMMAND}`"
        for stage, what in changed.items()
        if VERSIONS[stage] == pins[stage]["version"]
    ]


def unpinned(pins: Pins) -> list[str]:
    """A line for each stage of which another version, or none, is pinned."""
    return [
        f"stage `{stage}` is version {version}, but pinned is {_pinned(pins, stage)}: run `{COMMAND}`"
        for stage, version in VERSIONS.items()
        if stage not in pins or pins[stage]["version"] != version
    ]


def _pinned(pins: Pins, stage: str) -> str:
    return f"version {pins[stage]['version']}" if stage in pins else "none"


def pins_text(found: Mapping[str, Mapping[str, Digest]]) -> str:
    """The content of stage_pins.json: a line for each file, so that changes are read in a diff."""
    stages = []
    for stage, files in found.items():
        rows = ",\n".join(
            f"   {json.dumps(name)}: {canonical_json(to_json(digest))}" for name, digest in files.items()
        )
        stages.append(
            f' {json.dumps(stage)}: {{\n  "version": {VERSIONS[stage]},\n  "files": {{\n{rows}\n  }}\n }}'
        )
    return "{\n" + ",\n".join(stages) + "\n}\n"


def main() -> int:
    """Make the sample, and pin it if no version is missing."""
    with tempfile.TemporaryDirectory() as folder:
        sample = make_sample(Path(folder))
        found = digests(sample)
    pins = read_pins()
    lines = unraised(pins, changes(pins, sample, found))
    if lines:
        sys.stderr.write("\n".join(lines) + "\n")
        return 1
    PINS.write_text(pins_text(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
