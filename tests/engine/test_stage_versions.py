"""What is kept on disk has a version; one that writes something else under the same version is found."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pin_stages import changes, digests, read_pins, unpinned, unraised
from stage_digests import Digest, array_digest, difference, file_digest, json_digest
from stage_sample import SYNTHESIS, Sample, jobs, make_sample, read_sample

from kinectbench.core.storage import pretty_json
from kinectbench.core.voxels.npz import load_arrays, npz_bytes
from kinectbench.engine.artefact import VERSIONS
from kinectbench.engine.pipeline import STAGE_NAMES, build_recording
from kinectbench.engine.stages import STAGES, SUGGEST, current_stages
from kinectbench.lab.synthesize.make import Task
from kinectbench.lab.synthesize.models import Model, SynthesisSettings
from kinectbench.release.publish.publish_if_stale import publish_if_stale
from kinectbench.release.release import Release, open_release
from kinectbench.scoring.baselines.in_grids import comparison_baselines
from kinectbench.scoring.baselines.registry import LEARNED
from kinectbench.scoring.pair_result import Counting, PairJob

pytestmark = pytest.mark.xdist_group("stage versions")  # the sample is made once

Pinned = dict[str, dict[str, Digest]]


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the sample; not to be changed."""
    folder = tmp_path_factory.mktemp("sample")
    make_sample(folder)
    return folder


@pytest.fixture(scope="module")
def sample(root: Path) -> Sample:
    return read_sample(root)


@pytest.fixture(scope="module")
def found(sample: Sample) -> Pinned:
    return digests(sample)


# --- pins ---------------------------------------------------------------------------------------------


def test_every_stage_writes_what_its_version_wrote(sample: Sample, found: Pinned) -> None:
    pins = read_pins()
    lines = unraised(pins, changes(pins, sample, found)) or unpinned(pins)
    assert not lines, "\n".join(lines)


def test_everything_that_has_a_version_is_looked_at(sample: Sample) -> None:
    assert set(sample) == set(VERSIONS) and all(written.files for written in sample.values())
    assert {stage.name: stage.version for stage in (*STAGES, SUGGEST)}.items() <= VERSIONS.items()


@pytest.mark.parametrize("stage", VERSIONS)
def test_a_version_whose_pins_are_old_is_told(monkeypatch: pytest.MonkeyPatch, stage: str) -> None:
    pinned = read_pins()[stage]["version"]
    monkeypatch.setitem(VERSIONS, stage, pinned + 1)
    (line,) = unpinned(read_pins())
    assert line == (
        f"stage `{stage}` is version {pinned + 1}, but pinned is version {pinned}: "
        "run `python tests/support/pin_stages.py`"
    )


