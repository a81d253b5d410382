"""What a release holds of one recording: pairs, views and the object, or of a held-back one the inputs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinectbench.config import BenchmarkSettings, RecordingSettings
from kinectbench.errors import PairError, ReleaseError
from kinectbench.release.built import built_json, copy_built
from kinectbench.release.held_back import own_floor, own_views, without_truth
from kinectbench.release.lineage import recording_lineage
from kinectbench.release.metadata import RecordingInfo
from kinectbench.release.privacy import Found, scrubbed, scrubbed_jpeg
from kinectbench.release.release import Target
from kinectbench.voxels.pair_file import Pair, read_pair
from kinectbench.voxels.pair_input import input_bytes
from kinectbench.workspace import pretty_json, sha256_file

JSON_OF_OBJECT = ("floor.json", "quality.json")
BYTES_OF_OBJECT = ("mesh.ply", "volume.npz")


@dataclass(frozen=True)
class Built:
    """A recording that is to be published.

    Attributes:
        settings: the benchmark's.
        recording: one of them.
        folder: `build/<recording>/`.
        hidden: whether its truth is held back.
    """

    settings: BenchmarkSettings
    recording: RecordingSettings
    folder: Path
    hidden: bool


@dataclass(frozen=True)
class Published:
    """What was published of a recording.

    Attributes:
        targets: its pairs; none: nothing was published.
        info: what benchmark.json says of it.
        lineage: what lineage.json says of it.
        has_color: whether its views have colour, published or not.
    """

    targets: tuple[Target, ...]
    info: RecordingInfo
    lineage: dict[str, Any]
    has_color: bool


def publish_recording(built: Built, folder: Path, found: Found) -> Published | None:
    """Copy what is published of one recording into a release; None if it has no pair.

    Args:
        built: the recording.
        folder: the release's.
        found: collects what is removed for privacy.

    Raises:
        ReleaseError: a file is missing or damaged, or a pair is not of the benchmark's framing and rule.
    """
    listed = built_json(built.folder / "pairs" / "pairs.json").get("pairs", [])
    names = sorted(f"{int(entry['view']):03d}" for entry in listed)
    if not names:
        return None
    targets = tuple(_publish_pair(built, view, folder) for view in names)
    _publish_object(built, folder, found)
    has_color = _publish_views(built, names, folder, found)
    lineage = recording_lineage(
        built.settings, built.recording, built.folder, None if built.hidden else names
    )
    return Published(targets, _info(built, len(names), found), lineage, has_color)


def check_pair(settings: BenchmarkSettings, path: Path) -> Pair:
    """Read a built pair; one benchmark has one framing and one partial rule.

    Raises:
        ReleaseError: it is damaged, or has others.
    """
    try:
        pair = read_pair(path)
    except PairError as error:
        raise ReleaseError(str(error)) from error
    for key in ("framing", "partial_rule"):
        found, wanted = getattr(pair, key), getattr(settings.pairs, key)
        if found != wanted:
            raise ReleaseError(f"{path}: {key} is '{found}', the settings say '{wanted}'; run pairs again")
    return pair


def _publish_pair(built: Built, view: str, folder: Path) -> Target:
    """Copy a pair, or write its input alone."""
    recording = built.recording
    source = built.folder / "pairs" / f"{view}.npz"
    pair = check_pair(built.settings, source)
    file = f"pairs/{recording.id}/{view}.npz"
    if built.hidden:
        floor = built_json(built.folder / "object" / "floor.json")
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        data = input_bytes(without_truth(pair, np.array(floor["T_floor_world"], np.float64)))
        (folder / file).write_bytes(data)
    else:
        copy_built(source, folder / file)
    return Target(
        recording=recording.id,
        object=recording.object_name,
        view=view,
        category=recording.category,
        split=recording.split,
        file=file,
        sha256=sha256_file(folder / file),
    )


def _publish_object(built: Built, folder: Path, found: Found) -> None:
    """Copy the object's files; of a held-back one the floor only."""
    source, name = built.folder / "object", f"objects/{built.recording.id}"
    (folder / name).mkdir(parents=True)
    for file in BYTES_OF_OBJECT if not built.hidden else ():
        copy_built(source / file, folder / name / file)
    for file in JSON_OF_OBJECT:
        content = built_json(source / file)
        if built.hidden:
            if file != "floor.json":
                continue
            content = own_floor(content)
        _write_json(folder, f"{name}/{file}", content, found)


def _publish_views(built: Built, names: Sequence[str], folder: Path, found: Found) -> bool:
    """Copy depth and mask of every view that has a pair, and colour where it is wanted and there is any."""
    source, name = built.folder / "views", f"views/{built.recording.id}"
    (folder / name).mkdir(parents=True)
    has_color = False
    for view in names:
        for suffix in (".depth.png", ".mask.png"):
            copy_built(source / f"{view}{suffix}", folder / name / f"{view}{suffix}")
        image = f"{view}.color.jpg"
        has_color |= (source / image).is_file()
        if built.settings.publish.color and (source / image).is_file():
            data = scrubbed_jpeg((source / image).read_bytes(), f"{name}/{image}", found)
            (folder / name / image).write_bytes(data)
    content = _with_cameras(built_json(source / "views.json"), built.folder / "sequence", names)
    if built.hidden:
        content = own_views(content)
    _write_json(folder, f"{name}/views.json", content, found)
    return has_color


def _with_cameras(views: dict[str, Any], sequence: Path, names: Sequence[str]) -> dict[str, Any]:
    """views.json with the camera of each view: all of a recording's are from one."""
    camera = built_json(sequence / "camera.json")
    K = [[camera["fx"], 0.0, camera["cx"]], [0.0, camera["fy"], camera["cy"]], [0.0, 0.0, 1.0]]
    more = {"K": K, "width": camera["width"], "height": camera["height"]}
    rows = [row | more | {"pair": row["view"] in names} for row in views["views"]]
    return views | {"views": rows}


def _info(built: Built, pairs: int, found: Found) -> RecordingInfo:
    """What benchmark.json says of a recording."""
    recording, folder = built.recording, built.folder
    quality = {} if built.hidden else built_json(folder / "object" / "quality.json")
    return RecordingInfo(
        object=recording.object_name,
        category=recording.category,
        split=recording.split,
        pairs=pairs,
        refused=sum(
            len(built_json(folder / file).get("refused", []))
            for file in ("views/views.json", "pairs/pairs.json")
        ),
        quality=scrubbed(quality, "benchmark.json", found),
        license=built.settings.license_of(recording),
        source=built.settings.source_of(recording),
    )


def _write_json(folder: Path, name: str, content: Mapping[str, Any], found: Found) -> None:
    (folder / name).write_text(pretty_json(scrubbed(content, name, found)))
