"""The lists of keys in docs/keys.md are those of the models, and docs/format.md leads to each."""

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE, FILES = ROOT / "docs" / "keys.md", ROOT / "docs" / "format.md"


@pytest.fixture(scope="module", autouse=True)
def _scripts_are_found() -> None:
    sys.path.insert(0, str(ROOT / "scripts"))


def test_the_lists_are_those_of_the_models() -> None:
    from docs_format import page

    assert page() == PAGE.read_text(encoding="utf-8"), "run scripts/docs_format.py"


def test_the_page_on_files_leads_to_every_list() -> None:
    from docs_format import tables

    linked = re.findall(r"\]\(keys\.md#(\w+)\)", FILES.read_text(encoding="utf-8"))
    assert set(linked) == {name.replace(".", "") for name in tables()}


def test_rows_are_made_of_the_models() -> None:
    from docs_format import tables

    made = tables()
    assert "- `T_floor_world` 4×4 matrix: metres; frame floor: z up, floor at z = 0\n" in made["floor.json"]
    assert "    - `K`? 3×3 matrix: intrinsics, pixels; pixel centres" in made["views.json"]
    assert "    - `quality` as `quality.json`: " in made["benchmark.json"]
    assert "- `file`: the pair file, relative to the release\n" in made["targets.csv"]


def test_what_stands_on_the_page_already_is_named_in_one_line() -> None:
    from docs_format import tables

    made = tables()
    assert "- `box_odd`?: box from odd frames alone; keys as in `box`\n" in made["quality.json"]
    # The metrics of rows are listed; those of categories and overall are the same.
    assert made["scores.json"].count("as in [Metrics](scoring.md#metrics)") == 1
    assert made["scores.json"].count("all metrics?: as in `rows`\n") == 2
    assert made["pairs.json"].count("as in `views` of [views.json](#viewsjson)") == 1
    # The name and the kind say these.
    assert (
        "- `package_version`, `stage` text\n" in made["manifest.json"]
        and "- `first_frame`, `last_frame`\n" in made["health.json"]
    )


def test_what_the_head_says_of_every_file_is_not_said_again() -> None:
    from docs_format import COMMON, HEAD, tables

    assert [name for name in sorted(COMMON) if f"`{name}`" not in HEAD] == []
    made = tables()
    assert "- `recording`, `object` text\n    - `split`\n    - `decision`" in made["triage.json"]
    assert "- `view`? text: zero-padded index; frames that were no views have none\n" in made["views.json"]
    assert "`whole_iou`?: as above\n" in made["reference.json"]
