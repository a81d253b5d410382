"""Export to, and import from, the file layout of the 3D-RecGAN++ authors, which existing networks read."""

import re
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, cast

import numpy as np
from pydantic import AfterValidator, Field

from kinectbench.core import (
    NAME,
    KinectBenchError,
    PairError,
    SettingsError,
    below,
    followed,
    lies_below,
    replaced_folder,
    sha256_file,
    write_below,
)
from kinectbench.core.artefacts.benchmark import RecordingInfo
from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.stored import Matrix3, Matrix4, Stored, StoredPart
from kinectbench.core.artefacts.targets import Target, check_names
from kinectbench.core.artefacts.views import ViewName
from kinectbench.core.types import Framing, PartialRule, Progress, Split, no_progress
from kinectbench.core.voxels.pair_file import (
    FULL_CELLS,
    Pair,
    checked_pair,
    pack,
    pair_bytes,
    pair_values,
    unpack,
)
from kinectbench.core.voxels.recgan_file import read_recgan_file, recgan_file_bytes
from kinectbench.core.voxels.resample import reduce_blocks
from kinectbench.core.voxels.solid import packed_shell
from kinectbench.release.exchange.layouts import (
    EXPORT_JSON,
    MATRICES,
    NAMES,
    NUMBERS,
    SPLIT_NAMES,
    SYNSETS,
    new_folder,
    pair_record,
    recgan_path,
    write_export_json,
)
from kinectbench.release.own_folder import refuse_other_content
from kinectbench.release.publish.card import CardTexts
from kinectbench.release.publish.small_files import release_info, write_small_files
from kinectbench.release.release import Release
from kinectbench.settings.base import Line
from kinectbench.settings.models import PairSettings

SPLITS = {theirs: split for split, theirs in SPLIT_NAMES.items()}
PATH = re.compile(
    r"P1_(\d{8})_([A-Za-z0-9._-]+)/(train|val|test)_(\d+)_25d_vox256/(.+)_(\d+)_(\d+)_(\d+)\.npz"
)
TEXTS = CardTexts(
    "files of the authors of 3D-RecGAN++",
    "The files say nothing of what was\nseen or known: `known` is set everywhere, `seen` where the view "
    "measured a surface. Do not use the\nprotocols `known` and `occluded`. Where no transform was exported "
    "with them, the cube's edge\nstands for a metre, and `surface_sigma_m`, which is not known, is 0: do not "
    "use the surface Dice.",
)


def _checked_name(name: str) -> str:
    if not NAME.fullmatch(name):
        raise ValueError("a name that is not safe as a file's")
    return name


Name = Annotated[str, AfterValidator(_checked_name)]
Metres = Annotated[float, Field(ge=0)]


class ExportedPair(StoredPart):
    """A row of export.json: a pair's names, its two files, and facts that these files cannot hold."""

    recording: Name
    object: Name
    view: ViewName
    category: Name
    split: Split
    file_25d: str
    file_3d: str
    voxel_size_m: Metres
    surface_sigma_m: Metres
    framing: Framing
    partial_rule: PartialRule
    occupancy_rule: Literal["winding", "seeable", "six-rays"]
    T_world_grid: Matrix4
    T_world_camera: Matrix4
    K: Matrix3


class Exported(Stored):
    """The content of export.json; only exports in this layout have `pairs`."""

    FILE: ClassVar[str] = EXPORT_JSON
    ERROR: ClassVar[type[KinectBenchError]] = PairError
    ADVICE: ClassVar[str] = "export again"

    name: str | None = None
    license: Line = "unspecified"
    pairs: tuple[ExportedPair, ...] = ()


@dataclass(frozen=True)
class FoundPair:
    """A pair of files to import.

    Attributes:
        target: the imported pair's row of the release's targets.csv.
        file_25d: file of the visible part.
        file_3d: file of the full shape.
        values: values of those fields of `Pair` that are known and are not grids, such as transforms.
    """

    target: Target
    file_25d: Path
    file_3d: Path
    values: dict[str, Any]


