"""Find predictions that can be counted but are probably wrong."""

from collections.abc import Iterator, Mapping

from kinectbench.core.artefacts.counted import PairResult
from kinectbench.core.artefacts.targets import Target
from kinectbench.scoring.counts import THRESHOLDS
from kinectbench.scoring.thresholds import Thresholds

# Largest share of a mesh's volume outside the cube that is plausible: a cube that is placed by the view alone
# may cut off as much of the true shape (setting `framing: view` of pairs).
MOST_OUTSIDE = 0.05
# A smaller share of a mesh outside the grid is not reported.
LEAST_OUTSIDE = 0.001


def suspicious_lines(
    results: Mapping[Target, PairResult], thresholds: Thresholds, of_baseline: bool
) -> Iterator[str]:
    """Yield lines on how many meshes are cut off at the cube, and how many predictions are empty or full.

    Args:
        results: the result of every counted pair; its `cells` is 0 if there was no prediction.
        thresholds: threshold of every category of the test split.
        of_baseline: whether they are a baseline's; then empty and full predictions are not reported.
    """
    outside = {t.name: of.outside_share for t, of in results.items() if of.outside_share >= LEAST_OUTSIDE}
    if outside:
        worst = max(outside, key=lambda name: outside[name])
        frame = ": in another frame?" if outside[worst] > MOST_OUTSIDE else ""
        files = "1 mesh lies" if len(outside) == 1 else f"{len(outside)} meshes lie"
        yield (
            f"{files} partly outside the cube and {'is' if len(outside) == 1 else 'are'} cut off there, "
            f"{worst} by {outside[worst]:.1%} of its volume{frame}"
        )
    if of_baseline:
        return
    test = {t: of for t, of in results.items() if t.split == "test" and of.cells}
    empty: list[str] = []
    full: list[str] = []
    for target, of in sorted(test.items(), key=lambda item: item[0]):
        above = int(of.tally.above[THRESHOLDS.index(thresholds.of[target.category])].sum())
        if above in (0, int(of.tally.voxels.sum())):
            (full if above else empty).append(target.name)
    for names, what in ((empty, "predict nothing"), (full, "fill the whole cube")):
        if names:
            yield f"{len(names)} of {len(test)} predictions {what} at their threshold, such as {names[0]}"
