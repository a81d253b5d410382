"""Check facts that a recording's files state twice: the frames of its views, and the plane of its floor."""

from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress

import numpy as np

from kinectbench.core import ReleaseError, StorageError, printable
from kinectbench.core.artefacts.benchmark import ReleaseInfo
from kinectbench.core.artefacts.object import FloorFile
from kinectbench.core.artefacts.provenance import LINEAGE_JSON, Lineage, LineageRecording
from kinectbench.core.artefacts.views import ViewsFile
from kinectbench.core.geometry import ORTHONORMAL_TOLERANCE, is_rigid
from kinectbench.release.contents import Contents


def frame_problems(contents: Contents, metadata: ReleaseInfo, whole: Collection[str]) -> Iterator[str]:
    """Yield a message for each view with another frame or timestamp in views.json than in lineage.json."""
    recordings: Mapping[str, LineageRecording] = {}
    with suppress(ReleaseError, StorageError):  # reported as not of its schema
        if LINEAGE_JSON in whole:
            recordings = Lineage.parse(contents.text(LINEAGE_JSON), LINEAGE_JSON).recordings
    for name in metadata.recordings:
        file = f"views/{name}/{ViewsFile.FILE}"
        of_lineage = recordings[name].views if name in recordings else None
        if of_lineage is None or file not in whole:
            continue
        with suppress(ReleaseError, StorageError):  # reported as not of its schema
            rows = {row.view: row for row in ViewsFile.parse(contents.text(file), file).views}
            for view in of_lineage:
                row = rows.get(view.view)
                if row is not None and (row.frame, row.stamp_ns) != (view.frame, view.stamp_ns):
                    yield f"{file}: another frame or stamp of {printable(view.view)} than in {LINEAGE_JSON}"


def floor_problems(contents: Contents, metadata: ReleaseInfo, whole: Collection[str]) -> Iterator[str]:
    """Yield a message for each floor.json with a `plane_world` that is not z = 0 of its `T_floor_world`."""
    for name in metadata.recordings:
        file = f"objects/{name}/{FloorFile.FILE}"
        with suppress(ReleaseError, StorageError):  # reported as not of its schema
            floor = FloorFile.parse(contents.text(file), file) if file in whole else None
            if floor is None or not is_rigid(floor.T_floor_world):
                continue
            if not np.allclose(floor.T_floor_world[2], floor.plane_world, atol=ORTHONORMAL_TOLERANCE):
                yield f"{file}: plane_world is not z = 0 of T_floor_world"
