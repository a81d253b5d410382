"""Figures of a release that no measurement gives, with all hashes made again."""

import json
import shutil
from pathlib import Path

import pytest
from file_damage import seal

from kinectbench.release.check.verify import verify

VIEWS, FLOOR, LINEAGE = "views/chair_01/views.json", "objects/chair_01/floor.json", "lineage.json"
SHARE, LEAST = "must be a share from 0 to 1", "must not be negative"
# {file: ((path of the key, a value, what is wrong with it), …)}.
IMPOSSIBLE: dict[str, tuple[tuple[tuple[str | int, ...], object, str], ...]] = {
    VIEWS: (
        (("views", 0, "containment"), 1.5, SHARE),
        (("views", 0, "visible_share"), -0.1, SHARE),
        (("views", 0, "pixels"), -3, LEAST),
        (("views", 0, "residual_m"), -0.1, LEAST),
    ),
    FLOOR: ((("noise_m",), -0.001, LEAST), (("inlier_share",), 7.0, SHARE)),
    LINEAGE: ((("recordings", "chair_01", "views", 0, "frame"), -5, LEAST),),
    "benchmark.json": (
        (("recordings", "chair_01", "quality", "estimated_known_iou"), 7.0, SHARE),
        (("recordings", "chair_01", "quality", "volume_m3"), -4.0, LEAST),
        (("recordings", "chair_01", "refused"), -1, LEAST),
        (("settings", "pairs", "min_containment"), -1.0, SHARE),
    ),
    "objects/chair_01/quality.json": (
        (("unknown_share",), -0.2, SHARE),
        (("good_frames",), -3, LEAST),
        (("box",), {"center_m": [0, 0, 0], "size_m": [-1, 0, 1], "yaw_rad": 0}, LEAST),
    ),
}


@pytest.mark.parametrize("file", IMPOSSIBLE)
def test_figures_that_nothing_measures(analytic: Path, tmp_path: Path, file: str) -> None:
    for number, (path, value, why) in enumerate(IMPOSSIBLE[file]):
        folder = Path(shutil.copytree(analytic / "benchmark", tmp_path / str(number)))
        content = json.loads((folder / file).read_text())
        part = content
        for key in path[:-1]:
            part = part[key]
        part[path[-1]] = value
        (folder / file).write_text(json.dumps(content))
        seal(folder)
        said = ".".join(map(str, path))
        assert any(line.startswith(f"{file}: '{said}") and why in line for line in verify(folder)), path
