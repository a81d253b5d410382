"""A benchmark in the folder of its recording, as `record --build` writes it."""

from pathlib import Path

import pytest
from small_runs import make_small

from kinectbench.engine.parallel import build
from kinectbench.engine.stages import STAGES, Job
from kinectbench.settings.file import load_benchmark
from kinectbench.settings.models import BenchmarkSettings


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_small(tmp_path_factory.mktemp("own"), ("chair",)) / "recordings/chair"


@pytest.mark.parametrize("path", [".", "chair"])
@pytest.mark.parametrize(
    ("named", "file", "is_apart"),
    [
        ({"masks": "drawn"}, "drawn/frame_000001.png", True),
        ({"masks": "./drawn/"}, "drawn/masks.json", True),
        ({"masks": "drawn"}, "drawn/notes.txt", False),
        ({"masks": "drawn"}, "other/frame_000001.png", False),
        ({"masks": "masks"}, "masks/masks.json", True),
        ({"masks": "masks"}, "masks/000001.png", False),  # ingest reads masks/ and depth/, too
        ({"masks": "depth"}, "depth/000099.png", False),
        ({"masks": "depth"}, "depth/masks.json", True),
        ({"masks": "."}, "frame_000001.png", True),
        ({"masks": "."}, "camera.json", False),
        ({"reference": "cad.ply"}, "cad.ply", True),
        ({"reference": "./meshes/cad.ply"}, "meshes/cad.ply", True),
        ({}, "cad.ply", False),
    ],
)
def test_named_masks_and_meshes_are_no_part_of_the_recording(
    own: Path, named: dict[str, str], file: str, is_apart: bool, path: str
) -> None:
    root = own if path == "." else own.parent
    inside = {key: f"{path}/{name}" for key, name in named.items()}
    recording = {"id": "chair", "path": path, "category": "chair", **inside}
    settings = BenchmarkSettings.model_validate({"name": "own", "recordings": [recording]})

    def source() -> str:
        return STAGES[0].sources(Job(settings, settings.recordings[0], root))["recording"].sha256

    before, changed = source(), own / file
    text = changed.read_bytes() if changed.exists() else None
    changed.parent.mkdir(exist_ok=True)
    changed.write_bytes((text or b"") + b"\n")
    assert (source() == before) == is_apart
    changed.write_bytes(text) if text else changed.unlink()


def test_what_the_benchmark_keeps_there_is_no_part_of_the_recording(tmp_path: Path) -> None:
    """What commands write there leaves `ingest` current, and so do settings; a changed image does not."""
    root = make_small(tmp_path, ("chair",)) / "recordings/chair"
    file = root / "benchmark.yaml"
    file.write_text("name: own\nrecordings: [{id: chair, path: ., category: chair, trajectory: ignore}]\n")
    settings = load_benchmark(file)
    job = Job(settings, settings.recordings[0], root)
    assert build([job], "ingest")[0].made == ("ingest",)
    file.write_text(file.read_text() + "license: CC0-1.0\n")
    results = ("scores/nearest.json", "evaluation/chair/index.html", "benchmark-private/benchmark.json")
    for name in ("masks/chair/000.png", *results, "own-1.0.zip", "own-1.0.zip.sha256"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(b"something")
    assert build([job], "ingest")[0].current == ("ingest",)
    image = min((root / "depth").iterdir())
    image.write_bytes(image.read_bytes() + b" ")
    assert build([job], "ingest")[0].made == ("ingest",)
