"""Fit a plane to points: one-point RANSAC, and robust least squares."""

import numpy as np

from kinectbench.core.types import Float64

# Number of planes that RANSAC tries.
HYPOTHESES = 400


def ransac_plane(points: Float64, normals: Float64, rng: np.random.Generator, inlier_m: float) -> Float64:
    """Return the plane (4,) with most inliers, by one-point RANSAC: each trial is a point with its normal.

    Args:
        points: (n, 3), metres.
        normals: (n, 3) unit.
        rng: draws the points to try.
        inlier_m: largest distance of an inlier from the plane.
    """
    judged = points[rng.permutation(len(points))[:20_000]]
    chosen = rng.integers(len(points), size=HYPOTHESES)
    offsets = -(points[chosen] * normals[chosen]).sum(axis=1)
    counts = [
        int((np.abs(judged @ normal + offset) < inlier_m).sum())
        for normal, offset in zip(normals[chosen], offsets, strict=True)
    ]
    best = int(np.argmax(counts))
    return np.append(normals[chosen[best]], offsets[best])


def refine(points: Float64, plane: Float64, reach_m: float, inlier_m: float) -> Float64:
    """Fit a plane (4,) to its inliers by least squares, eight times; inliers are chosen again each time.

    With fewer than ten inliers, the plane stays as it is.

    Args:
        points: (n, 3), metres.
        plane: (4,) the initial plane.
        reach_m: largest distance of an inlier in the first fit.
        inlier_m: in later fits, the largest distance is three robust standard deviations, but at least half
            and at most twice this.
    """
    for _ in range(8):
        distance_m = points @ plane[:3] + plane[3]
        inliers = points[np.abs(distance_m) < reach_m]
        if len(inliers) < 10:
            return plane
        centre = inliers.mean(axis=0)
        _, _, axes = np.linalg.svd(inliers - centre, full_matrices=False)
        normal = axes[2] * np.sign(axes[2] @ plane[:3])
        plane = np.append(normal, -normal @ centre)
        deviation_m = 1.4826 * np.median(np.abs(inliers @ plane[:3] + plane[3]))
        reach_m = float(np.clip(3 * deviation_m, 0.5 * inlier_m, 2 * inlier_m))
    return plane
