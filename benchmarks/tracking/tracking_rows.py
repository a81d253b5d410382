"""One row of the tracker's table: what one tracker did on one recording, measured, judged and kept."""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tracking_cases import RIVALS, Bar, Case
from tracking_measure import Outcome

import kinectbench
from kinectbench.core.extras import package_version
from kinectbench.core.trajectory.compare import MIN_MATCHED, TrajectoryError, compare_poses, has_pose
from kinectbench.core.types import Float64

POSES = ("T_world_camera", "T_true")
PACKAGE = Path(kinectbench.__file__).parent
# The rooms that a trajectory depends on.
TRACKER = ("stages/track", "settings", "core")


@dataclass(frozen=True)
class Row:
    """A measured case; what came of it as figures.

    Attributes:
        case: the recording.
        method: the tracker.
        outcome: its poses, time and memory.
    """

    case: Case
    method: str
    outcome: Outcome

    @property
    def posed(self) -> NDArray[np.bool_]:
        """(n,) frames with a pose."""
        return has_pose(self.outcome.T_world_camera)

    @property
    def share(self) -> float:
        """Share of frames with a pose."""
        return float(self.posed.mean())

    def error(self, among: NDArray[np.bool_] | None = None) -> TrajectoryError | None:
        """Against the truth, over the frames that have a pose (and are among these); None if too few."""
        used = self.posed & has_pose(self.outcome.T_true)
        used &= True if among is None else among
        if used.sum() < MIN_MATCHED:
            return None
        return compare_poses(self.outcome.T_world_camera[used], self.outcome.T_true[used])

    def ate_mm(self, among: NDArray[np.bool_] | None = None) -> float:
        """Root mean square of the absolute trajectory error; NaN if there are too few poses."""
        error = self.error(among)
        return 1000 * error.ate_m.rmse if error else float("nan")

    @property
    def rpe_mm_per_m(self) -> float:
        """Root mean square of the relative error over a metre of path; NaN if there is no such piece."""
        error = self.error()
        return 1000 * error.rpe_metre_m.rmse if error and error.rpe_metre_m else float("nan")

    @property
    def cpu_ms(self) -> float:
        """CPU time per frame; of a rival that gave up, per frame that it posed."""
        frames = int(self.posed.sum()) if self.method in RIVALS else len(self.posed)
        return 1000 * self.outcome.cpu_s / max(frames, 1)

    def short_of(self, bar: Bar | None) -> list[str]:
        """What misses the bar; NaN misses it."""
        if bar is None:
            return []
        held = {
            "ATE": self.ate_mm() <= bar.ate_mm,
            "RPE": bar.rpe_mm_per_m is None or self.rpe_mm_per_m <= bar.rpe_mm_per_m,
            "tracked": self.share >= bar.share,
            "frames lost unnamed": self.outcome.unnamed == 0,
        }
        return [name for name, holds in held.items() if not holds]

    def line(self) -> str:
        """The row as it is printed."""
        words = f"{self.case.name:22} {self.method:17} ATE {self.ate_mm():7.2f} mm"
        words += f"  RPE {self.rpe_mm_per_m:7.2f} mm/m  tracked {self.share:6.1%}"
        words += f"  CPU {self.cpu_ms:5.0f} ms/frame  peak {self.outcome.peak_mb:5.0f} MB"
        bar = self.case.bars.get(self.method)
        if bar is not None:
            asked = f"<= {bar.ate_mm:g} mm"
            asked += f", {bar.rpe_mm_per_m:g} mm/m" if bar.rpe_mm_per_m else ""
            short = self.short_of(bar)
            verdict = f"FALLS SHORT: {', '.join(short)}" if short else "ok"
            words += f"  [{asked}, {bar.share:.0%}: {verdict}]"
        return words + (f"  ({self.outcome.problem})" if self.outcome.problem else "")

    def figures(self) -> dict[str, Any]:
        """The row as JSON values."""
        return {
            "group": self.case.group,
            "recording": self.case.name,
            "method": self.method,
            "frames": len(self.posed),
            "ate_mm": self.ate_mm(),
            "rpe_mm_per_m": self.rpe_mm_per_m,
            "tracked": self.share,
            "cpu_ms": self.cpu_ms,
            "peak_mb": self.outcome.peak_mb,
            "short_of": self.short_of(self.case.bars.get(self.method)),
            "problem": self.outcome.problem,
            **self.outcome.more,
        }


@dataclass(frozen=True)
class KeptRows:
    """Finished rows in a folder, a JSON file each; one that other code made is measured again.

    Attributes:
        folder: is made if it is not there.
        fresh: nothing kept is used.
    """

    folder: Path
    fresh: bool

    def kept(self, case: Case, method: str) -> Outcome | None:
        """What is kept of a row that the same code made; None if nothing is."""
        path = self._path(case, method)
        if self.fresh or not path.is_file():
            return None
        record = json.loads(path.read_text())
        if record.pop("made_by") != code_of(method):
            return None
        estimate, true = (_matrices(record.pop(name)) for name in POSES)
        return Outcome(estimate, true, **record)

    def keep(self, case: Case, method: str, made_by: str, outcome: Outcome) -> None:
        """Write a row whole or not at all; `made_by` is the `code_of` the method when it was started."""
        record = {**vars(outcome), "made_by": made_by}
        for name in POSES:
            record[name] = [T.ravel().tolist() if np.isfinite(T).all() else None for T in record[name]]
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self._path(case, method)
        path.with_suffix(".part").write_text(json.dumps(record))
        path.with_suffix(".part").replace(path)

    def _path(self, case: Case, method: str) -> Path:
        return self.folder / f"{case.name}.{method}.json".replace(" ", "_").replace(",", "")


def _matrices(rows: list[list[float] | None]) -> Float64:
    return np.array([np.full(16, np.nan) if row is None else row for row in rows]).reshape(-1, 4, 4)


def code_of(method: str) -> str:
    """A hash of the code that a method stands on."""
    here = Path(__file__).parent
    sources = [here / "tracking_rivals.py"]
    if method not in RIVALS:
        sources = [here / "tracking_measure.py", here / "tracking_distant.py"]
        sources += sorted(file for room in TRACKER for file in (PACKAGE / room).rglob("*.py"))
    digest = hashlib.sha256(str(package_version("open3d")).encode())
    for source in sources:
        digest.update(source.read_bytes())
    return digest.hexdigest()
