"""Recipes: scans of a list come here, are locked, and stand in the benchmark; nothing climbs out of it."""

import gzip
import io
import json
import shutil
import tarfile
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from scan_server import ScanServer
from small_benchmark import Run
from small_recipe import SOURCES, write_recipe

from kinectbench.core.errors import StorageError
from kinectbench.core.store.attempts import PATIENCE_VARIABLE
from kinectbench.release import recipe as recipes
from kinectbench.release.unpack import unpack_archive
from kinectbench.settings.file import load_benchmark
from kinectbench.settings.sources import chosen_scans, read_sources

Command = Callable[..., Run]
IDS = [f"{number:05d}" for number in range(1, 13)]


def zipped(content: str) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("depth/0000001-000000000000.png", content * 20_000)
    return packed.getvalue()


FILES = {f"/{name}.zip": zipped(name) for name in IDS}
LISTED = {"seat": IDS[:8], "table": IDS[8:], "car": ["00099"]}
INDEX = json.dumps(LISTED).encode()


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[ScanServer]:
    monkeypatch.setenv(PATIENCE_VARIABLE, "1")
    monkeypatch.setenv("no_proxy", "*")
    with ScanServer({**FILES, "/categories.json": INDEX}) as found:
        yield found


def fetched(folder: Path) -> list[str]:
    return sorted(path.stem for path in (folder / "scans").glob("*.zip"))


def test_a_recipe_with_two_interruptions_and_a_lying_server(
    command: Command, server: ScanServer, tmp_path: Path
) -> None:
    with ScanServer({**FILES, "/categories.json": INDEX}, lambda number, path: "short") as lying:
        recipe = write_recipe(tmp_path / "r", server.url)
        assert command(tmp_path, "fetch", "r", "--limit", "1").status == 0
        first = fetched(recipe)
        assert len(first) == 2  # one of each category
        for path in (recipe / "scans").glob("*.zip"):
            path.unlink()
        (recipe / "sources.yaml").write_text(SOURCES.format(bases=f"{lying.url}, {server.url}"))
        server.choose = lambda number, path: "cut" if number in (3, 5) else ""
        done = command(tmp_path, "fetch", "r", "--limit", "1")
        assert (done.status, done.err) == (0, "") and fetched(recipe) == first
        assert [path for path, asked in server.asked if asked] != []  # it went on
    for name in first:
        assert (recipe / "scans" / f"{name}.zip").read_bytes() == FILES[f"/{name}.zip"]
    rows = load_benchmark(recipe / "benchmark.yaml").by_id()
    assert sorted(rows) == first and {row.category for row in rows.values()} == {"chair", "table"}
    assert {(row.license, row.source) for row in rows.values()} == {("CC0-1.0", "Choi et al. 2016")}


def test_a_larger_limit_adds_and_keeps(command: Command, server: ScanServer, tmp_path: Path) -> None:
    recipe = write_recipe(tmp_path / "r", server.url)
    command(tmp_path, "fetch", "r", "--limit", "2", "--category", "chair")
    first = fetched(recipe)
    text = (recipe / "recordings.yaml").read_text()
    changed = text.replace("category: chair", "underside: closed\n    category: chair", 1)
    (recipe / "recordings.yaml").write_text(changed)
    asked = len(server.asked)
    done = command(tmp_path, "fetch", "r", "--limit", "4", "--category", "chair", "--json")
    rows = json.loads(done.out)["scans"]
    assert [row["fetched"] for row in rows] == [row["id"] not in first for row in rows]
    assert set(first) < set(fetched(recipe)) and len(server.asked) == asked + 2
    assert (recipe / "recordings.yaml").read_text().startswith(changed)
    assert server.most_at_once <= recipes.AT_ONCE


def test_what_came_first_is_locked(command: Command, server: ScanServer, tmp_path: Path) -> None:
    recipe = write_recipe(tmp_path / "r", server.url)
    command(tmp_path, "fetch", "r", "--category", "table")
    locked = json.loads((recipe / "sources.lock").read_text())["files"]
    assert set(locked) == {"categories.json", *(f"{name}.zip" for name in IDS[8:])}
    (recipe / "scans" / "00009.zip").unlink()
    (recipe / "scans" / "00010.zip").write_bytes(b"PK\x03\x04 damaged")
    server.files["/00009.zip"] = zipped("99999")
    done = command(tmp_path, "fetch", "r", "--category", "table")
    assert done.status == 3 and "Traceback" not in done.err
    text = " ".join(done.err.split())
    assert "00009: 00009.zip cannot be fetched" in text and "sends other bytes than came first" in text
    assert "00010.zip: differs from the file of the first download; remove it to fetch it again" in text
    assert json.loads((recipe / "sources.lock").read_text())["files"] == locked


