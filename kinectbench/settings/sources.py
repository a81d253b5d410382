"""Settings of a recipe, sources.yaml: location, content and owners of public scans."""

import hashlib
import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from kinectbench.core import Category, Name, SettingsError, below
from kinectbench.core.store.address import is_web, unusable
from kinectbench.core.types import Split
from kinectbench.settings.base import Line, Settings
from kinectbench.settings.models import CameraSettings, SegmentBy, TrajectoryMode
from kinectbench.settings.overrides import read_model

SOURCES_YAML = "sources.yaml"
# Stands for the scan's id in a file name.
ID = "{id}"
# Archives that are unpacked after download because no reader opens them; some readers open .zip.
UNPACKED = (".tgz", ".tar.gz", ".tar")


def _base(value: str) -> str:
    if problem := unusable(value):
        raise ValueError(problem)
    if not is_web(value) or re.search(r"[\s?#@]", value):
        raise ValueError("wanted an address that begins with https://, without user and query")
    return value.rstrip("/")


def _file(value: str) -> str:
    below(Path(), value.replace(ID, "0"))
    if re.search(r"[^A-Za-z0-9._/+-]", value.replace(ID, "")):
        raise ValueError("use letters, digits, '.', '_', '+', '-', '/' and {id} only")
    return value


Base = Annotated[str, AfterValidator(_base)]
File = Annotated[str, AfterValidator(_file)]


class SplitSettings(Settings):
    """How objects are divided into splits; objects in neither train nor validation are test."""

    seed: int = Field(0, ge=0, description="seed of the draw; also of the scans that --limit takes")
    train: float = Field(0.0, ge=0, le=1, description="share of the objects in train")
    validation: float = Field(0.0, ge=0, le=1, description="share of the objects in validation")

    @model_validator(mode="after")
    def _leaves_some(self) -> "SplitSettings":
        if self.train + self.validation > 1:
            raise ValueError("train and validation are more than 1 together")
        return self


class IndexSettings(Settings):
    """Where the source's own list of its scans is: a JSON file, {category: [id, …]}."""

    bases: list[Base] = Field(min_length=1, description="addresses of folders, tried in order")
    file: File = Field(description="name of the list below them")
    sha256: str | None = Field(
        None, pattern="^[0-9a-f]{64}$", description="SHA-256 of the list; default: any is read"
    )


class ScanSettings(Settings):
    """One scan of a source, for recipes that list the scans themselves."""

    id: Name = Field(description="id of the scan, and of its recording")
    category: Category = Field(description="category in the source's words")
    file: File | None = Field(
        None, description="name of the scan's file; default: `file` of the whole recipe"
    )
    object: Name | None = Field(
        None, description="name of the thing itself, where it is scanned more than once"
    )
    camera: CameraSettings | None = Field(None, description="intrinsics, only what the scan does not say")


class EntrySettings(Settings):
    """Keys that every recording gets in benchmark.yaml."""

    segment_by: SegmentBy | None = Field(
        None, description="`segment_by` in benchmark.yaml: masks or turntable"
    )
    trajectory: TrajectoryMode | None = Field(
        None, description="`trajectory` in benchmark.yaml: trust, refine or ignore"
    )


class SourcesSettings(Settings):
    """The content of sources.yaml."""

    format_version: Literal[1] = Field(description="version of this file's format")
    bases: list[Base] = Field(min_length=1, description="addresses of folders, tried in order")
    file: File = Field(description="name of a scan's file below them; {id} stands for its id")
    license: Line = Field(description="licence of the scans, such as CC-BY-4.0")
    source: Line = Field(description="who recorded them, as users of the scans must state")
    index: IndexSettings | None = Field(None, description="the source's own list of scans")
    scans: list[ScanSettings] | None = Field(
        None, min_length=1, description="list of scans, in place of `index`"
    )
    objects: dict[Name, Name] = Field(
        {}, description="scan's id -> name of the thing that it shows, where other scans show it, too"
    )
    categories: dict[str, Category] = Field(
        min_length=1, description="source's word for a category -> the benchmark's; other scans are left out"
    )
    camera: CameraSettings | None = Field(
        None, description="intrinsics of all scans, only what they do not say"
    )
    sensors: list[Name] | None = Field(
        None, min_length=1, description="cameras of each scan, each a recording: `camera: {sensor: …}`"
    )
    entry: EntrySettings = Field(EntrySettings(), description="keys that every recording's entry gets, too")
    split: SplitSettings = Field(SplitSettings(), description="how objects are divided into splits")

    @model_validator(mode="after")
    def _one_list(self) -> "SourcesSettings":
        if (self.index is None) is (self.scans is None):
            raise ValueError("give either `index` or `scans`, which say what there is")
        if self.index is not None and ID not in self.file:
            raise ValueError(f"`file` must hold {ID}: all scans of `index` would be one file")
        return self


