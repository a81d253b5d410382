"""Every key of benchmark.json is compared with what it summarises, or said to be compared with nothing."""

import json
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
from synthetic_release import synthetic_settings, write_build, write_json
from test_release_forged import sealed

from kinectbench.core.artefacts.benchmark import PublishOptions, RecordingInfo, ReleaseInfo
from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.stored import StoredPart
from kinectbench.release.check.verify import verify
from kinectbench.release.publish.publish import publish

DOCS = Path(__file__).parents[2] / "docs" / "evidence" / "releases.md"
ROW = re.compile(r"^\| (`.+`) \| (.+) \|$", re.MULTILINE)
WANTED = (
    ("poor", "chair", "red", "test", 1),
    ("good", "chair", "blue", "validation", 1),
    ("out", "chair", "green", "validation", 1),
    ("rejected", "chair", "grey", "validation", 1),
)
NAME = "poor"
# Of one part, all of whose sections are compared in one way.
WHOLE = {
    *("settings.pairs", "distribution", "flow"),
    *("recordings.<name>.quality", "recordings.<name>.reference"),
}
# No other value of these can be in a release of one part, or each has a test of its own.
NOT_FORGED = {
    *("format_version", "benchmark_sha256_version", "benchmark_sha256"),
    *("isolated", "recordings.<name>.rebuilt_iou", "recordings.<name>.rebuilt_single_iou"),
}
Change = Callable[[dict[str, Any]], object]


def keys(model: type[StoredPart], before: str = "") -> Iterator[str]:
    """Every key of a model, with dots; those of a recording below `recordings.<name>`."""
    for name, field in model.model_fields.items():
        key = f"{before}{name}"
        parts = [each for each in (field.annotation, *get_args(field.annotation)) if isinstance(each, type)]
        below = next(
            (part for part in parts if issubclass(part, StoredPart) and part is not QualityFile), None
        )
        if below is None or key in WHOLE:
            yield key
        elif below is RecordingInfo:
            yield from keys(below, f"{key}.<name>.")
        else:
            yield from keys(below, f"{key}.")


