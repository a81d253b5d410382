"""What a release says of itself, read by the tools of others: Croissant, JSON Schema, Hugging Face's YAML."""

import io
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from docs_schemas import schema_texts
from jsonschema import Draft202012Validator
from pydantic import ValidationError
from synthetic_release import RECORDINGS, resum, synthetic_settings, write_build, write_json
from typed import model_of

from kinectbench.core.artefacts.benchmark import RecordingInfo
from kinectbench.core.artefacts.targets import COLUMNS
from kinectbench.core.images import read_color
from kinectbench.core.storage import sha256_file, sha256_text
from kinectbench.core.voxels.pair_file import read_pair
from kinectbench.release.check.verify import verify
from kinectbench.release.publish.attribution import citation_text
from kinectbench.release.publish.card import origins_table
from kinectbench.release.publish.publish import publish
from kinectbench.release.publish.schemas import JSON_FILES, schema_problems
from kinectbench.release.release import Release, open_release

NAMES = [recording[0] for recording in RECORDINGS]
SCHEMAS = Path(__file__).resolve().parents[2] / "kinectbench" / "release" / "publish" / "schemas"


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("metadata") / "build"
    write_build(folder)
    return folder


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")
def test_croissant(release: Release, caplog: pytest.LogCaptureFixture) -> None:
    import mlcroissant

    dataset = mlcroissant.Dataset(jsonld=release.folder / "croissant.json")
    assert not dataset.metadata.issues.errors and not dataset.metadata.issues.warnings
    assert caplog.text == ""  # the context is the standard one, too
    for target, record in zip(release.targets, dataset.records("pairs"), strict=True):
        assert record["pairs/file"].decode() == target.file
        found = np.load(io.BytesIO(record["pairs/npz"]))
        np.testing.assert_array_equal(found["full"], read_pair(release.pair_path(target)).full)
    cameras = list(dataset.records("cameras"))
    # Each can be joined with the pairs of its view.
    places = [(each["cameras/recording"].decode(), each["cameras/view"].decode()) for each in cameras]
    assert places == sorted((target.recording, target.view) for target in release.targets)
    first = cameras[0]
    assert first["cameras/view"] == b"000" and first["cameras/width"] == 320
    np.testing.assert_array_equal(first["cameras/K"], [[200.0, 0, 159.5], [0, 200.0, 119.5], [0, 0, 1]])
    records = [
        {
            key.removeprefix("targets/"): value.decode() if isinstance(value, bytes) else value
            for key, value in record.items()
        }
        for record in dataset.records("targets")
    ]
    assert records == [{name: getattr(target, name) for name in COLUMNS} for target in release.targets]
    content = json.loads((release.folder / "croissant.json").read_text())
    assert content["conformsTo"] == [
        "http://mlcommons.org/croissant/1.1", "http://mlcommons.org/croissant/RAI/1.0"
    ]  # fmt: skip
    assert content["datePublished"] == "1980-01-01"  # the stamps of these frames are no times of a day
    assert content["license"] == "https://spdx.org/licenses/CC0-1.0.html"
    for entry in content["distribution"]:
        if entry["@type"] == "cr:FileSet":
            assert list(release.folder.glob(entry["includes"])), entry
        else:
            assert (
                f"{entry['sha256']}  {entry['contentUrl']}\n" in (release.folder / "SHA256SUMS").read_text()
            )


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")
def test_what_people_told_is_in_the_fields_of_responsible_use(build: Path, tmp_path: Path) -> None:
    import mlcroissant

    told = {"collection": "By us, with a Kinect.", "consent": "Nobody is seen.", "maintenance": "We do."}
    settings = synthetic_settings(
        publish={"datasheet": told, "citation": {"date_released": "2026-02-03", "authors": ["Doe, Jo"]}}
    )
    folder = publish(settings, build, tmp_path / "b", ["chair_01"]).folder
    metadata = mlcroissant.Dataset(jsonld=folder / "croissant.json").metadata
    assert metadata.data_collection == "By us, with a Kinect."
    assert metadata.personal_sensitive_information[0] == "Nobody is seen."
    assert metadata.data_release_maintenance_plan == "We do."
    assert metadata.date_published.date().isoformat() == "2026-02-03"
    assert metadata.data_limitations and metadata.data_biases and metadata.data_use_cases
    assert json.loads((folder / "datacite.json").read_text())["publicationYear"] == "2026"


