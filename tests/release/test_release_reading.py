"""READING.md is run where nothing but numpy can be imported; its points must lie on the true surface."""

import json
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from analytic_release import CAMERA, T_world_floor, surface_distance_m, true_depth_m
from synthetic_release import synthetic_settings

from kinectbench.core.artefacts.benchmark import PublishOptions
from kinectbench.core.geometry import invert_rigid, transform_points
from kinectbench.release.publish.publish import publish

# Runs the page, then says what was imported; and that this environment has nothing else.
AFTER = """
import importlib.util, json, sys
np.savez(sys.argv[1], **{k: v for k, v in globals().items() if k in ("seen", "surface")})
known = set(sys.stdlib_module_names) | {"numpy", "__main__"}
foreign = sorted({name.split(".")[0] for name in sys.modules} - known)
others = [n for n in ("kinectbench", "scipy", "pip", "open3d") if importlib.util.find_spec(n) is not None]
print(json.dumps({"foreign": foreign, "others": others}))
"""


@pytest.fixture(scope="module")
def held(analytic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Public parts: `some` has pairs with truth too, `all` has none."""
    root: Path = tmp_path_factory.mktemp("reading")
    for name, recordings in (("some", ["chair_02", "chair_03"]), ("all", ["chair_02"])):
        publish(
            synthetic_settings(),
            analytic / "build",
            root / name,
            recordings,
            PublishOptions(hold_back=("test",), thresholds=None),
        )
    return root


@pytest.fixture(scope="module")
def numpy_alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A Python of a virtual environment that holds links to numpy, and nothing else."""
    root: Path = tmp_path_factory.mktemp("venv") / "venv"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", root], check=True)
    (packages,) = root.glob("lib/python*/site-packages")
    home = Path(np.__file__).parents[1]
    for name in ("numpy", "numpy.libs"):
        if (home / name).is_dir():
            (packages / name).symlink_to(home / name)
    return root / "bin" / "python"


def run_page(python: Path, release: Path, out: Path) -> dict[str, np.ndarray]:
    """The page's code, run in the release's folder by a Python of its own."""
    text = (release / "READING.md").read_text()
    code = text.split("```python\n")[1].split("```")[0]
    assert len([line for line in code.splitlines() if line.strip()]) <= 10
    ran = subprocess.run(
        [python, "-I", "-c", code + textwrap.dedent(AFTER), out], cwd=release, capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stderr
    assert json.loads(ran.stdout) == {"foreign": [], "others": []}
    with np.load(out) as found:
        return dict(found)


def test_points_lie_on_the_true_surface(analytic: Path, numpy_alone: Path, tmp_path: Path) -> None:
    found = run_page(numpy_alone, analytic / "benchmark", tmp_path / "points.npz")
    # The first pair is chair_01/000, a ball of which the cube holds 252 cells.
    cell_m = 2 * 0.3 / 252
    T_floor_world = invert_rigid(T_world_floor(0))
    seen, surface = (transform_points(T_floor_world, found[name]) for name in ("seen", "surface"))
    half_diagonal = np.sqrt(3) / 2
    assert len(surface) > 100_000 and surface_distance_m("chair", surface).max() < 2 * half_diagonal * cell_m
    assert surface_distance_m("chair", seen).max() < 4 * half_diagonal * cell_m + 0.001
    # All of the ball's surface, and the part of it that the camera can see.
    for axis in range(3):
        assert np.ptp(surface[:, axis]) == pytest.approx(0.6, abs=3 * cell_m)
    depth_m = true_depth_m("chair", 0)
    in_view = CAMERA.backproject(depth_m)[depth_m > 0]
    assert len(seen) > 800 and np.ptp(in_view[:, 0]) < 0.6


def test_the_public_part(held: Path, numpy_alone: Path, tmp_path: Path) -> None:
    text = (held / "some" / "READING.md").read_text()
    assert "Pairs of the split test do not have `full`" in text
    found = run_page(numpy_alone, held / "some", tmp_path / "points.npz")
    # chair_03 is of the validation split: all of it is there, in its own world.
    surface = transform_points(invert_rigid(T_world_floor(2)), found["surface"])
    assert surface_distance_m("chair", surface).max() < 0.005


def test_a_part_without_any_truth(held: Path, numpy_alone: Path, tmp_path: Path) -> None:
    found = run_page(numpy_alone, held / "all", tmp_path / "points.npz")
    assert list(found) == ["seen"] and found["seen"].shape[1] == 3
    # In the view's own world the floor is z = 0 and the camera stands above the origin.
    distance = np.abs(np.linalg.norm(found["seen"] - found["seen"].mean(axis=0), axis=1))
    assert distance.max() < 0.4 and found["seen"][:, 2].min() > -0.01


def test_every_key_is_explained(analytic: Path) -> None:
    text = (analytic / "benchmark" / "READING.md").read_text()
    with np.load(analytic / "benchmark" / "pairs" / "chair_01" / "000.npz") as pair:
        assert all(f"`{key}`" in text for key in pair.files)
