"""Depth and colour are paired by time where names hold stamps; numbers of two streams are no times."""

import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from ingest_writers import (
    CAMERA,
    START_NS,
    STEP_NS,
    color_image,
    depth_image,
    jpeg,
    png,
    write_folder,
    write_tum,
)
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.image_names import stamps_of_names, times_of_names
from kinectbench.stages.ingest.pairing import pair_by_time
from kinectbench.stages.ingest.readers import open_recording

SMALL = CameraSettings(**CAMERA)
# Redwood's own: a scan of 68 s, whose colour comes a little more slowly than its depth.
DEPTH_MS, COLOR_MS, DEPTHS, COLORS = 33.36925, 33.516, 2032, 2024


def redwood_names(folder: str, step_ms: float, count: int, suffix: str) -> list[str]:
    return [f"{folder}/{i + 1:07d}-{round(1000 * step_ms * i):012d}{suffix}" for i in range(count)]


def stamp_ms(name: str) -> float:
    return int(Path(name).stem.split("-")[1]) / 1000


def zip_of(root: Path, names: Sequence[str], depth: bytes, color: bytes) -> Path:
    with zipfile.ZipFile(root / "r.zip", "w") as archive:
        for name in names:
            archive.writestr(name, depth if name.startswith("depth") else color)
    return root / "r.zip"


def folder_of(root: Path, names: Sequence[str], depth: bytes, color: bytes) -> Path:
    for folder in ("depth", "rgb"):
        (root / folder).mkdir()
    for name in names:
        (root / name).write_bytes(depth if name.startswith("depth") else color)
    return root


@pytest.mark.parametrize("made", [zip_of, folder_of])
def test_a_replica_of_redwoods_rates_is_paired_within_half_a_frame(
    tmp_path: Path, made: Callable[[Path, Sequence[str], bytes, bytes], Path]
) -> None:
    depths = redwood_names("depth", DEPTH_MS, DEPTHS, ".png")
    colors = redwood_names("rgb", COLOR_MS, COLORS, ".jpg")
    small = np.full((6, 8), 1500, np.uint16)
    path = made(tmp_path, [*depths, *colors], png(small), jpeg(np.zeros((6, 8, 3), np.uint8)))
    recording = open_recording(path, CameraSettings(fx=8, fy=8, cx=3.5, cy=2.5))
    apart = np.array(
        [
            stamp_ms(str(place.color)) - stamp_ms(str(place.depth))  # type: ignore[attr-defined]
            for place in recording.places
            if place.color is not None  # type: ignore[attr-defined]
        ]
    )
    alone = DEPTHS - len(apart)
    # A frame of colour is lost whenever it has fallen behind by a whole one: 8 or 9 times.
    assert (
        alone <= 9
        and f"{alone} of 2032 depth frames have no colour frame within 17 ms" in recording.warnings[0]
    )
    assert np.abs(apart).max() <= DEPTH_MS / 2 and np.median(np.abs(apart)) <= 9.0
    used = [str(place.color) for place in recording.places if place.color is not None]  # type: ignore[attr-defined]
    assert len(set(used)) == len(used)
    assert [len(stamps_ns) for stamps_ns in recording.recorded_stamps_ns] == [DEPTHS, COLORS]


