"""Keyframes that look alike, wherever the odometry believes they are: a bag of the recording's own ORB words.

Sivic & Zisserman 2003 ("Video Google") with binary words, as in Galvez-Lopez & Tardos 2012.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from kinectbench.tracking.features import Features

WORDS = 400


def likeness(features: Sequence[Features]) -> NDArray[np.float64]:
    """(k, k) cosine between the tf-idf weighted word counts of keyframes; the diagonal is 0."""
    import cv2

    k = len(features)
    descriptors = np.concatenate([f.descriptors for f in features]) if k else np.zeros((0, 32), np.uint8)
    if len(descriptors) < 2:
        return np.zeros((k, k))
    words = descriptors[np.unique(np.linspace(0, len(descriptors) - 1, WORDS).astype(int))]
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
