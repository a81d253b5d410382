"""Make croissant.json: machine-readable metadata of a release (JSON-LD, Croissant 1.1 with RAI fields)."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath
from typing import Any

from kinectbench.core import sha256_file
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON
from kinectbench.core.artefacts.targets import ALL_COLUMNS, COLUMNS, NUMBER_COLUMNS, TARGETS_CSV
from kinectbench.core.voxels.pair_file import Pair
from kinectbench.release.contents import CARD, CROISSANT, release_files
from kinectbench.release.publish.attribution import authors, citation_line, license_url
from kinectbench.release.publish.datacite import SUBJECTS, About, responsible_use

CONFORMS_TO = ("http://mlcommons.org/croissant/1.1", "http://mlcommons.org/croissant/RAI/1.0")
TYPES = {"": "text/plain", ".csv": "text/csv", ".json": "application/json", ".html": "text/html"}
NPZ = "application/x-npz"
TYPES |= {".md": "text/markdown", ".cff": "application/yaml"}
PAIR_FILES, VIEW_LISTS = "pair-files", "view-lists"
FILE_SETS: dict[str, tuple[str, str | list[str], str]] = {
    # "text/plain", too: readers that do not know npz, such as mlcroissant, then give the bytes.
    PAIR_FILES: ("pairs/*/*.npz", [NPZ, "text/plain"], "the pairs: npz files of bit-packed grids"),
    "depth-images": ("views/*/*.depth.png", "image/png", "depth of each view, uint16 millimetres, 0 = none"),
    "masks": ("views/*/*.mask.png", "image/png", "255 = the object, in the pixels of depth"),
    "previews": ("previews/*/*/*.jpg", "image/jpeg", "a small picture of each pair's view"),
    VIEW_LISTS: ("views/*/views.json", "application/json", "frame, camera and fit of each view"),
    "objects": ("objects/*/*", "application/octet-stream", "floor, closed mesh and labelled volume"),
    "shown-objects": ("objects/*.glb", "model/gltf-binary", "each object for viewers, of fewer triangles"),
}
# Files that croissant.json does not list.
LATER = (CROISSANT, CARD, BENCHMARK_JSON)
# From the file name: pandas, with which readers load the table, would turn 007 into a number.
VIEW_IN_FILE = r"pairs/[^/]+/([0-9]+)\.npz"
RECORDING_IN_FILE = r"views/([^/]+)/views\.json"


def croissant(about: About, folder: Path, columns: Sequence[str] = tuple(COLUMNS)) -> dict[str, object]:
    """Return the content of croissant.json.

    Files in `LATER` and SHA256SUMS may be missing in the folder.

    Source: https://docs.mlcommons.org/croissant/docs/croissant-spec-1.1.html, …/croissant-rai-spec.html
    """
    files = (path.relative_to(folder).as_posix() for path in release_files(folder))
    names = [name for name in files if name not in LATER]
    sums = {name: sha256_file(folder / name) for name in names if _is_described(name)}
    return described(about) | described_files(dict.fromkeys(names, "") | sums, columns)


def described_files(sums: Mapping[str, str], columns: Sequence[str]) -> dict[str, Any]:
    """Return those keys of croissant.json that depend on the files of the release.

    Of `sums`, {file: SHA-256}, only top-level files are used.
    """
    records = [_targets(columns), _pairs()]
    if any(fnmatchcase(name, FILE_SETS[VIEW_LISTS][0]) for name in sums):
        records.append(_cameras())
    return {"distribution": [*_file_objects(sums), *_file_sets(sums)], "recordSet": records}


def _is_described(name: str) -> bool:
    """Return whether a release's file is a FileObject: at the top, with a suffix in `TYPES`."""
    return "/" not in name and PurePosixPath(name).suffix in TYPES


def described(about: About) -> dict[str, Any]:
    """Return those keys of croissant.json that do not depend on the files of the release."""
    citation = about.citation
    content: dict[str, Any] = {
        "@context": _context(),
        "@type": "sc:Dataset",
        "name": about.name,
        "description": about.description,
        "conformsTo": list(CONFORMS_TO),
        "license": license_url(about.license) or about.license,
        "version": citation.version or "0.0.0",
        "datePublished": about.date,
        "citeAs": citation_line(citation, about.name),
        "creator": [_creator(author) for author in authors(citation, about.name)],
        "keywords": list(SUBJECTS),
        "isLiveDataset": False,
    }
    url = citation.url or (f"https://doi.org/{citation.doi}" if citation.doi else None)
    if url:
        content["url"] = url
    return content | {f"rai:{key}": text for key, text in responsible_use(about).items()}


