"""What `publish` never writes into a release of recordings, or always does; all hashes are made again."""

import json
import shutil
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import pytest
from file_damage import edit_pair, seal

from kinectbench.core.voxels.npz import load_arrays, npz_bytes
from kinectbench.engine.artefact import VERSIONS
from kinectbench.release.check.verify import verify

PAIR, DEPTH = "pairs/chair_01/000.npz", "views/chair_01/000.depth.png"
VOLUME, QUALITY = (f"objects/chair_01/{name}" for name in ("volume.npz", "quality.json"))
VIEWS = "views/chair_01/views.json"
EXIF = b"\xff\xe1\x00\x10Exif\0\0MM\0*\0\0\0\x08"
Forge = Callable[[Path], object]


def edited(file: str, change: Callable[[dict[str, Any]], object]) -> Forge:
    """A change of a JSON file."""

    def forge(folder: Path) -> None:
        content = json.loads((folder / file).read_text())
        change(content)
        (folder / file).write_text(json.dumps(content))

    return forge


def written(file: str, content: bytes) -> Forge:
    def forge(folder: Path) -> None:
        (folder / file).parent.mkdir(exist_ok=True)
        (folder / file).write_bytes(content)

    return forge


def inserted(file: str, at: int, more: bytes) -> Forge:
    def forge(folder: Path) -> None:
        content = (folder / file).read_bytes()
        end = at % (len(content) + 1)
        (folder / file).write_bytes(content[:end] + more + content[end:])

    return forge


def png_chunk(kind: bytes, text: bytes) -> bytes:
    return len(text).to_bytes(4, "big") + kind + text + zlib.crc32(kind + text).to_bytes(4, "big")


def note_in_all_pairs(folder: Path) -> None:
    for path in folder.glob("pairs/*/*.npz"):
        edit_pair(path, {"note": load_arrays(path)["K"]})


def note_in_volume(folder: Path) -> None:
    arrays = load_arrays(folder / VOLUME)
    (folder / VOLUME).write_bytes(npz_bytes({**arrays, "note": arrays["labels"]}))


def packed_otherwise(folder: Path) -> None:
    """One view under two names, in files of other bytes."""
    for name in ("pairs/chair_01/{}.npz", "views/chair_01/{}.depth.png", "views/chair_01/{}.mask.png"):
        shutil.copyfile(folder / name.format("000"), folder / name.format("001"))
    (folder / PAIR).write_bytes(npz_bytes(load_arrays(folder / PAIR), level=1))


