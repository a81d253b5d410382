"""URLs with quoted blanks name the same files wherever a release is read from."""

from pathlib import Path
from urllib.parse import quote

import pytest
from scan_server import ScanServer

from kinectbench.core.store.attempts import PATIENCE_VARIABLE
from kinectbench.core.store.store import Store
from kinectbench.release.published import is_there, release_text


def test_a_quoted_url_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PATIENCE_VARIABLE, "1")
    monkeypatch.setenv("no_proxy", "*")
    folder = tmp_path / "my chairs é"
    folder.mkdir()
    (folder / "a.txt").write_text("1")
    with ScanServer({"/my%20chairs/a.txt": b"1"}) as server:
        for url in (f"file://{folder}", f"file://{quote(str(folder))}", f"{server.url}/my%20chairs"):
            assert Store(url).read("a.txt").decode() == release_text(Path(url) / "a.txt") == "1"
    assert is_there(Path(f"file://{quote(str(folder))}") / "a.txt")
