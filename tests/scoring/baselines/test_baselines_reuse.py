"""Baselines that are scored as methods: tables of an earlier run are used again."""

from pathlib import Path
from typing import Any

from kinectbench.release.release import Release
from kinectbench.scoring.baselines.in_grids import score_baselines


def test_baselines_scored_as_methods_are_kept(release: Release, tmp_path: Path) -> None:
    done: list[int] = []

    def made(**options: Any) -> list[Any]:
        done.clear()
        how: dict[str, Any] = {"protocols": ["known"], "surface": False, **options}
        return score_baselines(release, tmp_path, progress=lambda at, _: done.append(at), **how)

    first = made()
    assert len(done) == len(release.targets)
    assert made() == [table.model_copy() for table in first] and done == []
    file = tmp_path / "thresholds.json"
    file.write_text('{"thresholds": {"chair": 0.3, "table": 0.7}}')
    made(thresholds_file=file)
    assert len(done) == len(release.split("test"))
    # Tables of a threshold file are not those without one.
    assert made() == first and len(done) == len(release.targets)
