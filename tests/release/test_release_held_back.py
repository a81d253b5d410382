"""What a public part tells of the truth, nothing, and that the private part scores as the whole release."""

import json
import re
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raising import raises
from small_benchmark import Run, hashes
from synthetic_release import FLOOR, RECORDINGS, resum, synthetic_pair, synthetic_settings, write_build

from kinectbench import Scorer, load
from kinectbench.cli.publish import publish_options
from kinectbench.core.artefacts.benchmark import PublishOptions
from kinectbench.core.errors import ReleaseError, SettingsError
from kinectbench.core.geometry import rigid, rotation_from_quaternion_xyzw
from kinectbench.core.voxels.pair_file import (
    INPUT_KEYS,
    OPTIONAL,
    TRUTH_KEYS,
    pair_bytes,
    read_input,
    read_pair,
    unpack,
)
from kinectbench.release.check.verify import verify
from kinectbench.release.check.view_check import input_problems
from kinectbench.release.exchange.recgan import export_recgan
from kinectbench.release.publish.held_back import own_world, without_truth
from kinectbench.release.publish.publish import PublishSummary, publish
from kinectbench.release.release import Release, open_release
from kinectbench.scoring.baselines.predict import possible_baselines, write_baselines
from kinectbench.scoring.predictions import check
from kinectbench.scoring.score import score

Command = Callable[..., Run]
NAMES = [recording[0] for recording in RECORDINGS]
TEST = [name for name, _, _, split, _ in RECORDINGS if split == "test"]


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> PublishSummary:
    root: Path = tmp_path_factory.mktemp("held")
    write_build(root / "build")
    return publish(
        synthetic_settings(),
        root / "build",
        root / "benchmark",
        NAMES,
        PublishOptions(hold_back=("test",), thresholds=None),
    )


def test_the_parts_name_each_other(parts: PublishSummary, release: Release) -> None:
    public = json.loads((parts.folder / "benchmark.json").read_text())
    assert parts.private is not None
    private = json.loads((parts.private / "benchmark.json").read_text())
    assert public["held_back"] == ["test"] and "held_back" not in private
    assert public["private_benchmark_sha256"] == private["benchmark_sha256"] == parts.private_sha256
    assert private["public_benchmark_sha256"] == public["benchmark_sha256"] == parts.benchmark_sha256
    # The private part is the release as it would be without the option.
    assert private["benchmark_sha256"] == release.benchmark_sha256
    ours, theirs = hashes(parts.private), hashes(release.folder)
    assert {name for name in ours if ours[name] != theirs[name]} == {"benchmark.json", "SHA256SUMS"}
    assert verify(parts.private) == []
    assert "framing 'object'" in parts.warnings[-1]


