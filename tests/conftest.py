"""Fixtures that several rooms' tests share.

What they are made with is imported by whoever asks for them: the process that hands out tests needs none.
"""

import gc
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from made_once import made_once

if TYPE_CHECKING:
    from small_benchmark import Run

    from kinectbench.release.release import Release

gc.disable()  # until all is imported and collected, of which nothing goes


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The tests of a file run in one process, or those of its group, so that what they share is made once."""
    for item in items:
        if item.get_closest_marker("xdist_group") is None:
            item.add_marker(pytest.mark.xdist_group(item.path.name))


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """Bytes name no test: archives hold the time they were made at, and each process makes its own."""
    return argname if isinstance(val, bytes) else None


@pytest.fixture(scope="session")
def release(tmp_path_factory: pytest.TempPathFactory) -> "Release":
    """A published release of simple shapes, not to be changed."""
    from synthetic_release import publish_synthetic

    from kinectbench.release.release import open_release

    root = made_once(tmp_path_factory, "synthetic", publish_synthetic)
    return open_release(root / "benchmark")


@pytest.fixture(scope="session")
def analytic(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`build/` and the `benchmark/` published of it: balls and boxes seen exactly; not to be changed."""
    from analytic_release import publish_analytic

    return made_once(tmp_path_factory, "analytic", publish_analytic)


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A benchmark of two small recordings, built up to the pairs; not to be changed."""
    from small_benchmark import build_small

    return made_once(tmp_path_factory, "small", build_small)


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> "Callable[..., Run]":
    """Runs a command in this process: command(folder, *arguments)."""
    from small_benchmark import run_here

    return lambda folder, *arguments: run_here(monkeypatch, capsys, folder, *arguments)


def pytest_collection_finish() -> None:
    """What was imported stays: the garbage collector need not look at it again and again."""
    gc.freeze()
    gc.enable()
