"""What is no plain file: pipes, devices, sockets, folders, links, in the place of files or beside them."""

import os
import shutil
import socket
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from hostile_cases.case import Case, in_turn, on

READ = "inspect recording\ninspect r\ningest --jobs 1\ninit --force ."
PATH_YAML = "name: a\nrecordings: [{{id: r, path: {}, category: chair}}]\n"
SCORE = "score predictions --benchmark release --jobs 1 --no-surface --no-baselines --no-gallery --out scored"
CHECK = "check predictions --benchmark release"
OF_RELEASE = f"""verify release
{SCORE}
{CHECK}
load release
baseline partial --benchmark release --jobs 1 --out made
export exported --layout recgan --benchmark release
export exported --layout bop --benchmark release
export exported --layout webdataset --benchmark release
report --benchmark release --out page.html"""
ANY = (0, 1, 3)


def pipe(path: Path) -> None:
    os.mkfifo(path)


def zero(path: Path) -> None:
    path.symlink_to("/dev/zero")


def everything(path: Path) -> None:
    path.symlink_to("/")


def loop(path: Path) -> None:
    path.symlink_to(path.name)


def listening(path: Path) -> None:
    with tempfile.TemporaryDirectory() as short:
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(f"{short}/s")
        shutil.move(f"{short}/s", path)


KINDS: dict[str, Callable[[Path], None]] = {
    "a pipe": pipe,
    "a link to /dev/zero": zero,
    "a link to /": everything,
    "a socket": listening,
    "a link to itself": loop,
    "a folder": Path.mkdir,
}
FEW = ("a pipe", "a link to /dev/zero")


def cases() -> Iterator[Case]:
    for kind, put in KINDS.items():
        yield from on(READ, Case("H4", f"{kind} beside the frames", "", _beside(put), "tum", ANY))
    for kind in FEW:
        for file in ("depth/*", "rgb/*", "masks/*", "camera.json", "depth.txt", "groundtruth.txt"):
            yield from on(READ, _instead("tum", f"recording/{file}", kind))
        yield from in_turn(
            "ingest --jobs 1\ninspect r",
            *(_instead(whole, file, kind) for whole, file in PLACES),
            others=kind == "a pipe",
        )
        for file in (
            "pairs/chair_01/000.npz",
            "SHA256SUMS",
            "targets.csv",
            "benchmark.json",
            "splits.json",
            "objects/chair_01/mesh.ply",
            "objects/chair_01/volume.npz",
            "views/chair_01/000.depth.png",
            "views/chair_01/views.json",
        ):
            yield from in_turn(
                OF_RELEASE,
                _instead("release", f"release/{file}", kind, errors=25),
                others=8 if kind == "a pipe" and file[0] in "pS" else 2,
            )
        yield from on(
            f"{SCORE}\n{CHECK}", _instead("release", "predictions/chair_01/000.npy", kind, errors=4)
        )
        yield from on(
            "compare scores\ncompare scores/a/scores.json scores/b/scores.json",
            _instead("release", "scores/a/scores.json", kind, (1, 2)),
        )
        yield from on(
            "report --benchmark release --out page.html --scores scores",
            _instead("release", "scores/a/scores.json", kind, (1, 2)),
            _instead("release", "scores/a/gallery.npz", kind),
        )
        yield from on(
            f"{SCORE} --thresholds thresholds.json", _instead("release", "thresholds.json", kind, (1, 2))
        )
        yield from on(
            "ingest --jobs 1\nbuild --jobs 1\ninspect r\npublish\nscore predictions\nreport",
            _instead("tum", "benchmark.yaml", kind, (1, 2)),
        )
        yield from in_turn(
            FILES_GIVEN,
            Case("H4", f"{kind} as a file that is given", "", _given(kind), "release", (1, 2), errors=2),
            others=16 if kind == "a pipe" else 4,
        )
    for path in ("/", "/proc", "/dev", "/proc/self", "/dev/zero", "/sys"):
        yield from on("ingest --jobs 1", Case("H4", f"the path {path}", "", _path(path), statuses=(0, 1, 3)))
        yield Case("H4", f"the path {path}", f"inspect {path}", statuses=(1,))
    yield Case(
        "H4",
        "folders that link to each other",
        "ingest --jobs 1 --set recordings.r.follow_links=true",
        _web,
        "tum",
        ANY,
    )
    yield from on(READ, Case("H4", "folders that link to each other", "", _web, "tum", ANY))
    yield from on(READ, Case("H4", "a folder 500 deep", "", _deep, "tum", ANY))
    yield from on(READ, Case("H4", "an image of 1 TB of nothing", "", _hole, "tum", ANY))
    yield from on(READ, Case("M6", "100,000 files beside the frames", "", _many, "tum", ANY))


