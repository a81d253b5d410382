"""Count one prediction against its truth: all that the table needs to know of a pair."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from kinectbench.core.artefacts.scores import SurfaceMetrics
from kinectbench.core.errors import PredictionError
from kinectbench.core.storage import canonical_json, sha256_text, storage_errors
from kinectbench.core.voxels.pair_file import FULL_CELLS
from kinectbench.core.voxels.resample import HALF_PIXEL
from kinectbench.engine.artefact import VERSIONS
from kinectbench.release.release import Target
from kinectbench.scoring.counts import Prediction, Tally, ceiling, occupied, protocol_counts, tally
from kinectbench.scoring.mesh_prediction import MESHES
from kinectbench.scoring.metrics import ious
from kinectbench.scoring.prediction_file import load_prediction
from kinectbench.scoring.surface import surface_metrics
from kinectbench.scoring.truth import Truth, read_truth, read_voxel_size

EMPTY_CELLS = 16


@dataclass(frozen=True)
class Counting:
    """How pairs are counted; the same for all pairs of a run.

    Attributes:
        protocols: some of "paper", "known", "occluded".
        upsampling: "half-pixel" or "corner-aligned".
        surface: whether surface metrics are computed.
    """

    protocols: tuple[str, ...]
    upsampling: str = HALF_PIXEL
    surface: bool = True


@dataclass(frozen=True)
class PairResult:
    """What was counted of one pair.

    Attributes:
        tally: of the prediction.
        cells: side of the prediction; 0 if there was none.
        ceilings: {protocol: the IoU that this side can reach}.
        surface: {protocol: surface metrics}; empty if they were not asked for.
        digest: BLAKE3 of the prediction's file, as "blake3:<hex>"; None if there is no file.
    """

    tally: Tally
    cells: int
    ceilings: Mapping[str, float]
    surface: Mapping[str, SurfaceMetrics]
    digest: str | None

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values; floats keep every bit."""
        counted = {name: values.tolist() for name, values in vars(self.tally).items()}
        surface = {protocol: asdict(values) for protocol, values in self.surface.items()}
        return {**vars(self), "tally": counted, "surface": surface}

    @staticmethod
    def from_json(content: Mapping[str, Any]) -> "PairResult":
        """The inverse of `to_json`."""
        counted = content["tally"]
        voxels, above = (np.array(counted[name], np.int64) for name in ("voxels", "above"))
        surface = {name: SurfaceMetrics(**values) for name, values in content["surface"].items()}
        return PairResult(
            Tally(voxels, above, np.array(counted["ce_sum"], np.float64)),
            content["cells"],
            content["ceilings"],
            surface,
            content["digest"],
        )


@dataclass(frozen=True)
class Job:
    """One pair to be counted.

    Attributes:
        target: the pair.
        truth: its pair file.
        file: the prediction's file, None for an empty grid.
        threshold: for the surface metrics; None leaves them out.
        counting: how.
        earlier: what an interrupted run wrote of this pair, as {"key", "result"}, or None.
    """

    target: Target
    truth: Path
    file: Path | None
    threshold: float | None
    counting: Counting
    earlier: Mapping[str, Any] | None = None

    def key(self, digest: str | None) -> str:
        """What a result depends on; `digest` is that of the prediction's file."""
        settings = (asdict(self.counting), self.threshold)
        return sha256_text(canonical_json([VERSIONS["score"], self.target.sha256, digest, settings]))


def count_job(job: Job) -> PairResult | str:
    """Count one pair; the reason where its prediction cannot be scored."""
    try:
        digest = None
        if job.file is None:
            prediction: Prediction = np.zeros((EMPTY_CELLS,) * 3, np.bool_)
        else:
            mesh = job.file.suffix in MESHES
            size_m = read_voxel_size(job.truth, job.target.sha256) if mesh else None
            prediction = load_prediction(job.file, job.target.name + job.file.suffix, size_m)
            digest = _blake3(job.file)
    except PredictionError as error:
        return str(error)
    if job.earlier is not None and job.earlier["key"] == job.key(digest):
        return PairResult.from_json(job.earlier["result"])
    truth = read_truth(job.truth, job.target.sha256)
    result = count(prediction, truth, job.counting, job.threshold)
    return replace(result, digest=digest, cells=0 if job.file is None else result.cells)


def count(prediction: Prediction, truth: Truth, counting: Counting, threshold: float | None) -> PairResult:
    """Count a prediction in memory; `threshold` is for the surface metrics, None leaves them out."""
    side, protocols = len(prediction), counting.protocols
    reached = ceilings(truth, FULL_CELLS if threshold is None else side, counting)
    surface: Mapping[str, SurfaceMetrics] = {}
    if counting.surface and threshold is not None:
        surface = surface_metrics(occupied(prediction, threshold, counting.upsampling), truth, protocols)
    return PairResult(tally(prediction, truth, counting.upsampling), side, reached, surface, None)


def ceilings(truth: Truth, side: int, counting: Counting) -> Mapping[str, float]:
    """{protocol: the IoU that a prediction of this side can reach}; 1 from 256 on."""
    if side >= FULL_CELLS:
        return dict.fromkeys(counting.protocols, 1.0)
    best = ceiling(truth, side, counting.upsampling)
    return {name: float(ious(protocol_counts(best, name)).max()) for name in counting.protocols}


def _blake3(path: Path) -> str:
    # SHA-256 of a 33 MB prediction takes longer than all the rest of its scoring.
    from blake3 import blake3

    digest = blake3()
    try:
        with path.open("rb") as file:
            while chunk := file.read(1 << 20):
                digest.update(chunk)
        return f"blake3:{digest.hexdigest()}"
    except OSError as error:
        raise PredictionError(f"{path}: cannot be read ({error.strerror or error})") from error


JOURNAL = ".counted.jsonl"


class Journal:
    """Results by pair, on disk as soon as they are known; None as folder keeps nothing."""

    def __init__(self, folder: Path | None) -> None:
        self._path = None if folder is None else folder / JOURNAL
        self._earlier = {} if self._path is None else _read(self._path)

    def earlier(self, pair: str) -> Mapping[str, Any] | None:
        """What an earlier run wrote of a pair."""
        return self._earlier.get(pair)

    def add(self, job: Job, result: PairResult) -> None:
        """Remember a result.

        Raises:
            StorageError: the disk is full or read-only.
        """
        key = job.key(result.digest)
        if self._path is None or self._earlier.get(job.target.name, {}).get("key") == key:
            return
        line = canonical_json({"pair": job.target.name, "key": key, "result": result.to_json()})
        with storage_errors(self._path):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a") as file:
                file.write(line + "\n")

    def remove(self) -> None:
        """All is done: the table holds it."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)


def _read(path: Path) -> dict[str, dict[str, Any]]:
    """{pair: {"key", "result"}}; lines that were not written whole are left out."""
    found = {}
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError):
        return {}
    for line in lines:
        try:
            content = json.loads(line)
            PairResult.from_json(content["result"])
            found[str(content["pair"])] = {"key": content["key"], "result": content["result"]}
        except (ValueError, KeyError, TypeError, AttributeError):
            continue
    return found
