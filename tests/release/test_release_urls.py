"""URLs that no attempt makes right: each is refused at once, in one line that says what to do."""

import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from raising import raises
from s3_server import free_port
from small_benchmark import Run
from stores import s3, s3_server

import kinectbench
from kinectbench.cli.publish import store_at
from kinectbench.core.errors import KinectBenchError, SettingsError, StorageError
from kinectbench.core.store import attempts
from kinectbench.core.store.address import unusable
from kinectbench.core.store.attempts import patiently
from kinectbench.core.store.store import Store

__all__ = ["s3", "s3_server"]
pytestmark = pytest.mark.xdist_group("stores")
Command = Callable[..., Run]
AT_ONCE_S = 20.0


@pytest.fixture(autouse=True)
def _at_once() -> Iterator[None]:
    begun = time.monotonic()
    yield
    assert time.monotonic() - begun < AT_ONCE_S


def said(command: Command, folder: Path, *words: str) -> str:
    """The one line that a wrong command line ends with."""
    result = command(folder, *words)
    assert result.status == 2, result.err
    assert "Traceback" not in result.err and "internal error" not in result.err
    return " ".join(result.err.split())


WORDS = (
    ("verify", "{url}"),
    ("verify", "--checksums", "{url}"),
    ("fetch", "{url}"),
    ("score", "--benchmark", "{url}"),
    ("gc", "--config", "{url}/benchmark.yaml"),
    ("build", "--config", "{url}/benchmark.yaml"),
)


@pytest.mark.parametrize("words", WORDS, ids=" ".join)
@pytest.mark.parametrize("url", ["s3://bucket/rel", "file:///data/rel", "https://host/rel"])
def test_without_obstore_one_line_says_what_to_install(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, url: str, words: tuple[str, ...]
) -> None:
    monkeypatch.setitem(sys.modules, "obstore", None)
    wanted = "needs obstore; run pip install 'kinectbench[cluster]'"
    if url.startswith("https") and words[0] == "gc":
        return  # a web server lists nothing
    assert wanted in said(command, tmp_path, *(word.format(url=url) for word in words))
    with raises(SettingsError, "settings.no-package", match="needs obstore; run pip install"):
        kinectbench.load(url)


def test_no_method_of_a_store_works_without_obstore(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "obstore", None)
    store = Store(f"file://{tmp_path}/store")
    calls: tuple[Callable[[], object], ...] = (
        lambda: store.read("a"),
        lambda: store.read_if_there("a"),
        lambda: store.fetch("a", tmp_path / "a"),
        lambda: store.put("a", b"1"),
        lambda: store.put_new("a", b"1"),
        lambda: store.objects(),
        lambda: store.head("a"),
        lambda: store.delete(["a"]),
    )
    for call in calls:
        with raises(SettingsError, "settings.no-package", match="needs obstore; run pip install"):
            call()
    # Before anything is published:
    with raises(SettingsError, "settings.no-package", match="--to s3://bucket/rel"):
        store_at("s3://bucket/rel")


@pytest.mark.parametrize("variable", ["AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT"])
@pytest.mark.parametrize("endpoint", ["127.0.0.1:15555", "localhost", "http://", "ftp://host", "http://a b"])
def test_an_endpoint_is_a_url(s3: str, monkeypatch: pytest.MonkeyPatch, endpoint: str, variable: str) -> None:
    monkeypatch.setenv(variable, endpoint)
    with raises(SettingsError, "settings.bad-environment", match=f"{variable}="):
        Store("s3://bucket/rel").read("a")


def test_a_panic_of_obstore_is_a_line() -> None:
    panic = type("PanicException", (BaseException,), {"__module__": "pyo3_runtime"})

    def call() -> None:
        raise panic("request valid: InvalidUri")

    with raises(StorageError, "storage.bad-address", match="s3://b/a"):
        patiently("s3://b/a", call)


@pytest.mark.parametrize(("after_s", "times"), [(0.0, 1), (3.0, 0)])
def test_a_store_that_does_not_answer_is_told_of_once(
    s3: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, after_s: float, times: int
) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{free_port()}")
    monkeypatch.setenv("KINECTBENCH_STORE_PATIENCE_S", "0.5")
    monkeypatch.setattr(attempts, "TELL_AFTER_S", after_s)
    for name in "ab":
        with raises(StorageError, "storage.no-answer"):
            Store(f"s3://told-{times}/rel").read(name)
    wanted = f"warning: s3://told-{times}/rel/a: the store does not answer well (Connection refused); trying"
    assert [message.startswith(wanted) for message in caplog.messages] == [True] * times


@pytest.mark.parametrize(
    ("words", "place"),
    [
        (("build", "--config", "s3:///benchmark.yaml"), "s3:///benchmark.yaml: no bucket in the URL"),
        (("gc", "--config", "s3:///benchmark.yaml"), "s3:///benchmark.yaml: no bucket in the URL"),
        (("build", "--config", "s3://"), "s3://: no bucket in the URL"),
        (("verify", "gs://"), "no bucket in the URL; wanted gs://BUCKET/…"),
        (("fetch", "s3:///rel"), "s3:///rel: no bucket in the URL"),
        (("score", "--benchmark", "az://"), "no bucket in the URL"),
        (("verify", "https://"), "no host in the URL"),
    ],
)
def test_a_url_without_a_bucket(command: Command, tmp_path: Path, words: tuple[str, ...], place: str) -> None:
    assert place in said(command, tmp_path, *words)


