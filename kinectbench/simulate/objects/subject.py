"""What is recorded: an object as a watertight mesh, and the coloured pieces it is drawn with."""

from dataclasses import dataclass

from kinectbench.geometry import TriangleMesh

Vector3 = tuple[float, float, float]


@dataclass(frozen=True)
class Piece:
    """A part of an object with one look.

    Attributes:
        name: what it is, such as "leg".
        mesh: triangles, object frame, metres; pieces may overlap, and need not be closed.
        color_rgb: its colour, each in [0, 1].
        albedo: share of infrared light that it reflects, in [0, 1]; dark pieces give less depth.
    """

    name: str
    mesh: TriangleMesh
    color_rgb: Vector3
    albedo: float = 0.6


@dataclass(frozen=True)
class Subject:
    """The object of a simulated recording, in frame `object`: z up, on z = 0, centred at x = y = 0.

    Attributes:
        name: such as "chair:seed=3", or a mesh file's name.
        pieces: what a camera sees.
        mesh: the solid's surface: watertight, outward, without inner faces; metres.
        origin: where the solid comes from and how it was closed, one line.
    """

    name: str
    pieces: tuple[Piece, ...]
    mesh: TriangleMesh
    origin: str
