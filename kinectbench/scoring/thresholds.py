"""The threshold of each category: searched on validation, read from a file, or fixed at 0.5."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinectbench.errors import ReleaseError, SettingsError
from kinectbench.release.metadata import strict_json
from kinectbench.release.release import Target
from kinectbench.scoring.counts import STEPS, THRESHOLD_STEPS, THRESHOLDS, Tally, protocol_counts
from kinectbench.scoring.metrics import ious
from kinectbench.workspace import pretty_json, sha256_file

FIXED = 0.5


@dataclass(frozen=True)
class Thresholds:
    """The thresholds of one method.

    Attributes:
        of: threshold by category, each k / 20 with k from 2 to 18.
        source: "validation", "file:<sha256 of the file>" or "fixed".
        warnings: one line each.
    """

    of: Mapping[str, float]
    source: str
    warnings: tuple[str, ...] = ()


def best_threshold(tallies: Sequence[Tally]) -> float:
    """The threshold of the highest mean pair IoU over all voxels (protocol `paper`), ties to the lowest.

    Args:
        tallies: the validation pairs of one category, at least one.

    Source: the paper; the tie rule is an own rule.
    """
    mean_iou = np.mean([ious(protocol_counts(tally, "paper")) for tally in tallies], axis=0)
    return THRESHOLDS[int(np.argmax(mean_iou))]


def searched_thresholds(
    categories: Sequence[str], tallies: Mapping[Target, Tally], has_validation: bool
) -> Thresholds:
    """Search each category's threshold on its validation pairs.

    Args:
        categories: the categories to be scored.
        tallies: of the validation targets that were predicted.
        has_validation: whether the release has a validation split at all.
    """
    if not tallies:
        why = (
            "no prediction for the validation split was supplied"
            if has_validation
            else "the benchmark has no validation split and no threshold file was given"
        )
        return Thresholds(dict.fromkeys(categories, FIXED), "fixed", (f"threshold fixed at {FIXED}: {why}",))
    of, warnings = {}, []
    for category in categories:
        here = [tally for target, tally in tallies.items() if target.category == category]
        of[category] = best_threshold(here) if here else FIXED
        if not here:
            warnings.append(f"threshold of {category} fixed at {FIXED}: no validation prediction of it")
    return Thresholds(of, "validation", tuple(warnings))


def read_thresholds(path: Path, categories: Sequence[str], test_objects: frozenset[str]) -> Thresholds:
    """Read a threshold file: JSON with `thresholds` {category: p} and, if known, `objects` it was found on.

    Raises:
        SettingsError: unreadable, a category is missing, a threshold is not one of the seventeen, or it was
            found on an object of the test split.
    """
    try:
        content = strict_json(path.read_text(), str(path))
    except (OSError, UnicodeDecodeError, ReleaseError) as error:
        raise SettingsError(f"{path}: cannot be read as a threshold file ({error})") from error
    given = content.get("thresholds") if isinstance(content, dict) else None
    if not isinstance(given, dict):
        raise SettingsError(f'{path}: a threshold file is {{"thresholds": {{"chair": 0.5}}}}')
    shared = sorted(test_objects.intersection(_objects(content, path)))
    if shared:
        raise SettingsError(f"{path}: found on objects of the test split ({', '.join(shared)}); use others")
    missing = [category for category in categories if category not in given]
    if missing:
        raise SettingsError(
            f"{path}: no threshold for {', '.join(missing)}; add {'it' if len(missing) == 1 else 'them'}"
        )
    of = {category: _step(given[category], f"{path}: threshold of {category}") for category in categories}
    return Thresholds(of, f"file:{sha256_file(path)}")


def thresholds_text(
    thresholds: Mapping[str, float], objects: Sequence[str], origin: Mapping[str, str]
) -> str:
    """A threshold file as text, the same for the same thresholds.

    Args:
        thresholds: by category.
        objects: they were found on; a benchmark that tests on one of them will refuse the file.
        origin: what to remember of them, such as the method's name; not read back.
    """
    return pretty_json({"thresholds": dict(thresholds), "objects": sorted(objects), **origin})


def _objects(content: Mapping[str, object], path: Path) -> list[str]:
    """The `objects` of a threshold file."""
    objects = content.get("objects", [])
    if not isinstance(objects, list) or not all(isinstance(name, str) for name in objects):
        raise SettingsError(f"{path}: 'objects' must be a list of names")
    return objects


def _step(value: object, where: str) -> float:
    """The threshold k / 20 that a number stands for."""
    number = float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else -1.0
    k = round(number * STEPS)
    if k not in THRESHOLD_STEPS or abs(number - k / STEPS) > 1e-9:
        raise SettingsError(f"{where} is {value!r}: it must be one of 0.1, 0.15, ... 0.9")
    return k / STEPS
