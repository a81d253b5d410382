"""Pages stay short; they and the code speak plain words. Studies are on the pages below docs/evidence."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
# Words of a page at most: none takes longer than 11 minutes at 238 words a minute (Brysbaert 2019, silent
# reading of English non-fiction), but for pages in which people look something up.
MOST_WORDS = {"format.md": 3600}
MOST_WORDS_ELSEWHERE = 2600
# Of README, CHANGELOG, CONTRIBUTING and docs/ without the evidence together. They had 60,000, and
# said most facts more than once.
MOST_WORDS_IN_ALL = 32_000
LONGEST_LINE = 120
NO_PROSE = ("|", "    ", "![")  # tables, code, pictures
# Made of descriptions in the code, parts of which are in the schemas of releases.
GENERATED = ("keys.md", "errors.md")
# Words that only those who wrote the code understand. In names, an underscore ends a word.
PRIVATE = re.compile(
    r"(?<![a-z])(?:(?:un|fore)?told|ties?|tied|doubt[a-z]*|glimpses?|witness(?:es)?|openness"
    r"|own[\s#]+(?:choice|rule)s?|anew|alike|amiss|lest|strangers?|hears?[\s#]+of"
    r"|kept[\s#]+back)(?![a-z])",
    re.IGNORECASE,
)
# Keys on disk and names of findings, which are a contract; equal values in a ranking; a comment.
ALLOWED = re.compile(
    r"max_doubts|[`\".]doubts\b|\bdoubts(?=[:=])|doubtful_share"
    r"|(?:lengths|floor)_doubtful|\bties(?=[:=] ?ConstraintCounts)|; ties: lowest"
)
PAGES = sorted([*DOCS.glob("*.md"), *ROOT.glob("*.md")])
WRITTEN = [page for page in PAGES if page.name not in GENERATED]
PROSE = sorted([*DOCS.rglob("*.md"), *ROOT.glob("*.md")])
CODE = sorted(path for path in (ROOT / "kinectbench").rglob("*") if path.suffix in (".py", ".html", ".md"))


def prose(text: str) -> str:
    """A page without its blocks of code, the words that are set as code, and the targets of links."""
    return re.sub(r"^```.*?^```|`[^`\n]*`|\]\([^)]*\)", "", text, flags=re.S | re.M)


def faults(text: str, most_words: int) -> list[str]:
    """What a page has too much of."""
    lines = re.sub(r"^```.*?^```", "", text, flags=re.S | re.M).splitlines()
    words = len(text.split())
    return [
        *([f"{words} words"] if words > most_words else []),
        *(line for line in lines if len(line) > LONGEST_LINE and not line.startswith(NO_PROSE)),
        *re.findall(r"\btells?\b", prose(text)),
    ]


@pytest.mark.parametrize("page", WRITTEN, ids=lambda page: page.name)
def test_pages_are_short_and_plain(page: Path) -> None:
    most = MOST_WORDS.get(page.name, MOST_WORDS_ELSEWHERE)
    assert faults(page.read_text(encoding="utf-8"), most) == []


def test_all_pages_together_are_short() -> None:
    assert sum(len(page.read_text(encoding="utf-8").split()) for page in PAGES) <= MOST_WORDS_IN_ALL


@pytest.mark.parametrize("page", PROSE, ids=lambda page: page.name)
def test_pages_have_no_private_words(page: Path) -> None:
    assert PRIVATE.findall(prose(page.read_text(encoding="utf-8"))) == []


def test_code_has_no_private_words() -> None:
    texts = {path: ALLOWED.sub("", path.read_text(encoding="utf-8")) for path in CODE}
    found = {str(path.relative_to(ROOT)): PRIVATE.findall(text) for path, text in texts.items()}
    assert len(texts) > 500 and {path: words for path, words in found.items() if words} == {}


def test_what_is_long_or_private_is_found() -> None:
    long = "word " * 30
    text = f"We tell it at once: `told`.\n{long}\n| {long} |\n```\n{long}\n```\n"
    assert faults(text, 20) == ["100 words", long.rstrip("\n"), "tell"]
    code = "def _is_told(tie: int) -> None:  # Own\n# choice, Lest anew; 'max_doubts', multiplied"
    assert PRIVATE.findall(ALLOWED.sub("", code)) == ["told", "tie", "Own\n# choice", "Lest", "anew"]


def test_no_table_is_cut_by_a_blank_line() -> None:
    for page in PROSE:
        lines = page.read_text(encoding="utf-8").split("\n")
        begins = [n for n in range(1, len(lines) - 1) if lines[n].startswith("|") and not lines[n - 1]]
        cut = [lines[n] for n in begins if not re.fullmatch(r"\|[-| :]+\|", lines[n + 1])]
        assert cut == [], page