def card_head(folder: Path) -> dict[str, Any]:
    text = (folder / "README.md").read_text()
    assert text.startswith("---\n")
    head: dict[str, Any] = yaml.safe_load(text.split("---\n")[1])
    return head


def test_head_of_the_card(release: Release) -> None:
    head = card_head(release.folder)
    assert head["license"] == "cc0-1.0" and head["size_categories"] == ["n<1K"]
    (config,) = head["configs"]
    rows = []
    for entry in config["data_files"]:
        name = entry["path"].removesuffix("/**")
        lines = (release.folder / f"targets/{entry['split']}.csv").read_text().splitlines()
        assert lines[0].split(",") == list(COLUMNS)
        assert all(f",{entry['split']}," in line for line in lines[1:])
        rows += lines[1:]
        shown = [
            json.loads(line) for line in (release.folder / name / "metadata.jsonl").read_text().splitlines()
        ]
        assert [row["view"] for row in shown] == [line.split(",")[2] for line in lines[1:]]
    assert sorted(rows) == (release.folder / "targets.csv").read_text().splitlines()[1:]


def test_each_row_of_a_viewer_has_a_picture(build: Path, tmp_path: Path) -> None:
    """`file_name` names it, as ImageFolder asks; of a view with colour that is beside depth."""
    sizes: dict[str, list[tuple[int, ...]]] = {}
    for color in (False, True):
        settings = synthetic_settings(publish={"color": color})
        folder = publish(settings, build, tmp_path / f"{color}", NAMES).folder
        assert verify(folder) == []
        for target in open_release(folder).targets:
            here = folder / "previews" / target.split
            rows = [json.loads(line) for line in (here / "metadata.jsonl").read_text().splitlines()]
            (row,) = [row for row in rows if row["file"] == target.file]
            size = read_color(here / row.pop("file_name")).shape
            assert row == {name: getattr(target, name) for name in COLUMNS}
            sizes.setdefault(target.name, []).append(size)
    assert all(plain == (240, 320, 3) for plain, _ in sizes.values())
    assert any(wide == (240, 640, 3) for _, wide in sizes.values())


@pytest.mark.parametrize("change", ["row", "gone", "more"])
def test_pictures_that_are_not_those_of_the_pairs(change: str, build: Path, tmp_path: Path) -> None:
    folder = publish(synthetic_settings(), build, tmp_path / "b", ["chair_02"]).folder
    name, other = "previews/test/chair_02/000.jpg", "previews/test/chair_02/900.jpg"
    rows, picture = folder / "previews/test/metadata.jsonl", folder / name
    if change == "row":
        rows.write_text(rows.read_text().replace('"view": "000"', '"view": "001"'))
    elif change == "gone":
        picture.unlink()
    else:
        shutil.copy(picture, folder / other)
    resum(folder, "previews/test/metadata.jsonl")
    sums = folder / "SHA256SUMS"
    lines = [
        line for line in sums.read_text().splitlines(keepends=True) if change != "gone" or name not in line
    ]
    sums.write_text("".join(lines) + (f"{sha256_file(picture)}  {other}\n" if change == "more" else ""))
    assert any(line.startswith("previews/test/metadata.jsonl: ") for line in verify(folder))


@pytest.mark.parametrize("license", ["unspecified", "our own terms"])
def test_other_licences(license: str, build: Path, tmp_path: Path) -> None:
    summary = publish(synthetic_settings(license=license), build, tmp_path / "b", ["chair_02"])
    head = card_head(summary.folder)
    if license == "unspecified":
        assert head["license"] == "unknown"
    else:
        assert (head["license"], head["license_name"], head["license_link"]) == (
            "other", "our-own-terms", "LICENSE"
        )  # fmt: skip


