"""benchmarks/speed/many.py: what it links and measures, and which figures it makes of that."""

from pathlib import Path

import many
import pytest
from raising import raises
from small_benchmark import hashes

from kinectbench.core.errors import KinectBenchError

pytestmark = pytest.mark.xdist_group("resume")


def test_recordings_are_linked_and_a_command_on_them_is_measured(small: Path, tmp_path: Path) -> None:
    originals = [small / "recordings" / name for name in ("chair", "table")]
    before = hashes(small)
    many.linked(originals, small, tmp_path / "2", 2)
    root = tmp_path / "2"
    for name, original in (("thing_00000", "chair"), ("thing_00001", "table")):
        pair = Path("build", "%s", "pairs", "000.npz")
        assert Path(root, str(pair) % name).samefile(Path(small, str(pair) % original))
        assert (root / "predictions" / "net" / name / "000.npy").samefile(root / "cube.npy")
    cost = many.called(root, "init", ".", "--force")
    assert cost.cpu_s > 0 and cost.wall_s > 0 and cost.peak_mb > 10
    text = (root / "benchmark.yaml").read_text()
    assert "thing_00000" in text and "thing_00001" in text and hashes(small) == before
    with raises(KinectBenchError, "run.failed", match=r"1; .*verify\.log"):
        many.called(root, "verify", "no_such_release")
    assert "there is no such file or folder" in (root / "verify.log").read_text()


def test_figures_are_times_each_and_their_growth() -> None:
    def cost(cpu_s: float) -> many.Cost:
        return many.Cost(cpu_s, cpu_s, 100.0)

    costs = {1000: {"publish": cost(19.0), "init": cost(1.0)}, 10_000: {"publish": cost(220.0)}}
    found = {figure.name: figure for figure in many.figures(costs)}
    assert found["publish, 1000 recordings: CPU, ms each"].value == 19
    assert found["publish, 1000 recordings: CPU, ms each"].met
    assert not found["publish, 10000 recordings: CPU, ms each"].met
    assert found["publish: time each of 10000 recordings by that of 1000"].value == round(22 / 19, 3)
    assert not found["publish: time each of 10000 recordings by that of 1000"].met
    assert not any("init: time" in name for name in found)


def test_every_step_has_a_command_of_kinectbench() -> None:
    from kinectbench.cli.main import PANELS

    known = {name for commands in PANELS.values() for name in commands}
    assert {command[0] for command, _ in many.STEPS.values()} <= known
    assert set(many.TAKES_SETTINGS) <= known
