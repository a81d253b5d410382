"""croissant.json: the metadata of a release as machines read it, in Croissant 1.0 (JSON-LD)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kinectbench.core.artefacts.targets import COLUMNS, NUMBER_COLUMNS, TARGETS_CSV
from kinectbench.core.storage import sha256_file
from kinectbench.release.publish.attribution import authors, citation_line, license_url
from kinectbench.settings.models import CitationSettings

CONFORMS_TO = "http://mlcommons.org/croissant/1.0"
TYPES = {"": "text/plain", ".csv": "text/csv", ".json": "application/json", ".html": "text/html"}
TYPES |= {".md": "text/markdown", ".cff": "application/yaml"}
FILE_SETS = {
    "pair-files": ("pairs/*/*.npz", "application/octet-stream", "the pairs: npz files of bit-packed grids"),
    "depth-images": ("views/*/*.depth.png", "image/png", "depth of each view, uint16 millimetres, 0 = none"),
    "masks": ("views/*/*.mask.png", "image/png", "255 = the object, in the pixels of depth"),
    "view-lists": ("views/*/views.json", "application/json", "frame, camera and fit of each view"),
    "objects": ("objects/*/*", "application/octet-stream", "floor, closed mesh and labelled volume"),
}
# pandas, which readers load the table with, would make a number of 007.
VIEW_IN_FILE = r"pairs/[^/]+/([0-9]+)\.npz"


def croissant(
    name: str, license: str, description: str, citation: CitationSettings, folder: Path
) -> dict[str, Any]:
    """Content of croissant.json.

    Args:
        name: of the benchmark.
        license: of all its recordings.
        description: a sentence.
        citation: how it is cited.
        folder: the release, complete but for what holds hashes or describes it.

    Source: https://docs.mlcommons.org/croissant/docs/croissant-spec-1.0.html
    """
    content: dict[str, Any] = {
        "@context": _context(),
        "@type": "sc:Dataset",
        "name": name,
        "description": description,
        "conformsTo": CONFORMS_TO,
        "license": license_url(license) or license,
        "version": citation.version or "0.0.0",
        "citeAs": citation_line(citation, name),
        "creator": [_creator(author) for author in authors(citation, name)],
        "keywords": ["3-D shape completion", "RGB-D", "voxel grids", "benchmark"],
        "isLiveDataset": False,
    }
    if citation.date_released:
        content["datePublished"] = citation.date_released
    url = citation.url or (f"https://doi.org/{citation.doi}" if citation.doi else None)
    if url:
        content["url"] = url
    content["distribution"] = [*_file_objects(folder), *_file_sets(folder)]
    content["recordSet"] = [_targets()]
    return content


def _file_objects(folder: Path) -> list[dict[str, Any]]:
    """The files at the top, each with its hash."""
    return [
        {
            "@type": "cr:FileObject",
            "@id": path.name,
            "name": path.name,
            "contentUrl": path.name,
            "encodingFormat": TYPES[path.suffix],
            "sha256": sha256_file(path),
        }
        for path in sorted(folder.iterdir())
        if path.is_file() and path.suffix in TYPES
    ]


def _file_sets(folder: Path) -> list[dict[str, Any]]:
    """The files in folders, by pattern; only where there are any."""
    return [
        {
            "@type": "cr:FileSet",
            "@id": key,
            "name": key,
            "description": text,
            "encodingFormat": encoding,
            "includes": pattern,
        }
        for key, (pattern, encoding, text) in FILE_SETS.items()
        if next(folder.glob(pattern), None) is not None
    ]


def _targets() -> dict[str, Any]:
    """targets.csv as records."""
    return {
        "@type": "cr:RecordSet",
        "@id": "targets",
        "name": "targets",
        "description": "one record per pair to be predicted",
        "key": {"@id": "targets/file"},
        "field": [_field(column, text) for column, text in COLUMNS.items()],
    }


def _field(column: str, text: str) -> dict[str, Any]:
    source: dict[str, Any] = {"fileObject": {"@id": TARGETS_CSV}, "extract": {"column": column}}
    if column == "view":
        source |= {"extract": {"column": "file"}, "transform": {"regex": VIEW_IN_FILE}}
    return {
        "@type": "cr:Field",
        "@id": f"targets/{column}",
        "name": column,
        "description": text,
        "dataType": "sc:Float" if column in NUMBER_COLUMNS else "sc:Text",
        "source": source,
    }


def _creator(author: str) -> Mapping[str, str]:
    family, comma, given = author.partition(", ")
    kind = "sc:Person" if comma else "sc:Organization"
    return {"@type": kind, "name": f"{given} {family}" if comma else author}


def _context() -> dict[str, Any]:
    """The context of Croissant 1.0, word for word; readers compare it."""
    of_croissant = (
        "citeAs column equivalentProperty extract field fileProperty fileObject fileSet format includes "
        "isLiveDataset jsonPath key md5 parentField path recordSet references regex repeated replace "
        "samplingRate separator source subField transform"
    )
    context: dict[str, Any] = {"@language": "en", "@vocab": "https://schema.org/"}
    context |= {word: f"cr:{word}" for word in of_croissant.split()}
    return context | {
        "conformsTo": "dct:conformsTo",
        "cr": "http://mlcommons.org/croissant/",
        "data": {"@id": "cr:data", "@type": "@json"},
        "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
        "dct": "http://purl.org/dc/terms/",
        "examples": {"@id": "cr:examples", "@type": "@json"},
        "rai": "http://mlcommons.org/croissant/RAI/",
        "sc": "https://schema.org/",
    }
