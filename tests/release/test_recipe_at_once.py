"""Two fetches of one recipe to different folders at the same moment: sources.lock has the rows of both."""

import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from small_recipe import write_recipe

from kinectbench.core.artefacts.sources_lock import SourcesLock
from kinectbench.core.store.download import Content
from kinectbench.release.recipe import Recipe, opened_recipe


def test_no_row_is_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = write_recipe(tmp_path / "r", "http://127.0.0.1:9")
    outs = [tmp_path / name for name in ("one", "two", "three")]
    opened = [opened_recipe(recipe, out, is_read=lambda path: True) for out in outs]
    recipes = [each.__enter__() for each in opened]
    read = SourcesLock.read_if_there

    def slowly(folder: Path) -> SourcesLock | None:
        found = read(folder)
        time.sleep(0.2)
        return found

    monkeypatch.setattr(SourcesLock, "read_if_there", slowly)

    def lock(one: Recipe) -> None:
        one._lock(f"{one.out.name}.zip", one.out, Content(1, "a" * 64))

    with ThreadPoolExecutor(len(recipes)) as pool:
        list(pool.map(lock, recipes))
    for each in opened:
        each.__exit__(None, None, None)
    lock_file = read(recipe)
    assert lock_file is not None and set(lock_file.files) == {f"{out.name}.zip" for out in outs}
