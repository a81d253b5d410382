"""Offsets between clocks that are put in by hand: the line that is offered takes them away again."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import pytest
from slow import slow
from small_benchmark import Run
from typed import present
from wrong_recordings import make_wrong, rows_of, write_rows

from kinectbench.core.artefacts.sequence import CameraFile
from kinectbench.doctor import inspect
from kinectbench.doctor.depth import check_intrinsics
from kinectbench.doctor.during_build import OffsetWatch, likely_cause
from kinectbench.doctor.probe import probe_recording
from kinectbench.lab.simulate.presets import preset_spec
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence

CHAIR = Path(__file__).parents[2] / "recordings/chair_01"
LINE = re.compile(r"put `camera: \{(\w+): (-?[\d.]+)\}` into benchmark.yaml")
ONE_WORKER = pytest.mark.xdist_group("orbits")  # else each worker simulates them
# fault -> the setting, its value, how well that can be told (s)
OFFSETS = {
    "colour three frames late": ("color_delay_s", 0.6, 0.001),
    "colour of another clock": ("color_delay_s", 5000.0, 0.001),
    "poses 200 ms late": ("trajectory_delay_s", 0.2, 0.03),
    "poses 150 ms early": ("trajectory_delay_s", -0.15, 0.03),
}


def offered(texts: list[str]) -> list[tuple[str, float]]:
    return [(found[1], float(found[2])) for text in texts for found in LINE.finditer(text)]


def ingested(folder: Path, settings: CameraSettings, to: Path) -> list[tuple[str, float]]:
    recording = open_recording(folder, settings)
    return offered(write_sequence(recording, to, watch=OffsetWatch(recording)))


@pytest.mark.parametrize("name", [slow(name) if name == "poses 150 ms early" else name for name in OFFSETS])
def test_the_line_that_is_offered_takes_it_away(name: str, tmp_path: Path) -> None:
    key, late_s, tolerance_s = OFFSETS[name]
    folder = make_wrong(CHAIR, name, tmp_path / "r")
    ((said, value),) = ingested(folder, CameraSettings(), tmp_path / "first")
    assert said == key and value == pytest.approx(late_s, abs=tolerance_s)
    told = offered([found.advice for found in inspect(folder)[0].findings])
    assert told == [(key, value)]  # the doctor says the same
    corrected = CameraSettings.model_validate({key: value})
    assert ingested(folder, corrected, tmp_path / "second") == []
    left = [found for found in inspect(folder, corrected)[0].findings if found.name != "reader"]
    assert left == []  # the reader warns of frames at an end that now have no colour
    if name == "colour three frames late":
        # Each depth image has got its own colour.
        again, right = (read_sequence(tmp_path / "second"), open_recording(CHAIR))
        for i in range(5, 60):
            assert again.frames.color_encoded(i) == right.frame(i).color


@pytest.mark.parametrize("name", ["colour three frames late", "poses 200 ms late"])
def test_what_is_offered_is_the_whole_delay(name: str, tmp_path: Path) -> None:
    key, late_s, tolerance_s = OFFSETS[name]
    folder = make_wrong(CHAIR, name, tmp_path / "r")
    part = CameraSettings.model_validate({key: 0.2 if key == "color_delay_s" else 0.1})
    ((said, value),) = ingested(folder, part, tmp_path / "first")
    assert said == key and value == pytest.approx(late_s, abs=tolerance_s)


@pytest.mark.parametrize("name", [slow("chair_01"), "table_01.bag"])
def test_nothing_is_offered_for_the_samples(name: str, tmp_path: Path) -> None:
    assert ingested(CHAIR.parent / name, CameraSettings(), tmp_path / "s") == []


def with_swapped_centre(folder: Path, poses: bool) -> Path:
    shutil.copytree(CHAIR, folder)
    camera = json.loads((folder / "camera.json").read_text())
    camera["cx"], camera["cy"] = camera["cy"], camera["cx"]
    (folder / "camera.json").write_text(json.dumps(camera))
    if not poses:
        (folder / "groundtruth.txt").unlink()
    return folder


@pytest.mark.parametrize("poses", [True, False])
def test_implausible_intrinsics_are_doubted(poses: bool, tmp_path: Path) -> None:
    recording = open_recording(with_swapped_centre(tmp_path / "r", poses))
    warnings = write_sequence(recording, tmp_path / "s", watch=OffsetWatch(recording))
    (doubt,) = CameraFile.read(tmp_path / "s").doubts
    assert "the principal point (" in doubt and "if cx and cy are swapped, `camera: {cx: 159.5" in doubt
    assert any(line.endswith(doubt) for line in warnings)
    cause, first = likely_cause(recording)
    assert first == poses and doubt in cause
    stated = OffsetWatch(recording, intrinsics_stated=True)
    assert write_sequence(recording, tmp_path / "t", watch=stated) == warnings
    assert CameraFile.read(tmp_path / "t").doubts == ()  # whoever states them has looked at them
    # No other scale or focal length is advised: it would only hide the fault.
    assert not any(finding.name == "lengths_doubtful" for finding in inspect(recording.path)[0].findings)


def test_poses_that_fit_prove_the_intrinsics(tmp_path: Path) -> None:
    """Images that were cut to their right part have their principal point on the left."""
    shutil.copytree(CHAIR, tmp_path / "r")
    for path in (*(tmp_path / "r/depth").iterdir(), *(tmp_path / "r/rgb").iterdir()):
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(path), present(image)[:, 100:])
    camera = json.loads((tmp_path / "r/camera.json").read_text())
    camera |= {"width": camera["width"] - 100, "cx": camera["cx"] - 100}
    (tmp_path / "r/camera.json").write_text(json.dumps(camera))
    recording = open_recording(tmp_path / "r")
    assert [each.name for each in check_intrinsics(probe_recording(recording))] == ["principal_point"]
    write_sequence(recording, tmp_path / "s", watch=OffsetWatch(recording))
    assert CameraFile.read(tmp_path / "s").doubts == ()


@pytest.fixture(scope="module")
def orbits(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Thirty frames all around an object, at 15 Hz: twelve degrees lie between two."""
    root = tmp_path_factory.mktemp("orbits")
    changes = {"path": {"frames": 30}, "sensor": {"width": 160, "height": 120}}
    for name in ("table:seed=5", "table:seed=2", "couch:seed=1"):
        simulate(preset_spec("orbit-v1", changes | {"object": name}), root / name)
    return {folder.name: folder for folder in root.iterdir()}


