"""Caveats of a score table, as one short mark each."""

from kinectbench.core import listed
from kinectbench.core.artefacts import score_marks as kinds
from kinectbench.core.artefacts.score_figures import any_in_space
from kinectbench.core.artefacts.score_marks import ACCOUNTED, Mark
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.engine.artefact import VERSIONS
from kinectbench.scoring.base_rates import BASELINE_NAMES
from kinectbench.scoring.thresholds import FIXED, FIXED_SOURCE, FROM_FILE, METHOD_SOURCE, POOLED_SOURCE

# Maximum number of names in a mark.
LISTED = 3


def marks_of(table: ScoreTable) -> tuple[Mark, ...]:
    """Return the caveats of a table: baseline, old version, thresholds, missing pairs, closed meshes.

    Args:
        table: a score table; its stored `marks` are ignored.
    """
    marks: list[tuple[kinds.Kind, str]] = [
        (kinds.BASELINE, _baseline(table)),
        (kinds.OLDER_VERSION, _older(table)),
        (kinds.MISSING_AS_EMPTY, _missing(table)),
        (kinds.VALIDATION_PARTIAL, _validation(table)),
        (kinds.THRESHOLDS_POOLED, _from(table, POOLED_SOURCE, "pooled over other categories,")),
        (kinds.THRESHOLDS_OWN, _from(table, METHOD_SOURCE, "the method's own,")),
        (kinds.THRESHOLDS_FIXED, _from(table, FIXED_SOURCE, "fixed at")),
        (kinds.THRESHOLDS_UNCHECKED, _unchecked(table)),
        (kinds.CLOSED, _closed(table)),
    ]
    return tuple(Mark(kind=kind, words=words) for kind, words in marks if words)


def _baseline(table: ScoreTable) -> str:
    """Return a mark if the table is a baseline's; older tables are recognised by the method's name."""
    by_name = table.settings.baseline_version is None and table.method.lower() in BASELINE_NAMES
    return "baseline" if table.baseline or table.settings.of_baseline or by_name else ""


def _older(table: ScoreTable) -> str:
    """Return a mark if the table is of an old version, whose tables lack a part of the provenance."""
    version = table.score_version
    return "" if version >= ACCOUNTED else f"score version {version}, now {VERSIONS['score']}"


def _missing(table: ScoreTable) -> str:
    """Return a mark with the number of test pairs without a prediction, scored as empty grids."""
    test = {row.pair: row.cells for row in table.rows}
    missing = [name for name, cells in test.items() if not cells]
    return f"{len(missing)} of {len(test)} missing, scored as empty" if missing else ""


def _validation(table: ScoreTable) -> str:
    """Return a mark if only some validation pairs were predicted."""
    use = table.validation
    if use is None or use.predicted >= use.pairs:
        return ""
    return f"{use.predicted} of {use.pairs} validation pairs predicted"


def _from(table: ScoreTable, source: str, words: str) -> str:
    """Return a mark with the categories whose threshold is from `source`, which `words` describe."""
    # Most methods in space have no thresholds. Thresholds of grid methods are searched or declared.
    has_none = any_in_space(table.settings.protocols) and table.threshold_source == FIXED_SOURCE
    sources = {} if has_none else table.threshold_source_by_category
    names = [name for name, of in sorted(sources.items()) if of == source]
    value = table.thresholds.get(names[0], FIXED) if names else FIXED
    if sources and table.threshold_source == source and len(names) == len(sources):
        return f"thresholds {words} {value:g}"
    return f"threshold {words} {value:g}: {listed(names, LISTED)}" if names else ""


def _unchecked(table: ScoreTable) -> str:
    """Return a mark if thresholds are from a file that does not name the objects they were chosen on."""
    if not table.threshold_source.startswith(FROM_FILE) or table.threshold_objects is not None:
        return ""
    return "thresholds from a file that names no objects"


def _closed(table: ScoreTable) -> str:
    """Return a mark that counts the open meshes and point clouds made solid by `--close`; "" if none."""
    closed = {row.pair for row in table.rows if row.closed is not None}
    views = len({row.pair for row in table.rows})
    return f"{len(closed)} of {views} open, closed by {table.settings.close}" if closed else ""
