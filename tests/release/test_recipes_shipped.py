"""The recipes of this repository, and the template for a lab's own, as far as no network is needed."""

import re
from pathlib import Path

import pytest
import yaml

from kinectbench.release.recipe import RECORDINGS, Recipe
from kinectbench.settings.file import load_benchmark
from kinectbench.settings.sources import SourcesSettings, chosen_scans, read_sources

RECIPES = Path(__file__).parents[2] / "recipes"
NAMES = sorted(path.parent.name for path in RECIPES.glob("*/sources.yaml"))
# As the first of each category of the data set's own list.
LISTED = {"bench": ["00188"], "chair": ["00021"], "sofa": ["00577"], "table": ["00288"], "car": ["01833"]}


def opened(folder: Path, out: Path, sources: SourcesSettings) -> Recipe:
    return Recipe(folder, out, sources, lambda path: True, {})


def test_there_are_recipes() -> None:
    assert {"redwood-furniture", "tum-objects", "ycb"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_a_recipe_gives_a_benchmark(name: str, tmp_path: Path) -> None:
    sources = read_sources(RECIPES / name)
    scans = chosen_scans(sources, LISTED)
    opened(RECIPES / name, tmp_path, sources).add_to_benchmark(scans)
    rows = load_benchmark(tmp_path / "benchmark.yaml").recordings
    assert [row.id for row in rows] == [scan.id for scan in scans] and len(rows) >= 4
    assert {row.split for row in rows} == {"test"}
    assert all(row.license == sources.license and row.source == sources.source for row in rows)
    text = (RECIPES / name / "README.md").read_text()
    assert sources.license.lower().replace("-", " ") in text.lower().replace("-", " ")
    assert f"kinectbench fetch recipes/{name}" in text and name in (RECIPES / "README.md").read_text()


def test_sofas_are_couches_and_cars_are_left_out() -> None:
    scans = chosen_scans(read_sources(RECIPES / "redwood-furniture"), LISTED)
    assert {(scan.id, scan.category) for scan in scans} >= {("00577", "couch"), ("00188", "bench")}
    assert "01833" not in {scan.id for scan in scans}


def test_each_tum_sequence_has_the_intrinsics_of_its_camera() -> None:
    scans = chosen_scans(read_sources(RECIPES / "tum-objects"), {})
    focal = {(scan.id.split("_")[0], scan.camera.fx if scan.camera else None) for scan in scans}
    assert focal == {("freiburg1", 517.3), ("freiburg2", 520.9), ("freiburg3", 535.4)}
    assert all(scan.file == f"{scan.id.split('_')[0]}/rgbd_dataset_{scan.id}.tgz" for scan in scans)


def test_a_thing_before_five_cameras_is_one_file_and_five_recordings() -> None:
    scans = chosen_scans(read_sources(RECIPES / "ycb"), {}, ("bottle",), limit=1)
    assert len(scans) == 5 and len({(scan.scan, scan.file, scan.object, scan.folder) for scan in scans}) == 1
    assert {scan.camera.sensor for scan in scans if scan.camera} == {f"NP{n}" for n in range(1, 6)}
    assert len({scan.id for scan in scans}) == 5


def test_the_template_for_a_lab_is_a_recipe(tmp_path: Path) -> None:
    sources, benchmark = re.findall(r"```yaml\n(.*?)```", (RECIPES / "README.md").read_text(), re.DOTALL)
    (tmp_path / "sources.yaml").write_text(sources)
    (tmp_path / "benchmark.yaml").write_text(benchmark)
    read = read_sources(tmp_path)
    scans = chosen_scans(read, {})
    opened(tmp_path, tmp_path, read).add_to_benchmark(scans)
    rows = load_benchmark(tmp_path / "benchmark.yaml").by_id()
    assert rows["chair_01"].split == rows["chair_01_again"].split and rows["sofa_01"].path == "scans/sofa_01"


def test_a_benchmark_that_does_not_include_the_scans_is_told(tmp_path: Path) -> None:
    sources = read_sources(RECIPES / "tum-objects")
    row = {"id": "own", "path": "own", "category": "chair"}
    (tmp_path / "benchmark.yaml").write_text(yaml.safe_dump({"name": "x", "recordings": [row]}))
    with pytest.raises(Exception, match=rf"add `include: \[{RECORDINGS}\]` to it"):
        Recipe(RECIPES / "tum-objects", tmp_path, sources, lambda path: True, {}).add_to_benchmark(
            chosen_scans(sources, {})
        )
