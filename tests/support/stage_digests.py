"""Digests of what was written: a few numbers for each part of a file, which two processors agree on closely.

A hash of rounded values would differ wherever a value lies beside a rounding boundary, so a digest holds sums
over all values instead, and these are compared with a tolerance.
"""

import json
import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from numba import njit
from numpy.typing import NDArray
from read_pictures import read_picture

from kinectbench._version import __version__
from kinectbench.core.geometry.mesh import TriangleMesh, read_own_ply
from kinectbench.core.storage import sha256_text
from kinectbench.core.voxels.npz import load_arrays
from kinectbench.release.publish.small_files import data_package_versions
from kinectbench.stages.ingest.depth_code import decode_depth


@dataclass(frozen=True)
class Part:
    """A part of a file: how it is compared, what must be the same, and what must be close."""

    kind: str
    exact: tuple[str, ...]
    numbers: tuple[float, ...]


# By the part's name, such as that of an array or the path of a key.
Digest = dict[str, Part]

# How much may differ, by kind: the number of values that are not 0, relative; mean and root mean square, and
# the projections, both relative to the root mean square; of meshes metres (square metres), of counts a share.
# Measured on the sample of `stage_sample.py` (72 frames, 320 x 240): with numba's generic processor,
# OpenBLAS's Prescott kernels and no AVX2 in numpy; and with OpenBLAS's Haswell kernels, one thread, and no
# SSE4.2, AVX and FMA in OpenCV, which moves features and with them tracked poses. The largest differences to
# an ordinary run were: cells 7e-5, 7e-5, 7.2e-3; volume 0, 8e-7, 2.0e-4; few 0, 1.7e-4, 4.8e-4;
# poses 0, 9e-6, 2.3e-5; millimetres (with few decimals) 0, 4.2e-2, 3.2e-2, and where each frame has its own
# (of which `shift_mm` sets the weights of fusion) 0, 4.8e-3, 9.0e-3; mesh 5.4e-6; counts 3.3e-5.
# Decoders of JPEG may round by a grey level or two of 255.
TOLERANCES: dict[str, tuple[float, ...]] = {
    "cells": (5e-4, 3e-4, 0.03),
    "volume": (1e-4, 1e-5, 1e-3),
    "few": (0.0, 1e-3, 2e-3),
    "poses": (0.0, 1e-4, 1e-4),
    "millimetres": (0.1, 0.1, 0.1),
    "frames": (0.02, 0.01, 0.02),
    "jpeg": (0.02, 0.02, 0.02),
    "mesh": (1e-4,),
    "counts": (1e-3,),
}
VERSIONS_HERE = (__version__, *data_package_versions().values())
# Larger numbers in a text are words: sums over them would hide all others.
LARGE = 1e9
# What is 0 on one processor may be as small on another, in units of the root mean square.
ROUNDING = 1e-12
# An array with more values is a volume or an image.
FEW = 1000
SEEDS = (0x9E3779B97F4A7C15, 0xD1B54A32D192ED03)

# What says who wrote a file, and with which other files, rather than what it holds.
PROVENANCE = {"package_version", "stage_version", "score_version", "baseline_version", "fingerprint"}
PROVENANCE |= {"packages", "contentSize", "publish_version"}
HASH = re.compile(r"\b[0-9a-f]{64}\b|blake3:[0-9a-f]+")
IMAGE = re.compile(r"base64,[A-Za-z0-9+/=]+")
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.]*\w)")


def file_digest(path: Path) -> Digest:
    """Digest of one file, by its suffix."""
    match path.suffix:
        case ".npz":
            arrays = load_arrays(path)
            return {name: array_digest(values) for name, values in arrays.items()}
        case ".kbd":
            return {"depth": array_digest(decode_depth(path.read_bytes()))}
        case ".png" | ".jpg":
            image = read_picture(path, cv2.IMREAD_UNCHANGED)
            assert image is not None, path
            return {"pixels": array_digest(image, "jpeg" if path.suffix == ".jpg" else None)}
        case ".ply":
            return mesh_digest(read_own_ply(path))
        case ".glb":
            shown = trimesh.load_mesh(path, process=False)
            return mesh_digest(TriangleMesh(np.array(shown.vertices), np.array(shown.faces, np.int32)))
        case ".json":
            return json_digest(json.loads(path.read_text(encoding="utf-8")))
        case ".txt":
            rows = np.loadtxt(path, ndmin=2)
            return {f"column {index}": array_digest(column, "poses") for index, column in enumerate(rows.T)}
        case _:
            return json_digest(path.read_text(encoding="utf-8").splitlines())


def array_digest(values: NDArray[Any], kind: str | None = None) -> Part:
    """Shape and type exactly; how many are not 0, mean, root mean square and two projections closely.

    A projection is the sum of all values, each by a weight of its own in [-1, 1), over the root of their
    number: values that trade places change it. Of packed bits, each byte stands for its number of ones.
    """
    exact = [str(values.dtype), *map(str, values.shape)]
    if values.dtype.kind not in "biuf":
        return Part("text", (*exact, sha256_text(str(values.tolist()))), ())
    cells = values.dtype.kind in "bu" and values.dtype.itemsize == 1
    if cells and values.ndim == 3 and values.shape[0] == 8 * values.shape[2]:
        values = np.bitwise_count(values)
    flat = values.astype(np.float64).ravel()
    finite = np.isfinite(flat)
    chosen = kind or ("cells" if cells else "volume" if flat.size > FEW else "few")
    return Part(chosen, tuple(exact), _sums(np.where(finite, flat, 0.0), int(finite.sum())))


