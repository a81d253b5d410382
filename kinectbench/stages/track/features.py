"""Relative pose of two frames without an initial guess: ORB features, matched and lifted to 3-D.

ORB: Rublee et al. 2011; the pose by P3P (Ke & Roumeliotis 2017) in RANSAC, then EPnP (Lepetit et al. 2009)
of all inliers. Where colour is not registered to depth, the features are found in a shaded image of the
depth. Its appearance is stable while the camera turns by less than about 30 degrees.

Similar keyframes are found by bags of ORB words, independently of the odometry (Sivic & Zisserman 2003,
"Video Google"; Galvez-Lopez & Tardos 2012). The words come from the recording itself.
"""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.even_choice import evenly
from kinectbench.core.geometry import Camera, invert_rigid, rigid
from kinectbench.core.types import Float64
from kinectbench.stages.track.frame_maps import FrameMaps, MapCache

# More features would cost time.
MAX_FEATURES = 600
# A third of OpenCV's default: shaded depth has little contrast.
FAST_THRESHOLD = 7
# Pixels of the working image: half of OpenCV's border, and a smaller patch than its 31.
BORDER_PX, PATCH_PX = 16, 25
# RANSAC of a pose (OpenCV's default is 100 rounds, at .99).
ROUNDS, CONFIDENCE = 200, 0.999
# Largest distance ratio of the best candidate match to the second best (Lowe 2004).
RATIO = 0.85
# Fewer matches or inliers may fit a pose by chance.
MIN_MATCHES, MIN_INLIERS = 12, 10
# Largest reprojection error, working pixels; the same for all octaves, as coarser features are not more
# exact.
REPROJECTION_PX = 2.5
# A frame has up to 600 features of 72 bytes: 43 MB in all.
CACHED_FRAMES = 1000
# A small vocabulary is enough, because only keyframes of one recording are compared.
WORDS = 400


@dataclass(frozen=True)
class Features:
    """The features of one frame that have depth.

    Attributes:
        pixels: (m, 2) float64, u and v at working resolution.
        points_m: (m, 3) float64, camera frame.
        descriptors: (m, 32) uint8.
    """

    pixels: Float64
    points_m: Float64
    descriptors: NDArray[np.uint8]


class FeatureCache(OrderedDict[int, Features]):
    """Features of frames, by index, computed on demand; those of the 1000 frames computed last are kept."""

    def __init__(self, maps: MapCache) -> None:
        super().__init__()
        self.maps = maps

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the maps, which are the argument of the constructor, and the features found so far."""
        return type(self), (self.maps,), None, None, iter(self.items())

    def __missing__(self, index: int) -> Features:
        found = self[index] = find_features(self.maps[index])
        if len(self) > CACHED_FRAMES:
            self.popitem(last=False)
        return found


def find_features(maps: FrameMaps) -> Features:
    """Find ORB features that have depth, in the intensity image or, without one, in the shaded depth."""
    level = maps[0]
    image = level.intensity if maps.has_intensity else shading(level.normals)
    orb = cv2.ORB.create(
        nfeatures=MAX_FEATURES, fastThreshold=FAST_THRESHOLD, edgeThreshold=BORDER_PX, patchSize=PATCH_PX
    )
    keypoints, descriptors = orb.detectAndCompute(np.clip(image, 0, 255).astype(np.uint8), None)
    if not keypoints:
        return Features(np.zeros((0, 2)), np.zeros((0, 3)), np.zeros((0, 32), np.uint8))
    pixels = np.array([keypoint.pt for keypoint in keypoints])
    u, v = np.rint(pixels).astype(int).T
    z = level.depth_m[v, u].astype(np.float64)
    points = level.camera.rays_at(*pixels.T) * z[:, None]
    has_depth = z > 0
    return Features(pixels[has_depth], points[has_depth], np.asarray(descriptors)[has_depth])


def shading(normals: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a grey image (height, width), 0 to 255, of normals (height, width, 3) lit from above."""
    light = np.array([0.45, -0.55, -0.70], np.float32)
    lit = normals @ light
    return np.asarray(np.where(normals[..., 2] == 0, 0.0, 60 + 195 * np.clip(lit, 0, 1)), np.float32)


def match(source: Features, target: Features) -> NDArray[np.int64]:
    """Match features; return index pairs (k, 2) into source and target.

    A match is mutual, and passes the ratio test: its distance is below 0.85 of the second best one.
    """
    if len(source.descriptors) < 2 or len(target.descriptors) < 2:
        return np.zeros((0, 2), np.int64)
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    matches = matcher.knnMatch(source.descriptors, target.descriptors, k=2)
    back = {m.queryIdx: m.trainIdx for m in matcher.match(target.descriptors, source.descriptors)}
    return np.array(
        [
            (best.queryIdx, best.trainIdx)
            for best, second in matches
            if best.distance < RATIO * second.distance and back.get(best.trainIdx) == best.queryIdx
        ],
        np.int64,
    ).reshape(-1, 2)


def pose_from_features(source: Features, target: Features, camera: Camera) -> tuple[Float64, int] | None:
    """Estimate T_target_source (4, 4) by PnP; return it and the number of inliers.

    The result is None if fewer than 12 features match, or if fewer than 10 matches are inliers.

    Args:
        source: features whose pixels are the observations.
        target: features whose points are the known 3-D points.
        camera: intrinsics of the source, at working resolution.
    """
    pairs = match(source, target)
    if len(pairs) < MIN_MATCHES:
        return None
    is_solved, turn, shift, inliers = cv2.solvePnPRansac(
        target.points_m[pairs[:, 1]],
        source.pixels[pairs[:, 0]],
        camera.K,
        None,
        iterationsCount=ROUNDS,
        reprojectionError=REPROJECTION_PX,
        confidence=CONFIDENCE,
        flags=cv2.SOLVEPNP_AP3P,
    )
    if not is_solved or inliers is None or len(inliers) < MIN_INLIERS:
        return None
    T_source_target = rigid(cv2.Rodrigues(turn)[0], shift.ravel())
    return invert_rigid(T_source_target), len(inliers)


def similarity(features: Sequence[Features]) -> NDArray[np.float64]:
    """Cosine similarity (k, k) of k frames' tf-idf weighted counts of ORB words; the diagonal is 0."""
    k = len(features)
    descriptors = np.concatenate([f.descriptors for f in features]) if k else np.zeros((0, 32), np.uint8)
    if len(descriptors) < 2:
        return np.zeros((k, k))
    words = descriptors[evenly(len(descriptors), WORDS)]
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    counts = np.zeros((k, len(words)))
    for row, frame in enumerate(features):
        if len(frame.descriptors):
            np.add.at(counts[row], [m.trainIdx for m in matcher.match(frame.descriptors, words)], 1)
    rarity = np.log((1 + k) / (1 + (counts > 0).sum(axis=0)))
    weighted = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1) * rarity
    weighted /= np.maximum(np.linalg.norm(weighted, axis=1, keepdims=True), 1e-9)
    result = weighted @ weighted.T
    np.fill_diagonal(result, 0)
    return np.asarray(result)
