"""Materials of objects: woods, cloths, leathers, plastics, metals and stones."""

from dataclasses import dataclass

from kinectbench.lab.simulate.objects.shapes import Vector3


@dataclass(frozen=True)
class Look:
    """Colour and infrared albedo of a material.

    Attributes:
        color_rgb: red, green and blue, each in [0, 1].
        albedo: reflected share of infrared light, in [0, 1].
    """

    color_rgb: Vector3
    albedo: float


# Colours and infrared albedos are chosen: dyes and varnish take little infrared light, black pigment
# takes most.
BLACK_STEEL = Look((0.09, 0.09, 0.10), 0.07)
WOODS = (
    Look((0.76, 0.60, 0.40), 0.72),
    Look((0.62, 0.43, 0.26), 0.65),
    Look((0.45, 0.28, 0.17), 0.55),
    Look((0.84, 0.72, 0.53), 0.78),
    Look((0.55, 0.29, 0.17), 0.58),
    Look((0.27, 0.18, 0.13), 0.42),
    Look((0.88, 0.87, 0.84), 0.80),
    Look((0.12, 0.11, 0.11), 0.12),
)
CLOTHS = (
    Look((0.62, 0.17, 0.16), 0.66),
    Look((0.19, 0.31, 0.52), 0.58),
    Look((0.27, 0.44, 0.30), 0.60),
    Look((0.78, 0.60, 0.22), 0.72),
    Look((0.50, 0.49, 0.47), 0.62),
    Look((0.78, 0.73, 0.65), 0.78),
    Look((0.28, 0.29, 0.31), 0.45),
    Look((0.58, 0.42, 0.50), 0.64),
)
LEATHERS = (
    Look((0.47, 0.26, 0.14), 0.55),
    Look((0.70, 0.48, 0.30), 0.62),
    Look((0.08, 0.08, 0.08), 0.06),
    Look((0.80, 0.76, 0.70), 0.70),
)
COVERS = CLOTHS + LEATHERS
PLASTICS = (
    Look((0.90, 0.90, 0.88), 0.80),
    Look((0.76, 0.20, 0.16), 0.68),
    Look((0.90, 0.70, 0.18), 0.74),
    Look((0.22, 0.52, 0.54), 0.62),
    Look((0.46, 0.54, 0.36), 0.62),
    Look((0.12, 0.12, 0.13), 0.10),
)
METALS = (
    Look((0.66, 0.67, 0.69), 0.50),
    Look((0.86, 0.86, 0.85), 0.76),
    BLACK_STEEL,
    Look((0.40, 0.41, 0.43), 0.45),
)
IRONS = (BLACK_STEEL, Look((0.16, 0.27, 0.21), 0.40), Look((0.40, 0.41, 0.43), 0.45))
STONES = (Look((0.66, 0.65, 0.62), 0.62), Look((0.52, 0.48, 0.45), 0.52))