def documented() -> dict[str, str]:
    """{key: what it is compared with}, as the evidence for releases says."""
    text = DOCS.read_text(encoding="utf-8").split("| key | compared with |")[1].split("\n\n")[0]
    return {key: what for names, what in ROW.findall(text) for key in re.findall("`([^`]+)`", names)}


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A release with a poor recording, one that is left out, and one that a person rejected."""
    folder = tmp_path_factory.mktemp("keys")
    write_build(folder / "build", WANTED)
    for name, figures in ((NAME, 0.45), ("out", 0.3)):
        write_json(folder / "build" / name / "object/quality.json", {"estimated_iou": figures})
    # The synthetic build has no settings in its manifests.
    for name, *_ in WANTED:
        path = folder / "build" / name / "pairs/manifest.json"
        said = {"pairs": {"min_containment": 0.85}, "tracking": {"voxel_size_m": 0.01}}
        path.write_text(json.dumps(json.loads(path.read_text()) | {"settings": said}))
    made = synthetic_settings(WANTED, publish={"citation": {"version": "1.0.0"}}).model_dump(mode="json")
    for row, decision in ((0, "accept"), (3, "reject")):
        made["recordings"][row]["review"] = {"decision": decision, "reason": "looked at"}
    settings = type(synthetic_settings()).model_validate(made)
    options = PublishOptions(hold_back=(), thresholds=None)
    publish(settings, folder / "build", folder / "benchmark", [name for name, *_ in WANTED], options)
    return folder / "benchmark"


def of_recording(**values: Any) -> Change:
    return lambda stated: stated["recordings"][NAME].update(values)


def of_settings(**values: Any) -> Change:
    return lambda stated: stated["settings"].update(values)


FORGED: dict[str, Change] = {
    "name": lambda stated: stated.update(name="other"),
    "license": lambda stated: stated.update(license="MIT"),
    "package_version": lambda stated: stated.update(package_version="9.9.9"),
    "framing": lambda stated: stated.update(framing="view"),
    "partial_rule": lambda stated: stated.update(partial_rule="majority"),
    "distribution": lambda stated: stated["distribution"].update(allowed=False),
    "settings.source": of_settings(source="somebody else"),
    "settings.recordings": lambda stated: stated["settings"]["recordings"][0].update(category="sofa"),
    "settings.pairs": lambda stated: stated["settings"]["pairs"].update(min_containment=0.1),
    "settings.publish": lambda stated: stated["settings"]["publish"]["gate"].update(min_estimated_iou=0.1),
    "recordings.<name>.object": of_recording(object="black"),
    "recordings.<name>.category": of_recording(category="sofa"),
    "recordings.<name>.split": of_recording(split="train"),
    "recordings.<name>.pairs": of_recording(pairs=2),
    "recordings.<name>.refused": of_recording(refused=2),
    "recordings.<name>.quality": of_recording(quality={"estimated_iou": 0.99}),
    "recordings.<name>.license": of_recording(license="MIT"),
    "recordings.<name>.source": of_recording(source="somebody else"),
    "recordings.<name>.poor": of_recording(poor=["estimated IoU 0.69, publish.gate.min_estimated_iou: 0.7"]),
    "recordings.<name>.accepted": of_recording(accepted="--allow-poor"),
    "left_out": lambda stated: stated.update(left_out={"out": "rejected by review: looked at"}),
    "recordings.<name>.look": lambda stated: stated["recordings"]["good"].update(look=["it is askew"]),
    "recordings.<name>.visible_share": of_recording(visible_share=0.99),
    "flow": lambda stated: stated["flow"].update(failed=1, below_limits=0),
    "version": lambda stated: stated.update(version="2.0.0"),
    "held_back": lambda stated: stated.update(held_back=["test"]),
    "surface_truth": lambda stated: stated.update(surface_truth=["test"]),
} | {
    f"settings.{key}": of_settings(**{key: {"voxel_size_m": 0.02}})
    for key in ("tracking", "fusion", "segmentation", "views")
}
# The synthetic lineage has the settings of these stages only.
OTHER_STAGES = {"settings.fusion", "settings.segmentation", "settings.views"}


def test_the_page_has_every_key() -> None:
    assert set(keys(ReleaseInfo)) == documented().keys()


def test_every_key_that_is_compared_is_forged_here() -> None:
    compared = {key for key, what in documented().items() if not what.startswith("nothing")}
    assert FORGED.keys() | NOT_FORGED == compared


@pytest.mark.parametrize("key", sorted(FORGED.keys() - OTHER_STAGES))
def test_a_forged_key_is_named(published: Path, tmp_path: Path, key: str) -> None:
    folder = Path(shutil.copytree(published, tmp_path / "benchmark"))
    sealed(folder, FORGED[key])
    assert verify(folder) != []


POOR = {
    "no longer poor": lambda stated: [stated["recordings"][NAME].pop(key) for key in ("poor", "accepted")],
    "poor, and nobody accepted it": lambda stated: stated["recordings"][NAME].pop("accepted"),
    "a good one is called poor": lambda stated: stated["recordings"]["good"].update(
        poor=["51% of the solid is unknown, more than publish.gate.max_unknown_share: 0.5"], accepted="why"
    ),
    "nothing is left out": lambda stated: stated.pop("left_out"),
    "one that was never built is left out": lambda stated: stated["left_out"].update(nobody="was bad"),
    "a published one is left out": lambda stated: stated["left_out"].update(good="was bad"),
    "a gate that is none": lambda stated: stated["settings"]["publish"].update(gate={"x": 1}),
}


@pytest.mark.parametrize("what", POOR)
def test_who_is_poor_or_left_out_follows(published: Path, tmp_path: Path, what: str) -> None:
    folder = Path(shutil.copytree(published, tmp_path / "benchmark"))
    sealed(folder, POOR[what])
    lines = verify(folder)
    assert any(line.startswith(("benchmark.json: ", "README.md: says otherwise")) for line in lines), lines


def test_sound_ones_are_well(published: Path) -> None:
    assert verify(published) == []