@ONE_WORKER
@pytest.mark.parametrize("name", ["table:seed=5", "table:seed=2", slow("couch:seed=1")])
def test_big_steps_are_no_delay(name: str, orbits: dict[str, Path], tmp_path: Path) -> None:
    assert ingested(orbits[name], CameraSettings(), tmp_path / "s") == []


@ONE_WORKER
@pytest.mark.parametrize("frames", [-4, slow(-3), slow(-2), 2, slow(3), slow(4)])
def test_a_delay_is_found_in_big_steps(frames: int, orbits: dict[str, Path], tmp_path: Path) -> None:
    folder = shutil.copytree(orbits["table:seed=2"], tmp_path / "r")
    rows = rows_of(folder, "rgb")
    shown = [(row[0], rows[i - frames][1]) for i, row in enumerate(rows) if 0 <= i - frames < len(rows)]
    write_rows(folder, "rgb", [list(row) for row in shown])
    ((key, value),) = ingested(folder, CameraSettings(), tmp_path / "s")
    assert key == "color_delay_s" and value == pytest.approx(frames / 15, abs=0.001)


@ONE_WORKER
def test_chance_is_no_delay(orbits: dict[str, Path], tmp_path: Path) -> None:
    """Colour of another recording, whose motion is by chance much like that of the depth."""
    folder = shutil.copytree(orbits["couch:seed=1"], tmp_path / "r")
    shutil.copytree(orbits["table:seed=5"] / "rgb", folder / "rgb", dirs_exist_ok=True)
    assert ingested(folder, CameraSettings(), tmp_path / "s") == []


def test_ingest_tells_it(command: Callable[..., Run], tmp_path: Path) -> None:
    make_wrong(CHAIR, "poses 200 ms late", tmp_path / "r")
    row = "name: x\nrecordings:\n  - {id: a, path: r, category: chair"
    (tmp_path / "benchmark.yaml").write_text(row + "}\n")
    ((key, value),) = offered([command(tmp_path, "ingest", "--jobs", "1").err])
    (tmp_path / "benchmark.yaml").write_text(f"{row}, camera: {{{key}: {value}}}}}\n")
    corrected = command(tmp_path, "ingest", "--jobs", "1")
    assert corrected.status == 0 and corrected.err == ""
    # Nobody who ignores the poses has to be told.
    (tmp_path / "benchmark.yaml").write_text(row + ", trajectory: ignore}\n")
    assert offered([command(tmp_path, "ingest", "--force", "--jobs", "1").err]) == []