def test_licence_and_source_of_each_recording(build: Path, tmp_path: Path) -> None:
    settings = synthetic_settings(source="unspecified")
    first = settings.recordings[0].model_copy(update={"license": "CC-BY-4.0", "source": "Jo's kitchen"})
    settings = settings.model_copy(update={"recordings": [first, *settings.recordings[1:]]})
    summary = publish(settings, build, tmp_path / "b", ["chair_01", "chair_02"])
    assert summary.warnings[0].startswith("no source is stated: set `source` in benchmark.yaml (chair_02)")
    info = json.loads((summary.folder / "benchmark.json").read_text())
    assert info["distribution"] == {"allowed": False, "reasons": [summary.warnings[0]]}
    assert "**Not for distribution.**" in (summary.folder / "README.md").read_text()
    text = (summary.folder / "LICENSE").read_text()
    assert "chair_01\n  licence: CC-BY-4.0\n  source: Jo's kitchen" in text and "NOT FOR DISTRIBUTION" in text
    card = (summary.folder / "README.md").read_text()
    assert "| chair_01 | CC-BY-4.0 | Jo's kitchen |" in card
    assert "| chair_02 | CC0-1.0 | unspecified |" in card
    (line,) = publish(settings, build, tmp_path / "c", ["chair_01"]).warnings
    assert line.startswith("no validation split is published, as this release is without ")


def test_the_card_names_recordings_of_one_origin_together() -> None:
    infos = {
        name: model_of(RecordingInfo, license=license, source=source)
        for name, license, source in (
            ("b", "CC0-1.0", "our lab"),
            ("c", "CC-BY-4.0", "a | b,\nsecond line"),
            ("a", "CC0-1.0", "our lab"),
            ("d", "CC-BY-4.0", "our lab"),
        )
    }
    assert origins_table(infos).splitlines()[2:] == [
        "| a, b | CC0-1.0 | our lab |",
        "| c | CC-BY-4.0 | a \\| b, second line |",
        "| d | CC-BY-4.0 | our lab |",
    ]


def test_citation() -> None:
    settings = synthetic_settings(
        publish={"citation": {"title": "Chairs", "authors": ["Doe, Jo", "A Lab"], "version": "1.2.0"}}
    )
    content = yaml.safe_load(citation_text(settings.publish.citation, "synthetic", "CC-BY-4.0"))
    assert content["authors"] == [{"family-names": "Doe", "given-names": "Jo"}, {"name": "A Lab"}]
    assert (content["title"], content["version"], content["license"]) == ("Chairs", "1.2.0", "CC-BY-4.0")
    assert (content["cff-version"], content["type"]) == ("1.2.0", "dataset")
    assert "license" not in yaml.safe_load(citation_text(settings.publish.citation, "x", "our own terms"))


def test_answers_and_changes(build: Path, tmp_path: Path) -> None:
    answers = {"motivation": "To try it out.", "consent": "Nobody is in it."}
    changes = [{"version": "1.1.0", "changes": ["a chair more"]}, {"version": "1.0.0", "changes": ["first"]}]
    settings = synthetic_settings(publish={"datasheet": answers, "changelog": changes})
    summary = publish(settings, build, tmp_path / "b", NAMES)
    assert summary.unanswered == ("creators", "collection", "uses_to_avoid", "maintenance")
    text = (summary.folder / "datasheet.md").read_text()
    assert "To try it out." in text and "Nobody is in it." in text and "Not stated." in text
    assert "0.93 (0.93 to 0.93), of 5 recordings" in text
    assert "$" not in text
    assert (summary.folder / "CHANGELOG.md").read_text() == (
        "# Changes of synthetic\n\n## 1.1.0\n\n- a chair more\n\n## 1.0.0\n\n- first\n"
    )


