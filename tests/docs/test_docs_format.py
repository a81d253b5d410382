"""The tables of keys in docs/keys.md are those of the models, and docs/format.md leads to each."""

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE, FILES = ROOT / "docs" / "keys.md", ROOT / "docs" / "format.md"


@pytest.fixture(scope="module", autouse=True)
def _scripts_are_found() -> None:
    sys.path.insert(0, str(ROOT / "scripts"))


def test_the_tables_are_those_of_the_models() -> None:
    from docs_format import page

    assert page() == PAGE.read_text(encoding="utf-8"), "run scripts/docs_format.py"


def test_the_page_on_files_leads_to_every_table() -> None:
    from docs_format import tables

    linked = re.findall(r"\[Keys of (\S+)\]\(keys\.md#", FILES.read_text(encoding="utf-8"))
    assert sorted(linked) == sorted(tables())


def test_rows_are_made_of_the_models() -> None:
    from docs_format import tables

    made = tables()
    assert (
        "| `T_floor_world` | 4 × 4 matrix | (4, 4), metres; frame floor: z up, floor at z = 0 |"
        in made["floor.json"]
    )
    assert "| `views[].K` | 3 × 3 matrix, optional | (3, 3) intrinsics" in made["views.json"]
    assert "| `recordings.<name>.quality` | as `quality.json` |" in made["benchmark.json"]
    assert "| `view` | zero-padded index of the view |" in made["targets.csv"]
