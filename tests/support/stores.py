"""Fixtures of stores, for the tests of several rooms: import those that a file of tests uses."""

import atexit
import uuid
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path

import pytest
from fault_proxy import FaultProxy
from s3_server import S3Server, start_s3

from kinectbench.core.store.attempts import PATIENCE_VARIABLE
from kinectbench.core.store.store import Store, in_parallel
from kinectbench.release.release import Release


@cache
def _one_server() -> S3Server:
    """One for all files of tests: a fixture would be another one in each file that imports it."""
    server = start_s3()
    atexit.register(server.kill)
    return server


@pytest.fixture
def s3_server() -> S3Server:
    return _one_server()


@pytest.fixture
def s3(s3_server: S3Server, monkeypatch: pytest.MonkeyPatch) -> str:
    """The URL of an empty folder of a bucket; the environment says how it is reached."""
    for name, value in s3_server.variables().items():
        monkeypatch.setenv(name, value)
    return f"s3://{s3_server.bucket()}/lab"


@pytest.fixture
def proxied(s3_server: S3Server, s3: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[FaultProxy]:
    """The same bucket, now behind a proxy; a store is waited for two seconds."""
    with FaultProxy(s3_server.port) as proxy:
        monkeypatch.setenv("AWS_ENDPOINT_URL", proxy.url)
        monkeypatch.setenv(PATIENCE_VARIABLE, "2")
        yield proxy


@pytest.fixture(params=["file", "memory", "s3"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """The URL of an empty place, of each kind that tests have."""
    if request.param == "s3":
        found: str = request.getfixturevalue("s3")
        return found
    return f"file://{tmp_path}/store" if request.param == "file" else f"memory:///{uuid.uuid4()}"


def copy_to(release: Release, url: str) -> Store:
    """Put a release's files there as they are."""
    store = Store(url)
    files = [path for path in release.folder.rglob("*") if path.is_file()]
    in_parallel(partial(store.put, path.relative_to(release.folder).as_posix(), path) for path in files)
    return store
