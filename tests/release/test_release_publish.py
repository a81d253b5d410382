"""What publish writes, and what open_release refuses."""

import hashlib
import json
import os
import shutil
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from raising import raises
from synthetic_release import RECORDINGS, synthetic_settings, write_build

from kinectbench.core.artefacts.object import INTERVAL_HIGH, INTERVAL_LOW
from kinectbench.core.artefacts.targets import (
    COLUMNS,
    EARLIER_COLUMNS,
    check_names,
    parse_sums,
    parse_targets,
    targets_text,
)
from kinectbench.core.artefacts.views import ViewsFile
from kinectbench.core.errors import ReleaseError
from kinectbench.core.voxels.pair_file import pack, pair_bytes, read_pair, unpack
from kinectbench.release import contents
from kinectbench.release.check import object_check
from kinectbench.release.check.verify import verify
from kinectbench.release.contents import most_bytes
from kinectbench.release.publish import publish as publish_module
from kinectbench.release.publish.publish import publish
from kinectbench.release.release import Release, open_release

NAMES = [recording[0] for recording in RECORDINGS]


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("publish") / "build"
    write_build(folder)
    return folder


def test_targets_and_splits(release: Release) -> None:
    assert [target.name for target in release.split("test")] == [
        "chair_01/000", "chair_01/001", "chair_02/000", "table_01/000"
    ]  # fmt: skip
    target = release.targets[0]
    assert (target.object, target.category, target.file) == ("red_chair", "chair", "pairs/chair_01/000.npz")
    assert target.sha256 == hashlib.sha256(release.pair_path(target).read_bytes()).hexdigest()
    assert release.categories == ("chair", "table")
    assert json.loads((release.folder / "splits.json").read_text()) == {
        "train": [], "validation": ["chair_03", "table_02"], "test": ["chair_01", "chair_02", "table_01"]
    }  # fmt: skip


def test_benchmark_json(release: Release) -> None:
    text = (release.folder / "benchmark.json").read_text()
    assert "/home/someone" not in text
    info = release.metadata
    assert (info.name, info.license, info.framing, info.partial_rule) == (
        "synthetic", "CC0-1.0", "object", "any"
    )  # fmt: skip
    assert info.recordings["chair_01"].quality.json_value() == {"repeatability_iou": 0.93}
    assert info.distribution is not None and info.distribution.allowed
    assert info.settings.pairs.min_containment == 0.85
    assert {"python", "numpy", "open3d"} <= set(info.packages)


def test_sums_are_those_of_sha256sum(release: Release) -> None:
    subprocess.run(["sha256sum", "-c", "--quiet", "--strict", "SHA256SUMS"], cwd=release.folder, check=True)
    sums, stated = ((release.folder / name).read_text() for name in ("SHA256SUMS", "benchmark.json"))
    # As docs/format.md says it, without this package.
    said = {key: value for key, value in json.loads(stated).items() if not key.endswith("benchmark_sha256")}
    files = "".join(line for line in sums.splitlines(keepends=True) if "  benchmark.json" not in line)
    text = files + json.dumps(said, sort_keys=True, separators=(",", ":"))
    assert hashlib.sha256(text.encode()).hexdigest() == release.benchmark_sha256


def test_files(release: Release) -> None:
    names = {p.relative_to(release.folder).as_posix() for p in release.folder.rglob("*") if p.is_file()}
    assert {
        "views/chair_01/001.depth.png",
        "views/chair_01/001.mask.png",
        "views/chair_01/views.json",
    } <= names
    assert {"objects/table_01/mesh.ply", "objects/table_01/quality.json", "README.md"} <= names
    assert not any("color" in name for name in names)


