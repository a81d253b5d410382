"""Shared parts of all layouts: export.json, and the names of splits, categories and files."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from kinectbench._version import __version__
from kinectbench.core.artefacts.targets import Target
from kinectbench.core.errors import SettingsError
from kinectbench.core.storage import pretty_json, replaced_folder
from kinectbench.core.voxels.pair_file import Pair, PairInput
from kinectbench.release.contents import release_files
from kinectbench.release.own_folder import unknown_file
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


@contextmanager
def new_folder(out: Path, known_by: str = EXPORT_JSON) -> Iterator[Path]:
    """Yield an empty temporary folder, which replaces `out` if the `with` block succeeds.

    Args:
        out: a new or an empty folder, or one that may be replaced.
        known_by: the file that marks a folder as replaceable; default: export.json of an earlier export.

    Raises:
        SettingsError: `out` holds something else: no `known_by`, or a file that the new folder lacks.
        StorageError: the disk is full or read-only.
    """
    if out.exists() and not (out.is_dir() and ((out / known_by).is_file() or not any(out.iterdir()))):
        raise SettingsError(
            f"{out}: holds something else; choose a new or empty folder", what="other-content"
        )
    with replaced_folder(out) as folder:
        yield folder
        written = {path.relative_to(folder).as_posix() for path in release_files(folder)}
        if out.exists() and (other := unknown_file(out, written)):
            raise SettingsError(
                f"{out / other}: would be deleted; move it away, or choose a new or empty folder",
                what="other-content",
            )


def write_export_json(folder: Path, release: Release, rows: Mapping[str, object]) -> None:
    """Write export.json: the release's identity, and in `rows` facts that the exported files cannot hold."""
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
    """Return all facts of a pair except its grids as JSON values: names, `files`, numbers and matrices.

    `unknown_share`, the share of the true shape that is not known, is included if the truth is published.
    """
    row: dict[str, object] = {name: getattr(target, name) for name in NAMES} | files
    row |= {name: getattr(pair, name) for name in NUMBERS if hasattr(pair, name)}
    if isinstance(pair, Pair):
        row["unknown_share"] = pair.stated_unknown_share
    return row | {name: getattr(pair, name).tolist() for name in MATRICES}
