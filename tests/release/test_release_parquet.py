"""`export --layout parquet`: the rows of targets.csv, typed."""

import json
import sys
from pathlib import Path

import pytest
from pyarrow import parquet
from raising import raises

from kinectbench.core.artefacts.targets import COLUMNS
from kinectbench.core.errors import SettingsError
from kinectbench.release.exchange import parquet as exchange
from kinectbench.release.release import Release


def test_the_rows_are_those_of_the_csv(
    release: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exchange, "ROWS_PER_GROUP", 2)
    told: list[tuple[int, int]] = []
    count = exchange.export_parquet(release, tmp_path / "out", lambda *done: told.append(done))
    assert count == len(release.targets) == told[-1][0] == told[-1][1]
    file = parquet.ParquetFile(tmp_path / "out" / "targets.parquet")
    table = file.read()
    assert tuple(table.column_names) == tuple(COLUMNS) and file.metadata.num_row_groups > 1
    assert table.to_pylist() == [{name: getattr(t, name) for name in COLUMNS} for t in release.targets]
    stated = json.loads((tmp_path / "out" / "export.json").read_text())
    assert stated["benchmark_sha256"] == release.benchmark_sha256


def test_without_pyarrow_it_says_what_to_install(
    release: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with raises(SettingsError, "settings.no-package"):
        exchange.export_parquet(release, tmp_path / "out")
    assert not (tmp_path / "out").exists()
