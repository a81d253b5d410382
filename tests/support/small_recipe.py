"""A recipe of two small scans in Redwood's layout, and the files that a server gives of it."""

import json
from pathlib import Path

from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.spec import SimulationSpec

# The source's words; `sofa` has no scan, and `car` is no category of the benchmark.
INDEX = {"seat": ["00021"], "table": ["00007"], "car": ["00099"]}
SOURCES = """\
format_version: 1
bases: [{bases}]
file: "{{id}}.zip"
license: CC0-1.0
source: "Choi et al. 2016"
index: {{bases: [{bases}], file: categories.json}}
categories: {{seat: chair, table: table}}
camera: {{fx: 131.25, fy: 131.25, cx: 79.5, cy: 59.5}}
split: {{seed: 3, validation: 0.5}}
"""
BENCHMARK = """\
name: replica
license: CC0-1.0
include: [recordings.yaml]
fusion: {voxel_size_m: 0.015, scene_voxel_size_m: 0.03}
views: {count: 3, min_pixels: 100}
publish: {gate: {min_estimated_iou: 0, max_unknown_share: 1, max_doubts: 100}}
"""


def make_scans(folder: Path) -> Path:
    """Simulate both scans, 160 x 120 pixels, 72 frames, without poses; returns `folder`."""
    for family, name in (("chair", "00021"), ("table", "00007")):
        spec = {
            "object": f"{family}:seed=0",
            "format": "redwood_zip",
            "path": {"frames": 72, "rate_hz": 30.0},
            "sensor": {"width": 160, "height": 120},
        }
        simulate(SimulationSpec.model_validate(spec), folder / f"{name}.zip")
    return folder


def served(scans: Path) -> dict[str, bytes]:
    """What a server of the scans gives."""
    found = {f"/{path.name}": path.read_bytes() for path in scans.glob("*.zip")}
    return found | {"/categories.json": json.dumps(INDEX).encode()}


def write_recipe(folder: Path, *bases: str, sources: str = SOURCES) -> Path:
    """Write a recipe of these addresses; returns `folder`."""
    folder.mkdir(parents=True)
    (folder / "benchmark.yaml").write_text(BENCHMARK)
    (folder / "sources.yaml").write_text(sources.format(bases=", ".join(bases)))
    return folder
