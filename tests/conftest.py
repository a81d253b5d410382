"""Fixtures that several rooms' tests share."""

import gc
from collections.abc import Callable
from pathlib import Path

import pytest
from analytic_release import publish_analytic
from made_once import made_once
from small_benchmark import Run, build_small, run_here
from synthetic_release import publish_synthetic

from kinectbench.release.release import Release, open_release


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The tests of a file run in one process, or those of its group, so that what they share is made once."""
    for item in items:
        if item.get_closest_marker("xdist_group") is None:
            item.add_marker(pytest.mark.xdist_group(item.path.name))


@pytest.fixture(scope="session")
def release(tmp_path_factory: pytest.TempPathFactory) -> Release:
    """A published release of simple shapes, not to be changed."""
    root = made_once(tmp_path_factory, "synthetic", publish_synthetic)
    return open_release(root / "benchmark")


@pytest.fixture(scope="session")
def analytic(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`build/` and the `benchmark/` published of it: balls and boxes seen exactly; not to be changed."""
    return made_once(tmp_path_factory, "analytic", publish_analytic)


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A benchmark of two small recordings, built up to the pairs; not to be changed."""
    return made_once(tmp_path_factory, "small", build_small)


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Run]:
    """Runs a command in this process: command(folder, *arguments)."""
    return lambda folder, *arguments: run_here(monkeypatch, capsys, folder, *arguments)


def pytest_collection_finish() -> None:
    """What was imported stays: the garbage collector need not look at it again and again."""
    gc.collect()
    gc.freeze()