def export_recgan(release: Release, out: Path, progress: Progress = no_progress) -> int:
    """Write each pair as two files, visible part (`25d`) and full shape (`3d`); return the number of pairs.

    The grids are not cropped: the authors' readers centre a cropped grid in 256 cells, which would shift it.
    Names and transforms, for which these files have no place, are in `export.json`. `known`, `seen` and
    `shell` are not exported.

    Args:
        release: the opened release.
        out: a new folder, or an earlier export, which is replaced.
        progress: called with (pairs done, pairs in all).

    Raises:
        SettingsError: `out` holds something else.
        ReleaseError, PairError: a pair is missing or damaged, or truth is held back.
        StorageError: the disk is full or read-only.
    """
    release.require_truth(SPLIT_NAMES)
    views = max(Counter(target.recording for target in release.targets).values(), default=0)
    rows = []
    with new_folder(out) as folder:
        for done, target in enumerate(release.targets, start=1):
            values = pair_values(release.pair_content(target), target.file)
            pair = checked_pair(Pair, values, target.file)
            files = {}
            for kind, cells in (("25d", pair.partial_256), ("3d", pair.full)):
                name = f"{target.recording}_{int(target.view)}_0_0"
                file = recgan_path(kind, target.category, target.split, views, name)
                write_below(folder / file, recgan_file_bytes(unpack(cells)))
                files[f"file_{kind}"] = file
            rows.append(pair_record(target, pair, **files))
            progress(done, len(release.targets))
        write_export_json(folder, release, {"pairs": rows})
    return len(rows)


def import_recgan(folder: Path, out: Path, progress: Progress = no_progress, views: int | None = None) -> int:
    """Write a release from a folder of the authors' layout; return the number of pairs.

    Pairs written by `kinectbench export` get their names and transforms back from export.json. For other
    files, a recording is named `<model>-<views>`, and its views are numbered in the order of the angles.

    Args:
        folder: the folder that holds `P1_<synset>_<category>/`.
        out: a new folder, or a release, which is replaced.
        progress: called with (pairs done, pairs in all).
        views: which test and validation pairs to import, by the number of views in their folder's name: 125
            have the viewing angles of the training pairs (SV in the paper), 216 have others (CV). None: all
            pairs, which is allowed only if all test pairs have the same number.

    Raises:
        SettingsError: there are no such files, or there are several numbers of views and none is chosen.
        PairError: a file or export.json is damaged; a file has another name than the layout's, lacks its
            counterpart, or is a link out of the folder.
        ReleaseError: names of models and categories contradict each other, or `out` holds something else.
        StorageError: the disk is full or read-only.
    """
    exported, root = folder / EXPORT_JSON, followed(folder)
    _refuse_link_out(exported, root)
    content = Exported.read(folder) if exported.exists() else Exported()
    if content.pairs and views is not None:
        raise SettingsError(f"{exported}: a release that was exported has its own split; leave out --views")
    pairs = (
        _exported(folder, content)
        if content.pairs
        else _one_view_set(_named_by_authors(folder), folder, views)
    )
    if not pairs:
        raise SettingsError(
            f"{folder}: no P1_<synset>_<category>/<split>_<views>_25d_vox256/*.npz there", what="no-file"
        )
    check_names([one.target for one in pairs], str(folder))
    refuse_other_content(out)
    with replaced_folder(out) as temporary:
        targets = []
        for done, one in enumerate(pairs, start=1):
            path = temporary / one.target.file
            write_below(path, pair_bytes(_pair(one, root)))
            targets.append(replace(one.target, sha256=sha256_file(path)))
            progress(done, len(pairs))
        first = pairs[0].values
        info = release_info(
            content.name or (followed(folder).name or "imported") + ("" if views is None else f"-{views}"),
            content.license,
            first.get("framing", "object"),
            first.get("partial_rule", "any"),
            {"pairs": PairSettings(min_containment=0.0).model_dump(mode="json")},
            _infos(targets),
        )
        write_small_files(info, temporary, tuple(sorted(targets)), [], TEXTS)
    return len(targets)


