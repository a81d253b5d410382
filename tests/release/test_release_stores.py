"""Releases in stores and on web servers: put, fetched whole or in part, verified and scored from there."""

import functools
import http.server
import json
import shutil
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fault_proxy import Fault, FaultProxy
from raising import raises
from small_benchmark import Run, hashes, leftovers
from stores import copy_to, proxied, s3, s3_server, url

import kinectbench
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON
from kinectbench.core.artefacts.targets import SHA256SUMS, Target
from kinectbench.core.errors import KinectBenchError, ReleaseError, SettingsError
from kinectbench.core.storage import sha256_file
from kinectbench.core.store.address import shown
from kinectbench.core.store.store import Store
from kinectbench.release.check.verify import CHANGED, EXTRA, MISSING
from kinectbench.release.fetch import (
    ReleasePart,
    cached_release,
    chosen_targets,
    fetch_release,
    mirror_release,
    release_url,
    wanted_names,
)
from kinectbench.release.release import Release, open_release

__all__ = ["proxied", "s3", "s3_server", "url"]
pytestmark = pytest.mark.xdist_group("stores")
Command = Callable[..., Run]


@pytest.fixture
def web(release: Release) -> Iterator[str]:
    """The URL of the release on a plain web server."""
    quiet = type("Quiet", (http.server.SimpleHTTPRequestHandler,), {"log_message": lambda *words: None})
    handler = functools.partial(quiet, directory=str(release.folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


# --- fetched in part ----------------------------------------------------------------------------------


def test_parts_are_chosen(release: Release) -> None:
    every = release.targets
    assert chosen_targets(every, ReleasePart()) == tuple(sorted(every))
    test = chosen_targets(every, ReleasePart(split="test"))
    assert test and {target.split for target in test} == {"test"}
    category = test[0].category
    assert {t.category for t in chosen_targets(every, ReleasePart(categories=(category,)))} == {category}
    one = chosen_targets(every, ReleasePart(views=1))
    assert set(Counter(target.recording for target in one).values()) == {1}
    assert {target.view for target in one} == {min(t.view for t in every)}


def test_a_part_has_its_own_surfaces_and_pictures() -> None:
    """And the tables beside the pictures, which belong to no recording."""
    chosen = [Target("a.b", "a", "000", "chair", "test", "pairs/a.b/000.npz", "0" * 64)]
    wanted = [
        "benchmark.json", "pairs/a.b/000.npz", "surfaces/a.b.ply", "objects/a.b.glb", "objects/a.b/mesh.ply",
        "previews/test/a.b/000.jpg", "previews/test/metadata.jsonl",
    ]  # fmt: skip
    others = [
        "pairs/a.b/001.npz", "pairs/c/000.npz", "surfaces/c.ply", "previews/test/a.b/001.jpg",
        "previews/train/c/000.jpg",
    ]  # fmt: skip
    assert wanted_names([*others, *wanted], chosen, ReleasePart(split="test")) == wanted


def test_a_part_is_enough_for_its_split(release: Release, web: str, tmp_path: Path) -> None:
    out = tmp_path / "got"
    found = fetch_release(web, out, ReleasePart(split="test", views=1))
    opened = open_release(out)
    assert found.benchmark_sha256 == opened.benchmark_sha256 == release.benchmark_sha256
    wanted = chosen_targets(release.targets, ReleasePart(split="test", views=1))
    assert {path.relative_to(out).as_posix() for path in out.glob("pairs/*/*")} == {t.file for t in wanted}
    recordings = {target.recording for target in wanted}
    there = {path.name for path in (out / "objects").iterdir()}
    assert there == recordings | {f"{recording}.glb" for recording in recordings}
    for target in wanted:
        assert opened.pair_content(target)
    more = fetch_release(web, out)
    assert hashes(out) == hashes(release.folder) and more.kept == found.fetched + found.kept


def test_a_fetch_that_was_stopped_goes_on(
    release: Release, proxied: FaultProxy, s3: str, tmp_path: Path
) -> None:
    copy_to(release, s3)
    proxied.requests.clear()
    proxied.choose = lambda number, method, path: "drop" if number > 20 else ""
    with raises(KinectBenchError, "storage.no-answer", match="for 2 s"):
        fetch_release(s3, tmp_path / "got")
    assert not (tmp_path / "got" / BENCHMARK_JSON).exists() and leftovers(tmp_path) == []
    proxied.choose = lambda number, method, path: ""
    found = fetch_release(s3, tmp_path / "got")
    assert found.kept >= 10 and hashes(tmp_path / "got") == hashes(release.folder)


def test_what_a_killed_fetch_left_goes(release: Release, web: str, tmp_path: Path) -> None:
    out = tmp_path / "got"
    for left in (".lock", ".SHA256SUMS.1f2e3d4c.part"):  # before the first file was there
        out.mkdir(exist_ok=True)
        (out / left).write_bytes(b"x")
    fetch_release(web, out)
    assert hashes(out) == hashes(release.folder)
    pair = out / release.targets[0].file
    for path in (pair.with_name(".000.npz.12345.part"), out / ".index.html.1f2e3d4c.part"):
        path.write_bytes(b"half")
    assert fetch_release(web, out).fetched == 0
    assert hashes(out) == hashes(release.folder)


@pytest.mark.parametrize("fails", [False, True])
def test_fetches_into_one_folder_share_the_work(
    release: Release, proxied: FaultProxy, s3: str, tmp_path: Path, fails: bool
) -> None:
    """Four at once bring each file once; if some of them fail, the others still bring all of it."""
    copy_to(release, s3)
    asked: Counter[str] = Counter()

    def choose(number: int, method: str, path: str) -> Fault:
        asked[path] += 1
        return "503" if fails and path.endswith(".npz") and asked[path] == 1 else ""

    proxied.choose = choose
    script = (
        "import sys; from pathlib import Path\n"
        "from kinectbench.core.store import attempts\n"
        "if sys.argv[3] == 'True': attempts.patience_s = lambda: -1.0\n"
        "from kinectbench.release.fetch import fetch_release\n"
        "print(fetch_release(sys.argv[1], Path(sys.argv[2])).fetched)"
    )
    words = [sys.executable, "-c", script, s3, str(tmp_path / "got"), str(fails)]
    runs = [
        subprocess.Popen(words, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE) for _ in range(4)
    ]
    told = [(*run.communicate(timeout=100), run.returncode) for run in runs]
    if fails:
        assert all("did not answer well" in err for _, err, status in told if status)
        fetch_release(s3, tmp_path / "got")
    else:
        assert sorted(int(out) for out, _, _ in told) == [0, 0, 0, len(release.sums)]
    assert hashes(tmp_path / "got") == hashes(release.folder)


def test_one_request_a_file(release: Release, proxied: FaultProxy, s3: str, tmp_path: Path) -> None:
    copy_to(release, s3)
    proxied.requests.clear()
    fetch_release(s3, tmp_path / "got")
    # benchmark.json and targets.csv are read once more, to know what is wanted.
    assert len(proxied.requests) <= len(release.sums) + 1 + 2


def test_releases_by_name(release: Release, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("KINECTBENCH_RELEASES", "https://lab.example/releases/")
    assert release_url("chairs") == "https://lab.example/releases/chairs"
    assert release_url("s3://bucket/chairs/") == "s3://bucket/chairs"
    assert release_url(str(release.folder)) == f"file://{release.folder}"
    for name in ("../chairs", "a/b"):
        with raises(SettingsError, "settings.no-file", match="no such folder and no URL"):
            release_url(name)
    odd = tmp_path / "100%25 chairs"
    shutil.copytree(release.folder, odd)
    assert fetch_release(release_url(str(odd)), tmp_path / "got").kept == 0
    monkeypatch.delenv("KINECTBENCH_RELEASES")
    with raises(SettingsError, "settings.no-file", match="set KINECTBENCH_RELEASES"):
        release_url("chairs")


# --- what is wrong there ------------------------------------------------------------------------------


def test_a_folder_whose_name_has_signs_of_urls(tmp_path: Path) -> None:
    folder = tmp_path / "chairs%20 100%#1"
    folder.mkdir()
    (folder / "a").write_bytes(b"1")
    assert Store(release_url(folder)).read("a") == b"1"


def test_a_file_that_was_changed_is_refused(release: Release, s3: str, tmp_path: Path) -> None:
    store, name = copy_to(release, s3), release.targets[0].file
    store.put(name, b"other bytes")
    with raises(ReleaseError, "release.changed", match=f"{name}: changed"):
        fetch_release(s3, tmp_path / "got")
    assert not (tmp_path / "got" / name).exists() and not (tmp_path / "got" / BENCHMARK_JSON).exists()


@pytest.mark.parametrize("line", ["../out", "/etc/passwd", ".bashrc", "a/../../out", "a\\..\\b", ""])
def test_names_that_lead_out_are_refused(release: Release, s3: str, tmp_path: Path, line: str) -> None:
    store = copy_to(release, s3)
    sums = store.read(SHA256SUMS).decode() + f"{'0' * 64}  {line}\n"
    store.put(SHA256SUMS, sums.encode())
    for call in (lambda: fetch_release(s3, tmp_path / "got"), lambda: mirror_release(s3, tmp_path / "m")):
        with pytest.raises(ReleaseError):
            call()
    assert not (tmp_path / "got").exists() and not (tmp_path / "m").exists()


def test_files_beyond_bounds_are_refused(
    release: Release, s3: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy_to(release, s3)
    with monkeypatch.context() as patch:
        patch.setattr("kinectbench.release.fetch.MOST_FILES", 10)
        with raises(ReleaseError, "release.too-large", match="than 10 files"):
            fetch_release(s3, tmp_path / "got")
    monkeypatch.setattr("kinectbench.release.fetch.most_bytes", lambda name: 10)
    with raises(KinectBenchError, "storage.too-large", match="the 10 it"):
        fetch_release(s3, tmp_path / "got")


def test_folders_that_hold_something_else_are_left(
    release: Release, analytic: Path, web: str, tmp_path: Path
) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    shutil.copytree(analytic / "benchmark", tmp_path / "other")
    (tmp_path / "file").write_text("mine")
    for name, said in (
        ("mine", "something else than a release"),
        ("other", "another release"),
        ("file", "a file"),
    ):
        before = hashes(tmp_path)
        with raises(ReleaseError, "release.other-content", match=said):
            fetch_release(web, tmp_path / name)
        assert hashes(tmp_path) == before


# --- commands -----------------------------------------------------------------------------------------


def test_verify_says_of_a_url_what_it_says_of_a_folder(
    command: Command, release: Release, s3: str, web: str, tmp_path: Path
) -> None:
    assert command(tmp_path, "verify", web).out == f"{web}: all well\n"
    store, (first, second) = copy_to(release, s3), [target.file for target in release.targets[:2]]
    store.put(first, b"changed")
    store.delete([second])
    store.put("extra.txt", b"1")
    result = command(tmp_path, "verify", "--json", s3)
    problems = json.loads(result.out)
    assert result.status == 1
    assert CHANGED.format(first) in problems
    assert MISSING.format(second) in problems and EXTRA.format("extra.txt") in problems


def test_checksums_of_a_url_need_little_room(
    command: Command, release: Release, s3: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "scratch").mkdir()
    monkeypatch.setenv("KINECTBENCH_SCRATCH", str(tmp_path / "scratch"))
    store, (first, second) = copy_to(release, s3), [target.file for target in release.targets[:2]]
    most, hashed = [0], sha256_file

    def counted(path: Path) -> str:
        most[0] = max(most[0], sum(each.is_file() for each in (tmp_path / "scratch").rglob("*")))
        return hashed(path)

    monkeypatch.setattr("kinectbench.release.fetch.sha256_file", counted)
    assert command(tmp_path, "verify", "--checksums", s3).out == f"{s3}: all well\n"
    assert 0 < most[0] <= 2 * 8 + 3 < len(release.sums)  # with what is being written; the lock, two that stay
    store.put(first, b"changed")
    store.delete([second])
    store.put("extra.txt", b"1")
    of_url = command(tmp_path, "verify", "--checksums", "--json", s3)
    shutil.copytree(release.folder, tmp_path / "same")
    (tmp_path / "same" / first).write_bytes(b"changed")
    (tmp_path / "same" / second).unlink()
    (tmp_path / "same" / "extra.txt").write_bytes(b"1")
    of_folder = command(tmp_path, "verify", "--checksums", "--json", "same")
    assert of_url.status == of_folder.status == 1
    assert sorted(json.loads(of_url.out)) == sorted(json.loads(of_folder.out))
    assert list((tmp_path / "scratch").iterdir()) == []


def test_verify_of_a_url_uses_the_scratch_folder(
    command: Command, web: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("KINECTBENCH_SCRATCH", str(tmp_path / "none"))
    for words in (("verify", web), ("verify", "--checksums", web)):
        result = command(tmp_path, *words)
        assert result.status != 0
        assert "none: no such folder; make it, or correct KINECTBENCH_SCRATCH" in result.err


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("https://me:a@b@host/rel", "https://host/rel"),
        ("https:/host/rel?X-Amz-Signature=b/pairs/000.npz", "https://host/rel?…"),
        ("https://host/me@home/rel", "https://host/me@home/rel"),
        ("file:///what?/rel", "file:///what?/rel"),
        ("here/what?", "here/what?"),
    ],
)
def test_places_are_shown_without_secrets(place: str, said: str) -> None:
    assert shown(place) == shown(Path(place)) == said


SECRETS = ["http://me:SECRET@127.0.0.1:{}/rel", "http://127.0.0.1:{}/rel?X-Amz-Signature=SECRET"]


@pytest.mark.parametrize("url", SECRETS)
def test_no_message_holds_what_is_secret_in_a_url(
    command: Command, web: str, tmp_path: Path, url: str
) -> None:
    place = url.format(web.rpartition(":")[2])
    calls = (
        lambda: kinectbench.load(place),
        lambda: fetch_release(place, tmp_path / "got"),
        lambda: mirror_release(place, tmp_path / "got"),
        lambda: cached_release(place),
    )
    for call in calls:
        with pytest.raises(ReleaseError) as raised:
            call()
        assert "SECRET" not in str(raised.value) and "/rel" in str(raised.value)
        assert ("a URL with a query" in str(raised.value)) == ("?" in url)
    for words in (("verify", place), ("fetch", place), ("score", "--benchmark", place)):
        result = command(tmp_path, *words)
        assert result.status != 0 and "SECRET" not in result.out + result.err


def test_fetch_and_score_by_url(
    command: Command, release: Release, web: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("KINECTBENCH_CACHE", str(tmp_path / "cache"))
    fetched = command(tmp_path, "fetch", web, "--json", "--split", "test", "--out", "got")
    told = json.loads(fetched.out)
    assert told["benchmark_sha256"] == release.benchmark_sha256 and told["release"] == "got"
    words = ("--no-surface", "--out", "scores", "--jobs", "1")
    assert command(tmp_path, "score", "--benchmark", web, *words).status == 0
    scores = json.loads((tmp_path / "scores" / "empty" / "scores.json").read_text())
    assert scores["benchmark_sha256"] == release.benchmark_sha256
    assert cached_release(web) == tmp_path / "cache" / "releases" / release.benchmark_sha256
    bad = command(tmp_path, "fetch", web, "--split", "all")
    assert bad.status == 2 and "--split all: choose among" in bad.err
    # Also beside a category that is there.
    for category in (("unicorn",), ("chair", "--category", "unicorn")):
        none = command(tmp_path, "fetch", web, "--category", *category, "--out", "none")
        assert none.status == 2 and "no pair of that split and category (unicorn);" in none.err
        assert not (tmp_path / "none").exists()
    assert command(tmp_path, "fetch", f"{web}/none").status == 1
