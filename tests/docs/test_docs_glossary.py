"""The glossary names files that exist, and each term once."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
GLOSSARY = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")


def test_files_exist() -> None:
    files = set(re.findall(r"`([\w/]+\.py)`", GLOSSARY))
    assert len(files) > 10
    assert [name for name in sorted(files) if not (ROOT / "kinectbench" / name).is_file()] == []


def test_each_term_is_defined_once() -> None:
    rows = re.findall(r"^\| ([^|]+) \|", GLOSSARY, re.M)
    terms = [term for row in rows if row != "term" for term in row.split(", ")]
    assert len(terms) >= 30 and len(terms) == len(set(terms))