def _one_view_set(pairs: list[FoundPair], folder: Path, views: int | None) -> list[FoundPair]:
    """Return all training pairs, and those test and validation pairs whose recordings have `views` views.

    If `views` is None, all pairs are returned, but it is an error if test recordings differ in their number
    of views: a mean score over several sets of views would be meaningless.
    """

    def number(one: FoundPair) -> int:
        return int(one.target.recording.rpartition("-")[2])

    counts = sorted({number(one) for one in pairs if one.target.split == "test"})
    if views is None and len(counts) > 1:
        numbers = " and ".join(map(str, counts))
        raise SettingsError(
            f"{folder}: test pairs of {numbers} views, which the paper scores apart (125: the viewing angles "
            f"of training; 216: others); import each into its own release, with --views {counts[0]} for one"
        )
    if views is not None and views not in counts:
        raise SettingsError(f"{folder}: no test pairs of {views} views; there are {counts or 'none'}")
    return [one for one in pairs if views is None or one.target.split == "train" or number(one) == views]


def _exported(folder: Path, content: Exported) -> list[FoundPair]:
    pairs = []
    for row in content.pairs:
        names = {key: getattr(row, key) for key in NAMES}
        try:
            files = [below(folder, name) for name in (row.file_25d, row.file_3d)]
        except ValueError as error:
            raise PairError(f"{folder / EXPORT_JSON}: {error}; export again") from error
        values = {key: getattr(row, key) for key in (*NUMBERS, *MATRICES)}
        pairs.append(FoundPair(_target(**names), files[0], files[1], values))
    return pairs


def _named_by_authors(folder: Path) -> list[FoundPair]:
    """Return the pairs of files that are named in the authors' way, sorted by category, split and model."""
    rows = []
    for path in sorted(folder.glob("P1_*/*_25d_vox256/*.npz")):
        match = PATH.fullmatch(path.relative_to(folder).as_posix())
        if not match or not NAME.fullmatch(f"{match[5]}-{match[4]}"):
            raise PairError(f"{path}: not named <model>_<roll>_<pitch>_<yaw>.npz in a folder of the layout")
        rows.append((match[2], match[3], match[5], match[4], tuple(map(int, match.group(6, 7, 8))), path))
    counts: dict[str, int] = {}
    pairs = []
    for category, split, model, views, _, path in sorted(rows):
        recording = f"{model}-{views}"
        view = counts[recording] = counts.get(recording, -1) + 1
        target = _target(recording, model, f"{view:03d}", SYNSETS.get(category, category), SPLITS[split])
        counterpart = path.parents[1] / path.parent.name.replace("_25d_", "_3d_") / path.name
        pairs.append(FoundPair(target, path, counterpart, {}))
    return pairs


def _target(recording: str, object: str, view: str, category: str, split: str) -> Target:
    return Target(recording, object, view, category, split, f"pairs/{recording}/{view}.npz", "")


def _refuse_link_out(path: Path, root: Path) -> None:
    """Raise an error if `path` is a link out of the folder: an import would publish any file it points to."""
    if not lies_below(path, root):
        raise PairError(f"{path}: a link out of the folder; put the file itself there")


def _pair(files: FoundPair, root: Path) -> Pair:
    """Read a pair from its two files; unknown fields get default values, which the card states."""
    for path in (files.file_25d, files.file_3d):
        _refuse_link_out(path, root)
        if not path.is_file():
            raise PairError(f"{path}: missing; every file of 25d needs its counterpart of 3d")
    seen, full = read_recgan_file(files.file_25d), pack(read_recgan_file(files.file_3d))
    unknown: dict[str, Any] = {
        "T_world_grid": np.eye(4),
        "T_world_camera": np.eye(4),
        "K": np.eye(3),
        "voxel_size_m": 1 / FULL_CELLS,
        "surface_sigma_m": 0.0,
        "framing": "object",
        "partial_rule": "any",
        "occupancy_rule": "six-rays",
    }
    values = unknown | files.values
    return Pair(
        partial=pack(reduce_blocks(seen, values["partial_rule"])),
        partial_256=pack(seen),
        full=full,
        shell=packed_shell(full),
        known=np.full_like(full, 255),
        seen=pack(seen),
        **values,
    )


def _infos(targets: list[Target]) -> dict[str, RecordingInfo]:
    recordings = {target.recording: target for target in targets}
    counts = Counter(target.recording for target in targets)
    return {
        name: RecordingInfo(
            object=target.object,
            category=target.category,
            split=cast(Split, target.split),
            pairs=counts[name],
            refused=0,
            quality=QualityFile(
                verdict="unknown", warnings=("imported: nothing is known of how good it is",)
            ),
        )
        for name, target in recordings.items()
    }