def named(form: str, stamps_ns: Sequence[int]) -> list[str]:
    forms: dict[str, Callable[[int, int], str]] = {
        "seconds": lambda i, ns: f"{ns // 10**9}.{ns % 10**9 // 1000:06d}",
        "seconds from 0": lambda i, ns: f"{(ns - START_NS) / 1e9:.6f}",
        "milliseconds": lambda i, ns: str(ns // 10**6),
        "milliseconds from 0": lambda i, ns: f"{(ns - START_NS) / 1e6:.3f}",
        "microseconds": lambda i, ns: str(ns // 1000),
        "microseconds from 0": lambda i, ns: str((ns - START_NS) // 1000),
        "nanoseconds": lambda i, ns: str(ns),
        "nanoseconds from 0": lambda i, ns: str(ns - START_NS),
        "two numbers": lambda i, ns: f"{ns // 10**9}_{ns % 10**9:09d}",
        "a word before": lambda i, ns: f"frame2_{ns // 1000}",
        "a count before": lambda i, ns: f"{i:04d}_{ns / 1e9:.6f}",
    }
    return [forms[form](i, ns) for i, ns in enumerate(stamps_ns)]


FORMS = (
    "seconds",
    "seconds from 0",
    "milliseconds",
    "milliseconds from 0",
    "microseconds",
    "microseconds from 0",
    "nanoseconds",
    "nanoseconds from 0",
    "two numbers",
    "a word before",
    "a count before",
)


def two_streams(root: Path, depth: Sequence[str], color: Sequence[str]) -> Path:
    """A plain folder whose two streams have these names; image i of either shows number i."""
    folder = write_folder(root / "r", ())
    for i, stem in enumerate(depth):
        (folder / f"depth/{stem}.png").write_bytes(png(depth_image(i, 1000.0)))
    for i, stem in enumerate(color):
        (folder / f"color/{stem}.jpg").write_bytes(jpeg(color_image(i)))
    return folder


@pytest.mark.parametrize("form", FORMS)
def test_names_that_are_stamps_pair_by_time(tmp_path: Path, form: str) -> None:
    """Colour is 11 ms early; three of its frames were lost, and the first has no depth."""
    depth_ns = START_NS + 500_000_000 + np.arange(16) * STEP_NS
    kept = [i for i in range(-1, 16) if i not in (3, 4, 9)]
    color_ns = [int(depth_ns[0]) + i * STEP_NS - 11_000_000 for i in kept]
    folder = two_streams(tmp_path, named(form, depth_ns.tolist()), named(form, color_ns))
    recording = open_recording(folder)
    for i in range(16):
        color = recording.frame(i).color
        assert color == ((".jpg", jpeg(color_image(kept.index(i)))) if i in kept else None)
    assert np.abs(np.diff(recording.stamps_ns) - STEP_NS).max() <= 1_000_000
    assert f"{folder}: 3 of 16 depth frames have no colour frame within 17 ms" in recording.warnings
    # The clocks are known, so an offset of them can be given.
    late = open_recording(folder, CameraSettings(color_delay_s=-0.011 + STEP_NS / 1e9))
    assert late.frame(5).color == (".jpg", jpeg(color_image(kept.index(6))))


@pytest.mark.parametrize(
    "stems",
    [
        ["0", "1", "2", "10"],
        ["33", "67", "100", "133"],  # may be milliseconds, and may be keyframes
        ["057983", "057984", "057985"],
        ["20240115_0001", "20240115_0002"],
        ["frame-000001", "frame-000002"],
        ["a", "b"],
        ["1700000000", "x"],
        ["1700000000.0", "1700000000.0"],
        ["9" * 40, "8" * 40],
        ["depth.1.5e", "depth.2"],
        [],
    ],
)
def test_names_that_are_no_stamps(stems: list[str]) -> None:
    assert times_of_names(stems) is None
    assert len(stamps_of_names(stems)) == len(stems)


def test_counters_of_two_streams_that_differ_are_said(tmp_path: Path) -> None:
    """Of one number are images of other times: they are paired, as nothing else is known, and it is said."""
    folder = two_streams(tmp_path, [f"{i:06d}" for i in range(20)], [f"{i:06d}" for i in range(8, 28)])
    recording = open_recording(folder)
    assert recording.frame(8).color == (".jpg", jpeg(color_image(0)))
    (warning,) = recording.warnings
    assert (
        "8 of 20 depth frames have no colour of their name; depth is numbered 0 to 19, colour 8 to 27"
        in warning
    )
    assert "name the images by their time stamps" in warning


def test_one_lost_image_says_nothing_of_counters(tmp_path: Path) -> None:
    folder = two_streams(tmp_path, ["0", "1", "2", "3"], ["0", "2", "3"])
    assert open_recording(folder).warnings == (f"{folder}: 1 of 4 depth frames have no colour of their name",)


def test_numbers_within_names_pair_before_the_order_does(tmp_path: Path) -> None:
    folder = two_streams(tmp_path, [f"depth_{i}" for i in range(4)], [f"color_{i}" for i in (0, 2, 3)])
    recording = open_recording(folder)
    assert recording.frame(2).color == (".jpg", jpeg(color_image(1)))
    assert recording.frame(1).color is None
    assert recording.warnings == (f"{folder}: 1 of 4 depth frames have no colour of their number",)


def test_pairing_by_order_is_said_and_unequal_counts_are_refused(tmp_path: Path) -> None:
    folder = two_streams(tmp_path, ["0", "1", "2"], ["a", "b", "c"])
    recording = open_recording(folder)
    assert recording.frame(1).color == (".jpg", jpeg(color_image(1)))
    assert "their 3 images each are paired in their order" in recording.warnings[0]
    (folder / "color/c.jpg").unlink()
    with raises(RecordingError, "recording.unpaired", match="3 depth and 2"):
        open_recording(folder)


def test_rows_that_are_counted_are_no_times_of_two_streams(tmp_path: Path) -> None:
    """TUM lists whose stamps are steps: a row of rgb.txt that is missing does not move those after it."""
    folder = write_tum(tmp_path / "r", frames=16)
    for name, suffix in (("depth", "png"), ("rgb", "jpg")):
        rows = [f"0.03{i % 3} {name}/{i}.{suffix}" for i in range(16) if (name, i) != ("rgb", 4)]
        (folder / f"{name}.txt").write_text("\n".join(rows) + "\n")
    recording = open_recording(folder)
    assert recording.frame(4).color is None
    assert recording.frame(9).color == (".jpg", jpeg(color_image(9)))
    assert any("1 of 16 depth frames have no colour of their name" in said for said in recording.warnings)


@pytest.mark.parametrize("rates_hz", [(30, 30), (30, 15), (30, 5), (15, 30), (90, 60), (60, 60)])
def test_no_pair_is_farther_apart_than_half_a_frame(rates_hz: tuple[int, int]) -> None:
    depth_ns, color_ns = (
        (np.arange(5 * rate) * 1e9 / rate + late * 1e6).astype(np.int64).tolist()
        for rate, late in zip(rates_hz, (0, 3), strict=True)
    )
    del color_ns[7:9]
    found = pair_by_time(depth_ns, color_ns, delay_s=0.0, where="r")
    apart = [abs(depth_ns[i] - color_ns[j]) for i, j in enumerate(found.of_depth) if j is not None]
    assert max(apart) <= 0.5e9 / max(rates_hz) + 1
    assert len(apart) >= 0.95 * min(len(depth_ns), len(color_ns))


def test_stamps_that_jitter_keep_their_partners() -> None:
    """Half a frame apart and with 1 ms of jitter, no frame is nearer: they are paired all the same."""
    rng = np.random.default_rng(1)
    depth_ns = (np.arange(300) * STEP_NS).tolist()
    color_ns = [ns + STEP_NS // 2 + int(1e6 * rng.standard_normal()) for ns in depth_ns]
    found = pair_by_time(depth_ns, color_ns, delay_s=0.0, where="r")
    assert sum(j is not None for j in found.of_depth) >= 294


def test_a_seven_scenes_folder_counts_what_has_no_colour(tmp_path: Path) -> None:
    for i in range(3):
        (tmp_path / f"frame-{i:06d}.depth.png").write_bytes(png(depth_image(i)))
    (tmp_path / "frame-000001.color.png").write_bytes(bytes(cv2.imencode(".png", color_image(1))[1]))
    recording = open_recording(tmp_path, SMALL)
    assert f"{tmp_path}: 2 of 3 depth frames have no colour of their name" in recording.warnings
