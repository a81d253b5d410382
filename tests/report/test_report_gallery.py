"""The gallery: what is kept of predictions, whatever a stranger puts there, and how it stands in the page."""

import base64
import io
import json
import re
import shutil
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from file_damage import seal
from raising import raises
from read_pictures import decoded_picture
from report_fake_build import parsed_tables
from synthetic_release import RECORDINGS, ball, synthetic_settings, write_build

from kinectbench.core import images
from kinectbench.core.artefacts.gallery import GALLERY, read_gallery, write_gallery
from kinectbench.core.errors import PredictionError, StorageError
from kinectbench.core.voxels.npz import npz_bytes
from kinectbench.core.voxels.pair_file import pack, read_pair, unpack
from kinectbench.release.publish.publish import publish
from kinectbench.release.release import Release, open_release
from kinectbench.report import gallery
from kinectbench.report.gallery import (
    PairTruth,
    gallery_cells,
    gallery_json,
    read_pair_truth,
    reduced_packed,
    shown_pairs,
)
from kinectbench.report.run import page_of_release, write_galleries
from kinectbench.scoring.score import score_methods

RNG = np.random.default_rng(0)


def cells(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (64, 64, 8), np.uint8)


def unpacked(text: str) -> np.ndarray:
    return unpack(np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8).reshape(64, 64, 8))


def test_a_quarter_of_a_cell_is_enough() -> None:
    grid = np.zeros((256, 256, 256), bool)
    grid[:4, :4, 0] = True  # 16 of 64
    grid[4:8, :4, 0] = True
    grid[4, 0, 0] = False  # 15 of 64
    grid |= ball((150, 140, 120), 40)
    plain = grid.reshape(64, 4, 64, 4, 64, 4).sum(axis=(1, 3, 5)) >= 16
    np.testing.assert_array_equal(unpack(reduced_packed(pack(grid))), plain)
    assert plain[0, 0, 0] and not plain[1, 0, 0]


def test_the_best_the_worst_and_some_that_all_methods_share() -> None:
    every = [f"r/{n:03d}" for n in range(100)]
    rising = [every[n] for n in RNG.permutation(100)]
    chosen = shown_pairs(rising, every)
    assert chosen == sorted(set(chosen)) and len(chosen) <= 24
    assert {*rising[:6], *rising[-6:]} <= set(chosen)
    assert {every[0], every[9], every[99]} <= set(chosen)
    assert shown_pairs(every[1::-1], every[:2]) == every[:2]
    assert shown_pairs([], []) == []


def test_a_file_comes_back_and_belongs_to_its_scores(tmp_path: Path) -> None:
    scores = tmp_path / "scores.json"
    scores.write_text("{}")
    assert read_gallery(scores) is None
    kept = {"b/001": cells(1), "a/000": cells(2)}
    write_gallery(kept, scores)
    first = (tmp_path / GALLERY).read_bytes()
    found = read_gallery(scores)
    assert found is not None and list(found) == ["a/000", "b/001"]
    for name, grid in kept.items():
        np.testing.assert_array_equal(found[name], grid)
    write_gallery(kept, scores)
    assert (tmp_path / GALLERY).read_bytes() == first
    scores.write_text("{ }")
    assert read_gallery(scores) is None
    write_gallery({}, scores)
    assert read_gallery(scores) == {}


def hostile(kind: str) -> bytes:
    arrays = {
        "format_version": np.asarray(1),
        "scores_sha256": np.asarray("0" * 64),
        "pairs": np.array(["a/000"]),
        "cells": np.zeros((1, 64, 64, 8), np.uint8),
    }
    if kind == "bomb":
        arrays["more"] = np.zeros(1 << 25, np.uint8)
    elif kind == "pickle":
        buffer = io.BytesIO()
        np.savez(buffer, pairs=np.array([{}], dtype=object))
        return buffer.getvalue()
    elif kind == "version":
        arrays["format_version"] = np.asarray(2)
    elif kind == "names":
        arrays["pairs"] = np.array([1])
    elif kind == "shape":
        arrays["cells"] = np.zeros((1, 64, 64, 9), np.uint8)
    elif kind == "many":
        arrays |= {"pairs": np.array(["a"] * 300), "cells": np.zeros((300, 64, 64, 8), np.uint8)}
    elif kind == "missing":
        del arrays["cells"]
    elif kind == "scalar":
        arrays["pairs"] = np.asarray("a/000")
    return npz_bytes(arrays) if kind != "cut" else npz_bytes(arrays)[:200]