def _file_objects(sums: Mapping[str, str]) -> list[dict[str, object]]:
    """Return Croissant's FileObject, with SHA-256, of each top-level file with a suffix in `TYPES`."""
    return [
        {
            "@type": "cr:FileObject",
            "@id": name,
            "name": name,
            "contentUrl": name,
            "encodingFormat": TYPES[PurePosixPath(name).suffix],
            "sha256": sums[name],
        }
        for name in sorted(sums)
        if _is_described(name)
    ]


def _file_sets(names: Iterable[str]) -> list[dict[str, object]]:
    """Return a Croissant FileSet for each pattern in `FILE_SETS` that any file of the release matches."""
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
        if any(fnmatchcase(name, pattern) for name in names)
    ]


def _targets(columns: Sequence[str]) -> dict[str, object]:
    return {
        "@type": "cr:RecordSet",
        "@id": "targets",
        "name": "targets",
        "description": "one record per pair to be predicted",
        "key": {"@id": "targets/file"},
        "field": [_field(column, ALL_COLUMNS[column]) for column in columns],
    }


def _pairs() -> dict[str, object]:
    """Return Croissant's RecordSet of the pair files; a record's `pairs/npz` has the bytes of an npz file."""
    arrays = "; ".join(f"{field.name}: {field.metadata['description']}" for field in fields(Pair))
    content = (
        "the bytes of an npz file, whose arrays are: "
        f"{arrays}. Grids are bits along the last axis: numpy.unpackbits(array, axis=-1)"
    )
    return {
        "@type": "cr:RecordSet",
        "@id": "pairs",
        "name": "pairs",
        "description": "one record per pair file, with its arrays; of what is held back without the truth",
        "key": {"@id": "pairs/file"},
        "field": [
            _of_files("pairs", "file", "relative to the release", {"fileProperty": "fullpath"}, PAIR_FILES),
            _of_files("pairs", "npz", content, {"fileProperty": "content"}, PAIR_FILES),
        ],
    }


def _cameras() -> dict[str, object]:
    """Return Croissant's RecordSet of all views.json: recording, name, K and image size of each view."""
    parts: dict[str, tuple[str, str, dict[str, object]]] = {
        "view": ("zero-padded index", "sc:Text", {}),
        "K": ("intrinsics, pixels", "cr:Float64", {"isArray": True, "arrayShape": "3,3"}),
        "width": ("of the view's images, pixels", "sc:Integer", {}),
        "height": ("of the view's images, pixels", "sc:Integer", {}),
    }
    path: dict[str, str] = {"fileProperty": "fullpath"}
    recording = _of_files("cameras", "recording", "id, as targets/recording", path, VIEW_LISTS)
    recording["source"]["transform"] = {"regex": RECORDING_IN_FILE}
    rows = [recording]
    for name, (text, kind, more) in parts.items():
        path = {"jsonPath": f"$.views[*].{name}"}
        rows.append(_of_files("cameras", name, text, path, VIEW_LISTS) | {"dataType": kind, **more})
    return {
        "@type": "cr:RecordSet",
        "@id": "cameras",
        "name": "cameras",
        "description": "one record per view; recording and view are those of targets",
        "field": rows,
    }


def _of_files(record_set: str, name: str, text: str, extract: dict[str, str], files: str) -> dict[str, Any]:
    """Return Croissant's Field `name`, whose value is extracted from each file of the FileSet `files`.

    `record_set` is the id of the RecordSet that has the field. `text` is the field's description, and
    `extract` is Croissant's rule of extraction.
    """
    return {
        "@type": "cr:Field",
        "@id": f"{record_set}/{name}",
        "name": name,
        "description": text,
        "dataType": "sc:Text",
        "source": {"fileSet": {"@id": files}, "extract": extract},
    }


def _field(column: str, text: str) -> dict[str, object]:
    source: dict[str, object] = {"fileObject": {"@id": TARGETS_CSV}, "extract": {"column": column}}
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


def _context() -> dict[str, object]:
    """Return Croissant 1.1's JSON-LD context word for word, because readers compare it."""
    of_croissant = (
        "arrayShape citeAs column containedIn equivalentProperty extract field fileProperty fileObject "
        "fileSet format includes isArray isLiveDataset jsonPath key md5 parentField path recordSet "
        "references regex repeated replace samplingRate separator source subField transform"
    )
    context: dict[str, object] = {"@language": "en", "@vocab": "https://schema.org/"}
    context |= {word: f"cr:{word}" for word in of_croissant.split()}
    return context | {
        "conformsTo": "dct:conformsTo",
        "cr": "http://mlcommons.org/croissant/",
        "data": {"@id": "cr:data", "@type": "@json"},
        "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
        "dct": "http://purl.org/dc/terms/",
        "description": {"@container": "@language"},
        "examples": {"@id": "cr:examples", "@type": "@json"},
        "name": {"@container": "@language"},
        "rai": "http://mlcommons.org/croissant/RAI/",
        "sc": "https://schema.org/",
    }
