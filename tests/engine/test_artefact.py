"""Artefacts on disk: fingerprints, whole or not at all, locks, disks that refuse."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from raising import raises

from kinectbench.core.artefacts.manifest import Manifest
from kinectbench.core.errors import StorageError
from kinectbench.core.storage import (
    canonical_json,
    pretty_json,
    replaced_file,
    replaced_folder,
    sha256_file,
    sha256_text,
    storage_errors,
)
from kinectbench.engine.artefact import Artefact, content_hash, fingerprint
from kinectbench.engine.locks import locked

# SHA-256 of "abc", FIPS 180-2, appendix B.1
ABC = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def artefact(folder: Path, **settings: Any) -> Artefact:
    return Artefact(folder / "object", "segment", 3, settings or {"cut_m": 0.02}, {"mesh": "00"})


def write(made: Artefact, text: str = "shape") -> None:
    with made.write() as folder:
        (folder / "sub").mkdir()
        (folder / "sub" / "mesh.ply").write_text(text)


def leftovers(folder: Path) -> list[str]:
    return sorted(
        path.name for path in folder.iterdir() if path.name.startswith(".") and path.name != ".lock"
    )


def test_json_and_checksums(tmp_path: Path) -> None:
    assert canonical_json({"b": 1, "a": [1.5, None]}) == '{"a":[1.5,null],"b":1}'
    assert pretty_json({"b": 1, "a": 2}) == '{\n "b": 1,\n "a": 2\n}\n'
    with pytest.raises(ValueError, match="not JSON compliant"):
        canonical_json(float("nan"))
    (tmp_path / "abc").write_bytes(b"abc")
    assert sha256_text("abc") == sha256_file(tmp_path / "abc") == ABC


def test_a_fingerprint_changes_with_what_goes_in_and_with_nothing_else() -> None:
    first = fingerprint("fuse", 1, {"voxel_size_m": 0.005, "seed": 0}, {"sequence": "aa"})
    assert first == fingerprint("fuse", 1, {"seed": 0, "voxel_size_m": 0.005}, {"sequence": "aa"})
    others = {
        fingerprint("fuse", 1, {"voxel_size_m": 0.006, "seed": 0}, {"sequence": "aa"}),
        fingerprint("fuse", 1, {"voxel_size_m": 0.005, "seed": 0}, {"sequence": "ab"}),
        fingerprint("fuse", 1, {"voxel_size_m": 0.005, "seed": 0}, {"sequence": "aa", "trajectory": "cc"}),
        fingerprint("track", 1, {"voxel_size_m": 0.005, "seed": 0}, {"sequence": "aa"}),
        fingerprint("fuse", 1, {"voxel_size_m": 0.005}, {"sequence": "aa"}),
        fingerprint("fuse", 2, {"voxel_size_m": 0.005, "seed": 0}, {"sequence": "aa"}),
    }
    assert first not in others and len(others) == 6


def test_an_artefact_is_current_once_written(tmp_path: Path) -> None:
    made = artefact(tmp_path)
    assert not made.is_current()
    write(made)
    assert made.is_current()
    assert not artefact(tmp_path, cut_m=0.03).is_current()
    manifest = json.loads((made.folder / Manifest.FILE).read_text())
    assert manifest["files"] == {"sub/mesh.ply": 5}
    assert manifest["fingerprint"] == made.fingerprint and manifest["stage_version"] == 3
    assert leftovers(tmp_path) == []


def test_another_version_of_the_stage_makes_it_stale_but_another_package_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = artefact(tmp_path)
    write(made)
    assert not replace(made, version=4).is_current()
    monkeypatch.setattr("kinectbench.engine.artefact.__version__", "99.0.0")
    assert made.is_current()


def test_a_manifest_without_stage_version_is_readable_but_not_current(tmp_path: Path) -> None:
    made = artefact(tmp_path)
    write(made)
    path = made.folder / Manifest.FILE
    earlier = {key: value for key, value in json.loads(path.read_text()).items() if key != "stage_version"}
    path.write_text(pretty_json(earlier | {"fingerprint": "0" * 64}))
    assert not made.is_current()


def test_the_same_artefact_has_the_same_bytes_elsewhere(tmp_path: Path) -> None:
    texts = []
    for place in ("a", "b"):
        write(artefact(tmp_path / place))
        texts.append((tmp_path / place / "object" / Manifest.FILE).read_bytes())
    assert texts[0] == texts[1]


@pytest.mark.parametrize("damage", ["missing", "truncated", "no manifest", "broken manifest", "other json"])
def test_a_damaged_artefact_is_not_current(tmp_path: Path, damage: str) -> None:
    made = artefact(tmp_path)
    write(made)
    file, manifest = made.folder / "sub" / "mesh.ply", made.folder / Manifest.FILE
    match damage:
        case "missing":
            file.unlink()
        case "truncated":
            file.write_text("sha")
        case "no manifest":
            manifest.unlink()
        case "broken manifest":
            manifest.write_text(manifest.read_text()[:-20])
        case "other json":
            manifest.write_text("[]")
    assert not made.is_current()
    write(made)
    assert made.is_current()


def test_timings_do_not_count(tmp_path: Path) -> None:
    made = artefact(tmp_path)
    with made.write() as folder:
        (folder / "timing.json").write_text("{}")
    (made.folder / "timing.json").unlink()
    assert made.is_current()


def test_a_failed_write_leaves_the_old_artefact(tmp_path: Path) -> None:
    made = artefact(tmp_path)
    write(made, "old")
    with pytest.raises(RuntimeError, match="halfway"), made.write() as folder:
        (folder / "mesh.ply").write_text("new")
        raise RuntimeError("halfway")
    assert made.is_current()
    assert (made.folder / "sub" / "mesh.ply").read_text() == "old"
    assert leftovers(tmp_path) == []


def test_a_killed_write_leaves_the_old_artefact_and_the_next_lock_sweeps_up(tmp_path: Path) -> None:
    made = artefact(tmp_path)
    write(made, "old")
    code = (
        "import os, signal, sys; from pathlib import Path\n"
        "from kinectbench.core.storage import replaced_folder\n"
        "with replaced_folder(Path(sys.argv[1])) as folder:\n"
        "    (folder / 'mesh.ply').write_text('new'); os.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(made.folder)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert made.is_current()
    (tmp_path / ".scores.json.1.part").write_text("a file that was being replaced")
    assert len(leftovers(tmp_path)) == 2
    with locked(tmp_path):
        assert leftovers(tmp_path) == []
    assert made.is_current()


def test_a_place_that_can_hold_no_file_is_told(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "gone").symlink_to("nothing/there")
    for name, words in (("pipe", "is no file"), ("folder", "is no file"), ("gone/a", "the way to it holds")):
        with pytest.raises(StorageError, match=f"{name}: {words}"), replaced_file(tmp_path / name) as part:
            part.write_text("new", encoding="utf-8")
    if Path("/proc/self").is_dir():  # where nothing can be made
        with raises(StorageError, "storage.no-way"), replaced_file(Path("/proc/a.html")):
            pass
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "gone", "pipe"]


def test_replaced_file_is_whole_or_old(tmp_path: Path) -> None:
    path = tmp_path / "new folder" / "scores.json"
    with replaced_file(path) as temporary:
        temporary.write_text("first")
        assert not path.exists()
    with pytest.raises(RuntimeError), replaced_file(path) as temporary:
        temporary.write_text("sec")
        raise RuntimeError
    assert path.read_text() == "first"
    assert leftovers(path.parent) == []


def test_two_who_replace_one_file_write_two_temporary_ones(tmp_path: Path) -> None:
    """Containers that share a disk may have the same process id, as two threads have."""
    with replaced_file(tmp_path / "a") as first, replaced_file(tmp_path / "a") as second:
        first.write_text("first")
        second.write_text("second")
        assert first.read_text() == "first"
    assert (tmp_path / "a").read_text() == "first"
    assert leftovers(tmp_path) == []


def test_replacing_a_folder_leaves_none_of_the_old_files(tmp_path: Path) -> None:
    for name in ("a", "b"):
        with replaced_folder(tmp_path / "views") as folder:
            (folder / name).write_text(name)
    assert [path.name for path in (tmp_path / "views").iterdir()] == ["b"]
    assert leftovers(tmp_path) == []


@pytest.mark.parametrize("last", [0, 1])
def test_an_interrupt_while_a_folder_is_replaced_leaves_the_old_or_the_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, last: int
) -> None:
    """Ctrl-C comes after the first or the second of the two renames."""
    made, rename, renamed = artefact(tmp_path), Path.rename, list[Path]()
    write(made, "old")

    def interrupted(path: Path, target: Path) -> Path:
        renamed.append(rename(path, target))
        if len(renamed) == last + 1:
            raise KeyboardInterrupt
        return target

    monkeypatch.setattr(Path, "rename", interrupted)
    with pytest.raises(KeyboardInterrupt), made.write() as folder:
        (folder / "sub").mkdir()
        (folder / "sub" / "mesh.ply").write_text("new")
    assert (made.folder / "sub" / "mesh.ply").read_text() == ("old", "new")[last]
    with locked(tmp_path):
        assert leftovers(tmp_path) == []


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENOSPC, "the disk is full: free some space"),
        (errno.EDQUOT, "the disk quota is used up"),
        (errno.EROFS, "the disk is read-only"),
        (errno.EACCES, "no permission to write there"),
    ],
)
def test_a_disk_that_refuses_gets_one_line_and_loses_nothing(tmp_path: Path, number: int, words: str) -> None:
    made = artefact(tmp_path)
    write(made, "old")
    with pytest.raises(StorageError) as caught, made.write() as folder:
        (folder / "mesh.ply").write_text("ne")
        raise OSError(number, os.strerror(number), str(folder / "mesh.ply"))
    message = str(caught.value)
    assert words in message and str(made.folder) in message and "\n" not in message
    assert made.is_current()
    assert leftovers(tmp_path) == []


def test_a_full_disk_while_the_manifest_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = artefact(tmp_path)
    write(made, "old")
    whole_write = Path.write_text

    def full(self: Path, *args: Any, **kwargs: Any) -> int:
        if self.name == Manifest.FILE:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return whole_write(self, *args, **kwargs)

    monkeypatch.setattr(Path, "write_text", full)
    with raises(StorageError, "storage.not-writable"):
        write(made, "new")
    monkeypatch.undo()
    assert made.is_current() and leftovers(tmp_path) == []


def test_other_errors_of_the_system_pass_unchanged(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), storage_errors(tmp_path):
        (tmp_path / "nothing").read_text()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(StorageError, match="no permission"):
            write(artefact(tmp_path / "build"))
    finally:
        tmp_path.chmod(0o700)


def test_a_lock_keeps_a_second_process_waiting(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from kinectbench.engine.locks import locked\n"
        "print('ready', flush=True)\n"
        "with locked(Path(sys.argv[1])): print('in', flush=True)"
    )
    with locked(tmp_path):
        second = subprocess.Popen(
            [sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE, text=True
        )
        assert second.stdout is not None
        assert second.stdout.readline() == "ready\n"
        time.sleep(0.3)
        assert second.poll() is None
    rest, _ = second.communicate(timeout=20)
    assert rest == "in\n" and second.returncode == 0


def test_a_lock_of_a_killed_process_is_free(tmp_path: Path) -> None:
    code = (
        "import os, signal, sys; from pathlib import Path; from kinectbench.engine.locks import locked\n"
        "with locked(Path(sys.argv[1])): os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)
    with locked(tmp_path):
        pass


def test_a_disk_without_any_room_keeps_the_lock_without_a_name(tmp_path: Path) -> None:
    program = (
        "import resource, signal, sys; from pathlib import Path\n"
        "from kinectbench.engine.locks import locked\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN); resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))\n"
        "with locked(Path(sys.argv[1])): pass"
    )
    done = subprocess.run([sys.executable, "-c", program, str(tmp_path)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_another_file_of_equal_name_size_and_time_is_read(tmp_path: Path) -> None:
    """Two raw logs of one archive have one name in the cache: each is the whole recording."""
    logs = [tmp_path / "a.klg", tmp_path / "b.klg"]
    for log in logs:
        log.write_text(log.name)
        os.utime(log, (1, 1))
    cached = [content_hash([log], log, cache=tmp_path / "sources.json") for log in logs]
    assert cached == [content_hash([log], log) for log in logs]
    assert cached[0] != cached[1]
