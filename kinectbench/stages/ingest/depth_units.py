"""Read the unit of depth that a camera's file states under one of many names."""

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from kinectbench.core import quoted
from kinectbench.core.types import MM_PER_M

# What a number under a name says. BY_SIZE: which of the three is judged by its size.
UNITS_A_METRE, METRES_A_UNIT, BY_SIZE = "units a metre", "metres a unit", "by its size"
# Names in small letters, and by whom; where a file has several, the first of this list counts.
MEANINGS = {
    "depth_scale": BY_SIZE,  # BOP and SIXD (beside cam_K): mm a unit; librealsense: metres a unit
    "depth_factor": BY_SIZE,
    "depthmapfactor": UNITS_A_METRE,  # ORB-SLAM2
    "rgbd.depthmapfactor": UNITS_A_METRE,  # ORB-SLAM3
    "png_depth_scale": UNITS_A_METRE,  # NICE-SLAM and SplaTAM
    "depth_units": METRES_A_UNIT,  # librealsense
    "depth_unit_scale_factor": METRES_A_UNIT,  # nerfstudio
    "integer_depth_scale": METRES_A_UNIT,  # instant-ngp
}
# A line of YAML with such a name.
YAML_UNIT = re.compile(
    rf"^[ \t]*({'|'.join(map(re.escape, MEANINGS))})[ \t]*:[ \t]*([^#\n]{{1,40}})",
    re.MULTILINE | re.IGNORECASE,
)
# No unit of depth images is as long as this many mm: a larger scale is in units per metre.
MOST_MM_A_UNIT = 100.0


def scale_of_keys(
    stated: Mapping[str, object], path: Path, *, of_bop: bool
) -> tuple[float | None, tuple[str, ...]]:
    """Return the depth units per metre that a file states, and warnings.

    The meaning of `depth_scale` depends on its value. Beside `cam_K`, a value below 100 is BOP's, in mm per
    unit. Otherwise, a value below 1 is in metres per unit, as in librealsense, because as units per metre it
    would mean a unit longer than 1 m. Any other value is in units per metre. Only names in `MEANINGS` are
    looked at; `of_bop` tells whether the file has `cam_K`.

    Returns:
        Units per metre; None if no such name is found, or if none of the values is a unit of 16-bit depth.
    """
    scales, notes = dict[str, float](), list[str]()
    by_name = {name.lower(): (name, value) for name, value in stated.items()}
    for name, value in (by_name[key] for key in MEANINGS if key in by_name):
        number = _positive(value)
        if number is None:
            notes.append(f"{path}: its {name} {quoted(value)} is no unit of depth, and is not used")
            continue
        scale, how = _units_a_metre(number, MEANINGS[name.lower()], of_bop=of_bop)
        if how and not scales:
            notes.append(f"{path}: its {name} {number:g} is taken for {how}: 1 m is {scale:g} units")
        scales[name] = scale
    if len({f"{scale:.6g}" for scale in scales.values()}) > 1:
        said = " and ".join(f"{scale:g} by {name}" for name, scale in scales.items())
        notes.append(f"{path}: 1 m is {said} units: the first is taken; remove what is wrong")
    return next(iter(scales.values()), None), tuple(notes)


def yaml_scale(text: str, path: Path, *, of_bop: bool) -> tuple[float | None, tuple[str, ...]]:
    """Return the depth units per metre that a YAML text states, and warnings; see `scale_of_keys`.

    A scale below 10 units per metre is not used: it is for float depth (1 in ORB-SLAM's examples for ROS), or
    for something else. A name that occurs again with another value is not used either.
    """
    values = dict[str, object]()
    for name, word in YAML_UNIT.findall(text):
        value = _number_or_text(word)
        if values.setdefault(name, value) != value:
            values[name] = f"{values[name]}, {value}"
    scale, notes = scale_of_keys(values, path, of_bop=of_bop)
    if scale is None or scale >= MM_PER_M / MOST_MM_A_UNIT:
        return scale, notes
    return None, (f"{path}: says that 1 m is {scale:g} units of depth, which is not used for 16-bit depth",)


def _positive(value: object) -> float | None:
    """Return a parsed value as a float if it is a positive, finite number, else None."""
    with suppress(OverflowError):  # an integer may be too large
        if isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf:
            return float(value)
    return None


def _number_or_text(word: str) -> float | str:
    try:
        return float(word)
    except ValueError:
        return word.strip()


def _units_a_metre(stated: float, meaning: str, *, of_bop: bool) -> tuple[float, str]:
    """Return a stated unit as units per metre, and the unit that it was taken for ("" if not converted)."""
    if meaning == BY_SIZE and of_bop and stated < MOST_MM_A_UNIT:
        return MM_PER_M / stated, "mm a unit, as BOP has it beside cam_K"
    if meaning == METRES_A_UNIT or (meaning == BY_SIZE and stated < 1):
        return 1 / stated, "metres a unit, as librealsense has it"
    return stated, ""
