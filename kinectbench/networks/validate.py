"""Measure a network's IoU on validation pairs, by the rules of scoring."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from kinectbench.core.types import Float64
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.networks.config import MethodSettings
from kinectbench.networks.data import PairFile, as_tensor, turned_axes
from kinectbench.networks.network import Network
from kinectbench.scoring.counts import THRESHOLDS, ious, is_all_unknown, protocol_counts, tally
from kinectbench.scoring.prediction_file import checked
from kinectbench.scoring.truth import read_packed_truth, read_parts

PROTOCOL = "known"


def completed(
    network: Network, partial: NDArray[np.bool_], config: MethodSettings, device: str
) -> NDArray[np.float16]:
    """Complete a partial view (64, 64, 64) to probabilities (n, n, n) float16, both in the pair's axes.

    Raises:
        PredictionError: an output of the network is no probability.
    """
    network.eval()
    with torch.inference_mode():
        tensor = as_tensor(turned_axes(partial, config)[None], device)
        wanted = config.training.precision == "bfloat16"
        with torch.autocast(device.partition(":")[0], torch.bfloat16, enabled=wanted):
            probability = network.completed(tensor)
    values: NDArray[np.float16] = probability[0, 0].half().cpu().numpy()
    # Counting and thresholds rely on numbers from 0 to 1.
    checked(values, f"the output of network '{config.name}'")
    return np.ascontiguousarray(turned_axes(values, config))


def validation_iou(
    network: Network, pairs: Sequence[PairFile], config: MethodSettings, device: str
) -> tuple[float, float]:
    """Return the mean IoU over known voxels at the best of 17 probability thresholds, and this threshold.

    Pairs without known truth are left out, unless all pairs are such pairs. There must be a pair; `config`
    determines axes and precision.

    Raises:
        PredictionError: an output of the network is no probability.
        ReleaseError: a pair is missing or changed.
    """
    curves, unknown = list[Float64](), list[Float64]()
    for path, sha256 in pairs:
        (partial,) = read_parts(path, sha256, ("partial",))
        prediction = completed(network, unpack(partial), config, device)
        counted = tally(prediction, read_packed_truth(path, sha256))
        # As in scores, a pair without known truth is left out.
        of = unknown if is_all_unknown(counted, PROTOCOL) else curves
        of.append(ious(protocol_counts(counted, PROTOCOL)))
    mean = np.mean(curves or unknown, axis=0)
    best = int(np.argmax(mean))
    return float(mean[best]), THRESHOLDS[best]
