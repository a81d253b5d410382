"""How candidate boxes are stored: candidates.json, plan.png and one picture each."""

import json
from pathlib import Path
from typing import Any

from kinectbench.errors import StorageError
from kinectbench.geometry import OrientedBox
from kinectbench.segmentation.candidate_pictures import candidate_picture, plan_picture
from kinectbench.segmentation.candidates import Candidates
from kinectbench.sequence import Sequence
from kinectbench.tracking.trajectory import Trajectory
from kinectbench.workspace import pretty_json

CANDIDATES = "candidates"


def write_candidates(found: Candidates, sequence: Sequence, trajectory: Trajectory, folder: Path) -> None:
    """Write candidates.json (numbers from 1, boxes as benchmark.yaml writes them) and the pictures."""
    rows = []
    for number, candidate in enumerate(found.candidates, start=1):
        name = f"{number}.png"
        picture = candidate_picture(number, candidate, found.scene.floor, sequence, trajectory)
        (folder / name).write_bytes(picture)
        rows.append(
            {
                "number": number,
                "automatic": candidate.automatic,
                "box": box_json(candidate.box),
                "distance_m": round(candidate.distance_m, 3),
                "picture": name,
            }
        )
    (folder / "plan.png").write_bytes(plan_picture(found, trajectory))
    content = {
        "format_version": 1,
        "floor_found": found.scene.floor.found,
        "plan": "plan.png",
        "candidates": rows,
    }
    (folder / "candidates.json").write_text(pretty_json(content))


def read_candidates(folder: Path) -> dict[str, Any]:
    """The content of candidates.json.

    Raises:
        StorageError: the file is missing or damaged.
    """
    try:
        content: dict[str, Any] = json.loads((folder / "candidates.json").read_text())
    except (OSError, ValueError) as error:
        raise StorageError(
            f"{folder}: no candidates there, or damaged; `kinectbench segment --suggest --force` makes them"
        ) from error
    return content


def box_json(box: OrientedBox) -> dict[str, Any]:
    """A box as benchmark.yaml writes it: floor frame, to 1 mm and 1 mrad."""
    return {
        "center_m": [round(value, 3) for value in box.center_m],
        "size_m": [round(value, 3) for value in box.size_m],
        "yaw_rad": round(box.yaw_rad, 3),
    }


def box_line(box: dict[str, Any]) -> str:
    """The line `box: {…}` of benchmark.yaml."""
    inner = ", ".join(f"{key}: {json.dumps(value)}" for key, value in box.items())
    return f"box: {{{inner}}}"
