"""What is published, left out, or published all the same: `publish.gate`, reviews, --allow-poor."""

import json
from pathlib import Path
from typing import Any

import pytest
from analytic_scenes import health_of
from raising import raises
from synthetic_release import RECORDINGS, synthetic_settings, write_build, write_json

from kinectbench.core.artefacts.benchmark import PublishOptions
from kinectbench.core.artefacts.object import MEASUREMENT_WARNINGS
from kinectbench.core.artefacts.sequence import CameraFile
from kinectbench.core.errors import ReleaseError
from kinectbench.release.check.reservations import reservations
from kinectbench.release.check.verify import verify
from kinectbench.release.publish.gate import WITHHELD, gate
from kinectbench.release.publish.publish import publish
from kinectbench.stages.segment.find.pieces import LOOK

NAME = RECORDINGS[0][0]
NAMES = [recording[0] for recording in RECORDINGS]
SOUND = {"estimated_iou": 0.93, "estimated_iou_low": 0.8, "unknown_share": 0.2}


def settings(review: Any = None, **limits: Any) -> Any:
    """The synthetic benchmark's, with limits, and a review of its first recording."""
    made = synthetic_settings(publish={"gate": limits}).model_dump(mode="json")
    made["recordings"][0]["review"] = review
    return type(synthetic_settings()).model_validate(made)


def built(folder: Path, grade: str = "good", **quality: Any) -> Path:
    """What the gate reads of the first recording."""
    for name in ("object", "trajectory"):
        (folder / NAME / name).mkdir(parents=True, exist_ok=True)
    write_json(folder / NAME / "object/quality.json", SOUND | quality)
    health_of(8, grade=grade).write(folder / NAME / "trajectory")
    return folder


@pytest.mark.parametrize(
    ("found", "limits", "said"),
    [
        ({"estimated_iou": 0.45}, {}, "estimated IoU 0.45, less than publish.gate.min_estimated_iou: 0.7"),
        (
            {"estimated_iou_low": 0.69, "grade": "not good"},
            {},
            "trajectory is not good, 0.69, less than",
        ),
        (
            {"grade": "not good"},
            {"min_grade": "fair"},
            "not good, below publish.gate.min_grade",
        ),
        (
            {"unknown_share": 0.51},
            {},
            "51% of the solid is unknown, more than publish.gate.max_unk",
        ),
        (
            {"warnings": [f"falls into 3; {LOOK}"]},
            {},
            "falls into 3 (1 warning of the object, its floor or its size, more",
        ),
        ({"warnings": [f"begins 0.2 m up: {MEASUREMENT_WARNINGS[1]}"]}, {}, "publish.gate.max_doubts: 0"),
        ({"warnings": [f"the solid is in 2 {MEASUREMENT_WARNINGS[2]}: x"]}, {}, "publish.gate.max_doubts: 0"),
        # A file with doubts says itself which of its warnings are some, in any words.
        (
            {"warnings": ["in other words; x", "thin"], "doubts": ["in other words; x"]},
            {},
            "in other words (",
        ),
        ({"warnings": [f"no doubt; {LOOK}"], "doubts": []}, {}, None),
        # Sound, or as wide as the limits are set.
        ({}, {}, None),
        ({"estimated_iou_low": 0.69}, {}, None),
        ({"grade": "not good"}, {}, None),
        ({"estimated_iou": 0.45}, {"min_estimated_iou": 0.45}, None),
        ({"warnings": ["nobody saw the underside", "thin"]}, {}, None),
        ({"estimated_iou": None, "estimated_iou_low": None, "unknown_share": None}, {}, None),
    ],
)
def test_limits(found: dict[str, Any], limits: dict[str, Any], said: str | None, tmp_path: Path) -> None:
    passed = gate(settings(**limits), built(tmp_path, **found), [NAME], allow_poor=False)
    if said is None:
        assert passed.published == (NAME,) and not passed.left_out and not passed.poor
        return
    assert passed.published == () and list(passed.refused) == [NAME]
    (line,) = passed.reasons()
    assert said in line and line.startswith(f"{NAME} is left out: ") and "--allow-poor" in line
    for review, allow_poor, why in (
        ({"decision": "accept", "reason": "looked at"}, False, "accepted by review: looked at"),
        (None, True, "--allow-poor"),
    ):
        passed = gate(settings(review, **limits), tmp_path, [NAME], allow_poor)
        assert passed.published == (NAME,) and not passed.refused and passed.poor[NAME][1] == why
        assert said in next(passed.lines())


