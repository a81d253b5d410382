"""Licence and source of every recording: whether a release may be given away, and its LICENSE."""

from collections.abc import Mapping
from dataclasses import dataclass

UNSPECIFIED = "unspecified"
# SPDX identifier -> what Hugging Face calls it.
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


@dataclass(frozen=True)
class Origin:
    """Where the data of a recording is from.

    Attributes:
        license: SPDX identifier or other words; "unspecified" if nobody said.
        source: who recorded it, or where it is from; "unspecified" if nobody said.
    """

    license: str
    source: str


def reasons_against_distribution(origins: Mapping[str, Origin]) -> tuple[str, ...]:
    """Why the data must not be given away, one line each; empty if it may.

    Args:
        origins: by recording.
    """
    reasons = []
    for key, word in (("license", "licence"), ("source", "source")):
        silent = [name for name, origin in sorted(origins.items()) if getattr(origin, key) == UNSPECIFIED]
        if silent:
            which = "every recording" if len(silent) == len(origins) else ", ".join(silent)
            reasons.append(
                f"no {word} is stated: set `{key}` in benchmark.yaml ({which}); until then the release is "
                "not for distribution"
            )
    return tuple(reasons)


def common_license(origins: Mapping[str, Origin], otherwise: str) -> str:
    """The licence of all recordings if they have the same one, else `otherwise`."""
    licenses = {origin.license for origin in origins.values()}
    return licenses.pop() if len(licenses) == 1 else otherwise


def license_url(license: str) -> str | None:
    """Where the text of a licence with an SPDX identifier is; None for other words."""
    return f"https://spdx.org/licenses/{license}.html" if license in HUGGING_FACE else None


def license_text(name: str, license: str, origins: Mapping[str, Origin]) -> str:
    """LICENSE: the licence, and of each recording its licence and source.

    Args:
        name: of the benchmark.
        license: of the benchmark.
        origins: by recording.
    """
    head = "No licence is stated for the benchmark as a whole." if license == UNSPECIFIED else license
    lines = [f"The data of the benchmark '{name}'", "", f"Licence: {head}"]
    if url := license_url(license):
        lines.append(f"Its text: {url}")
    lines += ["", "Each recording, and all that was made from it, is under its own licence:", ""]
    for recording, origin in sorted(origins.items()):
        lines += [recording, f"  licence: {origin.license}", f"  source: {' '.join(origin.source.split())}"]
    reasons = reasons_against_distribution(origins)
    if reasons:
        lines += ["", "NOT FOR DISTRIBUTION", *(f"- {reason}" for reason in reasons)]
    return "\n".join(lines) + "\n"
