"""A disk that runs full while a release is published, exported or inflated: what was there stays.

The disk is a small tmpfs in a mount namespace of its own, so neither the machine nor other tests notice.
"""

import hashlib
import json
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

# Mounts a disk of so many kilobytes, fills it as it was before, and runs a command on it.
SCRIPT = """
set -e
mount -t tmpfs -o size="$2k" none "$1"
cp -r "$3/." "$1"
cd "$1"
before=$(find . -type f ! -name .lock | sort | xargs sha256sum | sha256sum)
set +e
TMPDIR="$1" "${@:4}" 2> "$1.err" > /dev/null
echo "status $?"
after=$(find . -type f ! -name .lock | sort | xargs sha256sum | sha256sum)
[ "$before" = "$after" ] && echo same || find . -type f
"""
UNSHARE = ["unshare", "--map-root-user", "--mount", "bash", "-c"]

KINECTBENCH = (sys.executable, "-m", "kinectbench")

pytestmark = pytest.mark.skipif(
    subprocess.run([*UNSHARE, "mount -t tmpfs none /mnt"], capture_output=True).returncode != 0,
    reason="this machine does not let a process mount a small disk for itself",
)


def on_small_disk(tmp_path: Path, before: Path, room_kb: int, *command: str) -> tuple[list[str], list[str]]:
    """Run a command on a disk that holds a copy of `before` and has so much room left.

    Returns:
        "status N" and "same", or files that are there now; and the lines of standard error.
    """
    disk = tmp_path / "disk"
    disk.mkdir()
    used_kb = sum(-(-path.stat().st_size // 4096) * 4 for path in before.rglob("*") if path.is_file())
    folders = sum(path.is_dir() for path in before.rglob("*"))
    size_kb = used_kb + 4 * folders + room_kb
    ran = subprocess.run(
        [*UNSHARE, SCRIPT, "bash", disk, str(size_kb), before, *command], capture_output=True, text=True
    )
    assert ran.returncode == 0 or ran.stdout, ran.stderr
    return ran.stdout.splitlines(), Path(f"{disk}.err").read_text(encoding="utf-8").splitlines()


@pytest.mark.parametrize("layout", ["recgan", "bop", "webdataset"])
def test_export(analytic: Path, tmp_path: Path, layout: str) -> None:
    (tmp_path / "before" / "out").mkdir(parents=True)
    earlier = {"files_sha256": hashlib.sha256(b"").hexdigest()}
    (tmp_path / "before" / "out" / "export.json").write_text(json.dumps(earlier))
    release = str(analytic / "benchmark")
    arguments = (*KINECTBENCH, "export", "out", "--layout", layout, "--benchmark", release)
    out, err = on_small_disk(tmp_path, tmp_path / "before", 100, *arguments)
    assert out == ["status 1", "same"]
    assert len(err) == 1 and "the disk is full" in err[0] and "untouched" in err[0]


@pytest.mark.parametrize("room_kb", [8, 600])
def test_publish(analytic: Path, tmp_path: Path, room_kb: int) -> None:
    """Over a release that is there already: the disk is full at once, or after some pairs."""
    here = Path(__file__).parents[1] / "support"
    code = (
        "from synthetic_release import *; from kinectbench.cli.console import lines\n"
        "try: publish(synthetic_settings(), Path('build'), Path('benchmark'), [r[0] for r in RECORDINGS])\n"
        "except Exception as error: lines(type(error).__name__, [str(error)], ''); raise SystemExit(1)"
    )
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(here)!r})\n{code}"]
    out, err = on_small_disk(tmp_path, analytic, room_kb, *command)
    assert out == ["status 1", "same"]
    assert len(err) == 1 and err[0].startswith("StorageError: benchmark: the disk is full")


def test_inflating_an_archive(script_archive: Path, tmp_path: Path) -> None:
    (tmp_path / "before").mkdir()
    out, err = on_small_disk(tmp_path, tmp_path / "before", 20, *KINECTBENCH, "verify", str(script_archive))
    assert out == ["status 1", "same"]
    assert len(err) == 1 and "the disk is full" in err[0]


@pytest.fixture(scope="module")
def script_archive(analytic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = tmp_path_factory.mktemp("packed") / "release.tar.gz"
    with tarfile.open(path, "w:gz") as archive:
        archive.add(analytic / "benchmark", "release")
    return path