def test_loading_from_a_url_without_a_bucket() -> None:
    for url in ("s3://", "gs:///", "https://", "s3:///rel", "s3://@/rel", "http://:80/rel"):
        with raises(SettingsError, "settings.bad-url", match="[a-z0-9]+://"):
            kinectbench.load(url)


@pytest.mark.parametrize(
    "words",
    (*WORDS, ("publish", "--to", "{url}"), ("publish", "-c{url}"), ("report", "--benchmark={url}")),
)
@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("s3:///rel", "s3:///rel: no bucket in the URL; wanted s3://BUCKET/…"),
        ("gs:///rel", "gs:///rel: no bucket in the URL; wanted gs://BUCKET/…"),
        ("az://?sig=SECRET", "az://?…: no bucket in the URL"),
        ("s3://...", "s3://...: no bucket can be called so"),
        ("file://host/rel", "file://host/rel: wanted file:///PATH, of this machine"),
        ("ftp://host/rel", "ftp:// is not supported; s3, gs, az, https, file are"),
    ],
)
def test_a_url_is_judged_as_it_is_written(
    command: Command, tmp_path: Path, url: str, why: str, words: tuple[str, ...]
) -> None:
    """A path keeps one slash of several, by which `rel` would be the bucket."""
    line = said(command, tmp_path, *(word.format(url=url) for word in words))
    # A URL is shown as it was given, with benchmark.yaml where that is asked for.
    assert why.rpartition(": ")[2] in line and "SECRET" not in line and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "url",
    [
        *("s3://bucket/rel", "az://$web/rel", "abfs://c@account.dfs.core.windows.net/rel", "memory:///rel"),
        *("file:///rel", "https://me@host:443/rel", "http://[::1]:80/rel", "https://bücher.example/rel"),
        *("s3:bucket", "C:/rel", "rel", "./s3:///rel", "foo:bar/rel"),
    ],
)
def test_what_can_be_used_is_not_refused(url: str) -> None:
    assert unusable(url) is None


@pytest.mark.parametrize(
    "words",
    [
        ("export", "s3://b/out"),
        ("score", "gs://b/predictions"),
        ("fetch", "https://host/rel", "--out", "s3://b/out"),
        ("publish", "--archives-to", "file:///zips"),
    ],
)
def test_where_a_path_is_wanted_a_url_makes_no_folder(
    command: Command, tmp_path: Path, words: tuple[str, ...]
) -> None:
    assert "wanted a path of this machine, not a URL" in said(command, tmp_path, *words)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_bucket_is_called_so_by_load_too(s3: str) -> None:
    with raises(StorageError, "storage.no-bucket", match=r"s3://nobucket/x/benchmark\.json"):
        kinectbench.load("s3://nobucket/x")


def test_places_without_a_release_keep_their_slashes(s3: str, tmp_path: Path) -> None:
    for url in (s3, f"file://{tmp_path}/none"):
        with raises(KinectBenchError, "release.not-one", match=f"{url}: no"):
            kinectbench.load(url)


@pytest.mark.parametrize("words", WORDS[:4] + WORDS[5:], ids=" ".join)
@pytest.mark.parametrize("scheme", ["ftp", "hdfs", "S3", "git+ssh"])
def test_other_schemes_are_named(
    command: Command, tmp_path: Path, scheme: str, words: tuple[str, ...]
) -> None:
    wanted = f"{scheme}:// is not supported; s3, gs, az, https, file are"
    assert wanted in said(command, tmp_path, *(word.format(url=f"{scheme}://a/b") for word in words))
    with raises(SettingsError, "settings.bad-url", match="supported; s3, gs"):
        kinectbench.load(f"{scheme}://a/b")


def test_no_traceback_shows_a_password(tmp_path: Path) -> None:
    secret = "".join(["SEC", "RET"])
    for url in (f"http://me:{secret}@127.0.0.1:1/x", f"https://me:{secret}@host.invalid/x"):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("KINECTBENCH_STORE_PATIENCE_S", "0")
            try:
                kinectbench.load(url)
            except KinectBenchError:
                assert secret not in traceback.format_exc()
            else:
                pytest.fail("no server answers there")


@pytest.mark.parametrize("written", [["--cluster", "tcp://127.0.0.1:1"], ["--cluster=tls://127.0.0.1:1"]])
def test_the_address_of_a_cluster_is_no_place(command: Command, tmp_path: Path, written: list[str]) -> None:
    made = command(tmp_path, "build", *written)
    assert made.status == 2 and made.err.startswith("error: benchmark.yaml: no such file")


def test_a_name_that_no_file_can_have(command: Command, tmp_path: Path) -> None:
    assert "no such folder and no URL; name a release's URL" in said(command, tmp_path, "fetch", "a" * 5000)