# Files given by name that are pipes or devices; `odd` is made by `_given`.
FILES_GIVEN = """verify odd
verify release --rebuild odd
compare odd
inspect odd
init odd
ingest -c odd
score odd --benchmark release --out scored
score predictions --benchmark odd --out scored
score predictions --benchmark release --recheck odd --out scored
check odd --benchmark release
import odd imported
baseline empty --benchmark odd --out made
export exported --layout bop --benchmark odd
report --benchmark odd --out page.html
report --benchmark release --scores odd --out page.html
synthesize odd --out made
load odd"""
PLACES = (
    ("nerfstudio", "recording/transforms.json"),
    ("polycam", "recording/keyframes/*cameras/*"),
    ("scanner_app", "recording/frame_*.json"),
    ("stray", "recording/odometry.csv"),
    ("stray", "recording/camera_matrix.csv"),
    ("stray", "recording/rgb.mp4"),
    ("bop", "recording/scene_camera.json"),
    ("wildrgbd", "recording/metadata"),
    ("7scenes", "recording/frame-000000.pose.txt"),
    ("scannet", "recording/intrinsic/*"),
    ("scannet", "recording/pose/*"),
    ("sun3d", "recording/intrinsics.txt"),
    ("sun3d", "recording/extrinsics/*"),
    ("redwood", "recording/depth/*"),
    ("ros2_sqlite", "recording/*.db3"),
    ("ros2_mcap", "recording/*.mcap"),
    ("bag", "recording.bag"),
    ("sens", "recording.sens"),
    ("klg", "recording.klg"),
    ("record3d", "recording.r3d"),
    ("redwood_zip", "recording.zip"),
    ("azure_kinect", "recording.mkv"),
)


def _instead(whole: str, pattern: str, kind: str, statuses: tuple[int, ...] = ANY, errors: int = 2) -> Case:
    """Something else in the place of the first file of a pattern; nothing where a format has no such file."""

    def make(folder: Path) -> None:
        found = sorted([*folder.glob(pattern), *folder.glob(f"{pattern}*")])
        assert found, (whole, pattern)
        path = found[0]
        if path.is_dir():
            path = min(file for file in path.rglob("*") if file.is_file())
        path.unlink()
        KINDS[kind](path)

    return Case("H4", f"{kind} instead of {whole}: {pattern}", "", make, whole, statuses, errors=errors)


def _beside(put: Callable[[Path], None]) -> Callable[[Path], None]:
    return lambda folder: put(folder / "recording/x.bin")


def _given(kind: str) -> Callable[[Path], None]:
    return lambda folder: KINDS[kind](folder / "odd")


def _path(path: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        (folder / "benchmark.yaml").write_text(PATH_YAML.format(path), encoding="utf-8")

    return make


def _web(folder: Path) -> None:
    for a in range(9):
        (folder / f"recording/f{a}").mkdir()
        for b in range(9):
            (folder / f"recording/f{a}/{b}").symlink_to(f"../f{b}")


def _deep(folder: Path) -> None:
    (folder / "recording" / "/".join("d" * 500)).mkdir(parents=True)


def _hole(folder: Path) -> None:
    path = min((folder / "recording/rgb").iterdir())
    os.truncate(path, 1 << 40)


def _many(folder: Path) -> None:
    for number in range(100_000):
        (folder / f"recording/x{number:06d}").touch()
