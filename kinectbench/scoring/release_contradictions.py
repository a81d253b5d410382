"""Check that a score table agrees with the release: pairs, objects, hashes of the truth, and splits.

The caller has already compared the release's hash with the one in the table. No pair file is read here;
`recheck` checks base rates and coverage.
"""

from collections.abc import Iterator

from kinectbench.core import printable
from kinectbench.core.artefacts.score_figures import ScoreRow
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.artefacts.targets import Target
from kinectbench.core.voxels.pair_file import SHARE_DECIMALS
from kinectbench.release.release import Release
from kinectbench.scoring.protocols import EVERY_VOXEL, PRIMARY
from kinectbench.scoring.thresholds import VALIDATION_SOURCE


def release_contradictions(table: ScoreTable, release: Release) -> Iterator[str]:
    """Yield a sentence for each value in a table that contradicts the release it was scored against."""
    test = {target.name: target for target in release.split("test")}
    yield from _rows(table, test)
    scored = {row.pair for row in table.rows}
    if table.complete and len(scored) < len(test):
        first = next(name for name in test if name not in scored)
        yield f"called complete, but has {len(scored)} of the {len(test)} test pairs; {first} is not there"
    yield from _hashes(table, release)
    yield from _validation(table, release)
    for name, quality in table.truth_quality.items():
        of = release.metadata.recordings.get(name)
        if of is None or of.quality.json_value() != quality.json_value():
            yield f"'truth_quality.{printable(name, 60)}' is not what the release says of its truth"


def _rows(table: ScoreTable, test: dict[str, Target]) -> Iterator[str]:
    """Report rows whose pair is no test pair, or whose object, category or unknown share is wrong."""
    for row in table.rows:
        target = test.get(row.pair)
        if target is None:
            yield f"{printable(row.pair, 60)} is no pair of the test split"
        elif (row.object, row.category) != (target.object, target.category):
            yield f"{row.pair} is of {target.object}, a {target.category}; the table says otherwise"
        elif target.unknown_share is not None:
            yield from (f"{row.pair} {words}" for words in _unknown(row, target.unknown_share))


def _unknown(row: ScoreRow, share: float) -> Iterator[str]:
    """Report a row whose unknown share of the true shape is not `share`, or which wrongly has no scores.

    Missing scores are checked under `known` and under the protocols that count every voxel; for other
    protocols, the pair file would be needed.
    """
    if row.unknown_share is not None and abs(row.unknown_share - share) > 10**-SHARE_DECIMALS:
        yield f"has {row.unknown_share:g} of its true shape unknown; the release says {share:g}"
    elif row.iou is None and (row.protocol in EVERY_VOXEL or (row.protocol == PRIMARY and share < 1)):
        yield f"is left out under {row.protocol} as all unknown; the release says {share:g} of its shape"


def _hashes(table: ScoreTable, release: Release) -> Iterator[str]:
    """Report entries of `hashes` for unknown or training pairs, or with a wrong hash of the truth."""
    known = {target.name: target for target in release.targets if target.split != "train"}
    for name, of in table.hashes.items():
        target = known.get(name)
        if target is None:
            yield f"'hashes' has {printable(name, 60)}, no pair of the test or validation split"
        elif of.truth != target.sha256:
            yield f"{name}: scored against another truth than the release's"


def _validation(table: ScoreTable, release: Release) -> Iterator[str]:
    """Report a wrong number of validation pairs, and "validation" as source for categories without any."""
    validation = release.split("validation")
    if table.validation is not None and table.validation.pairs != len(validation):
        yield f"states {table.validation.pairs} validation pairs; the release has {len(validation)}"
    categories = {target.category for target in validation}
    for name, source in table.threshold_source_by_category.items():
        if source == VALIDATION_SOURCE and name not in categories:
            yield f"the threshold of {printable(name, 60)} is from validation, which has no pair of it"
