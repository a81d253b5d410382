"""Write docs/errors.md, a list of the codes of all errors, from `kinectbench.core.error_codes`.

.venv/bin/python scripts/docs_errors.py
"""

from pathlib import Path

from kinectbench.core.error_codes import ERROR_CODES, KINDS

PAGE = Path(__file__).parents[1] / "docs" / "errors.md"
HEAD = """# Errors

Every error is one line, which says what, where and what to do. It has a code, which stays where the line
is reworded. In Python it is `error.code`.
`failed.json`, `build --json` and `build --status --json` have it as the key `code`. `build --verbose`
shows it, and so does any command with KINECTBENCH_DEBUG=1. `scripts/docs_errors.py` makes this page of
`kinectbench/core/error_codes.py`.
"""


def page() -> str:
    """The page: a section for each kind of error."""
    made = HEAD
    for kind, about in KINDS.items():
        made += f"\n## {kind}\n\n{about}\n\n"
        codes = {code: text for code, text in ERROR_CODES.items() if code.startswith(f"{kind}.")}
        made += "".join(f"- `{code}`: {text.split('; ')[0]}.\n" for code, text in codes.items())
    return made


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