def other_probability(path: Path) -> None:
    """2 percent off in one half of the volume."""
    arrays = load_arrays(path)
    arrays["probability"][: len(arrays["probability"]) // 2] *= 0.98
    path.write_bytes(npz_bytes(arrays))


def other_json(key: str, add: float) -> Callable[[Path], None]:
    """One number is another."""

    def change(path: Path) -> None:
        content = json.loads(path.read_text(encoding="utf-8"))
        content[key] += add
        path.write_text(pretty_json(content), encoding="utf-8")

    return change


def other_shifts(path: Path) -> None:
    """Each frame's shift, which sets its weight in fusion, is 5 percent larger."""
    content = json.loads(path.read_text(encoding="utf-8"))
    for row in content["per_frame"]:
        row["shift_mm"] *= 1.05
    path.write_text(pretty_json(content), encoding="utf-8")


def other_pose(path: Path) -> None:
    """One frame lies 5 mm elsewhere."""
    rows = path.read_text(encoding="utf-8").splitlines()
    values = rows[3].split()
    values[1] = str(float(values[1]) + 0.005)
    rows[3] = " ".join(values)
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")


@pytest.mark.parametrize(
    ("stage", "file", "change", "part"),
    [
        ("track", "trajectory/trajectory.txt", other_pose, "column 1"),
        ("track", "trajectory/health.json", other_shifts, "per_frame.shift_mm"),
        ("segment", "object/volume.npz", other_probability, "probability"),
        ("segment", "object/quality.json", other_json("estimated_iou", 0.01), "estimated_iou"),
        ("sample-views", "views/001.mask.png", Path.unlink, "is gone"),
        ("ingest", "sequence/camera.json", other_json("source_format", "!"), "source_format"),  # type: ignore[arg-type]
    ],
)
def test_one_changed_value_is_told_with_what_to_do(
    root: Path,
    found: Pinned,
    tmp_path: Path,
    stage: str,
    file: str,
    change: Callable[[Path], None],
    part: str,
) -> None:
    folder = Path(file).parent
    copied = tmp_path / "build" / "given" / folder
    shutil.copytree(root / "build" / "given" / folder, copied)
    change(tmp_path / "build" / "given" / file)
    pins, sample = read_pins(), read_sample(root)
    files = read_sample(tmp_path)[stage].files
    changed = {name: file_digest(path) for name, path in files.items()}
    kept = {name: digest for name, digest in found[stage].items() if not name.startswith("given/")}
    (line,) = unraised(pins, changes(pins, sample, found | {stage: changed | kept}))
    gone = part == "is gone"
    what = f"given/{file} {part}" if gone else f"given/{file}: {part}"
    assert line == (
        f"stage `{stage}` writes something else than version {VERSIONS[stage]} did ({what}): if that is "
        "meant, raise its version in kinectbench/engine/artefact.py and run "
        "`python tests/support/pin_stages.py`"
    )


def test_a_stage_is_not_blamed_for_what_it_stands_on(sample: Sample, found: Pinned) -> None:
    other = {"given/trajectory/health.json": json_digest({"grade": "other"})}
    changed = found | {name: found[name] | other for name in ("track", "segment", "pairs")}
    assert list(changes(read_pins(), sample, changed)) == ["track"]


def test_scores_are_not_excused_by_what_they_count(sample: Sample, found: Pinned) -> None:
    other = {"given/pairs/pairs.json": json_digest({"pairs": 3})}
    changed = found | {name: found[name] | other for name in ("pairs", "baselines", "score")}
    assert list(changes(read_pins(), sample, changed)) == ["pairs", "baselines", "score"]


def test_a_raised_version_may_write_something_else(
    sample: Sample, found: Pinned, monkeypatch: pytest.MonkeyPatch
) -> None:
    changed = found | {"fuse": {}}
    assert len(unraised(read_pins(), changes(read_pins(), sample, changed))) == 1
    monkeypatch.setitem(VERSIONS, "fuse", VERSIONS["fuse"] + 1)
    assert unraised(read_pins(), changes(read_pins(), sample, changed)) == []


def test_the_last_bits_do_not_count_and_order_does() -> None:
    exact, rounded = (array_digest(np.array([1.0, 0.5, last])) for last in (0.0, -2.6e-23))
    assert difference({"T": exact}, {"T": rounded}) == ""
    values = np.random.default_rng(0).uniform(0, 1, (40, 40, 40)).astype(np.float32)
    pinned = {"probability": array_digest(values)}
    noise = np.random.default_rng(1).choice([1 - 1e-6, 1 + 1e-6], values.shape).astype(np.float32)
    assert difference(pinned, {"probability": array_digest(values * noise)}) == ""
    assert difference(pinned, {"probability": array_digest(values[::-1])}) == "probability"
    assert difference(pinned, {"probability": array_digest(values.astype(np.float64))}) == "probability"
    assert difference(pinned, {"weight": array_digest(values)}) == "probability is gone"


# --- what is kept, and what is made again -------------------------------------------------------------


@pytest.mark.parametrize(
    ("stage", "again"),
    [("fuse", ("fuse", "segment", "sample-views", "pairs")), ("pairs", ("pairs",))],
)
def test_another_version_makes_a_stage_and_what_stands_on_it_again(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stage: str, again: tuple[str, ...]
) -> None:
    shutil.copytree(root / "build", tmp_path / "build")
    job = jobs(tmp_path)[0]
    monkeypatch.setattr("kinectbench.engine.artefact.__version__", "99.0.0")
    assert build_recording(job).made == ()
    monkeypatch.setitem(VERSIONS, stage, VERSIONS[stage] + 1)
    outcome = build_recording(job)
    assert (outcome.error, outcome.made) == (None, again)
    manifest = json.loads((job.build / STAGES[-1].folder / "manifest.json").read_text())
    assert manifest["stage_version"] == VERSIONS["pairs"] and manifest["package_version"] == "99.0.0"


def test_another_version_is_not_current(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job, boxed = jobs(root)[0], jobs(root)[3]
    names = [stage.name for stage in STAGES]
    assert [*current_stages(job.build, job)] == [*current_stages(job.build)] == names
    assert [*current_stages(job.build, boxed)] == names[:3]  # it has another box
    monkeypatch.setitem(VERSIONS, "fuse", VERSIONS["fuse"] + 1)
    assert [*current_stages(job.build)] == names[:2]


@pytest.mark.parametrize(
    ("recording", "named", "last"),
    [
        ("boxed", {}, "sample-views"),
        ("boxed", {"masks": None}, "segment"),
        ("boxed", {"masks": "other"}, "segment"),
        ("boxed", {"path": "half"}, None),
        ("given", {}, "pairs"),
        ("given", {"masks": "masks"}, "segment"),
        ("given", {"reference": "cad.ply"}, "fuse"),
        ("given", {"path": "half"}, None),
        ("given", {"path": "deleted"}, "pairs"),  # it may have been deleted after the build
    ],
)
def test_other_sources_are_not_current(
    root: Path, recording: str, named: dict[str, str | None], last: str | None
) -> None:
    for name in ("other/000.exclude.png", "cad.ply"):
        (root / name).parent.mkdir(exist_ok=True)
        (root / name).write_bytes(b"another")
    job = next(job for job in jobs(root) if job.recording.id == recording)
    job = replace(job, recording=job.recording.model_copy(update=named))
    assert max(current_stages(job.build, job), key=STAGE_NAMES.index, default=None) == last


def test_another_version_publishes_again(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("build", "benchmark"):
        shutil.copytree(root / name, tmp_path / name)
    settings, names = jobs(tmp_path)[0].settings, ["given"]
    before = (tmp_path / "benchmark").stat().st_ino
    publish_if_stale(settings, tmp_path, names)
    assert (tmp_path / "benchmark").stat().st_ino == before
    monkeypatch.setitem(VERSIONS, "publish", VERSIONS["publish"] + 1)
    publish_if_stale(settings, tmp_path, names)
    assert (tmp_path / "benchmark").stat().st_ino != before


def test_another_version_synthesises_a_model_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = SynthesisSettings.model_validate(SYNTHESIS)
    artefact = Task(Model("chair", "c0", seed=0), "train", settings, tmp_path).artefact()
    monkeypatch.setitem(VERSIONS, "synthesize", VERSIONS["synthesize"] + 1)
    again = Task(Model("chair", "c0", seed=0), "train", settings, tmp_path).artefact()
    assert again.fingerprint != artefact.fingerprint


def test_another_version_counts_again(release: Release, monkeypatch: pytest.MonkeyPatch) -> None:
    target = release.targets[0]
    job = PairJob(target, release.pair_path(target), None, None, Counting(("paper",)))
    before = job.key("digest")
    monkeypatch.setitem(VERSIONS, "score", VERSIONS["score"] + 1)
    assert job.key("digest") != before


@pytest.mark.parametrize("stage", ["score", "baselines"])
def test_another_version_scores_the_baselines_again(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stage: str
) -> None:
    release = open_release(root / "fixed" / "benchmark")
    (first, *_) = comparison_baselines(release, tmp_path, protocols=("paper",), without=LEARNED)
    monkeypatch.setattr("kinectbench.scoring.assemble.__version__", "99.0.0")
    (kept, *_) = comparison_baselines(release, tmp_path, protocols=("paper",), without=LEARNED)
    assert kept.package_version == first.package_version != "99.0.0"
    monkeypatch.setitem(VERSIONS, stage, VERSIONS[stage] + 1)
    (again, *_) = comparison_baselines(release, tmp_path, protocols=("paper",), without=LEARNED)
    assert again.package_version == "99.0.0"
    assert again.settings.baseline_version == VERSIONS["baselines"]
    assert again.settings.score_version == VERSIONS["score"]
