"""Shared parts of all layouts: export.json, and the names of splits, categories and files."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar

from kinectbench._version import __version__
from kinectbench.core import (
    KinectBenchError,
    PairError,
    SettingsError,
    pretty_json,
    replaced_folder,
    sha256_text,
)
from kinectbench.core.artefacts.stored import Stored
from kinectbench.core.artefacts.targets import Target
from kinectbench.core.voxels.pair_file import Pair, PairInput
from kinectbench.release.contents import release_files
from kinectbench.release.own_folder import is_ignored
from kinectbench.release.release import Release

EXPORT_JSON = "export.json"
# ShapeNet synsets of the paper's categories; ShapeNet's sofa is the paper's couch.
SYNSETS = {
    "02828884": "bench",
    "03001627": "chair",
    "04256520": "couch",
    "04379243": "table",
    "02958343": "car",
    "03325088": "faucet",
    "04090263": "firearm",
    "03467517": "guitar",
    "03211117": "monitor",
    "02691156": "plane",
}
NO_SYNSET = "00000000"
# Columns that name a pair, and its values that are no grids.
NAMES = ("recording", "object", "view", "category", "split")
NUMBERS = ("voxel_size_m", "surface_sigma_m", "framing", "partial_rule", "occupancy_rule")
MATRICES = ("T_world_grid", "T_world_camera", "K")
# Split -> its name in BOP and in the paper authors' files.
SPLIT_NAMES = {"train": "train", "validation": "val", "test": "test"}


class ExportFile(Stored):
    """The keys of export.json that are read before an earlier export is replaced."""

    FILE: ClassVar[str] = EXPORT_JSON
    ERROR: ClassVar[type[KinectBenchError]] = PairError
    ADVICE: ClassVar[str] = "choose a new or empty folder"

    files_sha256: str | None = None


def names_sha256(folder: Path, but: str = EXPORT_JSON) -> str:
    """Return the SHA-256 of the sorted names of all files in a folder, one name per line.

    The file `but`, locks, unfinished downloads and the files of file managers are left out.
    """
    files = (path for path in release_files(folder) if not is_ignored(path.name))
    names = {path.relative_to(folder).as_posix() for path in files}
    return sha256_text("\n".join(map(ascii, sorted(names - {but}))))


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """Yield an empty temporary folder, which replaces `out` if the `with` block succeeds.

    The block must write export.json. A hash over the names of all files is then added to it. A later export
    reads this hash to check that `out` holds nothing but the earlier export.

    Args:
        out: a new or an empty folder, or an earlier export.

    Raises:
        SettingsError: `out` holds something else.
        PairError: `out` holds a damaged export.json.
        StorageError: the disk is full or read-only.
    """
    earlier = ExportFile.read_if_there(out) if out.is_dir() else None
    refuse_others(out, earlier.files_sha256 if earlier else None, EXPORT_JSON)
    with replaced_folder(out) as folder:
        yield folder
        export = ExportFile.read(folder)
        export.model_copy(update={"files_sha256": names_sha256(folder)}).write(folder)


def refuse_others(out: Path, written_sha256: str | None, stated_in: str) -> None:
    """Raise an error if files were added to or removed from an output folder since it was written.

    A missing or empty folder gives no error.

    Args:
        out: the folder.
        written_sha256: its `names_sha256` when it was written; None (not known) counts as a difference.
        stated_in: name of the file that states this hash; the hash does not include this name.

    Raises:
        SettingsError: the folder holds something else.
    """
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    if not out.is_dir() or written_sha256 is None or written_sha256 != names_sha256(out, stated_in):
        raise SettingsError(
            f"{out}: holds something else, or the output of an earlier version; choose a new or empty folder",
            what="other-content",
        )


def write_export_json(folder: Path, release: Release, rows: Mapping[str, object]) -> None:
    """Write export.json: the release's identity, and `rows`: facts that the exported files cannot hold."""
    content = {
        "format_version": 1,
        "package_version": __version__,
        "benchmark_sha256": release.benchmark_sha256,
        "name": release.metadata.name,
        "license": release.metadata.license,
    }
    (folder / EXPORT_JSON).write_text(pretty_json(content | dict(rows)), encoding="utf-8")


def synset_of(category: str) -> str:
    """Return the ShapeNet synset id of a category; "00000000" for categories outside the paper."""
    return next((synset for synset, name in SYNSETS.items() if name == category), NO_SYNSET)


def recgan_path(kind: str, category: str, split: str, views: int, name: str) -> str:
    """Return `P1_<synset>_<category>/<split>_<views>_<kind>_vox256/<name>.npz`.

    Args:
        kind: "25d" (the visible part) or "3d" (the full shape).
        category: such as "chair".
        split: "train", "validation" (in the path: "val") or "test".
        views: number of views, as in the folder's name.
        name: `<model>_<roll>_<pitch>_<yaw>`.
    """
    group = f"{SPLIT_NAMES[split]}_{views}_{kind}_vox256"
    return f"P1_{synset_of(category)}_{category}/{group}/{name}.npz"


def pair_record(target: Target, pair: Pair | PairInput, **files: str) -> dict[str, object]:
    """Return a pair as JSON values without its grids: names, `files`, numbers and matrices.

    If the truth is published, `unknown_share`, the share of the true shape that is not known, is included.
    """
    row: dict[str, object] = {name: getattr(target, name) for name in NAMES} | files
    row |= {name: getattr(pair, name) for name in NUMBERS if hasattr(pair, name)}
    if isinstance(pair, Pair):
        row["unknown_share"] = pair.stated_unknown_share
    return row | {name: getattr(pair, name).tolist() for name in MATRICES}
