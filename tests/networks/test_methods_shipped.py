"""The network that comes with its weights: what it was shipped for, and shapes that nobody trained on."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from raising import raises

from kinectbench.core.artefacts.method import TrainingFile
from kinectbench.core.errors import SettingsError
from kinectbench.core.voxels.convex_hull import filled_hull
from kinectbench.core.voxels.pair_file import Pair, unpack
from kinectbench.lab.synthesize.make import make_synthetic_pair
from kinectbench.lab.synthesize.mesh_check import load_model
from kinectbench.lab.synthesize.models import Model, SynthesisSettings
from kinectbench.lab.synthesize.views import DepthCamera, all_views, virtual_camera
from kinectbench.networks.config import find_config, write_config
from kinectbench.networks.convert import fitting_config
from kinectbench.networks.trained import folder_of, open_trained, packaged_methods
from kinectbench.networks.validate import completed
from kinectbench.networks.weights import FILE

NAME = "recae-small"
# Seeds of objects begin at 0 where there is something to learn from.
UNSEEN = 1000
SETTINGS = SynthesisSettings()


def unseen_pair(family: str, view: int) -> Pair:
    """A pair of an object that no release of `synthesize` holds."""
    model = load_model(Model(family, f"{family}-{UNSEEN:05d}", seed=UNSEEN), SETTINGS.max_faces)
    eye = DepthCamera(model.mesh, virtual_camera(SETTINGS.image_px))
    pair, reason = make_synthetic_pair(model, eye, all_views(SETTINGS.sv_steps)[view], SETTINGS)
    assert reason is None
    return pair


def iou(prediction: np.ndarray, pair: Pair) -> float:
    full = unpack(pair.full)
    return float((prediction & full).sum() / (prediction | full).sum())


def test_it_is_small_and_whole() -> None:
    assert packaged_methods() == (NAME,)
    folder = folder_of(NAME)
    assert (folder / FILE).stat().st_size <= 6_000_000
    training = TrainingFile.read(folder)
    assert training.steps == training.steps_in_all == training.rows[-1].step
    assert (folder / "curves.png").read_bytes().startswith(b"\x89PNG")


def test_one_command_trains_it_again() -> None:
    """Its configuration is that of the package, so the hash says."""
    assert TrainingFile.read(folder_of(NAME)).config_sha256 == find_config(NAME).sha256
    assert open_trained(folder_of(NAME)).config == find_config(NAME)


def test_a_name_of_the_package_and_of_something_here_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`train recae-small --out recae-small`, then `predict recae-small`: which weights are meant?"""
    monkeypatch.chdir(tmp_path)
    (tmp_path / NAME).mkdir()
    assert folder_of(NAME).is_absolute()  # an empty folder is no method
    write_config(find_config(NAME), tmp_path / NAME / "config.yaml")
    write_config(find_config(NAME), tmp_path / "varley")
    for find, name in ((folder_of, NAME), (find_config, "varley")):
        with raises(SettingsError, "settings.wrong-value", match=rf"write \./{name}"):
            find(name)
    assert folder_of(f"./{NAME}") == Path(NAME)
    assert find_config("./varley") == find_config(NAME)
    (tmp_path / "3d-recgan++-code").touch()  # what the package itself reads is its own
    tensors = {"aeu/e1_w": SimpleNamespace(shape=(4, 4, 4, 1, 64))}
    assert fitting_config(tensors, tmp_path).network.kind == "3d-recgan++"  # type: ignore[arg-type]


def test_it_beats_what_it_has_to_in_both_framings() -> None:
    figures = json.loads((folder_of(NAME) / "figures.json").read_text(encoding="utf-8"))
    judged = [figure for figure in figures if figure["bar"] == "interval above 0"]
    assert all(figure["met"] for figure in judged)
    said = {
        (figure["name"].split("framing ")[1].split(":")[0], figure["name"].split(" - ")[1])
        for figure in judged
    }
    assert said == {
        (framing, name) for framing in ("object", "view") for name in ("hull", "silhouette", "nearest")
    }


def test_it_learnt_from_no_object_of_the_demo() -> None:
    learnt = TrainingFile.read(folder_of(NAME)).objects
    assert learnt and not set(find_config(NAME).training.leave_out).intersection(learnt)


@pytest.mark.parametrize("family", ["mug", "bench", "bucket"])
def test_it_completes_what_it_never_saw(family: str) -> None:
    """By more than the convex hull of what is seen does, in the pairs' own cube."""
    method = open_trained(folder_of(NAME))
    ours, theirs = [], []
    for view in (31, 87):
        pair = unseen_pair(family, view)
        ours.append(iou(completed(method.network, unpack(pair.partial), method.config, "cpu") > 0.4, pair))
        theirs.append(iou(filled_hull(unpack(pair.partial_256)), pair))
    assert np.mean(ours) > np.mean(theirs)