def test_card(release: Release, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (release.folder / "README.md").read_text()
    assert "| chair | 3 | 0 | 2 | 3 |" in text and "CC0-1.0" in text and "0.93" in text
    code = text.split("```python\n")[1].split("```")[0]
    monkeypatch.chdir(release.folder)
    found: dict[str, np.ndarray] = {}
    exec(code, found)
    pair = read_pair(release.pair_path(release.targets[0]))
    np.testing.assert_array_equal(found["full"], unpack(pair.full))
    assert found["points_world"].shape == (found["full"].sum(), 3)


def test_same_build_same_bytes(release: Release, build: Path, tmp_path: Path) -> None:
    publish(synthetic_settings(), build, tmp_path / "benchmark", NAMES)
    assert (tmp_path / "benchmark" / "SHA256SUMS").read_text() == (release.folder / "SHA256SUMS").read_text()
    assert (tmp_path / "benchmark" / "benchmark.json").read_bytes() == (
        release.folder / "benchmark.json"
    ).read_bytes()


def test_color_and_other_warnings(build: Path, tmp_path: Path) -> None:
    settings = synthetic_settings()
    settings = settings.model_copy(
        update={"license": "unspecified", "publish": settings.publish.model_copy(update={"color": True})}
    )
    recordings = [each.model_copy(update={"split": "test"}) for each in settings.recordings]
    settings = settings.model_copy(update={"recordings": recordings})
    summary = publish(settings, build, tmp_path / "benchmark", ["chair_02"])
    assert (tmp_path / "benchmark" / "views" / "chair_02" / "000.color.jpg").is_file()
    assert [line.split(":")[0] for line in summary.warnings] == [
        "no licence is stated", "colour images are included", "no validation split"
    ]  # fmt: skip
    assert "faces" in (tmp_path / "benchmark" / "README.md").read_text()
    assert (summary.pairs, summary.recordings) == (1, ("chair_02",))


def test_a_doubtful_object_is_told(build: Path, tmp_path: Path) -> None:
    shutil.copytree(build, tmp_path / "build")
    quality_json = tmp_path / "build" / "chair_02" / "object" / "quality.json"
    quality = json.loads(quality_json.read_text()) | {"warnings": ["it hangs", "it falls apart"]}
    quality_json.write_text(json.dumps(quality))
    summary = publish(synthetic_settings(), tmp_path / "build", tmp_path / "benchmark", ["chair_02"])
    assert "chair_02: it hangs (and 1 more)" in summary.warnings


def test_the_estimate_is_told_with_its_interval_and_its_reasons(build: Path, tmp_path: Path) -> None:
    shutil.copytree(build, tmp_path / "build")
    advice = "nobody looked into the opening at the top, 31 x 29 cm: record from above"
    frontier = {
        "direction": "up", "area_m2": 0.09, "size_m": [0.31, 0.29], "center_m": [0, 0, 0.6],
        "look_from": [0, 0, 1], "advice": advice, "volume_m3": 0.05, "inside_share": 0.5, "solid_share": 1.0,
    }  # fmt: skip
    found = {
        "warnings": [advice], "estimated_iou": 0.7412, "estimated_iou_low": 0.352, "estimated_iou_high": 0.8,
        "estimated_known_iou": 0.78,
        "estimated_iou_reasons": ["an opening"], "frontiers": [frontier], "repeatability_iou": 0.93,
    }  # fmt: skip
    (tmp_path / "build" / "chair_02" / "object" / "quality.json").write_text(json.dumps(found))
    names = ["chair_01", "chair_02"]
    summary = publish(synthetic_settings(), tmp_path / "build", tmp_path / "benchmark", names)
    assert (
        f"chair_02: {advice}" in summary.warnings and "known voxels is 0.78, below 0.8" in summary.warnings[0]
    )
    card = (summary.folder / "README.md").read_text()
    head = "passed over | estimated IoU | estimated IoU on known voxels | repeatability IoU |"
    assert f"| recording | object | pairs | {head}" in card
    assert "| chair_02 | blue_chair | 1 | 0 | 0.741 (0.352 to 0.800) | 0.780 | 0.930 |" in card
    assert "| chair_01 | red_chair | 2 | 0 |  |  | 0.930 |" in card
    sheet = (summary.folder / "datasheet.md").read_text()
    assert f"- {INTERVAL_LOW}: 0.352, of 1 recording\n" in sheet
    assert f"- {INTERVAL_HIGH}: 0.8, of 1 recording\n" in sheet
    assert f"- chair_02: {advice}\n" in sheet
    page = (summary.folder / "index.html").read_text()
    assert "0.741 (0.352 to 0.800)" in page and "<li>an opening</li>" in page and f"<li>{advice}</li>" in page
    quality = open_release(summary.folder).metadata.recordings["chair_02"].quality
    assert quality.advice == (advice,) and quality.estimated_iou_words() == "0.74 (0.35 to 0.80)"


def test_every_pair_states_its_share_of_unknown(build: Path, tmp_path: Path) -> None:
    """As the pair files tell; the half-known and the all-unknown pair are made by hand."""
    shutil.copytree(build, tmp_path / "build")
    pairs = tmp_path / "build" / "chair_01" / "pairs"
    first, second = read_pair(pairs / "000.npz"), read_pair(pairs / "001.npz")
    full = unpack(second.full)
    (pairs / "000.npz").write_bytes(pair_bytes(replace(first, known=~first.full)))
    half = np.ones_like(full)
    half[full & (np.cumsum(full).reshape(full.shape) <= full.sum() // 2)] = False
    (pairs / "001.npz").write_bytes(pair_bytes(replace(second, known=pack(half))))
    summary = publish(
        synthetic_settings(), tmp_path / "build", tmp_path / "benchmark", ["chair_01", "chair_02"]
    )
    views = {name: ViewsFile.read(summary.folder / "views" / name).views for name in ("chair_01", "chair_02")}
    assert [row.unknown_share for row in views["chair_01"]] == [1.0, 0.5]
    pair = read_pair(summary.folder / "pairs" / "chair_02" / "000.npz")
    shape, known = unpack(pair.full), unpack(pair.known)
    expected = (shape & ~known).sum() / shape.sum()
    assert expected > 0.005
    assert views["chair_02"][0].unknown_share == pytest.approx(expected, abs=5e-5)
    targets = open_release(summary.folder).targets
    assert [target.unknown_share for target in targets] == [
        row.unknown_share for name in ("chair_01", "chair_02") for row in views[name]
    ]
    line = (
        "chair_01: nothing of the true shape is known in 1 pair (000); the protocol `known` leaves them out"
    )
    assert line in summary.warnings and line in (summary.folder / "README.md").read_text()


def test_a_failed_publish_leaves_the_old_release(build: Path, tmp_path: Path) -> None:
    shutil.copytree(build, tmp_path / "build")
    out = tmp_path / "benchmark"
    publish(synthetic_settings(), tmp_path / "build", out, ["chair_01"])
    before = (out / "SHA256SUMS").read_text()
    (tmp_path / "build" / "chair_02" / "views" / "000.mask.png").unlink()
    with raises(ReleaseError, "release.not-built", match=r"chair_02/views/000\.mask\.png"):
        publish(synthetic_settings(), tmp_path / "build", out, NAMES)
    assert (out / "SHA256SUMS").read_text() == before
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


@pytest.mark.parametrize("file", ["mesh.ply", "volume.npz"])
def test_what_verify_would_refuse_for_its_size_is_not_published(
    build: Path, tmp_path: Path, file: str
) -> None:
    name = f"objects/chair_02/{file}"
    shutil.copytree(build, tmp_path / "build")
    os.truncate(tmp_path / "build" / "chair_02" / "object" / file, most_bytes(name) + 1)
    said = f"^{name}: {most_bytes(name) + 1} bytes, of {most_bytes(name)} that it may have.*fusion"
    with raises(ReleaseError, "release.too-large", match=said):
        publish(synthetic_settings(), tmp_path / "build", tmp_path / "benchmark", ["chair_02"])
    assert [path.name for path in tmp_path.iterdir()] == ["build"]


def test_as_large_as_verify_accepts_is_published(
    build: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with zipfile.ZipFile(build / "chair_02" / "object" / "volume.npz") as archive:
        size = sum(entry.file_size for entry in archive.infolist())
    for module in (contents, object_check):
        monkeypatch.setattr(module, "VOLUME_BYTES", size)
    publish(synthetic_settings(), build, tmp_path / "benchmark", ["chair_02"])
    assert verify(tmp_path / "benchmark") == []
    for module in (contents, object_check):
        monkeypatch.setattr(module, "VOLUME_BYTES", size - 1)
    (line,) = verify(tmp_path / "benchmark")
    assert "claims to unpack to" in line
    with raises(ReleaseError, "release.damaged", match=r"volume\.npz"):
        publish(synthetic_settings(), build, tmp_path / "other", ["chair_02"])


def test_recordings_without_pairs(build: Path, tmp_path: Path) -> None:
    shutil.copytree(build, tmp_path / "build")
    (tmp_path / "build" / "chair_01" / "pairs" / "pairs.json").write_text('{"pairs": [], "refused": []}')
    summary = publish(
        synthetic_settings(), tmp_path / "build", tmp_path / "benchmark", ["chair_01", "chair_02"]
    )
    assert summary.recordings == ("chair_02",) and "chair_01 is left out: not a single" in summary.warnings[1]
    with raises(ReleaseError, "release.no-pairs"):
        publish(synthetic_settings(), tmp_path / "build", tmp_path / "benchmark", ["chair_01"])


def test_one_benchmark_has_one_framing(build: Path, tmp_path: Path) -> None:
    settings = synthetic_settings()
    settings = settings.model_copy(update={"pairs": settings.pairs.model_copy(update={"framing": "view"})})
    with raises(ReleaseError, "release.not-built", match=r"000\.npz"):
        publish(settings, build, tmp_path / "benchmark", NAMES)


def test_no_release(tmp_path: Path) -> None:
    with raises(ReleaseError, "release.not-one"):
        open_release(tmp_path)
    (tmp_path / "sample.zip").touch()
    with raises(ReleaseError, "release.damaged", match=r"sample\.zip"):
        open_release(tmp_path / "sample.zip")


@pytest.mark.parametrize("name", ["benchmark.json", "targets.csv", "splits.json", "SHA256SUMS"])
def test_changed_small_files_are_refused(name: str, release: Release, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(release.folder, tmp_path / "benchmark"))
    text = (folder / name).read_text()
    (folder / name).write_text(text.replace("chair_02", "chair_09", 1))
    with raises(ReleaseError, "release.changed", match=name):
        open_release(folder)


GOOD = ["r1", "thing", "000", "chair", "test", "pairs/r1/000.npz", "a" * 64, "0.25"]


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("recording", "../up", "a name with other characters"),
        ("object", "a/b", "a name with other characters"),
        ("view", "../../x", "not a zero-padded index"),
        ("split", "tset", "split 'tset' is none of"),
        ("file", "../../etc/passwd", "is not pairs/r1/000"),
        ("file", "/etc/passwd", "is not pairs/r1/000"),
        ("sha256", "12", "not 64 hex digits"),
        ("sha256", "a,b", "9 columns instead of 8"),
        ("unknown_share", "1.5", r"unknown_share '1\.5' is not a share from 0 to 1"),
        ("unknown_share", "nan", "unknown_share 'nan' is not a share"),
    ],
)
def test_bad_target_lines(column: str, value: str, message: str) -> None:
    row = [value if name == column else good for name, good in zip(COLUMNS, GOOD, strict=True)]
    text = ",".join(COLUMNS) + "\n" + ",".join(row) + "\n"
    with raises(ReleaseError, "release.damaged", match=f"2: .*{message}"):
        parse_targets(text, "targets.csv")


def test_repeated_targets_and_columns() -> None:
    line = ",".join(GOOD) + "\n"
    with raises(ReleaseError, "release.damaged", match=r"3: pairs/r1/000\.npz"):
        parse_targets(",".join(COLUMNS) + "\n" + line + line, "targets.csv")
    with raises(ReleaseError, "release.damaged", match="line 1: the"):
        parse_targets(line, "targets.csv")


def test_targets_published_before_they_stated_what_is_unknown() -> None:
    earlier, good = ",".join(EARLIER_COLUMNS), ",".join(GOOD[:-1])
    (target,) = targets = parse_targets(f"{earlier}\n{good}\n", "targets.csv")
    assert target.unknown_share is None and targets_text(targets, EARLIER_COLUMNS) == f"{earlier}\n{good}\n"
    with raises(ReleaseError, "release.damaged", match=r"2.*8.*7"):
        parse_targets(f"{earlier}\n{good},0.25\n", "targets.csv")


def test_object_in_two_splits() -> None:
    lines = [",".join(GOOD), ",".join([*GOOD[:2], "001", "chair", "train", "pairs/r1/001.npz", "a" * 64, ""])]
    targets = parse_targets("\n".join([",".join(COLUMNS), *lines]), "targets.csv")
    with raises(ReleaseError, "release.object-in-two-splits"):
        check_names(targets, "targets.csv")


@pytest.mark.parametrize("line", ["abc  x", "a" * 64 + "  ../x", "a" * 64 + "  /x", "a" * 64 + "  a/.b"])
def test_bad_sums(line: str) -> None:
    with raises(ReleaseError, "release.damaged", match="line 1: malformed"):
        parse_sums(line + "\n", "SHA256SUMS")


def test_too_many_files_are_refused_before_any_is_written(
    build: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(publish_module, "MOST_FILES", 50)
    with raises(ReleaseError, "release.too-large", match=r"5.*50"):
        publish(synthetic_settings(RECORDINGS), build, tmp_path / "b", NAMES)
    assert list(tmp_path.iterdir()) == []


def test_the_files_that_are_counted_beforehand_are_those_of_a_release(analytic: Path) -> None:
    release = analytic / "benchmark"
    written = [path for part in ("pairs", "views", "objects") for path in (release / part).rglob("*")]
    pairs = sum(path.suffix == ".npz" and path.is_relative_to(release / "pairs") for path in written)
    counted = 3 * pairs + publish_module.FILES_OF_RECORDING * len(RECORDINGS)
    assert len(written) <= counted <= 1.1 * len(written)
