"""Checks of the intrinsics against the images they should belong to."""

import math
from collections.abc import Iterator

from kinectbench.doctor.finding import Finding
from kinectbench.doctor.look import Look

# Of cameras that people hold: horizontal field of view, degrees.
NARROWEST_DEG, WIDEST_DEG = 35.0, 110.0
# A principal point farther from the middle, as a share of width or height, is not that of a whole image.
OFF_CENTRE = 0.15
SAME_RATIO = 0.08
USUAL_RATIOS = (0.25, 0.4, 0.5, 2 / 3, 1.5, 2.0, 2.5, 4.0)
NEARLY = 0.04
MAX_ASPECT = 1.1


def check_intrinsics(look: Look) -> Iterator[Finding]:
    """Judge focal lengths and principal point."""
    camera = look.recording.camera
    across, down = camera.width / (2 * camera.cx + 1), camera.height / (2 * camera.cy + 1)
    shown = f"fx {camera.fx:g}, fy {camera.fy:g}, cx {camera.cx:g}, cy {camera.cy:g}"
    size = f"{camera.width}x{camera.height}"
    advice = "give those of the depth images under `camera:`"
    off = max(abs(camera.cx / camera.width - 0.5), abs(camera.cy / camera.height - 0.5))
    if off > OFF_CENTRE and abs(across / down - 1) < SAME_RATIO:
        ratio = min(USUAL_RATIOS, key=lambda usual: abs(usual / across - 1))
        ratio = ratio if abs(ratio / across - 1) < NEARLY else across
        what = (
            f"the intrinsics ({shown}) are those of {camera.width / ratio:.0f}x{camera.height / ratio:.0f} "
            f"images, but depth is {size}"
        )
        yield Finding("intrinsics_resolution", "stops", what, look.where, f"multiply them by {ratio:.3g}")
        return
    if off > OFF_CENTRE:
        what = f"the principal point ({camera.cx:g}, {camera.cy:g}) is far from the middle of {size} images"
        yield Finding("principal_point", "warning", what, look.where, advice)
    view_deg = math.degrees(2 * math.atan(camera.width / (2 * camera.fx)))
    if not NARROWEST_DEG <= view_deg <= WIDEST_DEG:
        what = f"the field of view is {view_deg:.0f} degrees ({shown}, {size})"
        yield Finding("field_of_view", "warning", what, look.where, advice)
    if not 1 / MAX_ASPECT < camera.fx / camera.fy < MAX_ASPECT:
        what = f"fx and fy differ by more than 10 % ({shown}): pixels are not square"
        yield Finding("aspect", "warning", what, look.where, advice)
