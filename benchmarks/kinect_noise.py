"""The simulated Kinect on planes against the published figures: a table with bars, and a plot.

Sources: Nguyen et al. 2012 (axial noise, eq. 3 and 4; lateral noise, eq. 1), Khoshelham & Elberink 2012
(random error and steps of depth). Correlations of neighbouring errors are held against those of real planes:
24x24 pixels of 7-Scenes' red kitchen at 1-2.5 m, each with a plane fitted, every fifteenth of frames 0-149.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from figures import Figure, arguments, at_least, at_most, run, told

from kinectbench.core.geometry import Camera, OrientedBox
from kinectbench.core.geometry.mesh import box_mesh
from kinectbench.lab.simulate.kinect import (
    KinectNoise,
    draw_device,
    measure,
)
from kinectbench.lab.simulate.render import TEXTURE_PX, Renderer, Rendering
from kinectbench.lab.simulate.scene import Item

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "support"))
from references import axial_sigma_m, depth_step_m

from kinectbench.core.types import Float64

CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
DEPTHS_M = np.arange(0.6, 4.01, 0.2)
TILTS_RAD = np.radians([0.0, 15.0, 30.0, 45.0, 60.0, 65.0, 70.0])
TILTED_AT_M = 1.5
PHASES = 4
TEXTURE = np.zeros((TEXTURE_PX, TEXTURE_PX), np.float32)
LAGS_PX = (1, 2, 3, 5)
REAL_CORRELATIONS = (0.55, 0.40, 0.26, 0.07)
PATCH_PX = 24
# Khoshelham & Elberink 2012: sigma = 1.425e-5 z² in centimetres.
KHOSHELHAM_PER_M = 1.425e-3


def plane(depth_m: float, tilt_rad: float) -> Rendering:
    """A grey plane through the axis at a depth, turned about the image's vertical, rendered."""
    size = (60.0, 0.001, 60.0)
    wall = box_mesh(OrientedBox((0.0, 0.0, 0.0), size, tilt_rad))
    # The camera looks along the room's y, its right is the room's x.
    T_room_camera = np.array(
        [[1.0, 0, 0, 0], [0, 0, 1, -depth_m - 0.0005 / np.cos(tilt_rad)], [0, -1, 0, 0], [0, 0, 0, 1]]
    )
    return Renderer([Item("wall", wall, (0.5, 0.5, 0.5), 0.0)], TEXTURE).render(CAMERA, T_room_camera)


def errors_m(rendering: Rendering, distortion: float = 0.0, seed: int = 0) -> Float64:
    """Measured minus exact depth (height, width), metres; NaN = no measurement."""
    device = draw_device(CAMERA, distortion, 0.0, np.random.default_rng(seed))
    measured_m = measure(rendering, CAMERA, device, np.random.default_rng(seed + 1)).astype(np.float64)
    return np.where(measured_m > 0, measured_m - rendering.depth_m, np.nan)


def sigma_over_published(depth_m: float, tilt_rad: float) -> tuple[float, float]:
    """Standard deviation of depth in the middle of the image in metres, and its ratio to Nguyen's.

    Frames over a step of the disparity, so that rounding meets every phase.
    """
    middle = np.s_[200:280, 280:360]
    step_m = float(depth_step_m(np.array(depth_m), KinectNoise()))
    ratios, deviations = [], []
    for seed, offset in enumerate((np.arange(PHASES) + 0.5) / PHASES - 0.5):
        rendering = plane(depth_m + offset * step_m, tilt_rad)
        error_m = errors_m(rendering, seed=10 * seed)[middle]
        incidence = np.arccos(rendering.cos_incidence[middle].astype(np.float64))
        published_m = axial_sigma_m(rendering.depth_m[middle].astype(np.float64), incidence)
        ratios.append(error_m / published_m)
        deviations.append(error_m)
    return float(np.sqrt(np.nanmean(np.square(deviations)))), float(np.sqrt(np.nanmean(np.square(ratios))))


def correlations(error_m: Float64) -> list[float]:
    """Of errors `LAGS_PX` apart along rows, within patches that a plane is fitted to."""
    v, u = np.mgrid[:PATCH_PX, :PATCH_PX]
    basis = np.linalg.qr(np.stack([u.ravel(), v.ravel(), np.ones(u.size)], axis=1).astype(np.float64))[0]
    found = []
    for top in range(0, CAMERA.height - PATCH_PX, PATCH_PX):
        for left in range(0, CAMERA.width - PATCH_PX, PATCH_PX):
            patch = error_m[top : top + PATCH_PX, left : left + PATCH_PX].ravel()
            if np.isfinite(patch).all():
                rest = (patch - basis @ (basis.T @ patch)).reshape(PATCH_PX, PATCH_PX)
                found.append([np.mean(rest[:, :-k] * rest[:, k:]) / rest.var() for k in LAGS_PX])
    return [float(value) for value in np.mean(found, axis=0)]


