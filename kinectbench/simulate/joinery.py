"""Pieces that several families of furniture share: boards, legs, pedestals, rails, colours."""

import numpy as np

from kinectbench.simulate.solid import Outline, Part, Vector3

WOODS: tuple[Vector3, ...] = (
    (0.72, 0.53, 0.34),
    (0.50, 0.33, 0.20),
    (0.82, 0.69, 0.50),
    (0.33, 0.22, 0.16),
    (0.86, 0.85, 0.82),
    (0.25, 0.26, 0.28),
)
CLOTHS: tuple[Vector3, ...] = (
    (0.62, 0.16, 0.15),
    (0.18, 0.32, 0.55),
    (0.25, 0.45, 0.28),
    (0.75, 0.58, 0.20),
    (0.45, 0.43, 0.42),
)


def pick(rng: np.random.Generator, colors: tuple[Vector3, ...]) -> Vector3:
    """One of the colours."""
    return colors[int(rng.integers(len(colors)))]


def board(
    name: str,
    low_m: Vector3,
    high_m: Vector3,
    color_rgb: Vector3,
    outline: Outline = "rectangle",
    lean_m: float = 0.0,
) -> Part:
    """A plate between two corners (object frame, metres) whose top is moved by `lean_m` towards -y."""
    x, y = (low_m[0] + high_m[0]) / 2, (low_m[1] + high_m[1]) / 2
    size = (high_m[0] - low_m[0], high_m[1] - low_m[1])
    return Part(name, outline, size, (x, y, low_m[2]), (x, y - lean_m, high_m[2]), color_rgb=color_rgb)


def four_legs(
    rng: np.random.Generator, half_m: tuple[float, float], height_m: float, thick_m: float, color_rgb: Vector3
) -> list[Part]:
    """Four legs, square or round, perhaps splayed and tapered, perhaps joined by stretchers.

    Args:
        rng: draws splay, taper and stretchers.
        half_m: x and y of a leg's centre at the top, metres.
        height_m: height of the legs, metres.
        thick_m: thickness at the top, metres; the foot is never below 25 mm.
        color_rgb: colour.
    """
    outline: Outline = "ellipse" if rng.random() < 0.4 else "rectangle"
    splay = float(rng.uniform(0.0, 0.06)) if rng.random() < 0.5 else 0.0
    foot = max(0.025, thick_m * float(rng.uniform(0.65, 1.0)))
    corners = [(sx, sy) for sx in (-1, 1) for sy in (-1, 1)]
    legs = [
        Part(
            "leg",
            outline,
            (foot, foot),
            (sx * (half_m[0] + splay), sy * (half_m[1] + splay), 0.0),
            (sx * half_m[0], sy * half_m[1], height_m),
            thick_m / foot,
            color_rgb=color_rgb,
        )
        for sx, sy in corners
    ]
    if rng.random() < 0.45:
        z = height_m * float(rng.uniform(0.25, 0.5))
        out = splay * (1 - z / height_m)
        x, y, half = half_m[0] + out, half_m[1] + out, 0.0125
        for s in (-1, 1):
            legs.append(
                board("stretcher", (s * x - half, -y, z - 0.015), (s * x + half, y, z + 0.015), color_rgb)
            )
        legs.append(board("stretcher", (-x, -half, z - 0.015), (x, half, z + 0.015), color_rgb))
    return legs


def pedestal(
    rng: np.random.Generator, reach_m: float, height_m: float, thick_m: float, color_rgb: Vector3
) -> list[Part]:
    """A column on a round plate or on a star of four or five feet.

    Args:
        rng: chooses the base.
        reach_m: radius of the base, metres.
        height_m: height of the column's top, metres.
        thick_m: diameter of the column, metres.
        color_rgb: colour.
    """
    column = Part(
        "column", "ellipse", (thick_m, thick_m), (0.0, 0.0, 0.0), (0.0, 0.0, height_m), color_rgb=color_rgb
    )
    if rng.random() < 0.5:
        size = (2 * reach_m, 2 * reach_m)
        plate = Part("base", "ellipse", size, (0, 0, 0), (0, 0, 0.04), 0.9, color_rgb=color_rgb)
        return [column, plate]
    count, start, width = int(rng.integers(4, 6)), float(rng.uniform(0, np.pi)), 0.055
    feet = []
    for k in range(count):
        yaw = start + k * 2 * np.pi / count
        middle = (reach_m / 2 * float(np.cos(yaw)), reach_m / 2 * float(np.sin(yaw)))
        feet.append(
            Part(
                "foot",
                "rectangle",
                (reach_m, width),
                (*middle, 0.0),
                (*middle, 0.05),
                yaw_rad=yaw,
                color_rgb=color_rgb,
            )
        )
    return [column, *feet]
