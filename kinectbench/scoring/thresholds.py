"""The threshold of each category: searched on validation, read from a file, or fixed at 0.5."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from kinectbench.core.artefacts.counted import Tally
from kinectbench.core.artefacts.provenance import ThresholdsFile
from kinectbench.core.errors import ReleaseError, SettingsError
from kinectbench.core.untrusted import decoded, read_plain
from kinectbench.release.release import Target
from kinectbench.scoring.counts import STEPS, THRESHOLD_STEPS, THRESHOLDS, protocol_counts
from kinectbench.scoring.metrics import ious

FIXED = 0.5
# Where a threshold is from; of a file its SHA-256 follows.
VALIDATION_SOURCE = "validation"
FIXED_SOURCE = "fixed"
FROM_FILE = "file:"


@dataclass(frozen=True)
class Thresholds:
    """The thresholds of one method.

    Attributes:
        of: threshold by category, each k / 20 with k from 2 to 18.
        source: "validation", "file:<sha256 of the file>" or "fixed".
        warnings: one line each.
        sources: the same by category: of a validation split without a category it is "fixed" there.
        objects: those that the thresholds were found on; None if a file does not name them.
    """

    of: Mapping[str, float]
    source: str
    warnings: tuple[str, ...] = ()
    sources: Mapping[str, str] = field(default_factory=dict)
    objects: tuple[str, ...] | None = ()


def best_threshold(tallies: Sequence[Tally]) -> float:
    """The threshold of the highest mean pair IoU over all voxels (protocol `paper`), ties to the lowest.

    Args:
        tallies: the validation pairs of one category, at least one.

    Source: the paper; the tie rule is an own rule.
    """
    mean_iou = np.mean([ious(protocol_counts(tally, "paper")) for tally in tallies], axis=0)
    return THRESHOLDS[int(np.argmax(mean_iou))]


def searched_thresholds(targets: Sequence[Target], tallies: Mapping[Target, Tally]) -> Thresholds:
    """Search each category's threshold on its validation pairs.

    Args:
        targets: of the release; the categories of its test split are scored.
        tallies: of the validation targets that were predicted.
    """
    categories = sorted({target.category for target in targets if target.split == "test"})
    if not tallies:
        why = (
            "no prediction for the validation split was supplied"
            if any(target.split == "validation" for target in targets)
            else "the benchmark has no validation split and no threshold file was given"
        )
        return _fixed(categories, (f"threshold fixed at {FIXED}: {why}",))
    of, sources, warnings, objects = {}, {}, [], set()
    for category in categories:
        here = [target for target in tallies if target.category == category]
        of[category] = best_threshold([tallies[target] for target in here]) if here else FIXED
        sources[category] = VALIDATION_SOURCE if here else FIXED_SOURCE
        objects |= {target.object for target in here}
        if not here:
            warnings.append(f"threshold of {category} fixed at {FIXED}: no validation prediction of it")
    if not objects:
        return _fixed(categories, tuple(warnings))
    return Thresholds(of, VALIDATION_SOURCE, tuple(warnings), sources, tuple(sorted(objects)))


def _fixed(categories: Sequence[str], warnings: tuple[str, ...]) -> Thresholds:
    """The same threshold for every category, which nothing was searched for."""
    fixed = dict.fromkeys(categories, FIXED_SOURCE)
    return Thresholds(dict.fromkeys(categories, FIXED), FIXED_SOURCE, warnings, fixed)


def read_thresholds(path: Path, categories: Sequence[str], test_objects: frozenset[str]) -> Thresholds:
    """Read a threshold file: JSON with `thresholds` {category: p} and, if known, `objects` it was found on.

    Raises:
        SettingsError: missing or unreadable, a category is missing, a threshold is not one of the seventeen,
            or it was found on an object of the test split.
    """
    try:
        content = read_plain(path, ThresholdsFile.MAX_BYTES)
        file = ThresholdsFile.parse(decoded(content, ThresholdsFile.MAX_BYTES, str(path)), str(path))
    except FileNotFoundError as error:
        raise SettingsError(f"{path}: no such file") from error
    except (OSError, UnicodeDecodeError, ReleaseError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise SettingsError(
            f"{path}: cannot be read as a threshold file ({why}); "
            f'a threshold file is {{"thresholds": {{"chair": 0.5}}}}'
        ) from error
    given = file.thresholds
    test_names = {_plain(name) for name in test_objects}
    shared = sorted(name for name in file.objects if _plain(name) in test_names)
    if shared:
        raise SettingsError(f"{path}: found on objects of the test split ({', '.join(shared)}); use others")
    missing = [category for category in categories if category not in given]
    if missing:
        raise SettingsError(
            f"{path}: no threshold for {', '.join(missing)}; add {'it' if len(missing) == 1 else 'them'}"
        )
    of = {category: _step(given[category], f"{path}: threshold of {category}") for category in categories}
    source = f"{FROM_FILE}{hashlib.sha256(content).hexdigest()}"
    warning = (
        "the file of the thresholds does not say on which objects they were found: perhaps on those of the "
        "test split"
    )
    return Thresholds(
        of,
        source,
        () if file.objects else (warning,),
        dict.fromkeys(categories, source),
        tuple(sorted(set(file.objects))) or None,
    )


def thresholds_for(path: Path, test: Sequence[Target]) -> Thresholds:
    """`read_thresholds` for the pairs of a test split; the same errors."""
    categories = sorted({target.category for target in test})
    return read_thresholds(path, categories, frozenset(target.object for target in test))


def _plain(name: str) -> str:
    """A name without what people overlook: case, and blanks around it."""
    return name.strip().casefold()


def _step(value: float, where: str) -> float:
    """The threshold k / 20 that a number stands for."""
    for k in THRESHOLD_STEPS:
        if abs(value - k / STEPS) <= 1e-9:
            return k / STEPS
    raise SettingsError(f"{where} is {value!r}: it must be one of 0.1, 0.15, ... 0.9")
