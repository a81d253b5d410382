"""Fixtures that several rooms' tests share."""

from collections.abc import Callable
from pathlib import Path

import pytest
from analytic_release import publish_analytic
from small_benchmark import Run, make_benchmark, run, run_here
from synthetic_release import publish_synthetic

from kinectbench.release.release import Release, open_release


@pytest.fixture(scope="session")
def release(tmp_path_factory: pytest.TempPathFactory) -> Release:
    """A published release of simple shapes, not to be changed."""
    root: Path = tmp_path_factory.mktemp("synthetic")
    return open_release(publish_synthetic(root).folder)


@pytest.fixture(scope="session")
def analytic(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`build/` and the `benchmark/` published of it: balls and boxes seen exactly; not to be changed."""
    root: Path = tmp_path_factory.mktemp("analytic")
    publish_analytic(root)
    return root


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A benchmark of two small recordings, built up to the pairs; not to be changed."""
    root = make_benchmark(tmp_path_factory.mktemp("small"))
    built = run(root, "build", "--jobs", "1")
    assert built.status == 0, built.err
    return root


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Run]:
    """Runs a command in this process: command(folder, *arguments)."""
    return lambda folder, *arguments: run_here(monkeypatch, capsys, folder, *arguments)