def test_the_scans_go_to_another_folder(command: Command, server: ScanServer, tmp_path: Path) -> None:
    recipe = write_recipe(tmp_path / "r", server.url)
    assert command(tmp_path, "fetch", "r", "--category", "table", "--out", "bench").status == 0
    assert fetched(tmp_path / "bench") == IDS[8:] and not (recipe / "scans").exists()
    assert len(load_benchmark(tmp_path / "bench" / "benchmark.yaml").recordings) == 4
    assert (recipe / "sources.lock").is_file()


def test_two_fetches_to_two_folders_keep_each_others_hashes(server: ScanServer, tmp_path: Path) -> None:
    folder = write_recipe(tmp_path / "r", server.url)
    sources, locked = read_sources(folder), folder / "sources.lock"

    def opened(out: str) -> recipes.Recipe:
        return recipes.Recipe(folder, tmp_path / out, sources, lambda _path: True, {})

    one, other = opened("one"), opened("other")
    scans = {scan.id: scan for scan in one.chosen(("table",))}
    assert one.fetch(scans["00009"]).error is None and other.fetch(scans["00010"]).error is None
    assert json.loads(locked.read_text())["files"].keys() >= {"00009.zip", "00010.zip"}
    server.files["/00011.zip"] = zipped("first")
    assert one.fetch(scans["00011"]).error is None
    server.files["/00011.zip"] = zipped("second")
    late = other.fetch(scans["00011"]).error
    assert late is not None and "00011.zip: differs from the file of the first download; remove it" in late


def test_a_missing_scan_does_not_stop_the_others(
    command: Command, server: ScanServer, tmp_path: Path
) -> None:
    recipe = write_recipe(tmp_path / "r", server.url)
    del server.files["/00011.zip"]
    done = command(tmp_path, "fetch", "r", "--category", "table")
    assert done.status == 3 and "00011.zip cannot be fetched: 127.0.0.1" in done.err and "404" in done.err
    assert [row.id for row in load_benchmark(recipe / "benchmark.yaml").recordings].count("00011") == 0


