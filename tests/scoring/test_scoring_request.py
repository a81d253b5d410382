"""Options that contradict each other, or what a method declares, are refused before anything is counted."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raising import raises

from kinectbench.core.errors import PredictionError, SettingsError
from kinectbench.engine.shards import Shard
from kinectbench.release.release import Release
from kinectbench.scoring.request import Request, check_request
from kinectbench.scoring.score import count_methods, score_methods

IN_CAMERA = '{"name": "net", "frame": "camera"}'
FREE = '{"name": "net", "frame": "camera", "scale": "free"}'


@pytest.fixture
def folder(tmp_path: Path, release: Release) -> Path:
    """A method of cells, and one in the camera frame that comes after it."""
    for method in ("cells", "net"):
        for target in release.split("test"):
            path = tmp_path / "all" / method / f"{target.name}.npy"
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, np.zeros((8, 8, 8), bool))
    (tmp_path / "all" / "net" / "method.json").write_text(IN_CAMERA)
    return tmp_path / "all"


CONTRADICTIONS: dict[str, tuple[str, dict[str, Any], str]] = {
    "thresholds": (IN_CAMERA, {"thresholds_file": "t.json"}, "--thresholds .*: net in the camera frame has"),
    "saved": (IN_CAMERA, {"save_thresholds": Path("t.json")}, "--save-thresholds t.json: net in the camera"),
    "key": ('{"name": "net", "form": "sdf"}', {}, "'form' 'sdf' is not supported yet"),
}


UNFIT: dict[str, tuple[str, tuple[str, ...], str]] = {
    "cells": (IN_CAMERA, ("paper", "known"), "--protocol paper, known: net predicts in the"),
    "size": (FREE, ("camera",), "--protocol camera: the predictions of net are of free size"),
}


@pytest.mark.parametrize("name", list(UNFIT))
def test_protocols_that_do_not_fit_are_refused_of_one_method(
    folder: Path, release: Release, tmp_path: Path, name: str
) -> None:
    """Of several, the others are scored."""
    declared, protocols, words = UNFIT[name]
    (folder / "net" / "method.json").write_text(declared)
    with pytest.raises(SettingsError, match=words):
        score_methods(release, folder / "net", tmp_path / "out", protocols=protocols)
    with pytest.raises(SettingsError, match=words):
        check_request(Request(protocols), folder / "net")
    check_request(Request(protocols), folder)
    assert not (tmp_path / "out").exists()
    tables = score_methods(release, folder, tmp_path / "out", protocols=protocols, surface=False)
    assert [(table.method, table.complete) for table in tables] == [("cells", True), ("net", False)]
    assert re.match(words, tables[1].failures[0].reason)


@pytest.mark.parametrize("name", list(CONTRADICTIONS))
def test_a_contradiction_is_refused_before_any_method_is_counted(
    folder: Path, release: Release, tmp_path: Path, name: str
) -> None:
    """Also before a benchmark is built, which takes hours: by the folder alone."""
    declared, options, words = CONTRADICTIONS[name]
    (folder / "net" / "method.json").write_text(declared)
    (tmp_path / "t.json").write_text('{"thresholds": {"chair": 0.5}, "objects": []}')
    if "thresholds_file" in options:
        options = {"thresholds_file": tmp_path / "t.json"}
    done: list[int] = []
    with pytest.raises((SettingsError, PredictionError), match=words):
        score_methods(release, folder, tmp_path / "out", progress=lambda *n: done.append(n[0]), **options)
    assert not done and not (tmp_path / "out").exists()
    with pytest.raises((SettingsError, PredictionError), match=words):
        check_request(Request(**options), folder)
    check_request(Request(**options), folder / "cells")


def test_what_cells_contradict_is_refused_before_any_method_is_counted(
    folder: Path, release: Release, tmp_path: Path
) -> None:
    (folder / "cells").rename(folder / "z_cells")  # after the other
    done: list[int] = []
    for options in ({"close": "winding"}, {"protocols": ("camera",), "upsampling": "corner-aligned"}):
        with raises(SettingsError, "settings.wrong-value"):
            score_methods(release, folder, tmp_path / "out", progress=lambda *n: done.append(n[0]), **options)
    assert not done and not (tmp_path / "out").exists()


def test_thresholds_that_nothing_finds_are_not_to_be_saved(
    folder: Path, release: Release, tmp_path: Path
) -> None:
    done: list[int] = []
    out, saved = tmp_path / "out", tmp_path / "t.json"
    with raises(SettingsError, "settings.wrong-value", match="not from validation; predict it too"):
        score_methods(
            release, folder / "cells", out, save_thresholds=saved, progress=lambda *n: done.append(n[0])
        )
    assert not done and not out.exists()
    with raises(SettingsError, "settings.wrong-value", match="with --thresholds none are found"):
        check_request(Request(thresholds_file=saved, save_thresholds=saved), folder / "cells")


def test_surfaces_in_space_are_not_scored_in_parts_or_elsewhere(
    folder: Path, release: Release, tmp_path: Path
) -> None:
    with raises(SettingsError, "settings.wrong-value", match="not scored in parts"):
        count_methods(release, folder, tmp_path / "out", Shard(1, 2), surface=False)
    assert not (tmp_path / "out").exists()
    for method, protocols in (("net", None), ("cells", ("camera",))):
        with raises(SettingsError, "settings.wrong-value", match="--cluster: .* on one machine"):
            check_request(Request(protocols, jobs="tcp://there:8786"), folder / method)


def test_baselines_are_asked_for_protocols_of_one_kind() -> None:
    with raises(SettingsError, "settings.wrong-value", match="have tables of their own"):
        check_request(Request(("known", "camera")), None)
