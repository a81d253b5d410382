"""Simulated scans in Redwood's layout as strangers make them: good ones, and seven ways to go wrong."""

import io
import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from read_pictures import decoded_picture
from solid_cells import solid_cells

from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.types import Underside
from kinectbench.lab.simulate.objects import make_object
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.spec import SimulationSpec

# A turn of a Redwood scan has 1,000 frames and more. With 60, trajectories broke that hold with 100.
WIDTH, HEIGHT, FRAMES = 320, 240, 100
# The PrimeSense camera of 640x480 at this size.
CAMERA = "{fx: 262.5, fy: 262.5, cx: 159.5, cy: 119.5}"
# Two clocks, as Redwood's: colour is 1 % slower than depth, so that the counts differ, and 10 ms late.
RATE_HZ, COLOR_HZ, DELAY_S = 3.0, 2.97, 0.01
SOURCES = """\
format_version: 1
bases: [BASES]
file: "{id}.zip"
license: CC0-1.0
source: simulated in the layout of Choi et al. 2016
index: {bases: [BASES], file: categories.json}
categories: {chair: chair, table: table, bench: bench, sofa: couch, other: other}
camera: CAMERA
"""
BENCHMARK = """\
name: replica
license: CC0-1.0
include: [recordings.yaml]
"""
# A person who walks through: how near, how wide as a share of the image, and in which share of the frames.
PERSON_M, PERSON_SHARE, PERSON_FRAMES = 0.9, 0.3, (0.3, 0.6)
# Of a truncated scan: what is left of the archive, or how many of its depth images are cut off.
LEFT, DAMAGED = 0.7, 12
# Cells along the longest side, and how much hollow is much, of the solid's volume: of 13 seeds each chairs,
# tables, benches and couches have less than 0.04 or, with an apron, more than 0.16.
HOLLOW_CELLS, HOLLOW_SHARE = 80, 0.1


@dataclass(frozen=True)
class Scan:
    """One scan of a replica.

    Attributes:
        name: its id.
        object: family and seed.
        kind: what is the matter with it.
        settings: sections of the simulation that are not the default.
    """

    name: str
    object: str
    kind: str
    settings: dict[str, dict[str, Any]] = field(default_factory=dict)
    seed: int = 0

    @property
    def category(self) -> str:
        """In the source's words."""
        family = self.object.partition(":")[0]
        return {"couch": "sofa"}.get(family, family if family in ("chair", "table", "bench") else "other")

    @property
    def underside(self) -> Underside:
        """The word of a person who turns the object over."""
        family, _, seed = self.object.partition(":seed=")
        return "open" if is_hollow_below(make_object(family, int(seed)).mesh) else "closed"


def forty(first_seed: int = 0) -> list[Scan]:
    """Forty scans: sixteen good ones, two of them of objects that others show, and four of each fault.

    Args:
        first_seed: added to the seeds of the objects and of the recordings: other scans of the same kinds.
    """
    furniture = ("chair", "table", "bench", "couch")
    good = [f"{family}:seed={first_seed + seed}" for seed in range(20, 24) for family in furniture][:14]
    rows: list[tuple[str, str, dict[str, dict[str, Any]]]] = [(name, "good", {}) for name in good]
    rows += [(name, "again", {"path": {"elevation_rad": 0.6}}) for name in good[:2]]
    for number, family in enumerate(furniture):
        name = f"{family}:seed={first_seed + 30 + number}"
        rows += [
            (name, "drifting", {"path": {"jolt_m": 0.2, "jolt_rad": 0.5}, "faults": {"drop_share": 0.4}}),
            (f"{family}:seed={first_seed + 40 + number}", "cut" if number % 2 else "damaged", {}),
            (f"{family}:seed={first_seed + 50 + number}", "half", {"path": {"arc_rad": np.pi}}),
            (f"{family}:seed={first_seed + 60 + number}", "touching", {"scene": {"touching": True}}),
            (f"{family}:seed={first_seed + 70 + number}", "person", {}),
        ]
    rows += [
        (f"{family}:seed={first_seed}", "open", {}) for family in ("open_box", "bookshelf", "crate", "kennel")
    ]
    return [
        Scan(f"{number:05d}", name, kind, settings, seed=first_seed + number)
        for number, (name, kind, settings) in enumerate(rows, 1)
    ]


def four() -> list[Scan]:
    """A good one, one cut off, a half orbit, and one with a person."""
    wanted = {"good": 0, "cut": 0, "half": 0, "person": 0}
    return [next(scan for scan in forty() if scan.kind == kind) for kind in wanted]