def test_a_full_disk_is_told_before_a_scan_comes(
    command: Command, server: ScanServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_recipe(tmp_path / "r", server.url)
    command(tmp_path, "fetch", "r", "--category", "table", "--limit", "1")

    class Full:
        free = 1000

    monkeypatch.setattr(shutil, "disk_usage", lambda path: Full)
    done = command(tmp_path, "fetch", "r", "--category", "table")
    assert done.status == 1 and "free some space, or use --stream" in " ".join(done.err.split())
    assert len(done.err.strip().splitlines()) == 1


def test_without_a_network_one_line_ends_it(command: Command, tmp_path: Path) -> None:
    with ScanServer({**FILES, "/categories.json": INDEX}) as server:
        write_recipe(tmp_path / "r", server.url)
        command(tmp_path, "fetch", "r", "--category", "table", "--limit", "1")
    (tmp_path / "r" / "sources.yaml").write_text(
        SOURCES.format(bases="https://one.invalid, https://two.invalid")
    )
    done = command(tmp_path, "fetch", "r")
    assert done.status == 1 and "one.invalid: no such host is known" in " ".join(done.err.split())
    assert "two.invalid" in done.err and done.err.count("error:") == 1


def test_servers_that_are_gone_end_it_soon(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(PATIENCE_VARIABLE, "1")
    monkeypatch.setenv("no_proxy", "*")
    with ScanServer({**FILES, "/categories.json": INDEX}) as server:
        write_recipe(tmp_path / "r", server.url)
        command(tmp_path, "fetch", "r", "--category", "table", "--limit", "1")
    begun = time.monotonic()
    done = command(tmp_path, "fetch", "r")
    assert done.status == 1 and "run the same command again when it does" in " ".join(done.err.split())
    assert done.err.count("error:") == 1 and time.monotonic() - begun < 8


def test_a_list_that_somebody_wrote_otherwise_is_left_as_it_is(
    command: Command, server: ScanServer, tmp_path: Path
) -> None:
    recipe = write_recipe(tmp_path / "r", server.url)
    text = "recordings: [{id: own, path: own, category: chair}]\n"
    (recipe / "recordings.yaml").write_text(text)
    done = command(tmp_path, "fetch", "r", "--limit", "1")
    assert done.status == 2 and "nothing can be added to it" in " ".join(done.err.split())
    assert (recipe / "recordings.yaml").read_text() == text
    assert (
        command(tmp_path, "fetch", "r", "--out", "r/benchmark.yaml")
        .err.strip()
        .endswith("a file; name a folder")
    )


def test_the_split_is_of_objects_and_does_not_depend_on_the_limit(server: ScanServer, tmp_path: Path) -> None:
    text = SOURCES + "objects: {'00003': '00001', '00005': '00001'}\n"
    sources = read_sources(
        write_recipe(tmp_path / "r", server.url, sources=text.replace("{'", "{{'").replace("'}", "'}}"))
    )
    scans = {scan.id: scan for scan in chosen_scans(sources, LISTED)}
    assert len({scans[name].split for name in ("00001", "00003", "00005")}) == 1
    assert {scan.split for scan in scans.values()} == {"test", "validation"}
    few = chosen_scans(sources, LISTED, ("chair",), 3)
    assert len(few) == 3 and few == chosen_scans(sources, LISTED, ("chair",), 5)[:3]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"{{id}}.zip"', '"../{{id}}.zip"', "sources.yaml:3: file: '../0.zip' leads out of the folder"),
        ('"{{id}}.zip"', '"/etc/{{id}}"', "leads out of the folder"),
        ('"{{id}}.zip"', '"{{id}}?.zip"', "use letters, digits"),
        ('"{{id}}.zip"', '"one.zip"', "must hold {id}"),
        (
            "bases: [{bases}]\nfile",
            "bases: ['file:///etc']\nfile",
            "bases.0: wanted an address that begins with",
        ),
        (
            "bases: [{bases}]\nfile",
            "bases: ['s3://b/c']\nfile",
            "wanted an address that begins with https://",
        ),
        ("bases: [{bases}]\nfile", "bases: [3]\nfile", "bases"),
        ("seat: chair", "seat: [1]", "categories"),
        ("seat: chair", "seat: ../x", "use letters"),
        ("validation: 0.5", "validation: 2", "validation: found 2; wanted a number from 0 to 1"),
        ("validation: 0.5", "train: 0.6, validation: 0.5", "more than 1 together"),
        ("format_version: 1", "format_version: 2", "format_version: found 2; wanted 1"),
        ("split:", "splits:", "unknown key; did you mean 'split'?"),
        ("camera: {{", "camera: {{zoom: 2, ", "camera.zoom: unknown key; valid here: width, height"),
        ("index: {{", "index: {{md5: a, ", "index.md5: unknown key; valid here: bases, file, sha256"),
        (
            "index: {{",
            "scans: [{{id: a, category: seat, colour: 1}}]\nindex: {{",
            "scans.0.colour: unknown key; valid here: id",
        ),
        ("license: CC0-1.0\n", "", "license: missing; wanted text"),
    ],
)
def test_a_wrong_sources_yaml_is_a_line(
    command: Command, tmp_path: Path, old: str, new: str, words: str
) -> None:
    assert old in SOURCES
    recipe = write_recipe(tmp_path / "r", "http://127.0.0.1:9", sources=SOURCES.replace(old, new))
    done = command(tmp_path, "fetch", "r")
    assert done.status == 2 and words in " ".join(done.err.split()), done.err
    assert len(done.err.strip().splitlines()) == 1 and not (recipe / "scans").exists()


@pytest.mark.parametrize(
    ("index", "words"),
    [
        ({"seat": ["../../up"]}, "'seat.0': use letters"),
        ({"seat": ["a/b"]}, "use letters, digits"),
        ({"seat": "00001"}, "'seat': Input should be"),
        ({"seat": ["00001", "00001"]}, "'00001' is listed twice"),
        ({"other": ["00001"]}, "no scan of chair, table is listed"),
        ([1], "Input should be an object"),
    ],
)
def test_a_wrong_index_is_a_line(
    command: Command, server: ScanServer, tmp_path: Path, index: object, words: str
) -> None:
    write_recipe(tmp_path / "r", server.url)
    server.files["/categories.json"] = json.dumps(index).encode()
    done = command(tmp_path, "fetch", "r")
    assert done.status in (1, 2) and words in " ".join(done.err.split()), done.err
    assert len(done.err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    "text", ["{", '{"files": {"../a": 1}}', '{"files": {"a": {"bytes": -1, "sha256": ""}}}', "\0"]
)
def test_a_wrong_lock_is_a_line(command: Command, server: ScanServer, tmp_path: Path, text: str) -> None:
    (write_recipe(tmp_path / "r", server.url) / "sources.lock").write_text(text)
    done = command(tmp_path, "fetch", "r")
    assert done.status == 2 and "sources.lock" in done.err and len(done.err.strip().splitlines()) == 1


