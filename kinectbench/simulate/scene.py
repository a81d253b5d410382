"""The room around the subject: textured floor, walls, and clutter that does not touch it.

Frame `room`: z up, floor at z = 0, the subject's origin at the room's origin.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinectbench.geometry import OrientedBox, transform_points
from kinectbench.simulate.joinery import CLOTHS, WOODS, pick
from kinectbench.simulate.solid import Mesh, Part, Solid, Vector3

Role = Literal["subject", "floor", "wall", "clutter"]

HALF_ROOM_M = 4.0
WALL_HEIGHT_M = 2.6
CLEARANCE_M = 0.6


@dataclass(frozen=True)
class Item:
    """One closed mesh of the scene and how it looks.

    Attributes:
        role: what it is to the benchmark.
        mesh: in frame `room`, metres.
        color_rgb: mean colour, each in [0, 1].
        contrast: strength of its texture in [0, 1].
        tile_m: size of tiles with dark joints, metres; 0 for none.
    """

    role: Role
    mesh: Mesh
    color_rgb: Vector3
    contrast: float
    tile_m: float = 0.0


@dataclass(frozen=True)
class Scene:
    """Everything a ray can hit, in frame `room`."""

    items: tuple[Item, ...]


def make_scene(subject: Solid, yaw_rad: float, rng: np.random.Generator) -> Scene:
    """Put a subject, turned by `yaw_rad` about z, into a room drawn by `rng`.

    Clutter keeps at least 0.6 m away from the subject and stays low, so that it hides nothing of it.
    """
    T_room_object = OrientedBox((0, 0, 0), (1, 1, 1), yaw_rad).T_floor_box
    subjects = []
    for part in subject.parts:
        mesh = part.mesh()
        turned = Mesh(transform_points(T_room_object, mesh.vertices), mesh.triangles)
        subjects.append(Item("subject", turned, part.color_rgb, 0.25))
    radius = float(np.linalg.norm(subject.mesh().vertices[:, :2], axis=1).max())
    return Scene((*subjects, *_shell(rng), *_clutter(rng, radius)))


def _shell(rng: np.random.Generator) -> list[Item]:
    """Floor and two or three walls."""
    half, thick = HALF_ROOM_M, 0.1
    tint = float(rng.uniform(0.8, 1.0))
    floor = Part("floor", "rectangle", (2 * half, 2 * half), (0, 0, -thick), (0, 0, 0))
    items = [Item("floor", floor.mesh(), (0.62 * tint, 0.55 * tint, 0.46 * tint), 0.45, 0.28)]
    first = int(rng.integers(4))
    for k in range(int(rng.integers(2, 4))):
        turn, at = (first + k) * np.pi / 2, float(rng.uniform(3.0, 3.5))
        middle = (at * float(np.cos(turn)), at * float(np.sin(turn)))
        size = (thick, 2 * half)
        wall = Part("wall", "rectangle", size, (*middle, 0.0), (*middle, WALL_HEIGHT_M), yaw_rad=turn)
        gray = float(rng.uniform(0.7, 0.85))
        items.append(Item("wall", wall.mesh(), (gray, gray, 0.92 * gray), 0.4))
    return items


def _clutter(rng: np.random.Generator, subject_radius_m: float) -> list[Item]:
    """One or two low boxes around the subject."""
    items = []
    start = float(rng.uniform(0, 2 * np.pi))
    for k in range(int(rng.integers(1, 3))):
        size = (float(rng.uniform(0.15, 0.35)), float(rng.uniform(0.15, 0.35)))
        reach = subject_radius_m + CLEARANCE_M + float(np.hypot(*size)) / 2 + float(rng.uniform(0.0, 0.3))
        turn = start + k * float(rng.uniform(1.5, 4.5))
        middle = (reach * float(np.cos(turn)), reach * float(np.sin(turn)))
        top = (*middle, float(rng.uniform(0.12, 0.3)))
        yaw = float(rng.uniform(0, np.pi))
        part = Part("clutter", "rectangle", size, (*middle, 0.0), top, yaw_rad=yaw)
        items.append(Item("clutter", part.mesh(), pick(rng, CLOTHS + WOODS), 0.5))
    return items