def test_answers_and_changes_are_markdown_without_html(build: Path, tmp_path: Path) -> None:
    """Markdown of their author stays; no tag, comment or declaration begins in it."""
    text = "**Bold** if 2 < 3, `a`\n\n- see [x](y)\n\n<script>a()</script><!-- <?x <!D></p><IMG on=b()>"
    keys = ("motivation", "creators", "collection", "consent", "uses_to_avoid", "maintenance")
    changes = [{"version": "1.0.0\n<b>", "changes": [text]}]
    settings = synthetic_settings(publish={"datasheet": dict.fromkeys(keys, text), "changelog": changes})
    folder = publish(settings, build, tmp_path / "b", NAMES).folder
    assert verify(folder) == []
    for name, times in (("datasheet.md", len(keys)), ("CHANGELOG.md", 1)):
        found = (folder / name).read_text(encoding="utf-8")
        assert found.count("**Bold** if 2 < 3, `a`") == found.count("&lt;script>a()&lt;/script>") == times
        assert not re.search(r"<[A-Za-z/!?]", found) and found.count("[x](y)") == times
    assert "## 1.0.0 &lt;b>\n" in (folder / "CHANGELOG.md").read_text(encoding="utf-8")


def test_the_packaged_schemas_are_those_of_the_code() -> None:
    packaged = {path.name: path.read_text() for path in SCHEMAS.iterdir()}
    assert packaged == schema_texts()


def undescribed(content: Any, schema: Any, root: Any, at: str = "") -> list[str]:
    """Keys of a JSON value that its schema does not name."""
    while "$ref" in schema:
        schema = root["$defs"][schema["$ref"].split("/")[-1]]
    if "anyOf" in schema:
        return min((undescribed(content, one, root, at) for one in schema["anyOf"]), key=len)
    if isinstance(content, list) and "items" in schema:
        return [line for entry in content for line in undescribed(entry, schema["items"], root, at)]
    if not isinstance(content, dict) or at == ".settings":  # those are described by benchmark.yaml
        return []
    known, others = schema.get("properties", {}), schema.get("additionalProperties")
    lines = [f"{at}.{key}" for key in content if known and key not in known]
    for key, value in content.items():
        inner = known.get(key, others)
        if isinstance(inner, dict):
            lines += undescribed(value, inner, root, f"{at}.{key}")
    return lines


def check_schemas(folder: Path) -> set[str]:
    """Check every JSON file of a release with an independent validator; names of the schemas used."""
    used = set()
    for path in sorted((folder / "schemas").glob("*.schema.json")):
        schema = json.loads(path.read_text())
        Draft202012Validator.check_schema(schema)
        files = sorted(folder.glob(schema["$comment"]))
        assert files, path.name
        for file in files:
            content = json.loads(file.read_text())
            Draft202012Validator(schema).validate(content)
            assert undescribed(content, schema, schema) == [], file
            assert list(schema_problems(file.relative_to(folder).as_posix(), file.read_text())) == []
        used.add(path.name.split(".")[0])
    return used


def test_files_follow_their_schemas(release: Release) -> None:
    assert check_schemas(release.folder) == set(JSON_FILES) - {"thresholds"}
    keys = json.loads((release.folder / "schemas" / "pair.npz.json").read_text())["keys"]
    with np.load(release.pair_path(release.targets[0])) as pair:
        # Of a release made by hand nothing says by what cells are known.
        keys = [row for row in keys if row["name"] not in ("interior", "said")]
        assert [row["name"] for row in keys] == pair.files
        for row in keys:
            array = pair[row["name"]]
            assert list(array.shape) == row["shape"]
            kind = {"text": "U", "integer": "i"}.get(row["dtype"])
            assert array.dtype.kind == kind if kind else array.dtype == row["dtype"]
    table = json.loads((release.folder / "schemas" / "targets.csv.json").read_text())
    assert [row["name"] for row in table["fields"]] == list(COLUMNS)


