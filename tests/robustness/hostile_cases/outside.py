"""Files that lead out of their folder: by names in lists, by links, by archives."""

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path

from fuzz.releases import seal

from hostile_cases.case import Case, in_turn, on
from hostile_cases.process import SECRET

READ = "inspect r\ningest --jobs 1"
ADVICE = (0, 1, 3)
NAMES = ("/{folder}/secret{suffix}", "../secret{suffix}", "depth/../../secret{suffix}", ".hidden/a{suffix}")
OF_RELEASE = """verify release
score predictions --benchmark release --jobs 1 --no-surface --no-baselines --no-gallery --out scored
load release
baseline partial --benchmark release --jobs 1 --out made
export exported --layout webdataset --benchmark release
export exported --layout bop --benchmark release
report --benchmark release --out page.html"""


def cases() -> Iterator[Case]:
    for name in NAMES:
        for index in ("rgb", "depth"):
            yield from on(READ, _listed(name, index))
        for key in ("file_path", "depth_file_path"):
            yield from on(
                READ,
                Case(
                    "H5", f"transforms.json: {key} {name}", "", _transforms(key, name), "nerfstudio", ADVICE
                ),
            )
        yield from in_turn(
            OF_RELEASE,
            Case("H5", f"targets.csv: {name}", "", _targets(name), "release", (1,), errors=6),
            others=2,
        )
        yield from in_turn(
            OF_RELEASE,
            Case("H5", f"SHA256SUMS: {name}", "", _sums(name), "release", (0, 1), errors=6),
            others=2,
        )
    for place in ("rgb/0", "depth/0", "masks/0", "camera.json", "depth.txt", "groundtruth.txt", "rgb"):
        yield from on(READ, Case("H5", f"a link out at {place}", "", _linked(place), "tum", ADVICE))
    for whole, pattern in (
        ("7scenes", "camera-intrinsics.txt"),
        ("scannet", "intrinsic/intrinsic_depth.txt"),
        ("bop", "*.json"),
        ("wildrgbd", "metadata*"),
        ("nerfstudio", "*.json"),
        ("polycam", "keyframes/depth/*"),
        ("sun3d", "intrinsics.txt"),
        ("redwood", "depth/*"),
    ):
        yield from on(
            READ, Case("H5", f"{whole}: a link out at {pattern}", "", _link_of(pattern), whole, ADVICE)
        )
    for file in (
        "pairs/chair_01/000.npz",
        "LICENSE",
        "objects/chair_01/mesh.ply",
        "views/chair_01/000.depth.png",
    ):
        yield from in_turn(
            OF_RELEASE,
            Case(
                "H5",
                f"a link out of a release: {file}",
                "",
                _release_link(file),
                "release",
                (0, 1),
                errors=4,
            ),
            others=6,
        )
    yield from on(READ, Case("H5", "benchmark.yaml: masks elsewhere", "", _masks, "tum", (0, 1, 2, 3)))
    yield from on("publish", Case("H5", "a view that is a link out", "", _built_link, "built", (0, 1, 3)))


def _secret(folder: Path, suffix: str) -> Path:
    """A file of somebody else, beside the recording; a picture by its first bytes."""
    import cv2
    import numpy as np

    path = folder / f"secret{suffix}"
    code = (
        cv2.imencode(suffix, np.full((48, 64, 3), 9, np.uint8))[1].tobytes()
        if suffix in (".png", ".jpg")
        else b""
    )
    path.write_bytes(code + SECRET)
    return path


def _named(name: str, folder: Path, suffix: str) -> str:
    return name.format(folder=str(folder).lstrip("/"), suffix=suffix)


def _listed(name: str, index: str) -> Case:
    suffix = ".jpg" if index == "rgb" else ".png"

    def make(folder: Path) -> None:
        _secret(folder, suffix)
        path = folder / f"recording/{index}.txt"
        text = path.read_text(encoding="utf-8")
        path.write_text(
            re.sub(rf"{index}/\S+", lambda _: _named(name, folder, suffix), text), encoding="utf-8"
        )

    return Case("H5", f"{index}.txt: {name}", "", make, "tum", ADVICE)


def _transforms(key: str, name: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        suffix = ".png" if "depth" in key else ".jpg"
        _secret(folder, suffix)
        path = folder / "recording/transforms.json"
        content = json.loads(path.read_text(encoding="utf-8"))
        for frame in content["frames"]:
            frame[key] = _named(name, folder, suffix)
        path.write_text(json.dumps(content), encoding="utf-8")

    return make


def _targets(name: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        _secret(folder, ".npz")
        path = folder / "release/targets.csv"
        text = path.read_text(encoding="utf-8")
        path.write_text(
            text.replace("pairs/chair_01/000.npz", _named(name, folder, ".npz")), encoding="utf-8"
        )
        seal(folder / "release")

    return make


def _sums(name: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        _secret(folder, ".png")
        path = folder / "release/SHA256SUMS"
        path.write_text(
            path.read_text(encoding="utf-8") + f"{'0' * 64}  {_named(name, folder, '.png')}\n",
            encoding="utf-8",
        )

    return make


def _link(path: Path, folder: Path) -> None:
    """The file goes elsewhere, with a secret in it, and a link stands in its place."""
    elsewhere = folder / f"secret{path.suffix}"
    path.rename(elsewhere)
    if elsewhere.is_file():
        elsewhere.write_bytes(elsewhere.read_bytes() + (SECRET if path.suffix in (".png", ".jpg") else b""))
    path.symlink_to(elsewhere)


def _linked(place: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        parent = folder / "recording"
        path = min(parent.glob("rgb/*")) if place == "rgb/0" else parent / place
        if place.endswith("/0"):
            path = min((parent / place).parent.iterdir())
        _link(path, folder)

    return make


def _link_of(pattern: str) -> Callable[[Path], None]:
    return lambda folder: _link(min((folder / "recording").glob(pattern)), folder)


def _release_link(file: str) -> Callable[[Path], None]:
    """A link to a file that is not the published one."""

    def make(folder: Path) -> None:
        path = folder / "release" / file
        (folder / "secret").write_bytes(path.read_bytes() + SECRET)
        path.unlink()
        path.symlink_to(folder / "secret")

    return make


def _masks(folder: Path) -> None:
    _secret(folder, ".png")
    path = folder / "benchmark.yaml"
    text = path.read_text(encoding="utf-8").replace("category: chair", "category: chair, masks: /etc")
    path.write_text(text, encoding="utf-8")


def _built_link(folder: Path) -> None:
    (folder / "build/publish.json").unlink()
    path = next((folder / "build/chair/views").glob("*.png"))
    _link(path, folder)