@pytest.mark.parametrize(
    "kind", ["bomb", "pickle", "version", "names", "shape", "many", "missing", "scalar", "cut"]
)
def test_a_strangers_file_is_one_line(tmp_path: Path, kind: str) -> None:
    (tmp_path / "scores.json").write_text("{}")
    (tmp_path / GALLERY).write_bytes(hostile(kind))
    with raises(StorageError, "storage.damaged", match=re.escape(str(tmp_path / GALLERY))) as caught:
        read_gallery(tmp_path / "scores.json")
    assert "\n" not in str(caught.value)


def truth(seed: int, category: str = "chair") -> PairTruth:
    first, second, third, fourth = (cells(seed + k) for k in range(4))
    return PairTruth(category, "thing", np.array([0, -1.0, 0]), first, second, third, fourth)


def scored(method: str, names: list[str]) -> dict[str, Any]:
    rows = [
        {"recording": n.split("/")[0], "object": "thing", "view": n.split("/")[1], "category": "chair",
         "protocol": "known", "iou": 0.5, "threshold": 0.35} for n in names
    ]  # fmt: skip
    return {"method": method, "rows": rows}


def test_the_data_come_back_and_cannot_end_their_element() -> None:
    bad = "</script><script>alert(1)</script><!--&"
    tables = parsed_tables([scored(bad, ["a/000", "b/000"]), scored("other", ["a/000"])])
    kept = [{"a/000": cells(1), "b/000": cells(2), "gone/000": cells(3)}, None]
    text, left_out = gallery_json(tables, kept, {"a/000": truth(10, bad), "b/000": truth(20)}, "known")
    assert text is not None and left_out == 0
    assert not set("<>&") & set(text)
    found = json.loads(text)
    assert [method["name"] for method in found["methods"]] == [bad]
    assert sorted(found["pairs"]) == ["a/000", "b/000"] and found["pairs"]["a/000"]["category"] == bad
    shown = found["methods"][0]["pairs"]["b/000"]
    assert (shown["iou"], shown["threshold"]) == (0.5, 0.35)
    np.testing.assert_array_equal(unpacked(shown["cells"]), unpack(cells(2)))
    np.testing.assert_array_equal(unpacked(found["pairs"]["a/000"]["full"]), unpack(cells(11)))
    np.testing.assert_array_equal(unpacked(found["pairs"]["a/000"]["unseen"]), unpack(cells(13)))


def test_a_method_that_lacks_the_pages_protocol_is_shown_under_its_own() -> None:
    grid, space = scored("grid", ["a/000"]), scored("space", ["a/000"])
    of_space = {"protocol": "camera", "part": "whole", "iou": 0.25}
    space["rows"] = [{**space["rows"][0], **of_space}]
    kept = [{"a/000": cells(1)}, {"a/000": cells(2)}]
    text, left_out = gallery_json(parsed_tables([grid, space]), kept, {"a/000": truth(10)}, "known")
    assert text is not None and left_out == 0
    first, second = (method["pairs"]["a/000"] for method in json.loads(text)["methods"])
    assert (first["iou"], first.get("under")) == (0.5, None)
    assert (second["iou"], second["under"]) == (0.25, "camera")


def test_the_page_stays_small(monkeypatch: pytest.MonkeyPatch) -> None:
    names = [f"a/{n:03d}" for n in range(6)]
    tables = parsed_tables([scored("x", names), scored("y", names)])
    kept = [{name: cells(1) for name in names}, {names[4]: cells(2)}]
    # Random cells do not compress: 32 kB a grid, 44 as text; four of truth, one or two of predictions.
    monkeypatch.setattr(gallery, "MAX_BYTES", 550_000)
    text, left_out = gallery_json(tables, kept, {name: truth(5) for name in names}, "known")
    assert text is not None and len(text) < 550_000 and left_out == 4
    assert "a/004" in json.loads(text)["pairs"]  # the one that most methods have comes first
    monkeypatch.setattr(gallery, "MAX_BYTES", 1000)
    assert gallery_json(tables, kept, {name: truth(5) for name in names}, "known") == (None, 6)


