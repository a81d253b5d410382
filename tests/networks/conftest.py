"""A release to learn from, and a network that is trained in seconds; none of it without torch."""

from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from small_method import RECORDINGS, TINY
from synthetic_release import publish_synthetic

from kinectbench.release.release import Release, open_release

# Without torch nothing here can be imported; tests/cli says what the commands say then.
collect_ignore_glob = [] if find_spec("torch") else ["test_methods_*.py"]


@pytest.fixture(autouse=True, scope="session")
def _one_thread() -> Iterator[None]:
    """The same sums in the same order on every machine, and no more than a processor for each worker.

    Memory is kept, as a training keeps it.
    """
    import torch

    from kinectbench.networks.allocator import memory_kept

    torch.set_num_threads(1)
    with memory_kept():
        yield


@pytest.fixture(scope="session")
def learning(tmp_path_factory: pytest.TempPathFactory) -> Release:
    """Five training pairs, one of validation and two to test with; not to be changed."""
    return open_release(publish_synthetic(tmp_path_factory.mktemp("learning"), RECORDINGS).folder)


@pytest.fixture
def tiny(tmp_path: Path) -> Callable[..., Path]:
    """Writes the tiny configuration, with parts of its text replaced."""

    def write(*replaced: tuple[str, str]) -> Path:
        text = TINY
        for old, new in replaced:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "tiny.yaml"
        path.write_text(text)
        return path

    return write


@pytest.fixture(scope="module")
def trained(learning: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a tiny network, trained for one epoch."""
    from kinectbench.networks.config import read_config
    from kinectbench.networks.train import train

    root = tmp_path_factory.mktemp("trained")
    (root / "tiny.yaml").write_text(TINY.replace("epochs: 2", "epochs: 1"))
    train(read_config(root / "tiny.yaml"), [learning], root / "run", device="cpu")
    return root / "run"
