"""A benchmark in the folder of its recording, as `record --build` writes it."""

from pathlib import Path

from small_runs import make_small

from kinectbench.engine.parallel import build
from kinectbench.engine.stages import Job
from kinectbench.settings.file import load_benchmark


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