def lateral_px(seed: int) -> float:
    """Standard deviation of the place of a near plane's right edge over the rows, pixels."""
    near, far = plane(1.0, 0.0), plane(1.3, 0.0)
    depth_m = far.depth_m.copy()
    depth_m[:, :320] = near.depth_m[:, :320]
    device = draw_device(CAMERA, 0.0, 0.0, np.random.default_rng(0))
    measured_m = measure(near._replace(depth_m=depth_m), CAMERA, device, np.random.default_rng(seed))
    columns = np.arange(300, 340)
    part = measured_m[:, columns]
    last_near = np.max(np.where((part > 0) & (part < 1.08), columns, 0), axis=1)
    first_far = np.min(np.where(part > 1.2, columns, 999), axis=1)
    return float(np.std((last_near + first_far) / 2))


def measure_all(options: argparse.Namespace) -> Sequence[Figure]:
    """Every figure; the plot goes to `options.out`."""
    by_depth = np.array([sigma_over_published(float(z), 0.0) for z in DEPTHS_M])
    by_tilt = np.array([sigma_over_published(TILTED_AT_M, float(tilt)) for tilt in TILTS_RAD])
    found = np.mean(
        [correlations(errors_m(plane(z, 0.3), seed=int(10 * z))) for z in (1.2, 1.7, 2.2)], axis=0
    )
    lateral = float(np.mean([lateral_px(seed) for seed in range(5)]))
    values_m = np.unique(errors_m(plane(2.0, 0.0)) + plane(2.0, 0.0).depth_m)
    step_ratio = np.median(np.diff(values_m[np.isfinite(values_m)])) / depth_step_m(
        np.array(2.0), KinectNoise()
    )
    maps = [draw_device(CAMERA, 1.0, 0.0, np.random.default_rng(s)).distortion_px for s in range(5)]
    warp_share = float(np.mean([np.sqrt(np.mean(m**2)) for m in maps])) * 4.0 / (580 * 0.075)
    draw_plot(options.out, by_depth, by_tilt, found)
    return [
        told(
            "axial noise, measured, mm at " + ", ".join(f"{z:.1f}" for z in DEPTHS_M[::4]) + " m",
            [round(float(s) * 1000, 2) for s in by_depth[::4, 0]],
        ),
        at_least("axial noise / Nguyen 2012, 0.6-4 m, least", float(by_depth[:, 1].min()), 0.93),
        at_most("axial noise / Nguyen 2012, 0.6-4 m, most", float(by_depth[:, 1].max()), 1.07),
        at_least("axial noise / Nguyen 2012, tilts 0-70 degrees, least", float(by_tilt[:, 1].min()), 0.9),
        at_most("axial noise / Nguyen 2012, tilts 0-70 degrees, most", float(by_tilt[:, 1].max()), 1.1),
        at_least("lateral noise / Nguyen 2012 (0.8 px)", lateral / 0.8, 0.8),
        at_most("lateral noise / Nguyen 2012 (0.8 px)", lateral / 0.8, 1.2),
        at_most("step of depth at 2 m / Khoshelham 2012, off from 1", abs(float(step_ratio) - 1), 0.03),
        told(f"correlation at {LAGS_PX} px", [round(float(c), 3) for c in found]),
        at_most(
            "correlation, largest difference from real planes",
            float(np.abs(found - REAL_CORRELATIONS).max()),
            0.08,
        ),
        told("depth distortion at 4 m, root mean square / depth", warp_share),
    ]


def draw_plot(path: Path, by_depth: Float64, by_tilt: Float64, found: Float64) -> None:
    """Measured points over published curves: over depth, over tilt, and correlation over distance."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(15, 4.5), layout="constrained")
    z = np.linspace(0.5, 4.1, 200)
    left.plot(z, axial_sigma_m(z, np.zeros_like(z)) * 1000, label="Nguyen et al. 2012, eq. 3")
    left.plot(z, KHOSHELHAM_PER_M * z**2 * 1000, "--", label="Khoshelham & Elberink 2012")
    left.plot(DEPTHS_M, by_depth[:, 0] * 1000, "k.", label="simulated planes")
    left.set(xlabel="depth, m", ylabel="standard deviation, mm", title="facing planes")
    tilt = np.linspace(0, np.radians(72), 200)
    published_m = axial_sigma_m(np.full_like(tilt, TILTED_AT_M), tilt)
    middle.plot(np.degrees(tilt), published_m * 1000, label="Nguyen et al. 2012, eq. 4")
    middle.plot(np.degrees(TILTS_RAD), by_tilt[:, 0] * 1000, "k.", label="simulated planes")
    middle.set(xlabel="tilt, degrees", ylabel="standard deviation, mm", title=f"planes at {TILTED_AT_M} m")
    right.plot(LAGS_PX, REAL_CORRELATIONS, "o-", label="7-Scenes, red kitchen")
    right.plot(LAGS_PX, found, "k.", label="simulated planes")
    right.set(xlabel="distance, pixels", ylabel="correlation", title="errors of neighbours", ylim=(0, 1))
    for axes in (left, middle, right):
        axes.legend()
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    parser = arguments(__doc__)
    parser.add_argument("--out", type=Path, default=Path("kinect_noise.png"), help="the plot")
    chosen = parser.parse_args()
    run(chosen, lambda: measure_all(chosen))
