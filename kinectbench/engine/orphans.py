"""Find and delete files of a stored build that no manifest names: they remain from killed runs."""

import re
import time
from collections.abc import Iterable
from functools import partial

from kinectbench.core import StorageError
from kinectbench.core.artefacts.manifest import Manifest, Timing
from kinectbench.core.store.store import Store, StoredObject, in_parallel
from kinectbench.engine.stages import STAGES, SUGGEST
from kinectbench.engine.stored_stage import ARCHIVE, files_folder

# Younger files may belong to a current run on a machine whose clock is wrong by hours.
YOUNG_S = 86_400.0

_STAGES = "|".join(re.escape(stage.name) for stage in (*STAGES, SUGGEST))
_ARTEFACT = re.compile(rf"(build/[^/]+/(?:{_STAGES})/[0-9a-f]{{64}})/(.+)")


def find_orphans(store: Store, *, young: bool = False) -> list[StoredObject]:
    """List files in artefacts' folders that no manifest names; without a manifest, all files of the folder.

    Only folders of artefacts are searched: recordings, releases and other files must stay.

    Args:
        store: store of the benchmark's root.
        young: whether to include folders with files younger than a day, which a run may still be writing.

    Raises:
        StorageError: a manifest is damaged, or the store fails.
    """
    folders: dict[str, list[StoredObject]] = {}
    for each in store.objects("build"):
        if match := _ARTEFACT.fullmatch(each.name):
            folders.setdefault(match[1], []).append(each)
    now = time.time()
    by_folder = in_parallel(partial(_orphans_of, store, folder, files) for folder, files in folders.items())
    return [
        each
        for files in by_folder
        for each in files
        if young or all(now - other.modified_s > YOUNG_S for other in files)
    ]


def remove_orphans(store: Store, orphans: Iterable[StoredObject]) -> int:
    """Delete files that `find_orphans` found, unless a manifest names them by now; return their number."""
    folders: dict[str, list[StoredObject]] = {}
    for each in orphans:
        match = _ARTEFACT.fullmatch(each.name)
        assert match, "only files of artefacts are found"
        folders.setdefault(match[1], []).append(each)
    return sum(
        in_parallel(partial(_remove_orphans_of, store, folder, files) for folder, files in folders.items())
    )


def _remove_orphans_of(store: Store, folder: str, files: list[StoredObject]) -> int:
    still = {each.name for each in _orphans_of(store, folder, store.objects(folder))}
    names = [each.name for each in files if each.name in still]
    store.delete(names)
    return len(names)


def _orphans_of(store: Store, folder: str, files: list[StoredObject]) -> list[StoredObject]:
    """Return the files of a folder that its manifest does not name; without a manifest, all its files."""
    place = f"{folder}/{Manifest.FILE}"
    if not any(each.name == place for each in files):
        return files
    manifest = Manifest.parse(store.read(place).decode("utf-8", errors="replace"), store.place(place))
    if manifest.fingerprint != folder.rpartition("/")[2]:
        raise StorageError(
            f"{store.place(place)}: is of another artefact; look at it before anything is removed",
            what="other-content",
        )
    data = files_folder(folder, manifest)
    names = {place, *(f"{data}/{name}" for name in (*manifest.files, Timing.FILE, ARCHIVE))}
    return [each for each in files if each.name not in names]
