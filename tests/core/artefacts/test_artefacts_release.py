"""The files of a release: the same text comes back, older files are read, and damage is told in one line."""

import json
from dataclasses import replace
from typing import Any

import pytest
from raising import raises

from kinectbench.core.artefacts.benchmark import PublishStamp, ReleaseInfo
from kinectbench.core.artefacts.provenance import Lineage, Privacy, ThresholdsFile
from kinectbench.core.artefacts.stored import Stored
from kinectbench.core.artefacts.targets import (
    SPLITS,
    Splits,
    Target,
    benchmark_sha256,
    parse_sums,
    parse_targets,
    sums_text,
    targets_text,
)
from kinectbench.core.errors import ReleaseError
from kinectbench.core.storage import canonical_json, pretty_json, sha256_text

RECORDING: dict[str, Any] = {
    "object": "red_chair",
    "category": "chair",
    "split": "test",
    "pairs": 2,
    "refused": 1,
    "quality": {"verdict": "good", "estimated_iou": 0.93},
}
BENCHMARK: dict[str, Any] = {
    "name": "chairs",
    "license": "CC0-1.0",
    "format_version": 1,
    "package_version": "0.1.0",
    "benchmark_sha256": "ab" * 32,
    "framing": "object",
    "partial_rule": "any",
    "distribution": {"allowed": True, "reasons": []},
    "settings": {
        "source": "us",
        "recordings": [{"id": "chair_01", "object": None}],
        "views": {"count": 50},
        "pairs": {
            "framing": "object",
            "partial_rule": "any",
            "min_containment": 0.85,
            "new": 1,
        },
    },
    "packages": {"python": "3.11"},
    "recordings": {"chair_01": RECORDING | {"license": "CC0-1.0", "source": "us"}},
    "held_back": ["test"],
    "private_benchmark_sha256": "cd" * 32,
}
LINEAGE = {
    "format_version": 1,
    "package_version": "0.1.0",
    "packages": "benchmark.json: packages",
    "recordings": {
        "chair_01": {
            "source": "us",
            "license": "CC0-1.0",
            "files": {"depth/0.png": "ab" * 32},
            "stages": {
                "ingest": {
                    "package_version": "0.1.0",
                    "stage_version": None,
                    "settings": {},
                    "fingerprint": "",
                }
            },
            "views": [{"view": "000", "frame": 3, "stamp_ns": 5}],
        }
    },
}
PRIVACY = {
    "format_version": 1,
    "color": "left out",
    "looked_in": ["JSON files"],
    "looked_for": ["GPS positions"],
    "removed": [{"file": "lineage.json", "what": "the key 'gps'"}],
    "kept": ["capture times"],
}
STAMP = {
    "fingerprint": "f",
    "options": {"hold_back": ["test"], "thresholds": None},
    "benchmark_sha256": "ab" * 32,
    "pairs": 2,
    "recordings": ["chair_01"],
    "warnings": [],
    "private_sha256": "cd" * 32,
    "removed": [],
    "unanswered": ["consent"],
    "shortened": False,
}
TARGET = Target("chair_01", "red_chair", "000", "chair", "test", "pairs/chair_01/000.npz", "ab" * 32)


@pytest.mark.parametrize(
    ("model", "content"),
    [
        (ReleaseInfo, BENCHMARK),
        (Lineage, LINEAGE),
        (Privacy, PRIVACY),
        (PublishStamp, STAMP),
        (Splits, {"train": [], "validation": [], "test": ["chair_01"]}),
        (ThresholdsFile, {"thresholds": {"chair": 0.5}, "objects": ["a"], "method": "hull"}),
        (ThresholdsFile, {"thresholds": {"chair": 0.5}}),
    ],
)
def test_the_same_text_comes_back(model: type[Stored], content: dict[str, Any]) -> None:
    text = pretty_json(content)
    assert model.parse(text, model.FILE).text() == text


def test_a_release_older_than_some_keys() -> None:
    older = {key: value for key, value in BENCHMARK.items() if key not in ("distribution", "held_back")}
    older |= {
        "recordings": {"chair_01": RECORDING | {"quality": {}}},
        "settings": {"pairs": {"min_containment": 0}},
    }
    info = ReleaseInfo.parse(json.dumps(older), "benchmark.json")
    assert info.distribution is None and info.held_back == () and info.settings.recordings is None
    recording = info.recordings["chair_01"]
    assert (recording.license, recording.source) == ("unspecified", "unspecified")
    assert recording.quality.estimated_iou is None and recording.quality.json_value() == {}


def test_another_format_is_told_before_its_keys() -> None:
    for content in ({"format_version": 2}, BENCHMARK | {"format_version": 2}, {}):
        with raises(ReleaseError, "release.other-version", match=r"(2|None).*1"):
            ReleaseInfo.parse(json.dumps(content), "b.json")


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("[", "not valid JSON"),
        ("[1]", "valid dictionary|an object"),
        (json.dumps(BENCHMARK | {"framing": "cube"}), "'framing': "),
        (json.dumps(BENCHMARK | {"recordings": {"a": {}}}), r"'recordings\.a\.object': "),
        (json.dumps(BENCHMARK | {"benchmark_sha256": "ab"}), "'benchmark_sha256': "),
    ],
)
def test_what_is_wrong_is_named(text: str, part: str) -> None:
    with raises(ReleaseError, "release.damaged", match=f"(?:{part}).*make"):
        ReleaseInfo.parse(text, "b.json")


def test_targets_and_splits() -> None:
    targets = (TARGET, replace(TARGET, view="001", file="pairs/chair_01/001.npz", unknown_share=0.0625))
    assert parse_targets(targets_text(targets), "targets.csv") == targets
    assert Splits.of(targets).json_value() == {"train": [], "validation": [], "test": ["chair_01"]}
    assert tuple(Splits.model_fields) == SPLITS


def test_checksums_name_the_release() -> None:
    sums = {"pairs/chair_01/000.npz": "cd" * 32, "benchmark.json": "ab" * 32}
    text = sums_text(sums)
    assert text.splitlines()[0] == f"{'ab' * 32}  benchmark.json"
    assert parse_sums(text, "SHA256SUMS") == sums
    files = f"{'cd' * 32}  pairs/chair_01/000.npz\n"
    assert benchmark_sha256(text, '{"name": "a"}') == sha256_text(files)
    assert benchmark_sha256(text, json.dumps(BENCHMARK)) == sha256_text(files)
    second = BENCHMARK | {"benchmark_sha256_version": 2}
    covered = {key: value for key, value in second.items() if not key.endswith("benchmark_sha256")}
    assert benchmark_sha256(text, json.dumps(second)) == sha256_text(files + canonical_json(covered))
    with raises(ReleaseError, "release.damaged", match="line 1"):
        parse_sums(f"{'ab' * 32}  ../outside\n", "SHA256SUMS")