def arrays(path: Path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as archive:
        return {key: archive[key] for key in archive.files}


def test_no_truth_in_the_public_part(parts: PublishSummary) -> None:
    assert parts.private is not None
    public = open_release(parts.folder)
    for target in public.split("test"):
        values = arrays(public.pair_path(target))
        assert set(values) == {*INPUT_KEYS, "format_version"}
        with zipfile.ZipFile(public.pair_path(target)) as archive:  # nor hidden in the file
            assert {Path(name).stem for name in archive.namelist()} == set(values)
        assert (
            list(input_problems(read_input(public.pair_path(target)), framing="object", partial_rule="any"))
            == []
        )
        truth = arrays(parts.private / target.file)
        for key in truth.keys() & {*TRUTH_KEYS}:
            assert not any(np.array_equal(truth[key], value) for value in values.values())
    assert all(target.unknown_share is None for target in public.split("test"))
    for target in public.split("validation"):
        assert target.unknown_share is not None
        assert set(TRUTH_KEYS) - set(OPTIONAL) <= set(arrays(public.pair_path(target)))
    for name in TEST:
        assert [path.name for path in (parts.folder / "objects" / name).iterdir()] == ["floor.json"]
        views = json.loads((parts.folder / "views" / name / "views.json").read_text())
        assert all(set(row) == {"view", "K", "width", "height", "pair"} for row in views["views"])
    # No byte of a published file of the truth is anywhere in the public part.
    secret = {
        digest for name, digest in hashes(parts.private).items() if name.split("/")[0] in ("pairs", "objects")
    }
    secret -= {
        digest
        for name, digest in hashes(parts.folder).items()
        if name.split("/")[1:2] and name.split("/")[1] not in TEST
    }
    assert not secret & set(hashes(parts.folder).values())


def test_no_measured_figure_of_the_truth(parts: PublishSummary) -> None:
    info = json.loads((parts.folder / "benchmark.json").read_text())
    for name, recording in info["recordings"].items():
        assert (recording["quality"] == {}) == (name in TEST)
    assert all("box" not in row for row in info["settings"]["recordings"] if row["id"] in TEST)
    lineage = json.loads((parts.folder / "lineage.json").read_text())["recordings"]
    for name in TEST:
        assert "views" not in lineage[name]
        assert all("box" not in stage["settings"] for stage in lineage[name]["stages"].values())
    page = (parts.folder / "index.html").read_text()
    assert page.count(">full, as seen<") == 3  # of the three validation pairs
    assert "held back" in page and "held back" in (parts.folder / "README.md").read_text()


def test_input_in_a_world_of_its_own() -> None:
    pair = synthetic_pair(3, "chair")
    T_floor_world = np.array(FLOOR["T_floor_world"])
    own = without_truth(pair, T_floor_world)
    # The camera is as high above the floor as it was, above the origin, and looks along x.
    camera_floor = T_floor_world @ pair.T_world_camera
    np.testing.assert_allclose(own.T_world_camera[:3, 3], [0, 0, camera_floor[2, 3]], atol=1e-9)
    forward = own.T_world_camera[:3, 2]
    np.testing.assert_allclose(forward[1:], [0, camera_floor[2, 2]], atol=1e-9)
    assert forward[0] > 0
    # Grid and camera lie to each other as before.
    np.testing.assert_allclose(
        np.linalg.inv(own.T_world_camera) @ own.T_world_grid,
        np.linalg.inv(pair.T_world_camera) @ pair.T_world_grid,
        atol=1e-9,
    )
    # The same view from elsewhere on the floor is the same input: nothing tells where it was.
    elsewhere = rigid(rotation_from_quaternion_xyzw([0, 0, 0.6, 0.8]), [3.0, -1.0, 0.0])
    np.testing.assert_allclose(
        own_world(elsewhere @ camera_floor) @ elsewhere @ camera_floor, own.T_world_camera, atol=1e-9
    )


def test_straight_down() -> None:
    down = np.eye(4)
    down[:3, :3] = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])  # x right, z down, image top towards +y
    down[:3, 3] = 1, 2, 3
    T = own_world(down) @ down
    np.testing.assert_allclose(T[:3, 3], [0, 0, 3])
    np.testing.assert_allclose(-T[:3, 1], [1, 0, 0])


def test_scoring_is_refused(parts: PublishSummary, tmp_path: Path) -> None:
    public = open_release(parts.folder)
    with raises(ReleaseError, "release.truth-held-back", match="of the test split"):
        score(public, tmp_path, method="m")
    with raises(ReleaseError, "release.truth-held-back", match="held back"):
        Scorer(parts.folder)
    with raises(ReleaseError, "release.truth-held-back", match="held back"):
        export_recgan(public, tmp_path / "out")


def test_inputs_can_be_used(parts: PublishSummary, tmp_path: Path) -> None:
    assert parts.private is not None
    public, private = open_release(parts.folder), open_release(parts.private)
    dataset = load(parts.folder)
    item = dataset.split("test")[0]
    assert "full" not in item and "known" not in item
    pair = read_pair(private.pair_path(private.split("test")[0]))
    np.testing.assert_array_equal(item["partial"], unpack(pair.partial))
    assert "full" in dataset.split("validation")[0]
    names = ("partial", "mirror", "base-rate")
    write_baselines(public, tmp_path / "public", names)
    write_baselines(private, tmp_path / "private", names)
    # Up and the cube are the same, so the baselines are, too; they say of which half they are.
    ours, theirs = hashes(tmp_path / "public"), hashes(tmp_path / "private")
    assert {file for file in ours | theirs if ours.get(file) != theirs.get(file)} == {
        f"{name}/method.json" for name in names
    }
    assert check(private, tmp_path / "public" / "partial") == []


def test_scores_of_the_private_part(parts: PublishSummary, release: Release, tmp_path: Path) -> None:
    assert parts.private is not None
    write_baselines(open_release(parts.folder), tmp_path, ["partial"])
    one = score(open_release(parts.private), tmp_path / "partial", method="partial", surface=False)
    two = score(release, tmp_path / "partial", method="partial", surface=False)
    # Only the private part knows the public one, which the baselines were written for.
    (line,) = set(two.warnings) - set(one.warnings)
    assert "the predictions are for another release" in line
    assert one == two.model_copy(update={"warnings": one.warnings}) and one.complete


