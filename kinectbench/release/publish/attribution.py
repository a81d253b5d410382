"""Licences and sources of recordings, citation, and changelog of a release."""

import re
from collections.abc import Mapping, Sequence

import yaml

from kinectbench.core.artefacts.benchmark import UNSPECIFIED, RecordingInfo
from kinectbench.settings.models import RecordingSettings
from kinectbench.settings.publishing import ChangeSettings, CitationSettings

# SPDX identifier -> name of the licence on Hugging Face.
HUGGING_FACE = {
    "Apache-2.0": "apache-2.0",
    "CC-BY-3.0": "cc-by-3.0",
    "CC-BY-4.0": "cc-by-4.0",
    "CC-BY-NC-4.0": "cc-by-nc-4.0",
    "CC-BY-NC-ND-4.0": "cc-by-nc-nd-4.0",
    "CC-BY-NC-SA-4.0": "cc-by-nc-sa-4.0",
    "CC-BY-SA-4.0": "cc-by-sa-4.0",
    "CC0-1.0": "cc0-1.0",
    "CDLA-Permissive-2.0": "cdla-permissive-2.0",
    "MIT": "mit",
    "ODC-By-1.0": "odc-by",
    "ODbL-1.0": "odbl",
    "PDDL-1.0": "pddl",
}


def reasons_against_distribution(
    recordings: Mapping[str, RecordingInfo | RecordingSettings],
) -> tuple[str, ...]:
    """Return why the data must not be distributed, one line each; empty if distribution is allowed."""
    reasons = []
    for key, word in (("license", "licence"), ("source", "source")):
        silent = [name for name, info in sorted(recordings.items()) if getattr(info, key) == UNSPECIFIED]
        if silent:
            which = "every recording" if len(silent) == len(recordings) else ", ".join(silent)
            reasons.append(
                f"no {word} is stated: set `{key}` in benchmark.yaml ({which}); until then the release is "
                "not for distribution"
            )
    return tuple(reasons)


def common_license(recordings: Mapping[str, RecordingInfo], otherwise: str) -> str:
    """Return the licence that all recordings share, or `otherwise` if there is no such licence.

    `otherwise` is the benchmark's licence. It also holds for recordings that state none.
    """
    silent = otherwise or UNSPECIFIED
    licenses = {silent if info.license == UNSPECIFIED else info.license for info in recordings.values()}
    return licenses.pop() if len(licenses) == 1 else otherwise


def license_url(license: str) -> str | None:
    """Return the URL of a licence's text if `license` is a known SPDX identifier, else None."""
    return f"https://spdx.org/licenses/{license}.html" if license in HUGGING_FACE else None


def markdown_line(text: str) -> str:
    """Return an untrusted text as one line of Markdown in which tags, links and table cells are escaped."""
    line = " ".join(text.split()).replace("<", "&lt;")
    return re.sub(r"[\\[|]", r"\\\g<0>", line)


def without_tags(text: str) -> str:
    """Return a Markdown text in which HTML tags are escaped."""
    return re.sub(r"<(?=[A-Za-z/!?])", "&lt;", text)


def license_text(name: str, license: str, recordings: Mapping[str, RecordingInfo]) -> str:
    """Return the text of LICENSE: the benchmark's licence, then licence and source of each recording."""
    head = "No licence is stated for the benchmark as a whole." if license == UNSPECIFIED else license
    lines = [f"The data of the benchmark '{name}'", "", f"Licence: {head}"]
    if url := license_url(license):
        lines.append(f"Its text: {url}")
    lines += ["", "Each recording, and all that was made from it, is under its own licence:", ""]
    for recording, info in sorted(recordings.items()):
        lines += [recording, f"  licence: {info.license}", f"  source: {' '.join(info.source.split())}"]
    reasons = reasons_against_distribution(recordings)
    if reasons:
        lines += ["", "NOT FOR DISTRIBUTION", *(f"- {reason}" for reason in reasons)]
    return "\n".join(lines) + "\n"


def citation_text(citation: CitationSettings, name: str, license: str) -> str:
    """Return the text of CITATION.cff (Citation File Format 1.2.0) of a dataset.

    `name` replaces a missing title and authors. A licence that is not in `HUGGING_FACE` is left out, because
    the format requires an SPDX identifier.
    """
    content: dict[str, object] = {
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
    """Return the benchmark's authors, or "The makers of <name>" if it names none."""
    return citation.authors or [f"The makers of {name}"]


def citation_line(citation: CitationSettings, name: str) -> str:
    """Return a citation of the release in one line."""
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
    """Return the text of CHANGELOG.md; changes keep their order, which should be newest first."""
    lines = [f"# Changes of {name}", ""]
    for change in changes or []:
        lines += [
            f"## {markdown_line(change.version)}",
            "",
            *(f"- {without_tags(line)}" for line in change.changes),
            "",
        ]
    if not changes:
        lines += ["Nothing is recorded.", ""]
    return "\n".join(lines[:-1]) + "\n"


def _author(author: str) -> dict[str, str]:
    """Return an author's entry in CITATION.cff: `Family, Given` is a person, any other name is a group."""
    family, comma, given = author.partition(", ")
    return {"family-names": family, "given-names": given} if comma else {"name": author}
