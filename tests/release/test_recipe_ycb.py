"""Six things in YCB's layout, served as archives: fetched, built, published and verified by commands."""

import io
import tarfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from made_once import made_once
from scan_server import ScanServer
from small_benchmark import Run

from kinectbench.core.store.attempts import PATIENCE_VARIABLE
from kinectbench.settings.file import load_benchmark

pytest.importorskip("h5py", reason="needs kinectbench[ycb]")
from ycb_replica import make_thing

Command = Callable[..., Run]
THINGS = ("chair", "bench", "stool", "crate", "couch", "kennel")
SOURCES = """\
format_version: 1
bases: [{base}]
file: "{{id}}/{{id}}_berkeley_rgbd.tgz"
license: CC-BY-4.0
source: Calli et al. 2015
categories: {{thing: thing}}
sensors: [NP5]
entry: {{segment_by: masks, trajectory: trust}}
scans: [{scans}]
"""
BENCHMARK = """\
name: replica
license: CC-BY-4.0
include: [recordings.yaml]
fusion: {voxel_size_m: 0.01, scene_voxel_size_m: 0.06}
views: {count: 2, min_pixels: 60}
publish: {gate: {min_estimated_iou: 0, max_unknown_share: 1, max_doubts: 100, min_grade: not good}}
"""


def make_things(folder: Path) -> None:
    """Each on a turntable, 24 images of 160 x 120 pixels, with masks and the poses of the turntable."""
    for name in THINGS:
        make_thing(folder, name, f"{name}:seed=0")


def packed(folder: Path) -> bytes:
    content = io.BytesIO()
    with tarfile.open(fileobj=content, mode="w:gz", compresslevel=1) as archive:
        archive.add(folder, folder.name)
    return content.getvalue()


@pytest.fixture
def server(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[ScanServer]:
    made = made_once(tmp_path_factory, "ycb", make_things)
    monkeypatch.setenv(PATIENCE_VARIABLE, "1")
    monkeypatch.setenv("no_proxy", "*")
    files = {f"/{name}/{name}_berkeley_rgbd.tgz": packed(made / name) for name in THINGS}
    with ScanServer(files) as found:
        yield found


@pytest.mark.slow
def test_six_things_on_a_turntable_become_a_benchmark(
    command: Command, server: ScanServer, tmp_path: Path
) -> None:
    recipe = tmp_path / "ycb"
    recipe.mkdir()
    scans = ", ".join(f"{{id: {name}, category: thing}}" for name in THINGS)
    (recipe / "sources.yaml").write_text(SOURCES.format(base=server.url, scans=scans))
    (recipe / "benchmark.yaml").write_text(BENCHMARK)
    server.choose = lambda number, path: "cut" if number in (1, 4) else ""
    done = command(tmp_path, "fetch", "ycb")
    assert done.status == 0 and "6 scans chosen, 6 fetched now, 0 failed" in done.out
    rows = load_benchmark(recipe / "benchmark.yaml").by_id()
    assert set(rows) == {f"{name}_NP5" for name in THINGS}
    assert {(row.segment_by, row.trajectory, row.object_name) for row in rows.values()} == {
        ("masks", "trust", name) for name in THINGS
    }
    for arguments in (("build", "--jobs", "1"), ("publish", "--jobs", "1"), ("verify", "benchmark")):
        done = command(recipe, *arguments)
        assert done.status == 0, done.err
    card = (recipe / "benchmark" / "README.md").read_text()
    assert "Calli et al. 2015" in card and all(f"{name}_NP5" in card for name in THINGS)