def test_everything_held_back(tmp_path: Path) -> None:
    write_build(tmp_path / "build")
    summary = publish(
        synthetic_settings(),
        tmp_path / "build",
        tmp_path / "b",
        ["chair_02"],
        PublishOptions(hold_back=("test",), thresholds=None),
    )
    public = open_release(summary.folder)
    assert "base-rate" not in possible_baselines(public)
    with raises(SettingsError, "settings.truth-held-back"):
        write_baselines(public, tmp_path / "p", ["base-rate"])
    write_baselines(public, tmp_path / "p", ["hull"])
    code = (summary.folder / "README.md").read_text().split("```python\n")[1].split("```")[0]
    assert "full" not in code


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")
def test_croissant_without_shares_of_unknown(parts: PublishSummary) -> None:
    import mlcroissant

    records = list(mlcroissant.Dataset(jsonld=parts.folder / "croissant.json").records("targets"))
    told = {row["targets/split"].decode(): row["targets/unknown_share"] for row in records}
    assert told["test"] is None and told["validation"] > 0


def test_a_share_of_unknown_that_is_held_back(parts: PublishSummary, tmp_path: Path) -> None:
    public = Path(shutil.copytree(parts.folder, tmp_path / "public"))
    header, first, *rest = (public / "targets.csv").read_text().splitlines(keepends=True)
    (public / "targets.csv").write_text("".join([header, first.replace(",\n", ",0.25\n"), *rest]))
    resum(public, "targets.csv")
    assert "targets.csv, line 2: holds unknown_share, which is held back" in verify(public)


def test_damaged_inputs(parts: PublishSummary, tmp_path: Path) -> None:
    public = Path(shutil.copytree(parts.folder, tmp_path / "public"))
    name = "pairs/chair_01/000.npz"
    pair = synthetic_pair(0, "chair")
    wrong = replace(pair, framing="view", seen=0 * pair.seen)
    (public / name).write_bytes(pair_bytes(wrong))
    resum(public, name)
    lines = [line.removeprefix(f"{name}: ") for line in verify(public) if line.startswith(f"{name}: ")]
    assert [re.sub(r"^\d+", "N", line) for line in lines] == [
        "holds full, shell, known, surface_sigma_m, which is held back",
        "framing is 'view' where the benchmark has 'object'",
        f"only 0 of the {int(unpack(pair.partial_256).sum())} cells of 'partial_256' are 'seen'",
        "N cells of 'seen' are not as its view's depth has them",
        "its cube is not that of its view's depth in its mask",
    ]
    values: dict[str, Any] = arrays(parts.folder / name)
    del values["seen"]
    np.savez(public / name, **values)
    resum(public, name)
    assert f"{name}: not a pair's input: the keys seen are missing" in verify(public)


def test_options(tmp_path: Path) -> None:
    settings = synthetic_settings()
    with raises(SettingsError, "settings.wrong-value", match="--hold-back"):
        publish_options(settings, ["tset"], None)
    with raises(ReleaseError, "release.no-pairs"):
        publish(
            settings, tmp_path, tmp_path / "b", NAMES, PublishOptions(hold_back=("train",), thresholds=None)
        )
    file = tmp_path / "t.json"
    file.write_text('{"thresholds": {"chair": 0.4}}')
    with raises(SettingsError, "settings.bad-thresholds"):
        publish_options(settings, (), file)


@pytest.mark.xdist_group("commands")
def test_the_commands_know_which_part_scores(small: Path, command: Command, tmp_path: Path) -> None:
    root = Path(shutil.copytree(small, tmp_path / "b"))
    text = (root / "benchmark.yaml").read_text().replace("split: validation", "split: train")
    (root / "benchmark.yaml").write_text(text + "license: CC0-1.0\nsource: simulated\n")
    first = command(root, "publish", "--hold-back", "test", "--jobs", "1", "--json")
    assert first.status == 0, first
    result = json.loads(first.out)
    assert command(root, "baseline", "partial", "--jobs", "1").status == 0
    scored = command(root, "score", "predictions/partial", "--jobs", "1", "--no-surface")
    assert scored.status == 0, scored
    scores = json.loads((root / "scores" / "scores.json").read_text())
    assert scores["benchmark_sha256"] == result["private_benchmark_sha256"]
    # Neither has published the truth in the meantime.
    held = json.loads((root / "benchmark" / "benchmark.json").read_text())
    assert held["held_back"] == ["test"] and held["benchmark_sha256"] == result["benchmark_sha256"]
    refused = command(root, "score", "predictions/partial", "--benchmark", "benchmark", "--jobs", "1")
    assert refused.status == 1 and "held back" in refused.err and len(refused.err.splitlines()) == 1
    assert command(root, "check", "predictions/partial", "--benchmark", "benchmark").status == 0
    again = command(root, "publish", "--jobs", "1", "--json")
    assert json.loads(again.out)["benchmark_sha256"] == result["private_benchmark_sha256"]
    assert read_input(root / "benchmark" / "pairs" / "chair" / "000.npz").framing == "object"