def test_doubtful_lengths_of_a_recording_are_a_doubt_of_its_size(tmp_path: Path) -> None:
    built(tmp_path)
    head = CameraFile(
        format_version=2, width=4, height=3, fx=5.0, fy=5.0, cx=1.5, cy=1.0, depth_scale=1000.0,
        color_registered=True, doubts=("chair: fit better with depth 0.91 times as far; look",),
    )  # fmt: skip
    (tmp_path / NAME / "sequence").mkdir()
    head.write(tmp_path / NAME / "sequence")
    (line,) = gate(settings(), tmp_path, [NAME], allow_poor=False).reasons()
    assert "fit better with depth 0.91 times as far (1 warning of the object, its floor or its size" in line
    assert gate(settings(max_doubts=1), tmp_path, [NAME], allow_poor=False).published == (NAME,)


def test_what_a_person_rejects_is_no_failure(tmp_path: Path) -> None:
    review = {"decision": "reject", "reason": "a cloth hangs over it"}
    passed = gate(settings(review), built(tmp_path), [NAME], allow_poor=True)
    assert (passed.published, dict(passed.refused)) == ((), {})
    assert list(passed.lines()) == [
        "1 recording is left out of this release",
        f"{NAME} is left out: rejected by review: a cloth hangs over it",
    ]


def test_the_release_says_what_was_left_out_and_what_was_let_pass(tmp_path: Path) -> None:
    build = tmp_path / "build"
    write_build(build)
    built(build, estimated_iou=0.45)
    summary = publish(settings(), build, tmp_path / "strict", NAMES)
    assert summary.refused == (NAME,) and NAME not in summary.recordings and len(summary.recordings) == 4
    content = json.loads((tmp_path / "strict/benchmark.json").read_text())
    assert NAME not in content["recordings"] and "estimated IoU 0.45" in content["left_out"][NAME]
    card = (tmp_path / "strict/README.md").read_text()
    assert "- 1 recording is left out of this release" in card and f"- {NAME} is left out: estimated" in card

    asked = PublishOptions(hold_back=(), thresholds=None, allow_poor=True)
    summary = publish(settings(), build, tmp_path / "wide", NAMES, asked)
    assert summary.refused == () and NAME in summary.recordings
    content = json.loads((tmp_path / "wide/benchmark.json").read_text())
    assert content["recordings"][NAME]["accepted"] == "--allow-poor" and "left_out" not in content
    assert "estimated IoU 0.45" in content["recordings"][NAME]["poor"][0]
    assert "poor" not in content["recordings"][NAMES[1]]
    assert f"- {NAME} is published all the same (--allow-poor)" in (tmp_path / "wide/README.md").read_text()
    assert verify(tmp_path / "wide") == []
    assert reservations(tmp_path / "wide") == [f"published below its own limits: {NAME}"]


def test_what_the_gate_says_of_a_recording_is_not_said_twice(tmp_path: Path) -> None:
    build = tmp_path / "build"
    write_build(build)
    twice = "the walls are measured twice; record again, slowly"
    built(build, warnings=[twice, "it hangs; stand it up"], doubts=[twice])
    summary = publish(settings(max_doubts=2), build, tmp_path / "out", NAMES)
    lines = [line for line in summary.warnings if "walls are measured twice" in line]
    assert lines == [f"{NAME} is published, and a person should look at it: the walls are measured twice"]
    assert f"{NAME}: it hangs; stand it up" in summary.warnings


def test_a_poor_recording_without_a_pair_is_left_out_and_the_release_verifies(tmp_path: Path) -> None:
    """Its card must not say that it is published all the same, which `verify` takes for a contradiction."""
    build = tmp_path / "build"
    write_build(build)
    built(build, estimated_iou=0.45)
    pairs = build / NAME / "pairs" / "pairs.json"
    write_json(pairs, json.loads(pairs.read_text()) | {"pairs": []})
    asked = PublishOptions(hold_back=(), thresholds=None, allow_poor=True)
    summary = publish(settings(), build, tmp_path / "release", NAMES, asked)
    assert NAME not in summary.recordings and "all the same" not in " ".join(summary.warnings)
    assert verify(tmp_path / "release") == []


