"""Two scans of a recipe are fetched and built; with --stream each is deleted, and the release is the same."""

import hashlib
import io
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from made_once import made_once
from scan_server import ScanServer
from small_benchmark import Run, run
from small_recipe import SOURCES, make_scans, served, write_recipe

from kinectbench._version import __version__
from kinectbench.cli import recipe as cli_recipe
from kinectbench.cli.common import Common
from kinectbench.core.artefacts.benchmark import ReleaseInfo
from kinectbench.core.artefacts.manifest import Failed, Manifest
from kinectbench.core.errors import RecordingError, StorageError
from kinectbench.engine.artefact import Artefact
from kinectbench.engine.failures import keep_failure
from kinectbench.engine.slim import is_slim, slim
from kinectbench.release.recipe import FetchedScan, remove_scan
from kinectbench.settings.sources import Scan

Command = Callable[..., Run]
HERE = {"no_proxy": "*", "KINECTBENCH_STORE_PATIENCE_S": "2"}


def build_both_ways(root: Path) -> None:
    """`all/`: fetched with two interruptions and a lying server, then built; `one/`: streamed by its lock."""
    files = served(make_scans(root / "scans"))
    with (
        ScanServer(files, lambda number, path: "page") as lying,
        ScanServer(files, lambda number, path: "cut" if number in (1, 3) else "") as good,
    ):
        write_recipe(root / "all", lying.url, good.url)
        fetched = run(root / "all", "fetch", ".", variables=HERE)
        assert (fetched.status, fetched.err) == (0, "") and any(asked for _, asked in good.asked)
        built = run(root / "all", "build", "--jobs", "1")
        assert built.status == 0, built.err
        write_recipe(root / "one", good.url)
        (root / "one" / "sources.lock").write_bytes((root / "all" / "sources.lock").read_bytes())
        good.choose = lambda number, path: "cut" if number % 3 == 0 else ""
        streamed = run(root / "one", "fetch", ".", "--stream", "--jobs", "1", variables=HERE)
        assert streamed.status == 0, streamed.err