def _sums(flat: NDArray[np.float64], finite: int) -> tuple[float, ...]:
    """How many are finite and how many are not 0 (up to rounding), mean, RMS, two projections."""
    count = max(len(flat), 1)
    rms = float(np.sqrt(np.square(flat).sum() / count))
    filled, total, *projections = _weighted_sums(flat, ROUNDING * rms, *map(np.uint64, SEEDS))
    return (finite, int(filled), total / count, rms, *(float(each / np.sqrt(count)) for each in projections))


@njit(cache=True)
def _weighted_sums(
    flat: NDArray[np.float64], nothing: float, first_seed: np.uint64, second_seed: np.uint64
) -> tuple[int, float, float, float]:
    """How many exceed `nothing`; their sum; their sums by the weights of two seeds."""
    filled, total, first, second = 0, 0.0, 0.0, 0.0
    for index in range(len(flat)):
        value = flat[index]
        filled += abs(value) > nothing
        total += value
        if value != 0:
            first += value * _weight(np.uint64(index), first_seed)
            second += value * _weight(np.uint64(index), second_seed)
    return filled, total, first, second


@njit(cache=True)
def _weight(index: np.uint64, seed: np.uint64) -> float:
    """In [-1, 1), by the index alone: the mixing steps of SplitMix64 (Steele et al., 2014)."""
    mixed = (index + np.uint64(1)) * seed
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return float(mixed >> np.uint64(11)) / 2.0**52 - 1.0


def mesh_digest(mesh: TriangleMesh) -> Digest:
    """What the order of vertices and faces does not change: counts, area, centre, spread and box."""
    vertices = np.asarray(mesh.vertices, np.float64)
    corners = vertices[np.asarray(mesh.faces)]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    middle, total = corners.mean(axis=1), area.sum()
    centre = (middle * area[:, None]).sum(axis=0) / total
    spread = np.sqrt((np.square(middle - centre) * area[:, None]).sum(axis=0) / total)
    figures = [total, *centre, *spread, *vertices.min(axis=0), *vertices.max(axis=0)]
    counts = (len(vertices), len(mesh.faces))
    return {"counts": Part("counts", (), counts), "shape": Part("mesh", (), tuple(map(float, figures)))}


def json_digest(content: Any) -> Digest:
    """A part for each path of keys, over all items of its lists: words exactly, numbers closely."""
    words: dict[str, list[str]] = defaultdict(list)
    numbers: dict[str, list[float]] = defaultdict(list)
    _collect(content, "", words, numbers)
    parts = {}
    for path, said in words.items():
        found = np.array(numbers[path])
        exact = (sha256_text("\n".join(said)), str(len(found)))
        in_mm = "frames" if path.startswith("per_frame.") else "millimetres"
        kind = in_mm if path.endswith("_mm") else "few"
        parts[path or "text"] = Part(kind, exact, _sums(found, len(found)))
    return parts


def _collect(value: Any, path: str, words: dict[str, list[str]], numbers: dict[str, list[float]]) -> None:
    """Put the words of a JSON value, and the numbers in it and in its words, under their paths."""
    if isinstance(value, dict):
        kept = {key: inner for key, inner in value.items() if key not in PROVENANCE}
        words[path].append(" ".join(HASH.sub("hash", key) for key in kept))
        for key, inner in kept.items():
            _collect(inner, f"{path}.{key}".lstrip("."), words, numbers)
    elif isinstance(value, list):
        words[path].append(f"list of {len(value)}")
        for inner in value:
            _collect(inner, path, words, numbers)
    elif isinstance(value, str):
        text = IMAGE.sub("base64", HASH.sub("hash", value))
        for version in VERSIONS_HERE:
            text = text.replace(version, "version")
        words[path].append(NUMBER.sub(lambda found: "#" if abs(float(found[0])) < LARGE else found[0], text))
        numbers[path] += [number for number in map(float, NUMBER.findall(text)) if abs(number) < LARGE]
    elif isinstance(value, bool) or value is None:
        words[path].append(str(value))
    else:
        words[path].append("number")
        numbers[path].append(float(value))


def difference(pinned: Digest, found: Digest) -> str:
    """The first part that is not the same within the tolerances, in words; "" if all are."""
    for name in dict.fromkeys((*pinned, *found)):
        if name not in pinned or name not in found:
            return f"{name} {'is new' if name in found else 'is gone'}"
        if not _close(pinned[name], found[name]):
            return name
    return ""


def _close(pinned: Part, found: Part) -> bool:
    if (pinned.kind, pinned.exact) != (found.kind, found.exact) or len(pinned.numbers) != len(found.numbers):
        return False
    old, new = np.array(pinned.numbers, np.float64), np.array(found.numbers, np.float64)
    if len(old) == 0:
        return True
    tolerance = TOLERANCES[pinned.kind]
    if pinned.kind == "mesh":
        allowed = np.full(len(old), tolerance[0])
    elif pinned.kind == "counts":
        allowed = tolerance[0] * old
    else:
        filled, sums, projections = tolerance
        allowed = np.array([0, filled * old[1], *(sums * old[3],) * 2, *(projections * old[3],) * 2])
    # Pins are written with nine digits.
    return bool((np.abs(new - old) <= allowed + 1e-8 * np.abs(old)).all())


def to_json(digest: Digest) -> dict[str, list[Any]]:
    """As JSON values, with as many digits as the tolerances need."""
    return {
        name: [part.kind, list(part.exact), [float(f"{number:.9g}") for number in part.numbers]]
        for name, part in digest.items()
    }


def from_json(content: Mapping[str, list[Any]]) -> Digest:
    """The inverse of `to_json`."""
    return {
        name: Part(kind, tuple(exact), tuple(numbers)) for name, (kind, exact, numbers) in content.items()
    }
