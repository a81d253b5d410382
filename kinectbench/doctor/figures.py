"""Figures of a recording in words, for the terminal and the page."""

from collections.abc import Mapping, Sequence

# Suffix of a fact's name → the unit behind its value.
UNITS = {"_hz": " Hz", "_px": " px", "_mm": " mm", "_deg": "°", "_m": " m", "_s": " s"}
# Of a fact without a unit, what its value means.
NOTES = {"pose_disagreement": " (0: the depth fits the poses, 1: nowhere)"}
SIZE = ("width", "height")


def figures(facts: Mapping[str, object]) -> list[tuple[str, str]]:
    """Each fact that is known as (name, value), in their order, for people to read.

    Args:
        facts: of a `Diagnosis`: plain JSON values by name; a name ends in its unit.
    """
    return [_in_words(name, value) for name, value in facts.items() if value is not None]


def _in_words(name: str, value: object) -> tuple[str, str]:
    suffix = next((suffix for suffix in UNITS if name.endswith(suffix)), "")
    label = name.removesuffix(suffix).replace("_", " ").replace("color", "colour")
    if name.endswith("_share") and isinstance(value, float):
        return label, f"{100 * value:.1f} %"
    return label, _value(name, value, UNITS.get(suffix, "")) + NOTES.get(name, "")


def _value(name: str, value: object, unit: str) -> str:
    """A value in words: a camera, quantiles, a size, a yes or no, a number with its unit."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        size = " x ".join(f"{value[key]}" for key in SIZE if key in value)
        known = [(key, number) for key, number in value.items() if key not in SIZE and number is not None]
        rest = [f"{key} {_number(number)}{unit}" for key, number in known]
        return ", ".join([f"{size} px", *rest] if size else rest)
    if isinstance(value, Sequence) and not isinstance(value, str):
        return (" x " if "size" in name else ", ").join(map(_number, value)) + unit
    return _number(value) + unit


def _number(value: object) -> str:
    return f"{round(value, 3):g}" if isinstance(value, float) and abs(value) < 1e5 else str(value)
