"""How to cite a release, CITATION.cff, and what changed from version to version, CHANGELOG.md."""

from collections.abc import Sequence
from typing import Any

import yaml

from kinectbench.config import ChangeSettings, CitationSettings
from kinectbench.release.origins import HUGGING_FACE


def citation_text(citation: CitationSettings, name: str, license: str) -> str:
    """CITATION.cff (Citation File Format 1.2.0) of a dataset.

    Args:
        citation: the benchmark's; its name stands for what is not said.
        name: of the benchmark.
        license: left out where it is no SPDX identifier, as the format asks for.
    """
    content: dict[str, Any] = {
        "cff-version": "1.2.0",
        "message": "If you use this benchmark, please cite it.",
        "type": "dataset",
        "title": citation.title or name,
        "authors": [_author(author) for author in authors(citation, name)],
    }
    for key, value in (
        ("version", citation.version),
        ("doi", citation.doi),
        ("url", citation.url),
        ("date-released", citation.date_released),
        ("license", license if license in HUGGING_FACE else None),
    ):
        if value is not None:
            content[key] = value
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=10**9)


def authors(citation: CitationSettings, name: str) -> list[str]:
    """The authors, or words for those of a benchmark that does not name them."""
    return citation.authors or [f"The makers of {name}"]


def citation_line(citation: CitationSettings, name: str) -> str:
    """One line that cites the release."""
    parts = [", ".join(authors(citation, name))]
    if citation.date_released:
        parts[0] += f" ({citation.date_released[:4]})"
    parts.append(citation.title or name)
    if citation.version:
        parts[1] += f", version {citation.version}"
    if citation.doi:
        parts.append(f"https://doi.org/{citation.doi}")
    elif citation.url:
        parts.append(citation.url)
    return ". ".join(parts) + "."


def changelog_text(changes: Sequence[ChangeSettings] | None, name: str) -> str:
    """CHANGELOG.md, newest first, as given."""
    lines = [f"# Changes of {name}", ""]
    for change in changes or []:
        lines += [f"## {change.version}", "", *(f"- {' '.join(line.split())}" for line in change.changes), ""]
    if not changes:
        lines += ["Nothing is recorded.", ""]
    return "\n".join(lines[:-1]) + "\n"


def _author(author: str) -> dict[str, str]:
    """`Family, Given` is a person, anything else a group."""
    family, comma, given = author.partition(", ")
    return {"family-names": family, "given-names": given} if comma else {"name": author}