@pytest.fixture
def both(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_once(tmp_path_factory, "recipe", build_both_ways)


def identity(root: Path) -> str:
    return ReleaseInfo.read(root / "benchmark").benchmark_sha256


def pairs(root: Path) -> dict[str, str]:
    found = sorted((root / "build").glob("*/pairs/*.npz"))
    return {str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest() for path in found}


def test_a_streamed_benchmark_has_the_same_pairs_and_no_scans(both: Path) -> None:
    assert pairs(both / "one") == pairs(both / "all") != {}
    assert [path.name for path in (both / "one" / "scans").glob("0*")] == []
    for build in (both / "one" / "build").iterdir():
        assert is_slim(build / "sequence") and is_slim(build / "reconstruction")
        assert {path.suffix for path in (build / "sequence").rglob("*") if path.is_file()} == {".json"}
        assert (Manifest.read(build / "sequence").removed or 0) >= 2 * 72


def test_what_was_streamed_is_current_and_published_with_its_licence(both: Path, tmp_path: Path) -> None:
    for name in ("one", "all"):
        shutil.copytree(both / name, tmp_path / name)
        done = run(tmp_path / name, "publish", "--jobs", "1", "--allow-poor")
        assert done.status == 0, done.err
    assert run(tmp_path / "one", "build", "--status").status == 0
    assert identity(tmp_path / "one") == identity(tmp_path / "all")
    assert "Choi et al. 2016" in (tmp_path / "one" / "benchmark" / "README.md").read_text()
    assert run(tmp_path / "one", "verify", "benchmark").status == 0
    # Again: nothing is fetched, as no server is there but for the list, which is here.
    again = run(tmp_path / "one", "fetch", ".", "--stream", variables=HERE)
    assert again.status == 0 and "2 scans chosen, 0 fetched now, 0 failed" in again.out


def test_what_needs_the_deleted_frames_says_how_to_get_them(
    command: Command, both: Path, tmp_path: Path
) -> None:
    shutil.copytree(both / "one", tmp_path / "one")
    done = command(tmp_path / "one", "build", "00021", "--jobs", "1", "--set", "views.count=2")
    text = " ".join(done.err.split())
    assert (
        done.status == 1 and "its frames were deleted after the build; fetch the scan again and run" in text
    )
    gone = command(tmp_path / "one", "build", "00021", "--jobs", "1", "--force")
    assert gone.status == 1 and "Traceback" not in gone.err
    shutil.copytree(both / "scans", tmp_path / "one" / "scans", dirs_exist_ok=True)
    back = command(tmp_path / "one", "build", "00021", "--jobs", "1", "--force", "--set", "views.count=2")
    assert back.status == 0, back.err


def test_streaming_keeps_to_its_disk(
    command: Command, both: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("no_proxy", "*")
    root = write_recipe(tmp_path / "r", "http://127.0.0.1:9")
    with ScanServer(served(both / "scans")) as server:
        (root / "sources.yaml").write_text(SOURCES.format(bases=server.url))
        monkeypatch.setattr(cli_recipe, "STREAM_BYTES", 1_000_000)
        large = command(tmp_path, "fetch", "r", "--stream")
        monkeypatch.setattr(cli_recipe, "STREAM_BYTES", 302_000_000)
        (root / "other").write_bytes(bytes(2_000_000))
        full = command(tmp_path, "fetch", "r", "--stream")
    assert large.status == 1 and large.err.count("are too large for --stream; fetch it without") == 2
    text = " ".join(full.err.split())
    assert (
        full.status == 1
        and "the next scan and its build may take 0.30 GB, and --stream keeps to 0 GB" in text
    )
    assert not list((root / "scans").glob("*.zip*")) and full.err.count("error:") == 1


def test_a_scan_that_cannot_be_read_is_deleted_and_its_reason_stays(
    command: Command, both: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("rgb/0000001-000000000000.jpg", b"no image")
    monkeypatch.setenv("no_proxy", "*")
    with ScanServer({**served(both / "scans"), "/00007.zip": packed.getvalue()}) as server:
        root = write_recipe(tmp_path / "r", server.url)
        words = ("fetch", "r", "--stream", "--category", "table")
        first = command(tmp_path, *words)
        assert (
            first.status == 1 and "only colour" in first.err and not (root / "scans" / "00007.zip").exists()
        )
        asked = len(server.asked)
        again = command(tmp_path, *words)
        assert again.status == 1 and "failed before: " in again.err and len(server.asked) == asked
    built = command(root, "build")
    assert built.status == 1 and "only colour" in built.err and "no such recording" not in built.err


FULL = "/x: the disk is full: free some space and run the command again"


@pytest.mark.parametrize(
    ("left", "failure", "version", "outcome"),
    [
        ((), None, __version__, "fetched"),
        ((), RecordingError("no depth"), __version__, "failed before: no depth"),
        ((), RecordingError("no depth"), "0.0.1", "fetched"),  # another version may read it
        (("sequence",), StorageError(FULL), __version__, "fetched"),
        (("sequence",), OSError(28, "No space"), __version__, "fetched"),
        (("sequence",), None, __version__, "fetched"),  # killed, or too full a disk for failed.json
        (("sequence", "pairs"), None, __version__, ""),
        (("sequence", "pairs"), StorageError(FULL), __version__, ""),  # of a later run
        (("sequence", "pairs"), RecordingError("no depth"), __version__, ""),
    ],
)
def test_only_what_would_fail_again_is_not_fetched_again(
    left: tuple[str, ...], failure: Exception | None, version: str, outcome: str, tmp_path: Path
) -> None:
    build = tmp_path / "build" / "a"
    build.mkdir(parents=True)
    artefacts = [Artefact(build / name, name, 1, {}, {}) for name in ("sequence", "pairs")]
    for artefact in artefacts:
        if artefact.folder.name in left:
            with artefact.write() as folder:
                (folder / "000000.png").write_bytes(b"depth")
    slim(build)
    if failure is not None:
        keep_failure(build, "ingest", str(failure), failure, artefacts[0])
        stored = Failed.read(build)
        if stored.package_version is not None:
            stored.model_copy(update={"package_version": version}).write(build)
    scan: Any = SimpleNamespace(id="a", scan="a", path="scans/a", folder="scans/a", archive="scans/a.tgz")
    asked = []
    files = sorted(build.rglob("*"))

    def fetch(scan: Any, room: object) -> FetchedScan:
        asked.append(scan.id)
        return FetchedScan(scan, False, "a: no answer")

    recipe: Any = SimpleNamespace(out=tmp_path, fetch=fetch, other_attribution=lambda scans: [])
    with pytest.MonkeyPatch.context() as patch:
        rows: list[FetchedScan] = []
        patch.setattr(cli_recipe, "_tell", lambda common, recipe, told, then: rows.extend(told))
        cli_recipe._stream(Common(), recipe, [scan])
    (row,) = rows
    assert row.error == {"fetched": "a: no answer", "": None}.get(outcome, f"a: {outcome}")
    assert asked == (["a"] if outcome == "fetched" else [])
    kept = [path for path in files if outcome or path.name != Failed.FILE]
    assert sorted(build.rglob("*")) == kept  # no server answered: what was built stays


def test_what_was_slimmed_is_deleted_once_its_scan_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build = tmp_path / "build" / "a"
    with Artefact(build / "sequence", "sequence", 1, {}, {}).write() as folder:
        (folder / "000000.png").write_bytes(b"depth")
    slim(build)
    scan: Any = SimpleNamespace(id="a", scan="a", path="scans/a", folder="scans/a", archive="scans/a.tgz")

    def add(scans: object) -> None:
        raise StorageError(str(build.exists()))

    recipe: Any = SimpleNamespace(
        out=tmp_path, fetch=lambda scan, room: FetchedScan(scan, True), add_to_benchmark=add
    )
    with pytest.raises(StorageError, match="False"):
        cli_recipe._stream(Common(), recipe, [scan])


def test_a_scan_by_several_cameras_comes_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    places = {"path": "scans/x", "folder": "scans/x", "archive": "scans/x.tgz", "scan": "x"}
    scans: Any = [SimpleNamespace(id=f"x_{number}", **places) for number in range(3)]
    came = []

    def fetch(scan: Any, room: object) -> FetchedScan:
        came.append((scan.id, (tmp_path / scan.path).exists()))
        (tmp_path / scan.path).mkdir(parents=True, exist_ok=True)
        return FetchedScan(scan, True)

    settings = SimpleNamespace(by_id=lambda: {scan.id: None for scan in scans})
    monkeypatch.setattr("kinectbench.settings.file.load_benchmark", lambda path: settings)
    monkeypatch.setattr(
        "kinectbench.cli.build.build_jobs", lambda jobs, until, workers: [SimpleNamespace(error=None)]
    )
    monkeypatch.setattr(cli_recipe, "_tell", lambda *words: 0)
    recipe: Any = SimpleNamespace(out=tmp_path, fetch=fetch, add_to_benchmark=lambda scans: None)
    assert cli_recipe._stream(Common(), recipe, scans) == 0
    assert came == [("x_0", False), ("x_1", True), ("x_2", True)]
    assert not (tmp_path / "scans" / "x").exists()


def test_partial_downloads_of_another_scan_stay(tmp_path: Path) -> None:
    scan = Scan(id="x", scan="x", file="x.tgz", category="c", object="x", split="test")
    (tmp_path / "scans").mkdir()
    names = ("x.tgz.0123abcd.part", "x.1.tgz.0123abcd.part")
    for name in names:
        (tmp_path / "scans" / name).touch()
    remove_scan(tmp_path, scan)
    assert [path.name for path in (tmp_path / "scans").iterdir()] == [names[1]]
