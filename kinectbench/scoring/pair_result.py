"""Count the voxels in which a prediction and its truth agree; store each pair's counts to resume a run.

To "count a pair" means: read its prediction and its truth, and compute the voxel counts that all voxel
metrics follow from, and the surface metrics if requested.
"""

import contextlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from kinectbench.core import (
    PredictionError,
    StorageError,
    append_plain,
    canonical_json,
    read_plain_text,
    sha256_text,
)
from kinectbench.core.artefacts.counted import JOURNAL, JOURNALS, PART_JOURNAL, CountedPair, PairResult
from kinectbench.core.artefacts.score_figures import SurfaceMetrics
from kinectbench.core.voxels.pair_file import FULL_CELLS
from kinectbench.core.voxels.resample import HALF_PIXEL
from kinectbench.engine.artefact import VERSIONS
from kinectbench.engine.shards import Shard
from kinectbench.release.release import Release, Target
from kinectbench.scoring.counts import Prediction, ceiling_tallies, ious, occupied, protocol_counts, tallies
from kinectbench.scoring.mesh_prediction import MESHES
from kinectbench.scoring.prediction_file import load_hashed
from kinectbench.scoring.protocols import further_grids, protocols_of
from kinectbench.scoring.read_table import differing
from kinectbench.scoring.surface import surface_metrics
from kinectbench.scoring.truth import PackedTruth, read_packed_truth, read_voxel_size

EMPTY_CELLS = 16
# Maximum size of a journal; a pair takes some kilobytes.
MOST_JOURNAL_BYTES = 1 << 30
# Minimum number and minimum share of stored results that are computed again before the rest is accepted. If
# half of the results were invented, four drawn results would all be genuine in one case of sixteen.
LEAST_CHECKED, CHECKED_SHARE = 4, 0.01


def drawn(names: Iterable[str], of: str) -> frozenset[str]:
    """Return a random sample of pairs, at least four and 1 %, to be counted again as a check.

    Args:
        names: the names of all pairs.
        of: seed of the sample: the text or hash of the whole file, so that any changed row changes the
            sample.
    """
    order = sorted(set(names), key=lambda name: sha256_text(f"{of} {name}"))
    return frozenset(order[: max(LEAST_CHECKED, int(CHECKED_SHARE * len(order)))])


@dataclass(frozen=True)
class Counting:
    """The options by which all pairs of a run are counted.

    Attributes:
        protocols: names of `PROTOCOLS`.
        upsampling: "half-pixel" or "corner-aligned".
        surface: whether surface metrics are computed.
    """

    protocols: tuple[str, ...]
    upsampling: str = HALF_PIXEL
    surface: bool = True

    @property
    def further_grids(self) -> tuple[str, ...]:
        """Names of the grids of a pair file that the protocols need beside `full`, `known` and `seen`."""
        return further_grids(self.protocols)


def counting_of(
    release: Release, protocols: Sequence[str] | None, upsampling: str, surface: bool
) -> Counting:
    """Return how the pairs of a release are counted; arguments and errors are as in `score`."""
    return Counting(protocols_of(release, protocols), upsampling, surface)


@dataclass(frozen=True)
class PairJob:
    """One pair to count.

    Attributes:
        target: the pair.
        truth: the pair file.
        file: the prediction's file; None for an empty grid.
        threshold: threshold for the surface metrics; None leaves out these metrics, and sets all ceilings to
            1.
        counting: how the pair is counted.
        earlier: the pair's result in the journal of an interrupted run; None if there is none.
        check: whether the pair is counted in spite of `earlier`, and an error raised if the two results
            differ.
    """

    target: Target
    truth: Path
    file: Path | None
    threshold: float | None
    counting: Counting
    earlier: CountedPair | None = None
    check: bool = False

    def key(self, digest: str | None) -> str:
        """Return the hash of all inputs of a result; `digest` is the digest of the prediction's file."""
        # Without surface metrics only the presence of a threshold matters; one part of a run may not know its
        # value.
        threshold = self.threshold if self.counting.surface else self.threshold is not None
        settings = (asdict(self.counting), threshold)
        return sha256_text(canonical_json([VERSIONS["score"], self.target.sha256, digest, settings]))