def test_a_real_build_follows_the_schemas(small: Path, tmp_path: Path) -> None:
    from kinectbench.settings.file import load_benchmark

    settings = load_benchmark(small / "benchmark.yaml")
    publish(settings, small / "build", tmp_path / "b", ["chair", "table"])
    assert check_schemas(tmp_path / "b") == set(JSON_FILES) - {"thresholds"}
    (row, *_) = json.loads((tmp_path / "b/views/chair/views.json").read_text())["views"]
    assert (row["width"], row["height"], row["pair"]) == (160, 120, True)
    with np.load(tmp_path / f"b/pairs/chair/{row['view']}.npz") as pair:
        np.testing.assert_array_equal(pair["K"], row["K"])
    lineage = json.loads((tmp_path / "b/lineage.json").read_text())["recordings"]["chair"]
    assert list(lineage["stages"]) == ["ingest", "track", "fuse", "segment", "sample-views", "pairs"]
    assert str(tmp_path.parent) not in (tmp_path / "b/lineage.json").read_text()


def test_schema_problems() -> None:
    assert list(schema_problems("splits.json", '{"test": [1]}')) == [
        "'test.0': Input should be a valid string"
    ]
    assert "'views'" in next(schema_problems("views/a/views.json", '{"format_version": 1, "refused": []}'))
    assert list(schema_problems("croissant.json", "{}")) == []
    # What a check of this project says stands alone, without pydantic's "Value error, ".
    (problem,) = schema_problems("thresholds.json", '{"thresholds": {"chair": 0.5, "Chair": 0.5}}')
    assert problem.startswith("'thresholds': the categories 'chair' and 'Chair' differ")


def test_lineage(release: Release) -> None:
    chair = json.loads((release.folder / "lineage.json").read_text())["recordings"]["chair_01"]
    assert chair["files"] == {"depth/0.png": sha256_text("chair_01")} and chair["source"] == "made up"
    assert chair["views"] == [{"view": f"00{n}", "frame": n, "stamp_ns": 70} for n in (0, 1)]


def test_a_recording_of_one_file_has_its_name(build: Path, tmp_path: Path) -> None:

    copy = Path(shutil.copytree(build, tmp_path / "build"))
    write_json(copy / "chair_02" / "sources.json", {"": [1, 2, "cd" * 32]})
    publish(synthetic_settings(), copy, tmp_path / "b", ["chair_02"])
    lineage = json.loads((tmp_path / "b/lineage.json").read_text())
    assert lineage["recordings"]["chair_02"]["files"] == {"chair_02": "cd" * 32}


STEERS = "x<script>alert(1)</script> | a\n# Big\n---\nlicense: mit\n[a](javascript:b) ![c](d) $n \\[e](f)"


def test_texts_of_people_are_shown_and_do_nothing(build: Path, tmp_path: Path) -> None:
    settings = synthetic_settings(
        license=STEERS, source=STEERS, publish={"citation": {"title": STEERS, "authors": [STEERS]}}
    )
    folder = publish(settings, build, tmp_path / "b", NAMES).folder
    assert verify(folder) == []
    assert card_head(folder)["license"] == "other"
    for name in ("README.md", "datasheet.md", "LICENSE", "index.html"):
        text = (folder / name).read_text()
        lines = text.splitlines()
        assert "# Big" not in lines and "license: mit" not in lines, name
        if name != "LICENSE":  # a plain text
            assert "<script>alert" not in text and "alert(1)" in text, name
        if name.endswith(".md"):
            assert not re.search(r"(?<!\\)(\\\\)*\[[acef]\]\(", text), name
    assert yaml.safe_load((folder / "CITATION.cff").read_text())["title"] == " ".join(STEERS.split())


@pytest.mark.parametrize("sign", ["\x1b", "\x07", "\x9b", "\u202e", "\u2028", "\x00", "\r"])
@pytest.mark.parametrize("key", ["license", "source", "title", "authors", "motivation"])
def test_texts_that_steer_are_refused(key: str, sign: str) -> None:
    said: dict[str, Any] = {
        "license": {"license": sign},
        "source": {"source": sign},
        "title": {"publish": {"citation": {"title": sign}}},
        "authors": {"publish": {"citation": {"authors": [sign]}}},
        "motivation": {"publish": {"datasheet": {"motivation": sign}}},
    }
    with pytest.raises(ValidationError, match="it holds control characters; leave them out"):
        synthetic_settings(**said[key])
