"""A network of the user's own: trained and run as the others are; what is no network is never called."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from raising import raises
from small_benchmark import Run

from kinectbench.core.errors import SettingsError
from kinectbench.networks.config import NetworkSettings, read_config
from kinectbench.networks.registry import make_network
from kinectbench.networks.train import train
from kinectbench.networks.trained import open_trained
from kinectbench.release.release import Release

Command = Callable[..., Run]
CODE = """
from pathlib import Path
from torch import nn
from kinectbench.networks.network import Network

class Mine(Network):
    def __init__(self, divisor=1):
        super().__init__(input_cells=32, output_cells=32)
        self.layer = nn.Conv3d(1, 1, 3, padding=1)

    def forward(self, partial):
        return self.layer(partial)

def called(*arguments):
    raise SystemExit("was called")
"""
CONFIG = """\
name: mine
network: {kind: own, class_path: "my_nets:Mine"}
loss: {kind: cross-entropy}
training: {batch: 2, epochs: 1, validate_every_steps: 2, validation_pairs: 1}
"""


@pytest.fixture
def nets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder on Python's path with the module, and the configuration beside it."""
    (tmp_path / "my_nets.py").write_text(CODE)
    (tmp_path / "broken_nets.py").write_text("class Mine(:")
    (tmp_path / "failing_nets.py").write_text("1 / 0")
    (tmp_path / "ending_nets.py").write_text("raise SystemExit(3)")
    (tmp_path / "mine.yaml").write_text(CONFIG)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def test_it_is_trained_predicts_and_is_scored(command: Command, nets: Path, learning: Release) -> None:
    benchmark = str(learning.folder)
    trained = command(nets, "train", "mine.yaml", "--data", benchmark, "--out", "run", "--device", "cpu")
    assert trained.status == 0, trained.err
    assert json.loads((nets / "run" / "training.json").read_text())["parameter_count"] == 28
    made = command(nets, "predict", "run", benchmark, "--device", "cpu")
    assert (made.status, made.out) == (0, "wrote predictions/mine\n")
    with np.load(nets / "predictions" / "mine" / "chair_03" / "000.npz") as arrays:
        assert arrays["prediction"].shape == (32, 32, 32)
    again = command(nets, "predict", "run", benchmark, "--device", "cpu")
    assert again.status == 0 and "removes" not in again.err
    (nets / "my_nets.py").write_text(CODE.replace("self.layer(partial)", "-self.layer(partial)"))
    changed = command(nets, "predict", "run", benchmark, "--device", "cpu")
    assert changed.status == 0 and "of another run (other code of the network)" in changed.err
    words = ("--benchmark", benchmark, "--no-surface", "--no-baselines")
    assert command(nets, "score", "predictions", *words).status == 0


FOUND = """
import sys; sys.path.insert(0, '.')
from types import SimpleNamespace
import unrelated
from kinectbench.networks.config import NetworkSettings
from kinectbench.networks.predict import _code_sha256
from kinectbench.networks.registry import make_network
network = make_network(NetworkSettings(kind='own', class_path='%s:Mine'))
print(_code_sha256(SimpleNamespace(network=network)))
"""


@pytest.mark.parametrize(
    ("module", "place", "line", "layers"),
    [
        ("my_nets", "my_nets.py", "from my_layers import SIGN", "my_layers.py"),
        ("a.b", "a/b/__init__.py", "from a.layers import SIGN", "a/layers.py"),
        ("a.b", "a/b/__init__.py", "from ..layers import SIGN", "a/layers.py"),
        ("a.b.nets", "a/b/nets.py", "from . import layers", "a/b/layers.py"),
        ("plain.nets", "plain/nets.py", "from plain.deep.layers import SIGN", "plain/deep/layers.py"),
        ("plain.deep.nets", "plain/deep/nets.py", "from ..layers import SIGN", "plain/layers.py"),
    ],
)
def test_what_it_imports_from_its_own_folder_is_its_code(
    nets: Path, module: str, place: str, line: str, layers: str
) -> None:
    for path in (place, layers):
        (nets / path).parent.mkdir(parents=True, exist_ok=True)
    for package in ("a", "a/b"):
        if (nets / package).is_dir():
            (nets / package / "__init__.py").touch()
    (nets / layers).write_text("SIGN = 1")
    (nets / place).write_text(f"import json, numpy\n{line}\n{CODE}")
    (nets / "unrelated.py").write_text("X = 1")

    def found() -> str:
        words = [sys.executable, "-c", FOUND % module]
        return subprocess.run(words, cwd=nets, capture_output=True, text=True, check=True).stdout

    before = found()
    (nets / "unrelated.py").write_text("X = 2")  # in the same folder, but the network does not import it
    assert found() == before
    (nets / layers).write_text("SIGN = -1")
    assert found() != before


BUFFERS = {
    "bools": ("torch.ones(4, 4).tril().bool()", False),
    "infinite": ("torch.full((4, 4), -float('inf')).triu(1)", False),
    "short": ("torch.arange(4, dtype=torch.int32)", False),
    "bfloats": ("torch.ones(4, dtype=torch.bfloat16)", False),
    "sparse": ("torch.eye(4).to_sparse()", False),
    "empty": ("torch.zeros(0)", True),
    "steps": ("torch.tensor(3)", True),
    "strided": ("torch.rand(4, 6).T", True),
}


@pytest.mark.parametrize("name", BUFFERS)
def test_a_network_is_refused_before_its_training_or_can_be_read_after_it(
    name: str, nets: Path, learning: Release
) -> None:
    """An attention mask is such a buffer: it would be refused when hours of training are read."""
    value, fits = BUFFERS[name]
    line = f"        self.register_buffer('mask', {value})\n"
    code = "import torch\n" + CODE.replace("\n    def forward", f"{line}\n    def forward")
    (nets / f"nets_{name}.py").write_text(code)
    (nets / "mine.yaml").write_text(CONFIG.replace("my_nets", f"nets_{name}"))
    config = read_config(nets / "mine.yaml")
    if not fits:
        with raises(SettingsError, "settings.wrong-value", match=r"'mask' holds .*persistent=False"):
            train(config, [learning], nets / "run", device="cpu")
        assert not (nets / "run" / "weights.npz").exists()
        return
    assert train(config, [learning], nets / "run", device="cpu", minutes=0).step == 1
    assert train(config, [learning], nets / "run", device="cpu").step == 3
    made = make_network(config.network)
    assert torch.equal(open_trained(nets / "run").network.mask, made.mask)


@pytest.mark.parametrize(
    ("path", "words"),
    [
        (
            "no_such_module:Mine",
            "cannot be imported .*No module named 'no_such_module'.*install it, or name",
        ),
        ("broken_nets:Mine", "cannot be imported"),
        ("failing_nets:Mine", r"cannot be imported \(ZeroDivisionError: division by zero\); mend"),
        ("ending_nets:Mine", r"cannot be imported \(SystemExit: 3\)"),
        ("my_nets:Other", "no class of that name there that is a subclass of kinectbench"),
        ("my_nets:called", "no class of that name there"),
        ("my_nets:Path", "no class of that name there"),
    ],
)
def test_what_is_no_network_is_told_and_not_called(nets: Path, path: str, words: str) -> None:
    with raises(SettingsError, "settings.wrong-value", match=words) as error:
        make_network(NetworkSettings(kind="own", class_path=path))
    assert len(error.value.lines) == 1 and "\n" not in str(error.value)