def tgz(members: dict[str, bytes | str]) -> bytes:
    """An archive; a text is where a link leads."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as archive:
        for name, content in members.items():
            info = tarfile.TarInfo(name)
            if isinstance(content, str):
                info.type, info.linkname = tarfile.SYMTYPE, content
                archive.addfile(info)
            else:
                info.size = len(content)
                archive.addfile(info, io.BytesIO(content))
    return packed.getvalue()


def zip_of(members: dict[str, bytes]) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return packed.getvalue()


def plain_tar(members: dict[str, bytes | str]) -> bytes:
    return gzip.decompress(tgz(members))


def tum(folder: Path, server: ScanServer, archive: bytes, name: str = "plant.tgz") -> Path:
    """A recipe of one archive without an index."""
    server.files[f"/f1/{name}"] = archive
    text = SOURCES.replace("index: {{bases: [{bases}], file: categories.json}}\n", "").replace(
        "seat: chair", "seat: p"
    )
    text += "scans: [{{id: plant, category: seat, file: f1/" + name + ", object: thing}}]\n"
    return write_recipe(folder, server.url, sources=text)


def test_a_tgz_becomes_a_folder(command: Command, server: ScanServer, tmp_path: Path) -> None:
    members: dict[str, bytes | str] = {
        "set/depth.txt": b"1",
        "set/depth/a.png": b"2",
        "set/up": "/etc",
        "set/._x": b"3",
    }
    recipe = tum(tmp_path / "r", server, tgz(members))
    assert command(tmp_path, "fetch", "r").status == 0
    found = {
        path.relative_to(recipe / "scans").as_posix()
        for path in (recipe / "scans").rglob("*")
        if path.is_file()
    }
    assert found == {".lock", "plant/depth.txt", "plant/depth/a.png"}
    (row,) = load_benchmark(recipe / "benchmark.yaml").recordings
    assert (row.path, row.object, row.camera and row.camera.fx) == ("scans/plant", "thing", 131.25)
    asked = len(server.asked)
    assert command(tmp_path, "fetch", "r").status == 0 and len(server.asked) == asked


FOLDER = {"set/depth.txt": b"1", "set/depth/a.png": b"2"}


@pytest.mark.parametrize(
    ("name", "archive"),
    [("plant.zip", zip_of({**FOLDER, "set/.x": b"3"})), ("plant.tar", plain_tar({**FOLDER}))],
)
def test_a_folder_in_a_zip_or_a_plain_tar_is_unpacked(
    command: Command, server: ScanServer, tmp_path: Path, name: str, archive: bytes
) -> None:
    recipe = tum(tmp_path / "r", server, archive, name)
    assert command(tmp_path, "fetch", "r").status == 0
    found = {path.relative_to(recipe / "scans").as_posix() for path in (recipe / "scans").rglob("*.*")}
    assert found == {".lock", "plant/depth.txt", "plant/depth/a.png"}
    (row,) = load_benchmark(recipe / "benchmark.yaml").recordings
    assert row.path == "scans/plant"
    asked = len(server.asked)
    assert command(tmp_path, "fetch", "r").status == 0 and len(server.asked) == asked


def test_a_tar_that_ends_in_a_zip_is_a_tar(tmp_path: Path) -> None:
    (tmp_path / "a.tar").write_bytes(plain_tar({"a/b": b"1", "a/c.zip": zip_of({"d": b"2"})}))
    unpack_archive(tmp_path / "a.tar", tmp_path / "a")
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == ["b", "c.zip"]


def test_a_zip_says_less_than_it_unpacks_to(tmp_path: Path) -> None:
    whole = zip_of({"a/b": bytes(1 << 20)})
    lying = whole.replace((1 << 20).to_bytes(4, "little"), (10).to_bytes(4, "little"))
    (tmp_path / "a.zip").write_bytes(lying)
    with pytest.raises(StorageError, match="cannot be unpacked"):
        unpack_archive(tmp_path / "a.zip", tmp_path / "a")
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(
    ("archive", "words"),
    [
        (tgz({"../../up": b"1"}), "leads out of the folder"),
        (tgz({"/etc/up": b"1"}), "leads out of the folder"),
        (tgz({"a": bytes(80 << 20), "b": bytes(80 << 20)}), "it unpacks to more than"),
        (tgz({"a": b"1" * 5000})[:-30], "cannot be unpacked"),
        (b"\x1f\x8b no gzip", "cannot be unpacked"),
    ],
    ids=["upwards", "absolute", "bomb", "cut", "none"],
)
def test_a_hostile_tgz_is_a_line(
    command: Command, server: ScanServer, tmp_path: Path, archive: bytes, words: str
) -> None:
    tum(tmp_path / "r", server, archive)
    done = command(tmp_path, "fetch", "r")
    assert done.status == 1 and words in " ".join(done.err.split()), done.err
    assert not list(tmp_path.rglob("up")) and not (tmp_path / "r" / "scans" / "plant").exists()
