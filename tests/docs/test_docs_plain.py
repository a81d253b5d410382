"""Pages stay short and in plain words: studies and histories are on the pages below docs/evidence."""

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
# Words of a page at most: none takes longer than 15 minutes at 238 words a minute (Brysbaert 2019, silent
# reading of English non-fiction); shorter ones stay about as short as they are.
MOST_WORDS = {
    "scoring.md": 3000,
    "ground-truth.md": 1800,
    "tracking.md": 2500,
    "recordings.md": 3500,
    "methods.md": 2500,
    "tutorial.md": 2000,
    "simulation.md": 2600,
    "capture.md": 1300,
}
LONGEST_LINE = 120
# Words that only those who wrote the code understand; keys of files stay, as they stand in code.
PRIVATE = r"told|tells?|ties?|doubt|glimpse|witness|openness|own choice|own rule|anew|alike|amiss|lest"


def prose(text: str) -> str:
    """A page without its blocks of code, the words that are set as code, and the targets of links."""
    return re.sub(r"^```.*?^```|`[^`\n]*`|\]\([^)]*\)", "", text, flags=re.S | re.M)


def faults(text: str, most_words: int) -> list[str]:
    """What a page has too much of."""
    lines = re.sub(r"^```.*?^```", "", text, flags=re.S | re.M).splitlines()
    words = len(text.split())
    return [
        *([f"{words} words"] if words > most_words else []),
        *(line for line in lines if len(line) > LONGEST_LINE and not line.startswith("|")),
        *re.findall(rf"\b(?:{PRIVATE})\b", prose(text)),
    ]


@pytest.mark.parametrize("page", MOST_WORDS)
def test_pages_are_short_and_plain(page: str) -> None:
    assert faults((DOCS / page).read_text(encoding="utf-8"), MOST_WORDS[page]) == []


def test_what_is_long_or_private_is_found() -> None:
    long = "word " * 30
    text = f"We tell it anew: it ties `told`.\n{long}\n| {long} |\n```\n{long}\n```\n"
    assert faults(text, 20) == ["101 words", long.rstrip("\n"), "tell", "anew", "ties"]
