"""Simulate time-of-flight errors on exact depth: those of an Azure Kinect, and of a phone's LiDAR scanner.

Sources:
    Microsoft: Azure Kinect DK hardware specification (NFOV unbinned: 640x576 pixels, 0.5 to 3.86 m; standard
    deviation at most 17 mm and systematic error below 11 mm + 0.1 % of the distance, for reflectivities of 15
    to 95 % and without multipath). Tölgyessy, Dekan, Chovanec, Hubinský: Evaluation of the Azure Kinect and
    Its Comparison to Kinect V1 and Kinect V2, Sensors 21(2):413, 2021 (confirm both up to 3.5 m; flying
    pixels and multipath seen; not reliable in direct sun). Lange, Seitz: Solid-State Time-of-Flight Range
    Camera, IEEE J. Quantum Electronics 37(3), 2001 (noise of demodulated light). Luetzenburg, Kroon, Bjørk:
    Evaluation of the Apple iPhone 12 Pro LiDAR for an Application in Geosciences, Scientific Reports 11, 2021
    (absolute accuracy of 1 cm on small objects). Teo, Yang: Evaluating the Accuracy and Quality of an iPad
    Pro's Built-in Lidar for 3D Indoor Mapping, Developments in the Built Environment 14, 2023 (points less
    than 1 mm from their best-fitting plane at rest, 1 cm in motion). Values without a source are marked
    "chosen here".

Not simulated: cyclic errors, effects of temperature and of motion within a frame, the Azure Kinect's cut-off
image corners, ambiguity of the phase.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numba
import numpy as np

from kinectbench.core.geometry import Camera
from kinectbench.core.types import Float32
from kinectbench.lab.simulate.kinect import smooth_error, smooth_normal
from kinectbench.lab.simulate.render import Rendering

# Indirect light counts for at most this share of the direct light (limit of the formula, chosen here).
MOST_INDIRECT = np.float32(1.0)
STEEPEST_COS = np.float32(0.05)


class TimeOfFlight(NamedTuple):
    """Parameters of a time-of-flight sensor.

    The signal of a pixel is albedo * cos(incidence) / z², in 1/m²; a grey wall at 1 m gives 0.6.

    Attributes:
        focal_px: focal length of the image to which the pixel-valued parameters below refer.
        min_range_m: nearer surfaces give no depth, metres.
        max_range_m: farther surfaces give no depth, metres.
        noise_m: standard deviation of depth is noise_m * sqrt(signal + ambient) / signal (Lange & Seitz,
            section IV: the square root of all light over the demodulated light).
        ambient: light and read-out noise that carry no distance, in units of the signal.
        sun: full sun on a white surface, in units of the signal (as in `KinectNoise`).
        worst_m: pixels with a larger standard deviation of depth give no measurement, metres.
        worst_softness: standard deviation of the logarithm of that limit.
        smooth_share: share of the noise's variance that is correlated between neighbouring pixels.
        smooth_px: standard deviation of the blur that correlates it (chosen here, except the phone's).
        mixed_px: standard deviation of the blur by which a pixel gets its neighbours' light.
        same_surface: largest relative difference of depth between pixels of one surface.
        edge_margin: pixels within 1.5 times `mixed_px` of an edge are lost if a normal variate exceeds this.
        hole_px: standard deviation of the blur of these variates, which makes holes coherent blobs.
        multipath: share of the indirect light that the sensor does not separate from direct light.
        distortion_m: root mean square of one device's systematic error, metres.
        step_m: reported depth is a multiple of this, metres; 0: it is not quantised.
    """

    focal_px: float
    min_range_m: float
    max_range_m: float
    noise_m: float
    ambient: float
    sun: float
    worst_m: float
    worst_softness: float
    smooth_share: float
    smooth_px: float
    mixed_px: float
    same_surface: float
    edge_margin: float
    hole_px: float
    multipath: float
    distortion_m: float
    step_m: float


# `noise_m` and `ambient` follow from two points: 15 mm at 3.86 m and 15 % reflectivity (within the specified
# 17 mm), and 1.1 mm on a grey wall (60 %) at 1 m. That gives 2.3 mm at 2 m and 4.6 mm at 3.5 m; an albedo of
# 0.05 is lost beyond 3 m, a grey wall in the simulator's outdoor light beyond 2.6 m. Half of the pixels at
# edges are lost.
AZURE_KINECT = TimeOfFlight(
    focal_px=504.0,
    min_range_m=0.5,
    max_range_m=3.86,
    noise_m=8.4e-4,
    ambient=0.0225,
    sun=20.0,
    worst_m=0.025,
    worst_softness=0.2,
    smooth_share=0.5,
    smooth_px=1.0,
    mixed_px=0.6,
    same_surface=0.03,
    edge_margin=0.0,
    hole_px=4.0,
    multipath=0.3,
    distortion_m=0.002,
    step_m=0.001,
)
# The depth image is made from a grid of about 24x24 beams with the help of the colour image (Apple publishes
# neither the grid, which teardowns show, nor the method). So errors are blobs as wide as the distance of
# beams (256 / 24 pixels, at half their height), and edges are smoothed. On a grey wall the error is 4 mm at 1
# m, of which 0.5 mm varies from pixel to pixel (below 1 cm, and below 1 mm about the best-fitting plane
# nearby: Luetzenburg et al., Teo & Yang), and 8 mm at 2 m. Half of the pixels at edges have a low confidence,
# which readers treat as no measurement. A pulse's first return is partly separated from later ones, so there
# is less multipath.
PHONE_LIDAR = TimeOfFlight(
    focal_px=212.0,
    min_range_m=0.2,
    max_range_m=5.0,
    noise_m=3.05e-3,
    ambient=0.02,
    sun=4.0,
    worst_m=0.05,
    worst_softness=0.2,
    smooth_share=0.985,
    smooth_px=4.5,
    mixed_px=1.0,
    same_surface=0.06,
    edge_margin=0.0,
    hole_px=4.0,
    multipath=0.15,
    distortion_m=0.003,
    step_m=0.0,
)
SENSORS = {"azure_kinect": AZURE_KINECT, "phone_lidar": PHONE_LIDAR}
# Indirect light is computed at every 8th and from every 12th pixel of 640x576: from 2520 to 5760 patches.
RECEIVER_PX, SENDER_PX, STEPS_FOCAL_PX = 8, 12, 504.0


@dataclass(frozen=True)
class TimeOfFlightDevice:
    """One individual sensor and the sunlight on its scene.

    Attributes:
        sensor: parameters that all devices of the model share, scaled to the image's pixels.
        offset_m: (height, width) float32, systematic error of the device, metres.
        sunlight: sunlight on the scene, 0 to 1.
    """

    sensor: TimeOfFlight
    offset_m: Float32
    sunlight: float


def draw_time_of_flight(
    model: str, camera: Camera, distortion: float, sunlight: float, rng: np.random.Generator
) -> TimeOfFlightDevice:
    """Draw an individual sensor, with a systematic error that varies smoothly over the image, not with depth.

    Args:
        model: a key of `SENSORS`.
        camera: the depth camera.
        distortion: 1 for a typical device, 0 for none.
        sunlight: 0 to 1.
        rng: draws the map of the error.
    """
    sensor = SENSORS[model]
    # A smaller image is a reduced image of the sensor: blurs cover fewer of its pixels.
    scale = camera.fx / sensor.focal_px
    sensor = sensor._replace(
        smooth_px=sensor.smooth_px * scale, mixed_px=sensor.mixed_px * scale, hole_px=sensor.hole_px * scale
    )
    return TimeOfFlightDevice(
        sensor, smooth_error(camera, distortion * sensor.distortion_m, rng).astype(np.float32), sunlight
    )


def measure_time_of_flight(
    rendering: Rendering, camera: Camera, device: TimeOfFlightDevice, rng: np.random.Generator
) -> Float32:
    """Return the sensor's depth image of a noise-free rendering: (height, width) metres, 0 = none.

    The steps, in this order:
        1. Multipath: light that reached a surface by way of another surface comes later (`multipath_m`).
        2. Mixed pixels: a pixel gets some of its neighbours' light, and reports the light-weighted mean of
           their depths (the phase of a sum of returns whose distances differ by little of the wavelength).
           Beside an edge, such flying pixels lie between the two depths. Some pixels at edges are lost.
        3. The device's systematic error, and noise, which grows with distance and falls with albedo.
        4. No depth out of range, or where the noise is too strong.

    Args:
        rendering: the noise-free rendering.
        camera: the camera of the rendering.
        device: the sensor.
        rng: draws all noise of this frame.
    """
    sensor, exact_m = device.sensor, rendering.depth_m
    shape = (exact_m.shape[0], exact_m.shape[1])
    white = rng.standard_normal(shape, dtype=np.float32) * np.float32(np.sqrt(1 - sensor.smooth_share))
    smooth = smooth_normal(shape, sensor.smooth_px, rng)
    drawn = white + np.float32(np.sqrt(sensor.smooth_share)) * smooth
    # Half the resolution suffices for the field that decides where a hole lies.
    weak = smooth_normal(((shape[0] + 1) // 2, (shape[1] + 1) // 2), sensor.hole_px / 2, rng)
    late_m = exact_m + multipath_m(rendering, camera, sensor)
    near = np.maximum(exact_m, np.float32(0.05))
    signal = np.where(exact_m > 0, rendering.albedo * rendering.cos_incidence / (near * near), np.float32(0))
    reach = 2 * int(np.ceil(3 * sensor.mixed_px)) + 1
    light, weighted = (
        cv2.GaussianBlur(image, (reach, reach), sensor.mixed_px, borderType=cv2.BORDER_REPLICATE)
        for image in (signal.astype(np.float32), (signal * late_m).astype(np.float32))
    )
    # As far as mixed pixels are visible, but at least to the next pixel.
    wide = 2 * max(1, round(1.5 * sensor.mixed_px)) + 1
    window = np.ones((wide, wide), np.uint8)
    around_m = (cv2.erode(exact_m, window), cv2.dilate(exact_m, window))
    returned = (light, weighted, rendering.albedo, device.offset_m)
    return np.asarray(_report(exact_m, around_m, returned, (sensor, device.sunlight), (drawn, weak)))


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _report(exact_m, around_m, returned, device, drawn):  # type: ignore[no-untyped-def]
    """Return reported depth, (height, width) float32 metres, 0 = none, from the light that came back.

    Args:
        exact_m: (height, width), noise-free depth, 0 where nothing is hit.
        around_m: pair (smallest, largest) of the depth around each pixel.
        returned: light after mixing, light times depth, albedo, and systematic error in metres: each (height,
            width).
        device: pair (`TimeOfFlight`, sunlight).
        drawn: pair of standard normal variates: (height, width) for noise, and at half the resolution for
            lost pixels.
    """
    light, weighted, albedo, offset_m = returned
    sensor, sunlight = device
    normal, weak = drawn
    height, width = exact_m.shape
    reported = np.zeros((height, width), np.float32)
    for v in range(height):
        for u in range(width):
            needed = weak[v // 2, u // 2]
            if exact_m[v, u] <= 0 or light[v, u] <= 0:
                continue
            low, high = around_m[0][v, u], around_m[1][v, u]
            if high > low * np.float32(1 + sensor.same_surface) and needed > sensor.edge_margin:
                continue
            ambient = sensor.ambient + sensor.sun * sunlight * albedo[v, u]
            sigma_m = sensor.noise_m * np.sqrt(light[v, u] + ambient) / light[v, u]
            if sigma_m > sensor.worst_m * np.exp(-sensor.worst_softness * needed):
                continue
            z = weighted[v, u] / light[v, u] + offset_m[v, u] + sigma_m * normal[v, u]
            if sensor.step_m > 0:
                z = np.rint(z / sensor.step_m) * sensor.step_m
            if sensor.min_range_m <= z <= sensor.max_range_m:
                reported[v, u] = z
    return reported


def multipath_m(rendering: Rendering, camera: Camera, sensor: TimeOfFlight) -> Float32:
    """Return the depth error that indirect light (multipath) causes: (height, width) metres along z.

    The model is one diffuse bounce between Lambertian surfaces in the image. Further bounces, surfaces out of
    view, and occlusion between two surfaces are left out (chosen here). The light source is at the camera. A
    patch q with albedo rho and the solid angle W of its pixels reflects the light rho * W. Per area, a
    surface at p receives of this light the form factor cos_p cos_q / (pi r² + A_q) of a disc of q's area A_q
    at distance r. Directly from the source it receives cos(incidence) / d_p². Here d_p and d_q are distances
    from the camera. Indirect light seems (d_q + r - d_p) / 2 farther away. The sensor reports the
    light-weighted mean of distances, as for mixed pixels, with only its `multipath` share of indirect light.
    """
    wanted = (max(1, round(step * camera.fx / STEPS_FOCAL_PX)) for step in (RECEIVER_PX, SENDER_PX))
    # Of an image lower than a step, at least one row of patches is taken.
    fine, coarse = (min(step, *rendering.depth_m.shape) for step in wanted)
    receivers = _patches(rendering.depth_m, rendering.albedo, camera, fine)
    senders = _patches(rendering.depth_m, rendering.albedo, camera, coarse)
    late_m = _indirect(receivers[0], senders[0][senders[0][:, 6] > 0], np.float32(sensor.multipath))
    return np.asarray(_spread(late_m.reshape(receivers[1]), rendering.depth_m, fine))


def _patches(depth_m: Float32, albedo: Float32, camera: Camera, step: int) -> tuple[Float32, tuple[int, int]]:
    """Return one surface patch for every `step`th pixel of every `step`th row, and their (rows, columns).

    Returns:
        The patches, (n, 9) float32: point in metres and unit normal, both in the camera's frame; reflected
        light; area in m²; cosine of incidence. Light and area are 0 where nothing is hit. And the number of
        rows and of columns of patches.
    """
    lens = (camera.fx, camera.fy, camera.cx, camera.cy)
    rows, columns = (len(range(step // 2, size, step)) for size in depth_m.shape)
    return np.asarray(_patch_rows(depth_m, albedo, lens, step, (rows, columns))), (rows, columns)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _patch_rows(depth_m, albedo, lens, step, size):  # type: ignore[no-untyped-def]
    """Compute the patches (n, 9) of `_patches`; normals are from each pixel's neighbours at similar depth.

    `depth_m` and `albedo` are as in `_patches`. `lens` is (fx, fy, cx, cy), `step` the distance of patches in
    pixels, `size` their (rows, columns).
    """
    fx, fy, cx, cy = lens
    height, width = depth_m.shape
    patches = np.zeros((size[0] * size[1], 9), np.float32)
    for k in range(len(patches)):
        v, u = step // 2 + step * (k // size[1]), step // 2 + step * (k % size[1])
        z = depth_m[v, u]
        x, y = (u - cx) / fx, (v - cy) / fy
        left, right = max(u - 1, 0), min(u + 1, width - 1)
        if left == u or (right != u and abs(depth_m[v, right] - z) <= abs(depth_m[v, left] - z)):
            left, right = u, right
        else:
            left, right = left, u
        up, down = max(v - 1, 0), min(v + 1, height - 1)
        if up == v or (down != v and abs(depth_m[down, u] - z) <= abs(depth_m[up, u] - z)):
            up, down = v, down
        else:
            up, down = up, v
        z0, z1, z2, z3 = depth_m[v, left], depth_m[v, right], depth_m[up, u], depth_m[down, u]
        if z <= 0 or min(z0, z1) <= 0 or min(z2, z3) <= 0:
            continue
        ax, ay, az = (right - cx) / fx * z1 - (left - cx) / fx * z0, y * (z1 - z0), z1 - z0
        bx, by, bz = x * (z3 - z2), (down - cy) / fy * z3 - (up - cy) / fy * z2, z3 - z2
        # The cross product of down and right points towards the camera.
        nx, ny, nz = by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        ray = np.sqrt(x * x + y * y + 1)
        cosine = -(nx * x + ny * y + nz) / (length * ray)
        if not cosine > 0:
            continue
        solid = step * step / (fx * fy * ray**3)
        patches[k, 0], patches[k, 1], patches[k, 2] = x * z, y * z, z
        patches[k, 3], patches[k, 4], patches[k, 5] = nx / length, ny / length, nz / length
        patches[k, 6] = albedo[v, u] * solid
        patches[k, 7] = solid * (z * ray) ** 2 / max(cosine, STEEPEST_COS)
        patches[k, 8] = max(cosine, STEEPEST_COS)
    return patches


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _indirect(receivers, senders, share):  # type: ignore[no-untyped-def]
    """Return the multipath error of each receiving patch along z: (n,) float32 metres; see `multipath_m`.

    `receivers` and `senders` are patches of `_patches`; `share` is that of the indirect light that the sensor
    takes for direct light.
    """
    late_m = np.zeros(len(receivers), np.float32)
    far = np.sqrt(senders[:, 0] ** 2 + senders[:, 1] ** 2 + senders[:, 2] ** 2)
    for i in range(len(receivers)):
        px, py, pz, nx, ny, nz = receivers[i, :6]
        if receivers[i, 7] <= 0:
            continue
        own = np.sqrt(px * px + py * py + pz * pz)
        light, detour = np.float32(0), np.float32(0)
        for j in range(len(senders)):
            x, y, z = senders[j, 0] - px, senders[j, 1] - py, senders[j, 2] - pz
            arriving = nx * x + ny * y + nz * z
            leaving = -(senders[j, 3] * x + senders[j, 4] * y + senders[j, 5] * z)
            if arriving <= 0 or leaving <= 0:
                continue
            squared = x * x + y * y + z * z
            sent = senders[j, 6] * arriving * leaving
            got = sent / (squared * (np.float32(np.pi) * squared + senders[j, 7]))
            light += got
            detour += got * (far[j] + np.sqrt(squared) - own)
        direct = receivers[i, 8] / (own * own)
        if light > 0:
            part = min(share * light / direct, MOST_INDIRECT)
            late_m[i] = part / (1 + part) * detour / light / 2 * pz / own
    return late_m


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _spread(late_m, depth_m, step):  # type: ignore[no-untyped-def]
    """Interpolate the patches' errors to all pixels, mostly from neighbouring patches at similar depth.

    `late_m` (rows, columns) are the errors in metres of patches `step` pixels apart, `depth_m` the depth of
    all pixels (height, width). The result has the shape of `depth_m`.
    """
    rows, columns = late_m.shape
    height, width = depth_m.shape
    spread = np.zeros((height, width), np.float32)
    for v in range(height):
        t = min(max((v - step // 2) / step, 0.0), rows - 1.0)
        i = min(int(t), max(rows - 2, 0))
        for u in range(width):
            s = min(max((u - step // 2) / step, 0.0), columns - 1.0)
            j = min(int(s), max(columns - 2, 0))
            total, weights = 0.0, 0.0
            z = depth_m[v, u]
            if z <= 0:
                continue
            for k in range(4):
                a, b = min(i + k // 2, rows - 1), min(j + k % 2, columns - 1)
                patch_depth_m = depth_m[step // 2 + step * a, step // 2 + step * b]
                weight = (1 - abs(t - a)) * (1 - abs(s - b))
                # Neighbours a tenth of the depth apart hardly count, unless there are no others.
                weight *= np.exp(-(((patch_depth_m - z) / (0.05 * z)) ** 2)) + 1e-6
                total += weight * late_m[a, b]
                weights += weight
            if weights > 0:
                spread[v, u] = total / weights
    return spread