def mask_of_ones(folder: Path) -> None:
    path = str(folder / "views/chair_01/000.mask.png")
    levels = cv2.imread(path, cv2.IMREAD_UNCHANGED)
    assert levels is not None
    cv2.imwrite(path, levels // 255)


def of_this_stage(folder: Path) -> None:
    """lineage.json says that this version of the stages made the pairs and the object."""

    def change(content: dict[str, Any]) -> None:
        for stage in ("pairs", "segment"):
            content["recordings"]["chair_01"]["stages"][stage]["stage_version"] = VERSIONS[stage]

    edited("lineage.json", change)(folder)


def thresholds(**content: object) -> Forge:
    more = {"thresholds": {"chair": 0.5, "table": 0.5}, "objects": ["val_chair"]} | content
    return written("thresholds.json", json.dumps(more).encode())


NO_FILE = "no file of a release; take it out"
FORGED: dict[str, tuple[Forge, str]] = {
    "a program": (written("run_me.py", b""), f"run_me.py: {NO_FILE}"),
    "a file of an object": (written("objects/chair_01/cad.stl", b""), f"objects/chair_01/cad.stl: {NO_FILE}"),
    "a name in other case": (written("readme.md", b""), f"readme.md: {NO_FILE}"),
    "a page": (written("categories/sofa.html", b""), f"categories/sofa.html: {NO_FILE}"),
    "an image of no pair": (
        lambda folder: shutil.copy(folder / DEPTH, folder / "views/chair_01/999.depth.png"),
        f"views/chair_01/999.depth.png: {NO_FILE}",
    ),
    "a mesh that is no truth": (
        written("surfaces/chair_01.ply", b"ply"),
        f"surfaces/chair_01.ply: {NO_FILE}",
    ),
    "no GLB": (
        lambda folder: (folder / "objects/chair_01.glb").unlink(),
        "objects/chair_01.glb: missing, a release of recordings has it",
    ),
    "a key of all pairs": (note_in_all_pairs, f"{PAIR}: holds the unknown key 'note'"),
    "a key of a volume": (note_in_volume, f"{VOLUME}: holds the unknown key 'note'"),
    "no pair with interior": (of_this_stage, f"{PAIR}: lacks the key 'interior'"),
    "a truth without figures": (of_this_stage, f"{QUALITY}: does not state doubts, surface_sigma_m, unknown"),
    "a position": (
        edited(VIEWS, lambda views: views.update(gps={"latitude": 48.1})),
        f"{VIEWS}: holds the key 'gps', which `publish` removes",
    ),
    "an address": (
        edited("lineage.json", lambda content: content["recordings"]["chair_01"].update(x="a@b.org")),
        "lineage.json: holds an e-mail address in 'x'",
    ),
    "a path": (
        edited(VIEWS, lambda views: views.update(warnings=["see /home/jane/x.bag"])),
        f"{VIEWS}: holds a path in 'warnings'",
    ),
    "a text in an image": (
        inserted(DEPTH, 33, png_chunk(b"tEXt", b"by Jane")),
        f"{DEPTH}: holds a tEXt chunk",
    ),
    "data after an image": (inserted(DEPTH, -1, b"PK\3\4"), f"{DEPTH}: holds data after the picture"),
    "EXIF": (
        inserted("previews/test/chair_01/000.jpg", 2, EXIF),
        "previews/test/chair_01/000.jpg: holds EXIF",
    ),
    "no picture": (
        written("previews/test/chair_01/000.jpg", b"hello"),
        "previews/test/chair_01/000.jpg: holds no picture",
    ),
    "less looked for": (
        edited("privacy.json", lambda content: content.update(looked_for=[])),
        "privacy.json: looked_for is not what `publish` says",
    ),
    "colour published": (
        edited("privacy.json", lambda content: content.update(color="published")),
        "privacy.json: color is 'published', the settings say otherwise",
    ),
    "thresholds of the test split": (
        thresholds(objects=["red_chair "]),
        "thresholds.json: found on objects of the test split (red_chair",
    ),
    "no threshold": (thresholds(thresholds={"chair": 0.5}), "thresholds.json: no threshold for table"),
    "a threshold above 1": (
        thresholds(thresholds={"chair": 7.3, "table": 0.5}),
        "thresholds.json: 7.3 of chair is not one of",
    ),
    "a view twice": (
        edited(VIEWS, lambda views: views["views"].append(views["views"][0])),
        f"{VIEWS}: has view 000 twice",
    ),
    "a frame twice": (
        edited(VIEWS, lambda views: views["views"][0].update(frame=1, stamp_ns=10**9)),
        f"{VIEWS}: has frame 1 twice",
    ),
    "no poses": (
        edited(VIEWS, lambda views: [row.pop("T_world_camera") for row in views["views"]]),
        f"{VIEWS}: has views without T_world_camera",
    ),
    "no stages": (
        edited("lineage.json", lambda content: content["recordings"]["chair_01"].update(stages={})),
        "lineage.json: does not say how ingest, ",
    ),
    "no files": (
        edited("lineage.json", lambda content: content["recordings"]["chair_01"].update(files={})),
        "lineage.json: does not name the files of chair_01",
    ),
    "no views": (
        edited("lineage.json", lambda content: content["recordings"]["chair_01"].pop("views")),
        "lineage.json: does not name the views of chair_01",
    ),
    "a view packed otherwise": (
        packed_otherwise,
        "pairs/chair_01/001.npz: a copy of pairs/chair_01/000.npz; no camera gives one view twice",
    ),
    "a mask of ones": (mask_of_ones, "views/chair_01/000.mask.png: holds other values than 0 and 255"),
    "files elsewhere": (
        edited(
            "croissant.json", lambda content: content["distribution"].append({"contentUrl": "https://a.b"})
        ),
        "croissant.json: distribution is [",
    ),
    "no list of files": (
        edited("croissant.json", lambda content: content.update(distribution=[])),
        "croissant.json: distribution is []",
    ),
    "volume": (
        edited(
            "benchmark.json",
            lambda all: all["recordings"]["chair_01"]["quality"].update(
                volume_m3=9.0, labels=dict.fromkeys(("free", "other", "surface", "interior", "unknown"), 0)
            ),
        ),
        f"{VOLUME}: another labels, volume_m3 than in quality.json",
    ),
    "a doubtful estimate without `look`": (
        edited(
            "benchmark.json",
            lambda all: all["recordings"]["chair_01"]["quality"].update(estimated_known_iou=0.75),
        ),
        "benchmark.json: recordings.chair_01: 'look' does not have 'the estimated IoU on known",
    ),
    "an underside": (
        edited(
            "benchmark.json", lambda all: all["recordings"]["chair_01"]["quality"].update(underside="closed")
        ),
        "benchmark.json: settings.recordings of chair_01 has another underside than recordings",
    ),
    "a private part of nothing": (
        edited("benchmark.json", lambda all: all.update(private_benchmark_sha256="0" * 64)),
        "benchmark.json: names a private part, but holds nothing back",
    ),
    "isolated from nothing": (
        edited("benchmark.json", lambda all: all.update(isolated=["chair_01"])),
        "benchmark.json: isolates recordings, but holds nothing back",
    ),
}


@pytest.mark.parametrize("what", FORGED)
def test_what_publish_would_not_write(analytic: Path, tmp_path: Path, what: str) -> None:
    folder = Path(shutil.copytree(analytic / "benchmark", tmp_path / "benchmark"))
    forge, line = FORGED[what]
    forge(folder)
    if "thresholds.json" in line:  # with its schema, as publish stores it
        schema = Path("kinectbench/release/publish/schemas/thresholds.schema.json")
        shutil.copyfile(Path(__file__).parents[2] / schema, folder / "schemas" / schema.name)
    seal(folder)
    found = verify(folder)
    assert any(each.startswith(line) for each in found), found