def test_a_release_without_its_only_validation_recording_says_so(tmp_path: Path) -> None:
    build = tmp_path / "build"
    write_build(build)
    of_split = [each.id for each in settings().recordings if each.split == "validation"]
    for name in of_split:
        write_json(build / name / "object/quality.json", SOUND | {"estimated_iou": 0.45})
    summary = publish(settings(), build, tmp_path / "benchmark", NAMES)
    assert set(summary.refused) == set(of_split)
    said = f"no validation split is published, as this release is without {', '.join(of_split)}: thresholds"
    (line,) = [line for line in summary.warnings if "validation split" in line]
    assert line.startswith(said) and said in (tmp_path / "benchmark/README.md").read_text()


def test_nothing_passes(tmp_path: Path) -> None:
    with raises(ReleaseError, "release.no-pairs", match=r"chair_01.*0\.45"):
        publish(settings(), built(tmp_path, estimated_iou=0.45), tmp_path / "out", [NAME])


def test_where_nothing_passes_each_has_its_reason(tmp_path: Path) -> None:
    """The first few; the advice comes once."""
    build = tmp_path / "build"
    write_build(build)
    for name in NAMES:
        write_json(build / name / "object/quality.json", SOUND | {"estimated_iou": 0.45})
    review = {"decision": "reject", "reason": "a cloth"}
    with pytest.raises(ReleaseError) as error:
        publish(settings(review), build, tmp_path / "out", NAMES[:3])
    said = str(error.value)
    assert f"{NAME} is left out: rejected by review: a cloth" in said
    for name in NAMES[1:3]:
        assert f"{name} is left out: estimated IoU 0.45" in said
    assert said.count("--allow-poor") == 1
    with raises(ReleaseError, "release.no-pairs", match="and 1 more") as error:
        publish(settings(), build, tmp_path / "out", NAMES)
    assert str(error.value).count("is left out") == len(NAMES) - 1 == 4


# Each is a way to let pass, or to leave out, the first recording, which is of the test split.
@pytest.mark.parametrize(
    ("review", "allow_poor"),
    [
        (None, True),
        (None, False),
        ({"decision": "accept", "reason": "REASON"}, False),
        ({"decision": "reject", "reason": "REASON"}, False),
    ],
)
def test_no_figure_and_no_reason_of_a_truth_that_is_held_back(
    review: Any, allow_poor: bool, tmp_path: Path
) -> None:
    build = tmp_path / "build"
    write_build(build)
    built(
        build,
        estimated_iou=0.2345,
        unknown_share=0.8642,
        grade="not good",
        warnings=[f"it falls into 17 things; {LOOK}"],
    )
    asked = PublishOptions(hold_back=("test",), thresholds=None, allow_poor=allow_poor or None)
    summary = publish(settings(review, min_grade="good"), build, tmp_path / "out", NAMES, asked)
    # Quality of every kind, and the person's words; the rest of the page is of other recordings.
    told = ("0.23", "0.2345", "86%", "0.8642", "17 things", "REASON", "the trajectory is not good")
    for part, is_public in ((summary.folder, True), (summary.private, False)):
        assert part is not None
        texts = [path.read_text(errors="replace") for path in part.rglob("*") if is_text(path)]
        found = {word for word in told if any(word in text for text in texts)}
        assert not found if is_public else found
    content = json.loads((summary.folder / "benchmark.json").read_text())
    said = content["recordings"].get(NAME, {}).get("poor", [content.get("left_out", {}).get(NAME)])
    assert all(WITHHELD in line for line in said)
    assert f"- {NAME} is " in (summary.folder / "README.md").read_text()
    # Whoever publishes sees why.
    assert any(line.startswith(f"{NAME} is ") and WITHHELD not in line for line in summary.warnings)


def is_text(path: Path) -> bool:
    """Whether a file of a release is text."""
    return path.suffix in (".json", ".md", ".csv", ".html", ".cff", "") and path.is_file()
