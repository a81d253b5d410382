"""The guide beside a recording: in a process of its own, late without harm, and gone without harm."""

import json
import os
import signal
import struct
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Any
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from headless import Browser, find_chromium
from made_once import made_once
from numpy.typing import NDArray
from raising import raises
from small_benchmark import Run
from written_frames import read

from kinectbench.core.errors import SettingsError, StorageError
from kinectbench.core.geometry import invert_rigid, transform_points
from kinectbench.core.geometry.depth import TERMS, DepthCalibration
from kinectbench.core.geometry.rigid import rigid_from_twist
from kinectbench.core.trajectory.compare import compare_poses
from kinectbench.core.trajectory.trajectory_file import read_trajectory_file
from kinectbench.core.types import Float64
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.lab.simulate.truth import truth_folder
from kinectbench.record.devices.replay import Replay
from kinectbench.record.guide import looking
from kinectbench.record.guide.guide import FLOOR_THERE, NOTHING_THERE, Guide
from kinectbench.record.guide.process import NO_CLICK, GuideProcess
from kinectbench.record.guide.tracker import NEWEST, LiveFrames, LiveTracker
from kinectbench.record.interface import Frame, Setup
from kinectbench.record.recorder import record
from kinectbench.settings.models import TrackingSettings
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence
from kinectbench.stages.track import track
from kinectbench.stages.track.frame_maps import MapCache, stored_depth
from kinectbench.stages.track.keyframe_graph import KeyframeGraph

# Pixels of the ring that were seen.
PAINTED = """(() => {
  const c = document.getElementById("above"), pen = c.getContext("2d");
  const d = pen.getImageData(0, 0, c.width, c.height).data;
  let n = 0;
  for (let i = 0; i < d.length; i += 4) n += d[i + 3] > 200 && d[i + 2] > d[i] + 60;
  return n;
})()"""
PICTURE = "document.getElementById('picture')"
FRAMES = 60
RISE = np.outer(np.eye(4)[2], np.eye(4)[3])  # times metres, added to a pose: it is so much higher
# A third of the way around in four seconds.
SLOWLY = {"frames": FRAMES, "rate_hz": 15.0, "arc_rad": 2.0}


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A chair of 60 frames, a third of the way around it."""

    def make(to: Path) -> None:
        spec = SimulationSpec.model_validate(
            {"object": "chair:seed=3", "sensor": {"width": 320, "height": 240}, "path": SLOWLY}
        )
        simulate(spec, to / "chair")

    return made_once(tmp_path_factory, "guided", make) / "chair"


@pytest.fixture
def guide() -> Iterator[GuideProcess]:
    made = GuideProcess()
    yield made
    made.close()


def fetched(url: str) -> bytes:
    with urllib.request.urlopen(url, timeout=20) as answer:
        return bytes(answer.read())


def replayed(source: Path) -> tuple[Setup, list[Frame]]:
    replay = Replay(source, 1000.0)
    setup = replay.open()
    frames = [Frame(raw.stamp_ns, raw.depth, raw.color) for raw in read(open_recording(source))]
    replay.close()
    return setup, frames


def test_the_camera_is_followed_lost_and_found_again(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Poses are those of the truth within 15 mm; a covered lens is lost; the same place is found again.

    The page is given no more triangles than it can draw.
    """
    monkeypatch.setattr(looking, "SHOWN_TRIANGLES", 900)
    setup, frames = replayed(source)
    guide = Guide(setup, beside=False)
    said = [guide.take(number, each) for number, each in enumerate(frames)]
    assert not any(each.lost for each in said) and said[-1].looks > 0
    truth = np.loadtxt(truth_folder(source) / "trajectory.txt")[:, 1:4]
    moved = guide.tracker.poses()[1][:, :3, 3]
    for first, last in ((0, FRAMES - 1), (10, 40)):
        walked_m = np.linalg.norm(truth[last] - truth[first])
        assert abs(np.linalg.norm(moved[last] - moved[first]) - walked_m) < 0.015
    assert guide.seen is not None and guide.seen.box.size_m[2] == pytest.approx(0.85, abs=0.06)
    assert 500 < len(guide.seen.mesh.faces) <= 900
    # So long that the last frame before is old, and is what the next ones are compared with.
    dark = [later(each, 1 + k, covered=True) for k, each in enumerate(frames[-20:])]
    assert all(guide.take(FRAMES + k, each).lost for k, each in enumerate(dark))
    # Elsewhere on the way a segment begins, which the next graph of the keyframes joins.
    again = [guide.take(FRAMES + 20 + k, later(frames[20 + k], 60)) for k in range(4)]
    assert again[0].lost and not again[-1].lost
    assert np.linalg.norm(guide.tracker.poses()[1][-1, :3, 3] - moved[23]) < 0.01


