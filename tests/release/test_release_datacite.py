"""datacite.json: its keys, the day of a release, and what `verify` says of it and of releases without it."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from synthetic_release import synthetic_settings, write_build
from test_release_hostile import seal

from kinectbench._version import __version__
from kinectbench.core.artefacts.provenance import Lineage, LineageRecording, LineageView
from kinectbench.release.check.verify import verify
from kinectbench.release.publish.datacite import day_of
from kinectbench.release.publish.publish import publish
from kinectbench.release.release import Release, open_release
from kinectbench.settings.publishing import CitationSettings


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("metadata") / "build"
    write_build(folder)
    return folder


# Of datacite-v4.5.json: what must be there, by key and type; and the keys that there are.
DATACITE = {"creators": list, "titles": list, "publisher": dict, "publicationYear": str, "types": dict}
DATACITE_KEYS = {
    *("doi", "prefix", "suffix", "event", "url", "types", "creators", "titles", "publisher"),
    *("publicationYear", "subjects", "contributors", "dates", "language", "alternateIdentifiers"),
    *("relatedIdentifiers", "relatedItems", "sizes", "formats", "version", "rightsList", "descriptions"),
    *("geoLocations", "fundingReferences", "schemaVersion", "container"),
}


@pytest.mark.parametrize("said", [False, True])
def test_datacite(build: Path, tmp_path: Path, said: bool) -> None:
    citation = {
        "title": "Chairs", "authors": ["Doe, Jo", "The Chair Lab"], "version": "1.2.0",
        "doi": "10.5281/zenodo.1", "url": "https://example.org/chairs", "date_released": "2025-12-31",
    }  # fmt: skip
    settings = synthetic_settings(publish={"citation": citation} if said else {})
    folder = publish(settings, build, tmp_path / "b", ["chair_01"]).folder
    content = json.loads((folder / "datacite.json").read_text())
    assert content["schemaVersion"] == "http://datacite.org/schema/kernel-4"
    assert set(content) <= DATACITE_KEYS
    assert all(content[key] and isinstance(content[key], kind) for key, kind in DATACITE.items())
    assert re.fullmatch("[0-9]{4}", content["publicationYear"]) and content["publisher"]["name"]
    assert content["types"]["resourceTypeGeneral"] == "Dataset"
    assert content["rightsList"][0]["rightsIdentifier"] == "CC0-1.0"
    if said:
        assert (content["doi"], content["version"]) == ("10.5281/zenodo.1", "1.2.0")
        assert content["titles"] == [{"title": "Chairs"}] and content["dates"][0]["date"] == "2025-12-31"
        assert content["creators"] == [
            {"name": "Doe, Jo", "nameType": "Personal", "familyName": "Doe", "givenName": "Jo"},
            {"name": "The Chair Lab", "nameType": "Organizational"},
        ]
    else:
        assert content["titles"] == [{"title": "synthetic"}] and "doi" not in content


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        ({"version": "2"}, "version '2' where benchmark.json has none"),
        ({"rightsList": [{"rights": "MIT"}]}, "licence 'MIT' where benchmark.json has 'CC0-1.0'"),
        ({"rightsList": []}, "no licence where benchmark.json has 'CC0-1.0'"),
        ({"rightsList": 1}, "does not have the keys that it should"),
    ],
)
def test_a_datacite_that_says_otherwise_is_told(
    release: Release, tmp_path: Path, damage: dict[str, Any], told: str
) -> None:
    folder = Path(shutil.copytree(release.folder, tmp_path / "b"))
    path = folder / "datacite.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | damage))
    lines = verify(seal(folder))
    assert len(lines) == 1 and lines[0].startswith(f"datacite.json: {told}"), lines


@pytest.mark.parametrize("name", ["datacite.json", "lineage.json", "views/chair_01/views.json"])
def test_a_file_that_is_no_json_is_told_once(release: Release, tmp_path: Path, name: str) -> None:
    folder = Path(shutil.copytree(release.folder, tmp_path / "b"))
    (folder / name).write_text('{"name": 1, "name": 2}')
    lines = [line for line in verify(seal(folder)) if line.startswith(f"{name}: ")]
    assert len(lines) == 1 and "it has the key 'name' twice" in lines[0], lines


def test_a_release_of_earlier_versions_is_whole(release: Release, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(release.folder, tmp_path / "b"))
    croissant, sums = folder / "croissant.json", folder / "SHA256SUMS"
    content = json.loads(croissant.read_text())
    content["distribution"] = [each for each in content["distribution"] if each["@id"] != "datacite.json"]
    croissant.write_text(json.dumps(content))
    for name in ("benchmark.json", "lineage.json"):
        path, version = folder / name, f'"package_version": "{__version__}"'
        path.write_text(path.read_text().replace(version, '"package_version": "0.0.1"'))
    for path in (folder / "datacite.json", *folder.glob("objects/*.glb")):
        path.unlink()
        sums.write_text(re.sub(f".*{path.name}\n", "", sums.read_text()))
    assert verify(seal(folder)) == []
    assert len(open_release(folder).targets) == len(release.targets)


@pytest.mark.parametrize(
    ("stamp_ns", "day"),
    [(70, "1980-01-01"), (1_700_000_000 * 10**9, "2023-11-14"), (10**40, "1980-01-01")],
)
def test_the_day_of_a_release_is_that_of_its_last_frame(tmp_path: Path, stamp_ns: int, day: str) -> None:
    views = (
        LineageView(view="000", frame=1, stamp_ns=5),
        LineageView(view="001", frame=2, stamp_ns=stamp_ns),
    )
    row = LineageRecording(source="s", license="l", files={}, stages={}, views=views)
    hidden = row.model_copy(update={"views": None})
    assert day_of(CitationSettings(), tmp_path) == "1980-01-01"
    rows = {"a": row, "b": hidden}
    Lineage(format_version=1, package_version="1", packages="", recordings=rows).write(tmp_path)
    assert day_of(CitationSettings(), tmp_path) == day
    assert day_of(CitationSettings(date_released="2020-02-02"), tmp_path) == "2020-02-02"
