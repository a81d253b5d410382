"""What `triage` decides of recordings, and why: the rules that `publish` keeps, and what people say."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analytic_scenes import health_of
from synthetic_release import CAMERA, RECORDINGS, synthetic_settings, write_build, write_json

from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, Flow, ReleaseInfo
from kinectbench.core.artefacts.manifest import Failed
from kinectbench.core.artefacts.triage import TriageFile
from kinectbench.release.check.figure_check import gate_problems
from kinectbench.release.check.verify import verify
from kinectbench.release.publish.gate import REJECTED, WITHOUT_PAIR, gate, would_be_left_out
from kinectbench.release.publish.publish import publish
from kinectbench.release.triage.stands_alone import share_standing_alone
from kinectbench.release.triage.triage import triage
from kinectbench.report.triage import write_triage_page

NAMES = [recording[0] for recording in RECORDINGS]
NAME = NAMES[0]
SOUND = {"estimated_iou": 0.93, "estimated_iou_low": 0.8, "unknown_share": 0.2, "volume_m3": 0.01}
FRONTIER = {
    "direction": "up", "area_m2": 0.09, "size_m": [0.31, 0.29], "center_m": [0, 0, 0.6],
    "look_from": [0, 0, 1], "advice": "record from above", "volume_m3": 0.003, "inside_share": 0.5,
    "solid_share": 1.0,
}  # fmt: skip


def settings(review: Any = None, **limits: Any) -> Any:
    made = synthetic_settings(publish={"gate": limits}).model_dump(mode="json")
    made["recordings"][0]["review"] = review
    return type(synthetic_settings()).model_validate(made)


def built(
    folder: Path, grade: str = "good", warnings: tuple[str, ...] = (), lost: int = 0, **quality: Any
) -> Path:
    """What the rules read of the first recording."""
    for name in ("object", "trajectory", "sequence"):
        (folder / NAME / name).mkdir(parents=True, exist_ok=True)
    write_json(folder / NAME / "object/quality.json", SOUND | quality)
    write_json(folder / NAME / "sequence/camera.json", CAMERA | {"warnings": warnings})
    health = health_of(8, grade=grade).model_copy(update={"lost": tuple(range(lost)), "tracked": 8 - lost})
    health.write(folder / NAME / "trajectory")
    return folder


@pytest.mark.parametrize(
    ("found", "said"),
    [
        ({"grade": "not good"}, "the trajectory is"),
        ({"estimated_known_iou": 0.79}, "the estimated IoU on known voxels is 0.79, below 0.8"),
        ({"moving": {"judged": 40, "frames": [3, 4, 5, 6, 7], "largest_share": 0.1}}, "in 5 of 40 frames"),
        ({"grade": "fair", "lost": 2}, "25% of the frames have no pose"),
        ({"beyond_share": 0.05}, "5% of the depth"),
        ({"off_share": 0.009}, "0.90% of the depth on the object lies 2 cm and more off its surface"),
        ({"warnings": ("x.klg: is cut off",)}, "x.klg: is cut off"),
    ],
)
def test_what_speaks_against_a_recording_is_looked_at(
    found: dict[str, Any], said: str, tmp_path: Path
) -> None:
    build = built(tmp_path, **found)
    row = _row(triage(settings(), build, [NAME]))
    assert row.decision == "look" and any(said in line for line in row.reasons), row.reasons
    # `publish` publishes it, and its card says so.
    passed = gate(settings(), build, [NAME], allow_poor=False)
    assert passed.published == (NAME,) and passed.look[NAME] == row.reasons
    assert any("a person should look at it" in line for line in passed.lines())
    # Somebody has looked.
    review = {"decision": "accept", "reason": "it is sound"}
    row = _row(triage(settings(review), build, [NAME]))
    assert (row.decision, row.review) == ("accept", "it is sound") and row.reasons
    assert not gate(settings(review), build, [NAME], allow_poor=False).look


@pytest.mark.parametrize(
    ("found", "said"),
    [
        ({"frontiers": [FRONTIER | {"volume_m3": 0.006}]}, "behind has 60% of the solid's volume"),
        ({"unseen_side": {"gap_deg": 150, "towards_deg": 0, "share": 0.3}}, "from a side of 150°"),
        ({"unknown_share": 0.45}, "45% of the solid is unknown"),
    ],
)
def test_what_nobody_saw_is_stated_and_decides_nothing(
    found: dict[str, Any], said: str, tmp_path: Path
) -> None:
    row = _row(triage(settings(), built(tmp_path, **found), [NAME]))
    assert (row.decision, row.reasons) == ("accept", ()) and said in row.incomplete[0]


def _row(found: TriageFile) -> Any:
    return next(row for row in found.rows if row.recording == NAME)


def test_sound_recordings_are_accepted_and_limits_reject(tmp_path: Path) -> None:
    assert _row(triage(settings(), built(tmp_path), [NAME])).decision == "accept"
    row = _row(triage(settings(), built(tmp_path, estimated_known_iou=0.65), [NAME]))
    assert row.decision == "reject" and row.reasons[0].startswith("estimated IoU on known voxels 0.65, less")
    unsure: dict[str, Any] = {"estimated_known_iou": 0.9, "estimated_known_iou_low": 0.6}
    row = _row(triage(settings(), built(tmp_path, "not good", **unsure), [NAME]))
    assert row.decision == "reject" and row.reasons[0].startswith("lower end of the estimated IoU on known")
    # Of a build without that estimate the whole solid's counts.
    row = _row(triage(settings(), built(tmp_path, estimated_iou=0.45), [NAME]))
    assert row.decision == "reject" and "publish.gate.min_estimated_iou: 0.7" in row.reasons[0]
    # A limit of the settings moves both decisions.
    assert _row(triage(settings(min_estimated_iou=0.4), tmp_path, [NAME])).decision == "accept"
    review = {"decision": "reject", "reason": "a cloth hangs over it"}
    assert _row(triage(settings(review), built(tmp_path), [NAME])).decision == "reject"


def test_what_a_build_says_of_a_release_is_what_publish_does(tmp_path: Path) -> None:
    """`build` names the reasons of `publish`, of the recordings that it built."""
    low: dict[str, Any] = {"estimated_known_iou": 0.9, "estimated_known_iou_low": 0.6}
    build = built(tmp_path, "not good", **low)
    reason = gate(settings(), build, [NAME], allow_poor=False).left_out[NAME]
    assert reason.startswith("lower end of the estimated IoU on known voxels, as the trajectory is not good")
    said = would_be_left_out(settings(), build, {NAME: 8})
    assert list(said) == [NAME] and said[NAME].startswith(reason) and "`--allow-poor`" in said[NAME]
    assert would_be_left_out(settings(min_estimated_iou=0.5), build, {NAME: 8}) == {}
    assert would_be_left_out(settings(min_estimated_iou=0.5), build, {NAME: 0}) == {NAME: WITHOUT_PAIR}
    accepted = settings({"decision": "accept", "reason": "I measured it"})
    assert would_be_left_out(accepted, build, {NAME: 8}) == {}
    rejected = settings({"decision": "reject", "reason": "a cloth hangs over it"})
    assert would_be_left_out(rejected, build, {NAME: 8}) == {NAME: f"{REJECTED}a cloth hangs over it"}


def test_a_doubt_is_not_said_twice(tmp_path: Path) -> None:
    build = built(tmp_path, doubts=["it is several things; look at it"])
    assert len(_row(triage(settings(), build, [NAME])).reasons) == 1
    row = _row(triage(settings(max_doubts=1), build, [NAME]))
    assert (row.decision, row.reasons) == ("look", ("it is several things",))


def test_a_limit_hides_no_other_fact(tmp_path: Path) -> None:
    """The rows stay complete; the page leaves out what a limit states word for word."""
    low: dict[str, Any] = {"estimated_known_iou": 0.7, "estimated_known_iou_low": 0.35, "unknown_share": 0.6}
    build = built(tmp_path, "not good", **low)
    health_of(8, grade="not good", verdict="not good: 9 mm off").write(build / NAME / "trajectory")
    found = triage(settings(min_grade="fair", max_unknown_share=0.5), build, [NAME])
    row = _row(found)
    assert "the estimated IoU on known voxels is 0.70, below 0.8" in row.reasons
    assert "the trajectory is not good: 9 mm off" in row.reasons
    assert row.incomplete == ("60% of the solid is unknown",)
    write_triage_page("b", found, build, tmp_path / "index.html")
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert page.count("60% of the solid is unknown") == 1 and "is 0.70, below 0.8" in page
    assert "incomplete: 60%" not in page


@pytest.mark.parametrize(
    ("own", "categories", "stated"),
    [
        ("open", {"chair": {"underside": "closed"}}, ("open", "recording")),
        (None, {"chair": {"underside": "closed"}}, ("closed", "category")),
        (None, {"chair": {}}, ("unseen", None)),
        (None, {}, ("unseen", None)),
    ],
)
def test_whose_word_the_underside_is(
    own: str | None, categories: dict[str, Any], stated: tuple[str, str | None], tmp_path: Path
) -> None:
    made = settings().model_dump(mode="json", exclude_unset=True)
    made["recordings"][0] |= {"category": "chair", "underside": own}
    of = type(settings()).model_validate(made | {"categories": categories})
    row = _row(triage(of, built(tmp_path), [NAME]))
    assert (row.underside, row.underside_by) == stated


def test_the_largest_doubt_comes_first_and_what_failed_says_why(tmp_path: Path) -> None:
    build = built(tmp_path)
    (build / NAMES[1]).mkdir()
    Failed(stage="track", error="no frame has depth").write(build / NAMES[1])
    found = triage(settings(), build, [NAME])
    assert [row.recording for row in found.rows][-1] == NAME
    failed = next(row for row in found.rows if row.recording == NAMES[1])
    assert failed.reasons == ("its build failed at track: no frame has depth",) and not failed.built
    assert found.counts == {"reject": 4, "look": 0, "accept": 1}
    assert TriageFile.parse(found.text(), "triage.json") == found


def test_the_release_says_what_became_of_every_recording(tmp_path: Path) -> None:
    build = tmp_path / "build"
    write_build(build)
    built(build, beyond_share=0.05)
    Failed(stage="segment", error="/home/someone/data: no floor was found").write(build / NAMES[1])
    write_json(build / NAMES[3] / "pairs/pairs.json", {"pairs": [], "refused": []})
    summary = publish(settings(), build, tmp_path / "out", [NAME, NAMES[2], NAMES[3]])
    assert verify(summary.folder) == []
    info = ReleaseInfo.read(summary.folder)
    assert info.flow == Flow(
        tried=5, not_built=1, failed=1, rejected=0, below_limits=0, without_pair=1, of_one_object=0,
        published=2, poor=0, look=1,
    )  # fmt: skip
    # Paths of the machine are not published.
    assert info.left_out is not None and info.left_out[NAMES[1]].endswith("data: no floor was found")
    assert "/home" not in (summary.folder / BENCHMARK_JSON).read_text()
    card = (summary.folder / "README.md").read_text()
    assert "| built | 3 | 2: 1 failed, 1 not built |" in card and "| **published** | 2 |  |" in card
    assert f"- {NAMES[1]} is left out: its build failed at segment" in card
    assert f"- {NAME} is published, and a person should look at it: 5% of the depth" in card
    flow = json.loads(info.text())["flow"]
    forged = info.model_copy(update={"flow": Flow.model_validate(flow | {"tried": 4})})
    assert any("flow has other counts" in line for line in gate_problems(forged))


def test_a_box_against_a_chair_stands_alone_and_the_chair_does_without_it() -> None:
    chair = np.zeros((60, 60, 100), bool)
    for x in (2, 54):
        for y in (2, 54):
            chair[x : x + 4, y : y + 4, :50] = True
    chair[2:58, 2:58, 50:55] = True
    chair[2:58, 2:6, 55:] = True
    assert share_standing_alone(chair) is None
    joined = np.pad(chair, ((0, 60), (0, 0), (0, 0)))
    joined[58:90, 10:50, :52] = True
    share = share_standing_alone(joined)
    assert share is not None and share == pytest.approx(joined[58:90].sum() / joined.sum(), abs=0.05)


def test_a_thin_chair_beside_a_large_box_is_not_lost_in_it() -> None:
    """The chair is 8 % of the solid: less than scraps of a part's corners may be."""
    solid = np.zeros((130, 60, 100), bool)
    for x in (2, 54):
        for y in (2, 54):
            solid[x : x + 4, y : y + 4, :50] = True
    solid[2:58, 2:58, 50:52] = solid[2:58, 2:4, 50:] = True
    chair = solid.sum()
    solid[58:128, 2:58, :70] = True
    share = share_standing_alone(solid)
    assert chair / solid.sum() < 0.1 and share is not None and share > 0.9


def test_a_box_that_shares_a_side_of_a_couch_stands_alone() -> None:
    couch = np.zeros((140, 100, 80), bool)
    couch[10:100, 10:90, :40] = couch[10:100, 10:30] = True
    assert share_standing_alone(couch) is None
    couch[100:124, 78:98, :60] = True  # it shares a strip of twelve cells, and reaches past the corner
    share = share_standing_alone(couch)
    assert share is not None and share < 0.1


@pytest.mark.parametrize("low", [40, 0])
def test_a_thick_part_that_carries_the_rest_is_no_other_thing(low: int) -> None:
    table = np.zeros((100, 60, 60), bool)
    table[2:98, 2:58, 54:58] = True
    table[10:40, 10:50, low:54] = True  # a drawer below the top, or a pedestal beside two legs
    for y in (2, 54):
        table[94:98, y : y + 4, :54] = True
    if low:
        table[2:6, 2:6, :54] = table[2:6, 54:58, :54] = True
    assert share_standing_alone(table) is None
