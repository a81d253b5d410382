"""`ingest` goes on from the frames that were stored while one records, and writes the same bytes."""

import json
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from growing_folder import FRAMES, all_taken, contents, recorded_once
from small_runs import make_small
from typed import noted

from kinectbench.engine.parallel import build
from kinectbench.engine.stages import Job
from kinectbench.record.build_process import MAY_CHANGE
from kinectbench.settings.file import load_benchmark
from kinectbench.stages.ingest import sequence_writer
from kinectbench.stages.ingest.images import decode_depth_png, encode_png
from kinectbench.stages.ingest.partial_sequence import (
    PartialSequence,
    using_partial_sequence,
)
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import FileRecording, RawFrame
from kinectbench.stages.ingest.sequence_folder import write_sequence
from kinectbench.stages.track.partial_odometry import (
    PartialOdometry,
    using_partial_odometry,
)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`out`, 16 frames of a chair, and `sequence`, what `ingest` makes of it."""
    return recorded_once(tmp_path_factory)


@pytest.mark.parametrize("whole", [False, True])
def test_ingest_goes_on_with_the_same_bytes(
    recorded: Path, whole: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was stored is not read again; of one frame depth is empty, which the warnings count."""
    shutil.copytree(recorded / "out", tmp_path / "out")
    empty = sorted((tmp_path / "out/depth").iterdir())[3]
    empty.write_bytes(encode_png(np.zeros_like(decode_depth_png(empty.read_bytes(), ""))))
    source = open_recording(tmp_path / "out")
    write_sequence(source, tmp_path / "alone")
    growing = all_taken(tmp_path / "out", tmp_path / "stored", whole=whole)
    partial: PartialSequence = pickle.loads(pickle.dumps(growing.sequence()))
    read, frame = list[int](), FileRecording.frame

    def noted_frame(recording: FileRecording, index: int) -> RawFrame:
        read.append(index)
        return frame(recording, index)

    monkeypatch.setattr(FileRecording, "frame", noted_frame)
    warnings = write_sequence(source, tmp_path / "sequence", partial=partial)
    assert read == list(range(FRAMES - (0 if whole else MAY_CHANGE), FRAMES))
    assert any("1 depth images are empty" in line for line in warnings)
    assert contents(tmp_path / "sequence") == contents(tmp_path / "alone")


class EverySecond:
    """A watch that wants every second frame."""

    def __init__(self) -> None:
        self.seen: list[tuple[int, int]] = []

    def wants(self, index: int) -> bool:
        return index % 2 == 0

    def see(self, index: int, frame: RawFrame) -> None:
        self.seen += [(index, frame.stamp_ns)] if self.wants(index) else []

    def warnings(self) -> list[str]:
        return []

    def camera_faults(self) -> list[str]:
        return []


def test_a_watch_is_shown_what_it_wants_of_stored_frames(recorded: Path, tmp_path: Path) -> None:
    """In the same order, as if nothing had been stored before."""
    partial, alone = all_taken(recorded / "out", tmp_path / "stored", whole=False).sequence(), EverySecond()
    write_sequence(open_recording(recorded / "out"), tmp_path / "alone", watch=alone)
    after = EverySecond()
    write_sequence(open_recording(recorded / "out"), tmp_path / "sequence", watch=after, partial=partial)
    assert after.seen == alone.seen and len(alone.seen) == FRAMES // 2


@pytest.mark.parametrize("change", ["pixels", "scale", "gone"])
def test_what_was_stored_of_other_files_is_not_used(recorded: Path, tmp_path: Path, change: str) -> None:
    """A file was written again, the unit of depth differs, or what was stored is gone: all is read."""
    out = tmp_path / "out"
    shutil.copytree(recorded / "out", out)
    partial = all_taken(out, tmp_path / "stored", whole=True).sequence()
    if change == "pixels":
        first, second = sorted((out / "depth").iterdir())[:2]
        shutil.copyfile(second, first)
    elif change == "scale":
        said = json.loads((out / "camera.json").read_text())
        (out / "camera.json").write_text(json.dumps({**said, "depth_scale": said["depth_scale"] / 2}))
    else:
        shutil.rmtree(tmp_path / "stored")
    write_sequence(open_recording(out), tmp_path / "sequence", partial=partial)
    write_sequence(open_recording(out), tmp_path / "alone")
    assert contents(tmp_path / "sequence") == contents(tmp_path / "alone")


def test_a_build_goes_on_from_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The stages ask for it, and their files are the same bytes as without."""
    root = make_small(tmp_path, ("chair",))
    file = root / "benchmark.yaml"
    file.write_text(file.read_text().replace("category: chair}", "category: chair, trajectory: ignore}"))
    settings = load_benchmark(file)
    job = Job(settings, settings.recordings[0], root)
    growing, asked = all_taken(root / "recordings/chair", tmp_path / "stored", whole=True), list[str]()

    def sequence() -> PartialSequence | None:
        asked.append("sequence")
        return growing.sequence()

    def odometry() -> PartialOdometry | None:
        asked.append("odometry")
        return growing.odometry()

    written = list[object]()
    monkeypatch.setattr(sequence_writer, "_write_packed", noted(sequence_writer._write_packed, written))
    with using_partial_sequence(sequence), using_partial_odometry(odometry):
        assert build([job], "track")[0].error is None
    assert asked == ["sequence", "odometry"] and not written
    begun = contents(job.build)
    assert build([job], "track", ("ingest", "track"))[0].error is None and len(written) == FRAMES
    assert asked == ["sequence", "odometry"] and len(begun) > 2 * FRAMES and contents(job.build) == begun
