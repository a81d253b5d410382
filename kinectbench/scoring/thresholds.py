"""The threshold of each category: searched on validation pairs, the method's own, from a file, or 0.5."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from kinectbench.core import ReleaseError, SettingsError, decoded, read_plain
from kinectbench.core.artefacts.counted import Tally
from kinectbench.core.artefacts.provenance import ThresholdsFile, nearest_step
from kinectbench.release.release import Target
from kinectbench.scoring.counts import THRESHOLDS, ious, protocol_counts

FIXED = 0.5
# Sources of a threshold; after "file:" follows the file's SHA-256. "pooled": searched on the validation pairs
# of all other categories together.
VALIDATION_SOURCE = "validation"
POOLED_SOURCE = "pooled"
METHOD_SOURCE = "method"
FIXED_SOURCE = "fixed"
FROM_FILE = "file:"
STEPS_IN_WORDS = "0.1, 0.15, ... 0.9"
# Sources for which validation pairs were counted; and all sources except files, in order: the first that
# occurs is that of the whole table.
SEARCHED = (VALIDATION_SOURCE, POOLED_SOURCE)
SOURCES = (*SEARCHED, METHOD_SOURCE, FIXED_SOURCE)


@dataclass(frozen=True)
class Thresholds:
    """The thresholds of one method.

    Attributes:
        of: {category: threshold}, each k / 20 with k from 2 to 18.
        source: "file:<sha256>"; or the first of these sources that any category has: "validation", "pooled"
            (searched on pairs of other categories), "method" (the method's own threshold), "fixed" (0.5).
        warnings: one line each.
        sources: {category: source of its threshold}.
        objects: the objects on whose pairs the thresholds were chosen; None if they are not known, because a
            file does not name them, or because a threshold is the method's own.
    """

    of: Mapping[str, float]
    source: str
    warnings: tuple[str, ...] = ()
    sources: Mapping[str, str] = field(default_factory=dict)
    objects: tuple[str, ...] | None = ()


def best_threshold(tallies: Sequence[Tally]) -> float:
    """Return the threshold with the highest IoU, averaged over pairs; all voxels count (protocol `paper`).

    Args:
        tallies: voxel counts of the validation pairs of one category, at least one pair.

    Source: the paper. Of equally good thresholds, the lowest is taken; the paper does not say which.
    """
    mean_iou = np.mean([ious(protocol_counts(tally, "paper")) for tally in tallies], axis=0)
    return THRESHOLDS[int(np.argmax(mean_iou))]


def searched_thresholds(
    targets: Sequence[Target], tallies: Mapping[Target, Tally], own: float | None = None
) -> Thresholds:
    """Search the threshold of each category on its validation pairs.

    A category without validation pairs gets the method's own threshold. If the method has none, it gets the
    threshold that is best for the validation pairs of all other categories together; if there are none, 0.5.

    Args:
        targets: all targets of the release; every category with a test target gets a threshold.
        tallies: {validation target that was predicted: its voxel counts}.
        own: the method's own threshold, k / 20 with k from 2 to 18; None if it has none.
    """
    categories = sorted({target.category for target in targets if target.split == "test"})
    by_category: dict[str, list[Target]] = {category: [] for category in categories}
    for target in tallies:
        by_category.setdefault(target.category, []).append(target)
    searched = [category for category in categories if by_category[category]]
    of = {category: best_threshold([tallies[t] for t in by_category[category]]) for category in searched}
    sources = dict.fromkeys(searched, VALIDATION_SOURCE)
    found_on = {target.object for category in searched for target in by_category[category]}
    left = [category for category in categories if category not in of]
    if left and own is None and tallies:
        found_on = {target.object for target in tallies}
    value, source = _without_validation(tallies, own)
    of |= dict.fromkeys(left, value)
    sources |= dict.fromkeys(left, source)
    return Thresholds(
        {category: of[category] for category in categories},
        next((word for word in SOURCES if word in sources.values()), FIXED_SOURCE),
        (_fallback_warning(left, value, source, targets, tallies),) if left else (),
        {category: sources[category] for category in categories},
        None if METHOD_SOURCE in sources.values() else tuple(sorted(found_on)),
    )


def _without_validation(tallies: Mapping[Target, Tally], own: float | None) -> tuple[float, str]:
    """Return the threshold of categories without a validation pair (own, pooled or 0.5), and its source."""
    if own is not None:
        return own, METHOD_SOURCE
    if tallies:
        return best_threshold(list(tallies.values())), POOLED_SOURCE
    return FIXED, FIXED_SOURCE


def _fallback_warning(
    categories: Sequence[str],
    value: float,
    source: str,
    targets: Sequence[Target],
    tallies: Mapping[Target, Tally],
) -> str:
    """Return the warning that categories without predicted validation pairs get the threshold `value`."""
    how = {
        METHOD_SOURCE: f"is the method's own, {value:g}",
        POOLED_SOURCE: f"is {value:g}, which all validation predictions give together",
        FIXED_SOURCE: f"fixed at {value:g}",
    }[source]
    if tallies:
        return f"threshold of {', '.join(categories)} {how}: no validation prediction of it"
    if any(target.split == "validation" for target in targets):
        return f"threshold {how}: no prediction for the validation split was supplied"
    return f"threshold {how}: the benchmark has no validation split and no threshold file was given"


def read_thresholds(path: Path, categories: Sequence[str], test_objects: frozenset[str]) -> Thresholds:
    """Read a threshold file: JSON with `thresholds`, {category: threshold}, and optionally `objects`.

    `objects` names the objects on whose pairs the thresholds were chosen.

    Raises:
        SettingsError: the file is missing or unreadable, it has no threshold for a category, a threshold is
            not k / 20 with k from 2 to 18, or `objects` names an object of the test split.
    """
    try:
        content = read_plain(path, ThresholdsFile.MAX_BYTES)
        file = ThresholdsFile.parse(decoded(content, ThresholdsFile.MAX_BYTES, str(path)), str(path))
    except FileNotFoundError as error:
        raise SettingsError(f"{path}: no such file", what="no-file") from error
    except (OSError, UnicodeDecodeError, ReleaseError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise SettingsError(
            f"{path}: cannot be read as a threshold file ({why}); "
            f'a threshold file is {{"thresholds": {{"chair": 0.5}}}}',
            what="bad-thresholds",
        ) from error
    given = file.thresholds
    test_names = {_plain(name) for name in test_objects}
    shared = sorted(name for name in file.objects if _plain(name) in test_names)
    if shared:
        raise SettingsError(
            f"{path}: found on objects of the test split ({', '.join(shared)}); use others",
            what="bad-thresholds",
        )
    missing = [category for category in categories if category not in given]
    if missing:
        raise SettingsError(
            f"{path}: no threshold for {', '.join(missing)}; add {'it' if len(missing) == 1 else 'them'}",
            what="bad-thresholds",
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
    """Read a threshold file for the pairs of a test split; errors are as in `read_thresholds`."""
    categories = sorted({target.category for target in test})
    return read_thresholds(path, categories, frozenset(target.object for target in test))


def _plain(name: str) -> str:
    """Return a name without surrounding blanks, and with case folded."""
    return name.strip().casefold()


def _step(value: float, where: str) -> float:
    """Return the threshold k / 20 that equals a number; refuse others in a line that begins with `where`."""
    step = nearest_step(value)
    if step is None:
        raise SettingsError(
            f"{where} is {value!r}: it must be one of {STEPS_IN_WORDS}", what="bad-thresholds"
        )
    return step
