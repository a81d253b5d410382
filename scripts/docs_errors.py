"""Write docs/errors.md, a list of the codes of all errors, from `scripts/error_codes.py`.

.venv/bin/python scripts/docs_errors.py
"""

import re
import textwrap
from pathlib import Path

from error_codes import ERROR_CODES, KINDS

PAGE = Path(__file__).parents[1] / "docs" / "errors.md"
HEAD = """# Errors

Every error is one line, which says what, where and what to do. Its code stays where the line is reworded.
In Python it is `error.code`, in `failed.json`, `build --json` and `build --status --json` the key `code`.
`build --verbose` shows it, and so does any command with KINECTBENCH_DEBUG=1. A code without a meaning is one
whose words say it. `scripts/docs_errors.py` makes this page of `scripts/error_codes.py`.
"""
# Words that add nothing to those of a code.
EMPTY = set(
    re.findall(
        r"\w+",
        "a an the is are was were it in of to that this does not exist cannot be has have no there found "
        "file image used usable needed key read accepted supported by another do which its "
        "means known so holds hold "
        "folder optional full something package that too",
    )
)


def page() -> str:
    """The page: a section for each kind of error."""
    made = HEAD
    for kind, about in KINDS.items():
        made += f"\n## {kind}\n\n{about}\n\n"
        codes = {code: text for code, text in ERROR_CODES.items() if code.startswith(f"{kind}.")}
        meanings = {code: text.split("; ")[0] for code, text in codes.items()}
        said = [f"`{code}`" for code, meaning in meanings.items() if _said(code, meaning)]
        made += (
            textwrap.fill(f"- {', '.join(said)}", 110, subsequent_indent="  ", break_on_hyphens=False) + "\n"
            if said
            else ""
        )
        made += "".join(
            f"- `{code}`: {meaning}.\n" for code, meaning in meanings.items() if not _said(code, meaning)
        )
    return made


def _said(code: str, meaning: str) -> bool:
    """Whether a meaning says no more than the words of its code."""
    in_code = {word.removesuffix("s") for word in re.findall(r"[a-z]+", code)}
    return {
        word.removesuffix("s") for word in re.findall(r"[a-z]+", meaning.lower()) if word not in EMPTY
    } <= in_code


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
