"""Kernels of the Kinect: what the projector reaches, and what the sensor makes of each pixel."""

import numba
import numpy as np

# Beyond 85 degrees nothing is measured; the limit keeps the formulas finite there.
STEEPEST_COS = np.float32(0.0872)
SHADOW_DEPTH = np.float32(0.02)


@numba.njit(cache=True, error_model="numpy")
def projector_lit(depth_m, shift_px_m):  # type: ignore[no-untyped-def]
    """Which pixels the projector reaches, by a depth buffer along its own columns (exact but for rounding).

    The projector stands beside the camera in +x. So a point at column u of the camera lies at column
    u - f b / z of the projector, in the same row; the shadow falls to the left of what casts it.

    Args:
        depth_m: (height, width) float32, metres, 0 = nothing there.
        shift_px_m: focal length of the image times baseline, pixel metres.

    Returns:
        bool (height, width); false where there is no depth.
    """
    height, width = depth_m.shape
    lit = np.zeros((height, width), np.bool_)
    column, near = np.empty(width, np.float32), np.empty(width, np.float32)
    nearest = np.empty(2 * width, np.float32)
    for v in range(height):
        nearest[:] = 0
        for u in range(width):
            z = depth_m[v, u]
            near[u] = np.float32(1) / z if z > 0 else np.float32(0)
            # Columns count from one image's width to the left; still farther left is nothing of interest.
            column[u] = max(np.float32(width + u) - np.float32(shift_px_m) * near[u], np.float32(0))
        for u in range(width):
            first = last = int(column[u] + np.float32(0.5))
            # A surface goes on to the next pixel, which the projector may see several columns away.
            if u + 1 < width and abs(near[u + 1] - near[u]) < SHADOW_DEPTH * near[u]:
                last = max(first, int(column[u + 1] + np.float32(0.5)))
            for k in range(first, last + 1):
                nearest[k] = max(nearest[k], near[u])
        for u in range(width):
            ahead = nearest[int(column[u] + np.float32(0.5))]
            lit[v, u] = near[u] > 0 and ahead <= near[u] * (np.float32(1) + SHADOW_DEPTH)
    return lit


@numba.njit(cache=True, error_model="numpy")
def displace(seen_m, around_m, right, down, cosine, noise):  # type: ignore[no-untyped-def]
    """Which pixel's surface is measured in each pixel: its own, or across an edge one drawn nearby.

    Args:
        seen_m: (height, width) float32, metres, 0 where the sensor sees nothing.
        around_m: smallest and largest of them in 5x5 pixels, as far as a pixel is displaced.
        right: normal variates at half the resolution; they move it to the right.
        down: downwards.
        cosine: (height, width) float32, of incidence.
        noise: `KinectNoise`.

    Returns:
        (height, width) int32, index into the flat image.
    """
    height, width = seen_m.shape
    source = np.empty((height, width), np.int32)
    for v in range(height):
        for u in range(width):
            source[v, u] = v * width + u
            own = seen_m[v, u]
            if around_m[1][v, u] <= around_m[0][v, u] * (1 + noise.same_surface):
                continue
            sigma_px = _lateral_sigma_px(cosine[v, u])
            x = min(max(u + int(np.rint(sigma_px * right[v // 2, u // 2])), 0), width - 1)
            y = min(max(v + int(np.rint(sigma_px * down[v // 2, u // 2])), 0), height - 1)
            if abs(seen_m[y, x] - own) > noise.same_surface * own:
                source[v, u] = y * width + x
    return source


@numba.njit(cache=True, error_model="numpy")
def sense(seen_m, around_m, source, surface, device, drawn):  # type: ignore[no-untyped-def]
    """Depth as reported, (height, width) float32 metres, 0 = no measurement; see `kinect.measure`.

    Args:
        seen_m: (height, width) float32, metres, 0 where the sensor sees nothing.
        around_m: smallest and largest of them in 3x3 pixels.
        source: of `displace`.
        surface: cosine of incidence and albedo, both (height, width) float32.
        device: `KinectNoise`, distortion of disparity in pixels (height, width) float32, and sunlight.
        drawn: normal variates, float32: of depth, (height, width), and at half the resolution of the
            strength that is needed.
    """
    noise, distortion_px, sunlight = device
    axial, weak = drawn
    flat_m, cosines, albedos = seen_m.ravel(), surface[0].ravel(), surface[1].ravel()
    height, width = seen_m.shape
    reported = np.zeros((height, width), np.float32)
    scale = np.float32(noise.focal_px * noise.baseline_m)
    for v in range(height):
        for u in range(width - int(noise.blind_share * width + 0.5)):
            low, high = around_m[0][v, u], around_m[1][v, u]
            z, needed = flat_m[source[v, u]], weak[v // 2, u // 2]
            if z < noise.min_range_m or z > noise.max_range_m:
                continue
            at_edge = high > low * np.float32(1 + noise.same_surface)
            cosine = max(cosines[source[v, u]], STEEPEST_COS)
            margin = _margin(z, cosine, albedos[source[v, u]], noise, np.float32(sunlight))
            if needed > (min(margin, noise.edge_margin) if at_edge else margin):
                continue
            if at_edge and low > 0 and needed > noise.edge_margin - noise.edge_mix:
                z = 2 / (1 / low + 1 / high)
            steps_per_px = scale * np.float32(noise.steps_per_px)
            off = np.float32(1) / (np.float32(1) / z + distortion_px[v, u] / scale)
            noisy = off + _drawn_sigma_m(z, cosine, steps_per_px) * axial[v, u]
            steps = max(np.rint(steps_per_px / max(noisy, np.float32(0.1))), np.float32(1))
            if steps_per_px <= noise.max_range_m * steps:
                reported[v, u] = steps_per_px / steps
    return reported


@numba.njit(cache=True, error_model="numpy")
def _lateral_sigma_px(cosine):  # type: ignore[no-untyped-def]
    """`kinect.lateral_sigma_px` from the cosine of incidence."""
    angle = np.arccos(max(cosine, STEEPEST_COS))
    return 0.8 + 0.035 * angle / (np.pi / 2 - angle)


@numba.njit(cache=True, error_model="numpy")
def _drawn_sigma_m(z, cosine, scale):  # type: ignore[no-untyped-def]
    """`kinect.axial_sigma_m` without the variance of rounding to 1 / `scale` of inverse depth."""
    sigma = np.float32(0.0012) + np.float32(0.0019) * (z - np.float32(0.4)) ** 2
    if cosine < np.float32(0.5):
        angle = np.arccos(cosine)
        sigma += np.float32(0.0001) / np.sqrt(z) * (angle / (np.float32(np.pi / 2) - angle)) ** 2
    return np.sqrt(max(sigma**2 - (z * z / scale) ** 2 / np.float32(12), np.float32(0)))


@numba.njit(cache=True, error_model="numpy")
def _margin(z, cosine, albedo, noise, sunlight):  # type: ignore[no-untyped-def]
    """How strong the pattern is, in standard deviations of what is needed.

    Its light on the surface falls as cos / z², the camera gets the albedo's share of it. The sun's light,
    which gets the same share, drowns it.
    """
    drowned = z * z * (np.float32(1) + np.float32(noise.sun) * sunlight * albedo)
    signal = max(albedo * cosine / drowned, np.float32(1e-9))
    strong = np.log(signal / np.float32(noise.weakest_signal)) / np.float32(noise.signal_softness)
    steep = (cosine - np.float32(noise.graze_cos)) / np.float32(noise.graze_softness)
    return min(strong, steep, np.float32(noise.any_margin))
