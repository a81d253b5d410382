"""What `fetch` of a recipe says: entries of another licence, scans of another camera, wrong options."""

import io
import tarfile
from collections.abc import Callable
from pathlib import Path

from ingest_writers import CX, FX, write_folder
from scan_server import ScanServer
from small_benchmark import Run
from small_recipe import SOURCES, write_recipe
from test_recipe import server

from kinectbench.settings.file import load_benchmark

__all__ = ["server"]
Command = Callable[..., Run]


def test_a_changed_licence_is_a_line_that_says_what_to_edit(
    command: Command, server: ScanServer, tmp_path: Path
) -> None:
    recipe = write_recipe(tmp_path / "r", server.url)
    command(tmp_path, "fetch", "r", "--category", "table", "--limit", "2")
    sources = recipe / "sources.yaml"
    sources.write_text(sources.read_text().replace("CC0-1.0", "CC-BY-4.0"))
    done = command(tmp_path, "fetch", "r", "--category", "table", "--limit", "3")
    text = " ".join(done.err.split())
    assert done.status == 0 and "recordings.yaml: 2 entries, such as" in text
    assert "state another license or source than sources.yaml" in text and "edit them there" in text
    rows = load_benchmark(recipe / "benchmark.yaml").recordings
    assert sorted(str(row.license) for row in rows) == ["CC-BY-4.0", "CC0-1.0", "CC0-1.0"]


def test_a_camera_that_a_scan_contradicts_is_said(
    command: Command, server: ScanServer, tmp_path: Path
) -> None:
    packed = io.BytesIO()
    scene = write_folder(tmp_path / "scene")
    with tarfile.open(fileobj=packed, mode="w") as archive:
        archive.add(scene, "scene")
    server.files |= {f"/{name}.tgz": packed.getvalue() for name in ("one", "two")}
    scans = "scans: [{{id: one, category: seat}}, {{id: two, category: seat, camera: {{cx: OWN}}}}]"
    scans = scans.replace("OWN", str(CX))
    text = SOURCES.replace("index: {{bases: [{bases}], file: categories.json}}", scans)
    text = text.replace(".zip", ".tgz").replace("131.25, fy: 131.25, cx: 79.5, cy: 59.5", "525")
    write_recipe(tmp_path / "r", server.url, sources=text)
    done = command(tmp_path, "fetch", "r")
    line = " ".join(done.err.split())
    assert done.status == 0 and f"one: the recipe says fx 525, the recording says {FX:g}" in line
    assert "two: the recipe" not in line
    assert "the recipe says" not in command(tmp_path, "fetch", "r").err  # nothing came


def test_an_unknown_category_and_options_of_releases(
    command: Command, server: ScanServer, tmp_path: Path
) -> None:
    write_recipe(tmp_path / "r", server.url)
    assert (
        "--category sofa: the recipe has chair, table"
        in command(tmp_path, "fetch", "r", "--category", "sofa").err
    )
    assert "are of a release" in " ".join(command(tmp_path, "fetch", "r", "--views", "3").err.split())
    (tmp_path / "empty").mkdir()
    assert "no recipe" in " ".join(command(tmp_path, "fetch", "empty", "--stream").err.split())