def make(scan: Scan, folder: Path, **sizes: Any) -> None:
    """Simulate a scan, <name>.zip with its truth beside it; `sizes` are width, height and frames."""
    frames = sizes.get("frames", FRAMES)
    spec: dict[str, Any] = {
        "object": scan.object,
        "seed": scan.seed,
        "format": "redwood_zip",
        "path": {"frames": frames, "rate_hz": RATE_HZ},
        "sensor": {
            "width": sizes.get("width", WIDTH),
            "height": sizes.get("height", HEIGHT),
            "color_rate_hz": COLOR_HZ,
            "color_delay_s": DELAY_S,
        },
        "save_depth": False,
    }
    for section, values in scan.settings.items():
        spec[section] = spec.get(section, {}) | values
    path = folder / f"{scan.name}.zip"
    simulate(SimulationSpec.model_validate(spec), path)
    if scan.kind == "person":
        path.write_bytes(_changed(path.read_bytes(), _with_person))
    elif scan.kind == "damaged":
        path.write_bytes(_changed(path.read_bytes(), _cut_off))
    elif scan.kind == "cut":
        path.write_bytes(path.read_bytes()[: int(LEFT * path.stat().st_size)])


def state_undersides(scans: Sequence[Scan], recordings: Path) -> None:
    """Write into recordings.yaml what a person finds who turns each object over: `underside`."""
    words = {scan.name: f"underside: {scan.underside}" for scan in scans}
    lines = recordings.read_text(encoding="utf-8").splitlines()
    for name, word in words.items():
        entry = f'  - id: "{name}"'
        if entry in lines and (place := lines.index(entry) + 1) and not lines[place].endswith(word):
            lines.insert(place, f"    {word}")
    recordings.write_text("\n".join(lines) + "\n", encoding="utf-8")


def is_hollow_below(mesh: TriangleMesh) -> bool:
    """Whether a solid (z up) has material above and on four sides of much air, as a bench with an apron."""
    solid = solid_cells([mesh], HOLLOW_CELLS)
    around = [
        np.flip(np.maximum.accumulate(np.flip(solid, turned), axis), turned)
        for axis, turned in ((0, ()), (0, 0), (1, ()), (1, 1), (2, 2))
    ]
    hollow = ~solid & np.logical_and.reduce(around)
    return bool(hollow.sum() > HOLLOW_SHARE * solid.sum())


def sources_yaml(*bases: str, camera: str = CAMERA) -> str:
    """sources.yaml of a replica at these addresses."""
    return SOURCES.replace("BASES", ", ".join(bases)).replace("CAMERA", camera)


def served(scans: Sequence[Scan], folder: Path) -> dict[str, bytes]:
    """What a server of the scans gives."""
    listed: dict[str, list[str]] = {}
    for scan in scans:
        listed.setdefault(scan.category, []).append(scan.name)
    files = {f"/{scan.name}.zip": (folder / f"{scan.name}.zip").read_bytes() for scan in scans}
    return files | {"/categories.json": json.dumps(listed).encode()}


def _changed(archive: bytes, change: Any) -> bytes:
    """An archive with each image as `change` makes it: (folder, place from 0 to 1, bytes) -> bytes."""
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(archive)) as old, zipfile.ZipFile(made, "w") as new:
        names = sorted(old.namelist())
        for folder in ("depth", "rgb"):
            of_folder = [name for name in names if name.startswith(folder)]
            for number, name in enumerate(of_folder):
                data = change(folder, number / len(of_folder), old.read(name))
                new.writestr(zipfile.ZipInfo(name), data)
    return made.getvalue()


def _cut_off(folder: str, place: float, data: bytes) -> bytes:
    """The last depth images end early, as of a disk that filled up."""
    return data[: len(data) // 2] if folder == "depth" and place >= 1 - DAMAGED / FRAMES else data


def _with_person(folder: str, place: float, data: bytes) -> bytes:
    """Somebody walks between camera and object, from the left to the right: an upright cylinder."""
    begin, end = PERSON_FRAMES
    if not begin <= place < end:
        return data
    image = decoded_picture(data, cv2.IMREAD_UNCHANGED)
    width = image.shape[1]
    half = PERSON_SHARE * width / 2
    middle = -half + (place - begin) / (end - begin) * (width + 2 * half)
    across = (np.arange(width) - middle) / half
    seen = np.abs(across) < 1
    if folder == "depth":
        near_mm = 1000 * (PERSON_M - 0.15 * np.sqrt(np.clip(1 - across**2, 0, 1)))
        image[:, seen] = near_mm[seen].astype(np.uint16)
    else:
        image[:, seen] = (70, 50, 40)
    return bytes(cv2.imencode(".png" if folder == "depth" else ".jpg", image)[1])