def count_job(job: PairJob) -> PairResult | str:
    """Read and count one pair; if its prediction cannot be scored, return the reason instead.

    Raises:
        ReleaseError: the truth is missing, or differs from the published one.
        StorageError: the stored result of an earlier run, computed again as a check, differs.
    """
    digest, outside = None, 0.0
    try:
        if job.file is None:
            prediction: Prediction = np.zeros((EMPTY_CELLS,) * 3, np.bool_)
        else:
            mesh = job.file.suffix in MESHES
            size_m = read_voxel_size(job.truth, job.target.sha256) if mesh else None
            loaded = load_hashed(job.file, job.target.name + job.file.suffix, size_m)
            prediction, digest, outside = loaded.prediction, loaded.digest, loaded.outside_share
    except PredictionError as error:
        return str(error)
    earlier = job.earlier
    if earlier is not None and (earlier.key != job.key(digest) or earlier.pair != job.target.name):
        earlier = None
    if earlier is not None and not job.check:
        return earlier.result
    truth = read_packed_truth(job.truth, job.target.sha256, job.counting.further_grids)
    result = count(prediction, truth, job.counting, job.threshold)
    cells = 0 if job.file is None else result.cells
    result = replace(result, digest=digest, cells=cells, outside_share=outside)
    if earlier is not None:
        again = earlier.model_copy(update={"result": result})
        if any(differing(earlier, again, "", whole=True)):
            raise StorageError(
                f"{job.target.name}: {JOURNAL} beside the scores says otherwise than its prediction: remove "
                f"{JOURNALS} there, and score again",
                what="other-content",
            )
    return result


def count(
    prediction: Prediction, truth: PackedTruth, counting: Counting, threshold: float | None
) -> PairResult:
    """Count a prediction that is in memory; without `threshold`, skip surface metrics, set ceilings to 1."""
    side = len(prediction)
    reached = ceilings(truth, FULL_CELLS if threshold is None else side, counting)
    surface = surfaces(prediction, truth, counting, threshold)
    counted, others = tallies(prediction, truth, counting.protocols, counting.upsampling)
    return PairResult(counted, side, reached, surface, None, tallies=others)


def surfaces(
    prediction: Prediction, truth: PackedTruth, counting: Counting, threshold: float | None
) -> Mapping[str, SurfaceMetrics]:
    """Return {protocol: surface metrics}; {} without a threshold, or if `counting.surface` is False."""
    if not counting.surface or threshold is None:
        return {}
    packed = occupied(prediction, threshold, counting.upsampling)
    return surface_metrics(packed, truth, counting.protocols)


def ceilings(truth: PackedTruth, side: int, counting: Counting) -> Mapping[str, float]:
    """Return {protocol: best IoU of the truth when averaged to side^3 cells}; 1 if `side` is at least 256."""
    if side >= FULL_CELLS:
        return dict.fromkeys(counting.protocols, 1.0)
    best, others = ceiling_tallies(truth, side, counting.protocols, counting.upsampling)
    of = {name: protocol_counts(others.get(name, best), name) for name in counting.protocols}
    return {name: float(ious(counts).max()) for name, counts in of.items()}


class Journal:
    """The results of pairs, written to disk as soon as they are known.

    Args:
        folder: where the results are kept; None keeps nothing.
        shard: the part of the pairs that this run counts; None for all. Each part has a file of its own; all
            files are read.
    """

    def __init__(self, folder: Path | None, shard: Shard | None = None) -> None:
        name = JOURNAL if shard is None else PART_JOURNAL.format(number=shard.number, of=shard.of)
        self._path = None if folder is None else folder / name
        self._earlier: dict[str, CountedPair] = {}
        whole = ""
        for path in () if folder is None else sorted(folder.glob(JOURNALS)):
            text = _text(path)
            self._earlier |= _pairs(text)
            whole = sha256_text(f"{whole} {text}")
        self._checked = drawn(self._earlier, whole)

    def earlier(self, pair: str) -> CountedPair | None:
        """Return an earlier run's result of a pair; None if there is none."""
        return self._earlier.get(pair)

    def is_checked(self, pair: str) -> bool:
        """Return whether a pair must be counted again, to check an earlier run's result."""
        return pair in self._checked

    def add(self, job: PairJob, result: PairResult) -> None:
        """Write a pair's result to disk, unless an earlier run has written it.

        Raises:
            StorageError: the disk is full or read-only, or the journal's path is no plain file.
        """
        counted = CountedPair(pair=job.target.name, key=job.key(result.digest), result=result)
        earlier = self.earlier(counted.pair)
        if self._path is None or (earlier is not None and earlier.key == counted.key):
            return
        append_plain(self._path, counted.line())

    def remove(self) -> None:
        """Delete the journal's files; call it when the table is complete."""
        for path in () if self._path is None else self._path.parent.glob(JOURNALS):
            path.unlink(missing_ok=True)


def _text(path: Path) -> str:
    try:
        return read_plain_text(path, MOST_JOURNAL_BYTES)
    except (OSError, UnicodeDecodeError):
        return ""


def _pairs(text: str) -> dict[str, CountedPair]:
    """Return {pair: its result} from a journal's text; invalid (such as incomplete) lines are skipped."""
    by_name = {}
    for line in text.splitlines():
        with contextlib.suppress(ValidationError):
            counted = CountedPair.model_validate_json(line, strict=True)
            by_name[counted.pair] = counted
    return by_name