def test_truth_of_a_pair(release: Release) -> None:
    target = release.split("test")[0]
    pair, found = read_pair(release.pair_path(target)), read_pair_truth(release, target)
    np.testing.assert_array_equal(found.partial, pair.partial)
    np.testing.assert_array_equal(found.full, reduced_packed(pair.full))
    np.testing.assert_array_equal(unpack(found.known), unpack(pair.known)[2::4, 2::4, 2::4])
    # What nobody knows of it is a slab of ten voxels along x, from 200 on: two and a half cells of its shape.
    unseen = unpack(found.unseen)
    assert np.flatnonzero(unseen.any(axis=(1, 2))).tolist() == [50, 51, 52]
    np.testing.assert_array_equal(unseen[50:53], unpack(found.full)[50:53])


def test_a_pair_has_its_view_with_colour_where_that_is_published(release: Release, tmp_path: Path) -> None:
    def size(of: Release) -> tuple[int, ...]:
        text = read_pair_truth(of, of.split("test")[0]).picture.removeprefix("data:image/jpeg;base64,")
        size: tuple[int, ...] = decoded_picture(base64.b64decode(text)).shape
        return size

    assert size(release) == (150, gallery.VIEW_PX, 3)
    write_build(tmp_path / "build")
    names = [recording[0] for recording in RECORDINGS]
    settings = synthetic_settings(publish={"color": True})
    colored = publish(settings, tmp_path / "build", tmp_path / "b", names).folder
    assert size(open_release(colored)) == (150, 2 * gallery.VIEW_PX, 3)


def test_from_predictions_to_the_page(release: Release, tmp_path: Path) -> None:
    for target in release.split("test"):
        path = tmp_path / "half" / target.recording / f"{target.view}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        full = unpack(read_pair(release.pair_path(target)).full)
        full[:, :128] = False
        np.save(path, np.where(full, np.float16(0.7), np.float16(0.2)))
    out = tmp_path / "scores"
    tables = score_methods(release, tmp_path / "half", out, surface=False)
    write_galleries(release, tmp_path / "half", tables, out, "half-pixel")
    page, warnings = page_of_release(release, out)
    assert page == out / "index.html" and warnings == []
    text = page.read_text(encoding="utf-8")
    match = re.search(r'id="gallery-data">([^<]+)</script>', text)
    assert match is not None
    data = json.loads(match[1])
    assert sorted(data["pairs"]) == [target.name for target in release.split("test")]
    for target in release.split("test"):
        full = unpack(read_pair(release.pair_path(target)).full)
        full[:, :128] = False
        shown = unpacked(data["methods"][0]["pairs"][target.name]["cells"])
        np.testing.assert_array_equal(shown, full.reshape(64, 4, 64, 4, 64, 4).sum(axis=(1, 3, 5)) >= 16)
    assert "The MIT License" in text and len(text) < 700_000
    again, _ = page_of_release(release, [out], tmp_path / "again.html")
    assert again.read_bytes() == page.read_bytes()


def test_a_missing_prediction_is_an_empty_grid(release: Release, tmp_path: Path) -> None:
    first, *rest = release.split("test")
    (tmp_path / "one" / first.recording).mkdir(parents=True)
    np.save(tmp_path / "one" / first.recording / f"{first.view}.npy", np.ones((1, 1, 1), bool))
    (table,) = score_methods(release, tmp_path / "one", tmp_path / "scores", surface=False, missing="empty")
    found = gallery_cells(release, tmp_path / "one", table)
    assert found[first.name].min() == 255
    assert [found[target.name].any() for target in rest] == [False] * len(rest)
    # Of those that cannot be scored nothing is kept.
    (table,) = score_methods(release, tmp_path / "one", tmp_path / "scores", surface=False)
    assert list(gallery_cells(release, tmp_path / "one", table)) == [first.name]


def test_what_is_not_what_was_scored_is_not_drawn(release: Release, tmp_path: Path) -> None:
    first = release.split("test")[0]
    path = tmp_path / "one" / first.recording / f"{first.view}.npy"
    path.parent.mkdir(parents=True)
    np.save(path, np.ones((1, 1, 1), bool))
    (table,) = score_methods(release, tmp_path / "one", tmp_path / "scores", surface=False)
    np.save(path, np.zeros((1, 1, 1), bool))
    with raises(PredictionError, "prediction.changed", match="score again"):
        gallery_cells(release, tmp_path / "one", table)


def test_a_mask_of_another_size_gives_no_picture(release: Release, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(release.folder, tmp_path / "copy"))
    target = release.split("test")[0]
    mask = copy / f"views/{target.recording}/{target.view}.mask.png"
    mask.write_bytes(images.png(np.ones((7, 9), np.uint8)))
    seal(copy)
    assert read_pair_truth(open_release(copy), target).picture == ""
