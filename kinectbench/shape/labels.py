"""What is known about a voxel. Stored as uint8 in object/volume.npz and object/surround.npz."""

from enum import IntEnum


class Label(IntEnum):
    """The five labels; all but UNKNOWN count as known."""

    FREE = 0
    """Seen through: empty."""
    OTHER = 1
    """Not the object: observed, but floor, neighbour, outside a given box, or below the floor; or never seen
    and inferred to be empty (a hollow behind an apron, a shadow under the object)."""
    SURFACE = 2
    """Measured on the object: occupied."""
    INTERIOR = 3
    """Enclosed by its surface: occupied."""
    UNKNOWN = 4
    """Never in a frustum, or never decided: occupied by probability, not trusted."""
