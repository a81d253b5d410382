"""Several processes that share each batch learn what one learns."""

import socket
import subprocess
import sys
from collections.abc import Callable
from datetime import timedelta
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from raising import raises
from torch import distributed

from kinectbench.core.errors import SettingsError
from kinectbench.networks.config import read_config
from kinectbench.networks.distributed import chosen_device, joined_processes
from kinectbench.networks.train import train
from kinectbench.release.release import Release

Tiny = Callable[..., Path]
ALL = ("unknown: mask", "unknown: count")  # the mean of means is that of all
PROGRAM = """
import sys, torch
from pathlib import Path
torch.set_num_threads(1)
from kinectbench.release.release import open_release
from kinectbench.networks.config import read_config
from kinectbench.networks.train import train
config, release, out = map(Path, sys.argv[1:])
train(read_config(config), [open_release(release)], out, device="cpu")
"""


def test_two_processes_learn_what_one_learns(
    learning: Release, tiny: Tiny, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This one and another."""
    config = tiny(ALL, ("epochs: 2", "epochs: 1"))
    train(read_config(config), [learning], tmp_path / "one", device="cpu")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    shared = {
        "WORLD_SIZE": "2",
        "MASTER_ADDR": "127.0.0.1",
        "MASTER_PORT": str(port),
        "GLOO_SOCKET_IFNAME": "lo",
    }
    for name, value in shared.items():
        monkeypatch.setenv(name, value)
    join = partial(distributed.init_process_group, timeout=timedelta(seconds=240))
    monkeypatch.setattr(distributed, "init_process_group", join)
    monkeypatch.setenv("RANK", "1")
    arguments = [sys.executable, "-W", "ignore", "-c", PROGRAM]
    other = subprocess.Popen([*arguments, config, learning.folder, tmp_path / "two"])
    monkeypatch.setenv("RANK", "0")
    train(read_config(config), [learning], tmp_path / "two", device="cpu")
    assert other.wait(timeout=240) == 0
    with np.load(tmp_path / "one" / "weights.npz") as one, np.load(tmp_path / "two" / "weights.npz") as two:
        assert one.files == two.files
        for name in one.files:
            # Adam turns gradients of rounding errors into whole steps: a thousandth of a step is allowed.
            np.testing.assert_allclose(two[name], one[name], atol=1e-4)


def test_a_batch_that_cannot_be_shared_is_told(
    learning: Release, tiny: Tiny, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from contextlib import nullcontext

    from kinectbench.networks import train as module

    monkeypatch.setattr(module, "joined_processes", lambda device: nullcontext((0, 3)))
    with raises(SettingsError, "settings.wrong-value", match=r"2.*3"):
        train(read_config(tiny()), [learning], tmp_path / "run", device="cpu")


def test_each_process_uses_its_own_gpu_before_it_joins(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = list[object]()
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.setattr(torch.cuda, "set_device", calls.append)
    monkeypatch.setattr(distributed, "init_process_group", calls.append)
    monkeypatch.setattr(distributed, "destroy_process_group", lambda: None)
    with joined_processes("cuda:1"):
        assert calls == ["cuda:1", "nccl"]


@pytest.mark.parametrize("name", ["cuda:77", "gpu", "meta", "a\x1bb"])
def test_a_device_that_is_not_there_is_told(name: str) -> None:
    with raises(SettingsError, "settings.wrong-value", match="--device") as error:
        chosen_device(name)
    assert str(error.value).isprintable()