def test_a_click_on_the_floor_is_refused_in_a_sentence(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Once the floor is known; before, and where a thing stands, a click is taken."""
    setup, frames = replayed(source)
    guide = Guide(setup, beside=False)
    pixels = dict(zip(("floor", "chair"), pixels_of_floor_and_chair(source, frames[-1], setup), strict=True))
    guide.take(0, frames[0])
    assert guide.pick(frames[0], (160, 120)) == ""
    for number, each in enumerate(frames[1:], 1):
        guide.take(number, each)
    assert guide.pick(frames[-1], pixels["floor"]) == FLOOR_THERE
    assert guide.pick(frames[-1], pixels["chair"]) == ""
    before, seen = guide._picked, guide.seen
    with pytest.raises(StorageError):
        guide.pick(frames[-2], pixels["chair"], Mock(side_effect=StorageError("full")))
    assert guide._picked is before and seen is not None
    # Where a table was taken for the floor, what lies below it is no floor.
    for rise_m, why in ((0.012, FLOOR_THERE), (0.03, ""), (-0.3, ""), (0, FLOOR_THERE)):
        guide.seen = replace(seen, T_floor_world=seen.T_floor_world + rise_m * RISE)
        assert guide.pick(frames[-1], pixels["floor"]) == why
    dark = later(frames[-1], 1, covered=True)
    guide.take(FRAMES, dark)
    assert guide.pick(dark, pixels["chair"]) == NOTHING_THERE
    assert clicked_while_the_world_moves(guide, frames[-1], pixels["floor"], monkeypatch) == [FLOOR_THERE]


def clicked_while_the_world_moves(
    guide: Guide, frame: Frame, pixel: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> list[str]:
    """The answer to a click of another thread, between the poses and the floor that move."""
    go_on_from, answers = guide.tracker.go_on_from, list[str]()
    clicking = Thread(target=lambda: answers.append(guide.pick(frame, pixel)))

    def go_on_slowly(graph: KeyframeGraph) -> Float64 | None:
        T_graph_before = go_on_from(graph)
        clicking.start()
        clicking.join(0.5)
        return T_graph_before

    monkeypatch.setattr(guide.tracker, "go_on_from", go_on_slowly)
    placed, T_moved = guide.tracker.so_far().graph(), rigid_from_twist(np.full(6, 0.5))
    guide._look = Future()
    guide._look.set_result((replace(placed, T_world=T_moved @ placed.T_world), None))
    guide._look_again(-np.inf)
    clicking.join()
    return answers


def test_of_near_things_less_height_is_floor(source: Path) -> None:
    """Where the same frames show a third of all lengths, the floor ends lower, as it does for `segment`."""
    setup, frames = replayed(source)
    pixel, _ = pixels_of_floor_and_chair(source, frames[-1], setup)
    guide = Guide(replace(setup, depth_scale=3 * setup.depth_scale), beside=False)
    for number, each in enumerate(frames):
        guide.take(number, each)
    assert guide.seen is not None and 0.006 <= guide.seen.floor_cut_m < 0.015
    assert guide.pick(frames[-1], pixel) == FLOOR_THERE
    guide.seen = replace(guide.seen, T_floor_world=guide.seen.T_floor_world + 0.018 * RISE)
    assert guide.pick(frames[-1], pixel) == ""


def pixels_of_floor_and_chair(source: Path, frame: Frame, setup: Setup) -> list[tuple[int, int]]:
    """A pixel on the floor, and one on the chair, of the last frame, by the true poses."""
    given, _ = read_trajectory_file(truth_folder(source) / "trajectory.txt")
    rows, columns = np.nonzero(frame.depth)
    depth_m = frame.depth[rows, columns] / setup.depth_scale
    points = setup.camera.rays_at(columns, rows) * depth_m[:, None]
    x, y, z = transform_points(given.T_world_camera[-1], points).T
    near = np.hypot(x, y) < 1.0
    chosen = [np.flatnonzero(near & (abs(z) < 0.005)), np.flatnonzero(near & (z > 0.2))]
    return [(int(columns[each[len(each) // 2]]), int(rows[each[len(each) // 2]])) for each in chosen]


def test_the_keyframes_are_placed_as_a_build_places_them(source: Path, tmp_path: Path) -> None:
    """Poses are near those of a build, nearer than at first; what came meanwhile goes with its keyframe."""
    setup, frames = replayed(source)
    tracker = LiveTracker(setup)
    for each in frames[:50]:
        tracker.take(each)
    known = tracker.so_far()
    for each in frames[50:]:
        tracker.take(each)
    before = tracker.poses()[1]
    tracker.go_on_from(known.graph())
    _, after = tracker.poses()
    write_sequence(open_recording(source), tmp_path)
    built = track(read_sequence(tmp_path), "ignore", TrackingSettings())
    first, last = (compare_poses(some, built.T_world_camera).ate_m.rmse for some in (before, after))
    assert last < min(first, 0.001), (first, last)  # measured: .97 and .81 mm
    steps = [invert_rigid(some[-2]) @ some[-1] for some in (before, after)]
    assert np.allclose(steps[0], steps[1], rtol=0, atol=1e-9)
    correction = known.maps.correction_per_m
    assert correction is not None and not built.depth_calibration.is_none
    theirs = built.depth_calibration.correction_per_m(320, 240)
    assert np.corrcoef(correction.ravel(), theirs.ravel())[0, 1] > 0.8


@pytest.mark.parametrize("rate_hz", [1, 30])
def test_no_frame_is_read_twice_and_old_ones_are_forgotten(
    source: Path, rate_hz: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two seconds, of seven frames at least, and of the keyframes the maps are kept."""
    setup, frames = replayed(source)
    asked: list[int] = []
    depth_native = LiveFrames.depth_native

    def noted_depth(self: LiveFrames, index: int) -> NDArray[np.uint16]:
        asked.append(index)
        return depth_native(self, index)

    monkeypatch.setattr(LiveFrames, "depth_native", noted_depth)
    monkeypatch.setattr("kinectbench.stages.track.frame_maps.READ_FRAMES", 2)
    tracker, count, kept = LiveTracker(setup), 70, max(NEWEST, 2 * rate_hz + 1)
    for index, each in enumerate([*frames, *frames[::-1]][:count]):
        tracker.take(replace(each, stamp_ns=index * 10**9 // rate_hz))
    assert asked == list(range(count)) and len(tracker.keyframes) > 2
    assert set(tracker.so_far().maps._read) == {*tracker.keyframes, *range(count - kept, count)}


def test_what_was_seen_stays_where_it_is_when_the_world_moves(source: Path) -> None:
    """A look that saw too little moves the poses; the last look moves with them, or ends with its world."""
    setup, frames = replayed(source)
    guide = Guide(setup, beside=False)
    for number, each in enumerate(frames):
        guide.take(number, each)
    assert guide.seen is not None
    before = guide.seen.T_floor_world @ guide.tracker.poses()[1]
    placed, T_moved = guide.tracker.so_far().graph(), rigid_from_twist(np.full(6, 0.5))
    T_keyframes = guide.tracker.poses(guide.tracker.keyframes)[1]
    guide._take_look(replace(placed, T_world=T_moved @ T_keyframes), None)
    assert guide.seen is not None
    after = guide.seen.T_floor_world @ guide.tracker.poses()[1]
    assert np.allclose(after, before, rtol=0, atol=1e-6)
    guide._take_look(replace(placed, joined=frozenset({1})), None)
    assert guide.seen is None and guide.shown()["path"] == []


def test_averaged_depth_is_corrected_once(source: Path, tmp_path: Path) -> None:
    """What `improve` is given of calibrated depth is given back, within a tenth of a millimetre."""
    write_sequence(open_recording(source), tmp_path)
    maps = MapCache(read_sequence(tmp_path))
    maps.calibrate(DepthCalibration(np.full(len(TERMS), 0.003)))
    depth_m = maps[3][0].depth_m
    maps.improve(3, stored_depth(depth_m))
    assert np.abs(maps[3][0].depth_m - depth_m).max() < 2e-4


def later(frame: Frame, seconds: int, *, covered: bool = False) -> Frame:
    """The same frame some seconds later; with the hand on the lens."""
    depth = np.zeros_like(frame.depth) if covered else frame.depth
    return Frame(frame.stamp_ns + seconds * 10**9, depth, frame.color)


def test_the_page_shows_what_was_seen(guide: GuideProcess, source: Path) -> None:
    setup, frames = replayed(source)
    assert fetched(guide.url + "state") == b""
    looks, number = 0, 0
    while not looks and number < 40 * FRAMES:
        # The look comes from a thread of its own: the last frame goes on until it is there.
        frame = frames[min(number, FRAMES - 1)]
        guide.see(number, later(frame, max(0, number - FRAMES + 1)), setup)
        number += 1
        looks = json.loads(fetched(guide.url + "state"))["looks"]
    state, mesh = json.loads(fetched(guide.url + "state")), fetched(guide.url + "mesh")
    assert state["sentence"] == guide.sentence != "" and not state["lost"]
    assert len(state["ring"]) == 12 and np.any(state["ring"]) and state["path"] and state["box"]
    points, faces = struct.unpack("<II", mesh[:8])
    assert points > 1000 and len(mesh) == 8 + 12 * points + 12 * faces
    assert fetched(f"{guide.url}picture?{state['picture']}")[:2] == b"\xff\xd8"
    assert [fetched(f"{guide.url}picture{other}") for other in ("", "?-1", "?999999", "?x")] == [b""] * 4
    assert fetched(guide.url + "picked") == b""
    assert [said.number for said in guide.said] == list(range(number))


def test_a_click_says_what_the_object_is(source: Path, tmp_path: Path) -> None:
    """The pixel is written beside the frames; a click on nothing, or on an old picture, changes nothing."""
    setup, frames = replayed(source)
    guide = GuideProcess(folder=tmp_path)
    try:
        for number in range(3):
            guide.see(number, frames[number], setup)
        number = json.loads(fetched(guide.url + "state"))["picture"]
        assert told(guide, picture=number, x=0.5, y=0.5) == (204, "")
        picked = {"frame": number, "pixel": [160, 120]}
        assert json.loads((tmp_path / "pick.json").read_text()) == picked
        assert json.loads(fetched(guide.url + "state"))["picked"] == picked
        # What was picked is shown, with a ring; the picture of a number is that frame, whatever came since.
        shown, plain = (pixels(fetched(guide.url + name)) for name in ("picked", f"picture?{number}"))
        guide.see(3, frames[3], setup)
        fetched(guide.url + "state")
        assert np.array_equal(pixels(fetched(f"{guide.url}picture?{number}")), plain)
        assert not np.array_equal(pixels(fetched(f"{guide.url}picture?3")), plain)
        changed = np.abs(shown.astype(int) - plain).max(axis=2) > 60
        rows, columns = np.nonzero(changed)
        assert changed.sum() > 100 and np.hypot(columns - 160, rows - 120).max() < 20
        wrong: dict[str, Any]
        for wrong in ({"picture": number + 5}, {"picture": number, "x": 1.5, "y": 0.5}, {"x": []}):
            assert told(guide, **wrong) == (422, NO_CLICK)
        assert told(guide, body=b"[" * 1000) == (422, NO_CLICK)
        assert json.loads((tmp_path / "pick.json").read_text()) == picked
        (tmp_path / "pick.json").unlink()
        (tmp_path / "pick.json").mkdir()
        status, why = told(guide, picture=number, x=0.6, y=0.5)
        assert status == 422 and why.startswith("it is not kept: ")
        assert json.loads(fetched(guide.url + "state"))["picked"] == picked
    finally:
        guide.close()


def pixels(jpeg: bytes) -> NDArray[np.uint8]:
    return np.asarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR), np.uint8)


def told(guide: GuideProcess, body: bytes = b"", **click: object) -> tuple[int, str]:
    """The status of a click that is told to the page, and the sentence."""
    origin = guide.url.rsplit("/", 2)[0]
    request = urllib.request.Request(
        guide.url + "pick", body or json.dumps(click).encode(), {"Origin": origin}
    )
    try:
        with urllib.request.urlopen(request, timeout=20) as answer:
            return int(answer.status), answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


@pytest.mark.skipif(find_chromium() is None, reason="no chromium")
def test_the_page_draws_the_object_and_obeys_its_policy(
    guide: GuideProcess, source: Path, tmp_path: Path
) -> None:
    """The sentence, the ring and the object are drawn; nothing is loaded from elsewhere, nothing refused."""
    setup, frames = replayed(source)
    with Browser(tmp_path / "profile") as browser:
        browser.window(1280, 800)
        browser.go(guide.url)
        number = 0
        while not browser.evaluate("window.guideFaces > 1000") and number < 40 * FRAMES:
            frame = frames[min(number, FRAMES - 1)]
            guide.see(number, later(frame, max(0, number - FRAMES + 1)), setup)
            number += 1
        said = json.dumps(guide.sentence)
        browser.wait_for(f"document.getElementById('sentence').textContent === {said}")
        assert browser.evaluate(PAINTED) > 1000
        box = browser.evaluate(f"JSON.parse(JSON.stringify({PICTURE}.getBoundingClientRect()))")
        browser.drag(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2, 0, 0)
        browser.wait_for("document.getElementById('answer').className === 'picked'")
        browser.wait_for("document.getElementById('picked').naturalWidth > 0")
        assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth")
        # The software renderer says that it is slow to be read back.
        assert [text for text in browser.complaints() if "GPU stall" not in text] == []
        assert all(url.startswith(guide.url) for url in browser.requested())


def test_a_guide_that_dies_costs_no_frame(guide: GuideProcess, source: Path, tmp_path: Path) -> None:
    assert guide.pid is not None
    os.kill(guide.pid, signal.SIGKILL)
    done = record(Replay(source), tmp_path / "out", observers=[guide])
    assert (done.frames, done.missed, done.dropped, done.failure) == (FRAMES, 0, 0, "")
    assert done.observers == ("the guide's process ended; the recording goes on",)


def test_the_command_names_the_page(command: Callable[..., Run], source: Path, tmp_path: Path) -> None:
    """--json --build is refused before anything is written; --guide names the page on standard error."""
    given = ("--from", str(source), "--speed", "4", "--guide")
    assert command(tmp_path, "record", "out", *given, "--build", "--json").status == 2
    assert not (tmp_path / "out").exists()
    run = command(tmp_path, "record", "out", *given, "--json")
    assert run.status == 0 and json.loads(run.out)["frames"] > 0
    assert "guide: open http://127.0.0.1:" in run.err


def test_a_port_of_another_is_refused(guide: GuideProcess) -> None:
    with raises(SettingsError, "settings.wrong-value", "--port"):
        GuideProcess(int(guide.url.split(":")[2].split("/")[0]))
