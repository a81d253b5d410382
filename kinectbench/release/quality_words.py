"""The figures of a recording's quality.json in words, for the card and the preview page."""

from collections.abc import Mapping
from typing import Any

# Key of quality.json -> what it is called, how it is written, factor.
QUALITY = {
    "estimated_iou": ("estimated IoU", "{:.3f}", 1.0),
    "repeatability_iou": ("repeatability IoU", "{:.3f}", 1.0),
    "surface_sigma_m": ("σ of the surface", "{:.1f} mm", 1000.0),
    "unknown_share": ("never seen", "{:.1f} %", 100.0),
    "doubtful_share": ("perhaps a hollow", "{:.1f} %", 100.0),
    "volume_m3": ("volume", "{:.1f} l", 1000.0),
    "good_frames": ("frames fused", "{:.0f}", 1.0),
}


def quality_words(quality: Mapping[str, Any]) -> dict[str, str]:
    """What each known figure is called → its value with its unit, in a fixed order.

    Args:
        quality: quality.json; {} where it is held back or the pairs come from elsewhere.
    """
    return {
        label: form.format(factor * value)
        for key, (label, form, factor) in QUALITY.items()
        if isinstance(value := quality.get(key), int | float)
    }
