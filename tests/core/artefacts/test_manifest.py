"""What a build keeps beside its results: the bytes of each file, and what becomes of damaged ones."""

import json
from pathlib import Path

import pytest
from raising import raises

from kinectbench.core.artefacts.manifest import Failed, Manifest, SourceFile, Sources, Timing
from kinectbench.core.errors import StorageError

MANIFEST = {
    "format_version": 1,
    "package_version": "0.1.0",
    "stage": "pairs",
    "stage_version": 2,
    "fingerprint": "ab" * 32,
    "settings": {"pairs": {"framing": "object", "min_containment": 0.95}, "box": None},
    "inputs": {"ingest": "cd" * 32},
    "files": {"pairs.json": 12, "000.npz": 5},
}


def test_a_manifest_comes_back_with_the_same_bytes(tmp_path: Path) -> None:
    text = json.dumps(MANIFEST, indent=1) + "\n"
    (tmp_path / "manifest.json").write_text(text)
    manifest = Manifest.read(tmp_path)
    assert (manifest.stage_version, manifest.files) == (2, {"pairs.json": 12, "000.npz": 5})
    manifest.write(tmp_path)
    assert (tmp_path / "manifest.json").read_text() == text


def test_a_manifest_older_than_the_versions_of_stages_is_readable() -> None:
    earlier = {key: value for key, value in MANIFEST.items() if key != "stage_version"}
    assert Manifest.parse(json.dumps(earlier), "manifest.json").stage_version is None


def test_times_and_failures(tmp_path: Path) -> None:
    Timing(seconds=1.25).write(tmp_path)
    Failed(stage=None, error="killed").write(tmp_path)
    assert json.loads((tmp_path / "timing.json").read_text()) == {"seconds": 1.25}
    assert (tmp_path / "failed.json").read_text() == (
        '{\n "format_version": 1,\n "stage": null,\n "error": "killed"\n}\n'
    )
    assert Failed.read(tmp_path) == Failed(stage=None, error="killed")


def test_sources_are_one_line_whatever_the_files_are_called(tmp_path: Path) -> None:
    files = {
        name: SourceFile(1, 2, name * 2, 3) for name in ("", "files", "copy", "depth/0.png", "model_fields")
    }
    sources = Sources.model_validate(files)
    assert sources.text().startswith('{"":[1,2,"",3],"copy":[1,2,"copycopy",3],')
    (tmp_path / "sources.json").write_text(sources.text())
    assert Sources.read(tmp_path).files == files
    (tmp_path / "old").mkdir()
    (tmp_path / "old/sources.json").write_text('{"a":[1,2,"b"]}')
    assert Sources.read(tmp_path / "old").files == {"a": SourceFile(1, 2, "b")}
    assert Sources.read(tmp_path).sha256["depth/0.png"] == "depth/0.pngdepth/0.png"


@pytest.mark.parametrize("text", ["", "[]", "{", '{"a": 5}', '{"a": [1, 2]}', '{"a": [1, "b", "c"]}'])
def test_a_damaged_file_of_hashes_is_told(tmp_path: Path, text: str) -> None:
    (tmp_path / "sources.json").write_text(text)
    with raises(StorageError, "storage.damaged", match=r"sources\.json: .*--force"):
        Sources.read(tmp_path)