class Scan(Settings):
    """A recording made from a scan that a recipe chooses.

    Attributes:
        id: id of the recording.
        scan: id of the scan, which is one file; a scan by several cameras becomes several recordings.
        file: path of the file below each base URL.
        category: category in the benchmark.
        object: name of the object.
        split: split of the object.
        camera: intrinsics that the scan lacks.
    """

    id: str
    scan: str
    file: str
    category: str
    object: str
    split: Split
    camera: CameraSettings | None = None

    @property
    def unpacked(self) -> bool:
        """Whether the scan's archive is unpacked after download."""
        return self.file.endswith(UNPACKED)

    @property
    def path(self) -> str:
        """Path of the downloaded scan, relative to benchmark.yaml: a file, or the folder of an archive."""
        return self.folder if self.unpacked else f"{self.folder}{PurePosixPath(self.file).suffix}"

    @property
    def archive(self) -> str:
        """Path of the file as downloaded, relative to benchmark.yaml."""
        return f"{self.folder}.tgz" if self.unpacked else self.path

    @property
    def folder(self) -> str:
        """Folder into which an archive is unpacked, relative to benchmark.yaml."""
        return f"scans/{self.scan}"


def read_sources(folder: Path) -> SourcesSettings:
    """Read sources.yaml from a recipe's folder.

    Raises:
        SettingsError: one line for each error.
    """
    return read_model(folder / SOURCES_YAML, SourcesSettings, "bases: [https://…]")


def chosen_scans(
    sources: SourcesSettings,
    listed: dict[str, list[str]],
    categories: tuple[str, ...] = (),
    limit: int | None = None,
) -> list[Scan]:
    """Choose scans of a recipe, in an order drawn by its seed, so that a higher limit only adds scans.

    Args:
        sources: the recipe.
        listed: {category as the source names it: ids of its scans}; unused if the recipe has `scans`.
        categories: categories of the benchmark to choose from; empty: all.
        limit: largest number of scans of each category.

    Raises:
        SettingsError: the recipe has no such category, no scan is left, or an id is listed twice.
    """
    known = sorted(set(sources.categories.values()))
    for name in categories:
        if name not in known:
            raise SettingsError(f"--category {name}: the recipe has {', '.join(known)}")
    if sources.scans is not None:
        rows = sources.scans
    else:
        rows = [
            ScanSettings(id=id_, category=name) for name in sources.categories for id_ in listed.get(name, ())
        ]
    scans: dict[str, list[Scan]] = {}
    for row in rows:
        category = sources.categories.get(row.category)
        if category is None or (categories and category not in categories):
            continue
        if row.id in scans:
            raise SettingsError(f"the scan '{row.id}' is listed twice; correct {SOURCES_YAML} or its index")
        scans[row.id] = list(_recordings(sources, _scan(sources, row, category)))
    counts = dict.fromkeys(known, 0)
    chosen = []
    for name in sorted(scans, key=lambda name: _draw(sources.split.seed, "scan", name)):
        category = scans[name][0].category
        counts[category] += 1
        if limit is None or counts[category] <= limit:
            chosen += scans[name]
    if not chosen:
        raise SettingsError(f"{SOURCES_YAML}: no scan of {', '.join(categories or known)} is listed")
    return chosen


def _scan(sources: SourcesSettings, row: ScanSettings, category: str) -> Scan:
    name = sources.objects.get(row.id) or row.object or row.id
    share, split = _draw(sources.split.seed, "split", name), sources.split
    part: Split = "test"
    if share < split.train + split.validation:
        part = "train" if share < split.train else "validation"
    file = (row.file or sources.file).replace(ID, row.id)
    camera = row.camera or sources.camera
    return Scan(id=row.id, scan=row.id, file=file, category=category, object=name, split=part, camera=camera)


def _recordings(sources: SourcesSettings, scan: Scan) -> Iterator[Scan]:
    """Yield the recordings of a scan: the scan itself, or one for each camera."""
    if sources.sensors is None:
        yield scan
        return
    for sensor in sources.sensors:
        camera = (scan.camera or CameraSettings()).model_copy(update={"sensor": sensor})
        yield scan.model_copy(update={"id": f"{scan.id}_{sensor}", "camera": camera})


def _draw(seed: int, what: str, name: str) -> float:
    """Return a pseudorandom number in [0, 1) that depends only on seed and name, and on its use `what`."""
    digest = hashlib.sha256(f"{seed} {what} {name}".encode()).digest()
    return int.from_bytes(digest[:6], "big") / 2**48
