"""How often two recordings are taken for one object: those of one, and those of two of the same family.

Of each family some objects are drawn, and two simulated surfaces made of each: turned and moved anywhere,
noisy, without undersides and without a sector of 60 degrees that no camera saw. Pairs of two objects are of
one family, whose objects differ least; those of other sizes are not compared, as `triage` does not.
"""

import argparse
import sys
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1]))

from figures import Figure, arguments, at_least, at_most, run, stated

from kinectbench.core.geometry.boxes import yaw_rotation
from kinectbench.core.types import Float64
from kinectbench.core.voxels.point_cells import sample_surface
from kinectbench.lab.simulate.objects import families, make_object
from kinectbench.lab.simulate.objects.shapes import Subject
from kinectbench.release.triage.triage import LEAST_AGREEMENT, SIZES_APART, Shape, shape_agreement

SAMPLES = 12_000
# Of a surface that was fused, and less on what is small; the sector that no camera saw.
SIGMA_M, SIGMA_SHARE, HALF_SECTOR_RAD = 0.004, 0.004, np.pi / 6
THRESHOLDS = (0.7, 0.75, 0.8, 0.85, 0.9, 0.95)
LEAST_FOUND, MOST_FALSE = 0.9, 0.02


def scanned(subject: Subject, rng: np.random.Generator) -> Shape:
    """The surface of an object as a recording might give it."""
    points, normals = sample_surface(subject.mesh.vertices, subject.mesh.faces, SAMPLES, rng)
    sigma_m = min(SIGMA_M, SIGMA_SHARE * float(np.linalg.norm(np.ptp(points, axis=0))))
    away = np.arctan2(normals[:, 1], normals[:, 0]) - rng.uniform(-np.pi, np.pi)
    unseen = np.abs(np.angle(np.exp(1j * away))) < HALF_SECTOR_RAD
    measured = (normals[:, 2] > -0.5) & ~(unseen & (np.abs(normals[:, 2]) < 0.5))
    R, t = yaw_rotation(rng.uniform(0, 2 * np.pi)), [*rng.uniform(-1, 1, 2), 0.0]
    points = (points + sigma_m * rng.standard_normal(points.shape)) @ R.T + t
    return Shape.of(points[measured], points)


def size_m(subject: Subject) -> Float64:
    """The longer and the shorter side and the height of an object, metres."""
    x, y, z = np.ptp(subject.mesh.vertices, axis=0)
    return np.array([max(x, y), min(x, y), z])


def measure(options: argparse.Namespace) -> Iterator[Figure]:
    same, others, skipped = list[float](), list[float](), 0
    alike = list[tuple[float, str]]()
    for family in options.families or families():
        subjects = [make_object(family, seed) for seed in range(options.seeds)]
        shapes = [[scanned(s, np.random.default_rng([i, j])) for j in (0, 1)] for i, s in enumerate(subjects)]
        same += [shape_agreement(one, other) for one, other in shapes]
        for i, j in combinations(range(len(subjects)), 2):
            a, b = size_m(subjects[i]), size_m(subjects[j])
            if (np.abs(a - b) > SIZES_APART * np.maximum(a, b)).any():
                skipped += 1
                continue
            others.append(shape_agreement(shapes[i][0], shapes[j][1]))
            alike.append((others[-1], f"{family}: seeds {i} and {j}, {others[-1]:.2f}"))
        print(family, np.round(same[-len(subjects) :], 2), flush=True)
    false = np.array([*others, *[0.0] * skipped])
    yield stated("objects recorded twice", len(same))
    yield stated("pairs of two objects of one family", f"{len(false)}, {skipped} of other sizes")
    for least in THRESHOLDS:
        found, wrong = float(np.mean(np.array(same) >= least)), float(np.mean(false >= least))
        yield stated(f"found, and taken for one, at {least:g}", f"{found:.3f}, {wrong:.4f}")
    yield stated("most alike", [name for _, name in sorted(alike, reverse=True)[:8]])
    yield at_least(
        "objects recorded twice that are found",
        float(np.mean(np.array(same) >= LEAST_AGREEMENT)),
        LEAST_FOUND,
    )
    yield at_most("two objects taken for one", float(np.mean(false >= LEAST_AGREEMENT)), MOST_FALSE)


if __name__ == "__main__":
    parser = arguments(__doc__)
    parser.add_argument("--seeds", type=int, default=6, help="objects of each family")
    parser.add_argument("--families", nargs="*", default=[], metavar="NAME", help="only these")
    options = parser.parse_args()
    run(options, lambda: [*measure(options)])
