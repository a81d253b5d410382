"""Predict the pairs of a release with a trained network, and write the predictions with method.json."""

import ast
import inspect
import resource
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.util import resolve_name
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray

from kinectbench._version import __version__
from kinectbench.core import (
    KinectBenchError,
    PairError,
    PredictionError,
    listed,
    open_plain,
    sha256_file,
    sha256_text,
    storage_errors,
)
from kinectbench.core.artefacts.method import MethodFile, UnfinishedFile
from kinectbench.core.types import Progress, Split, no_progress
from kinectbench.core.voxels.npz import npz_bytes, packed_npz_bytes
from kinectbench.core.voxels.pair_file import FULL_CELLS, PairInput, checked_pair, pack, pair_values, unpack
from kinectbench.core.voxels.resample import upsampled_planes
from kinectbench.engine.locks import locked
from kinectbench.networks.allocator import memory_kept
from kinectbench.networks.config import OWN
from kinectbench.networks.prediction_folder import PredictionFolder
from kinectbench.networks.run_folder import hardware, make_folder
from kinectbench.networks.trained import Trained
from kinectbench.networks.validate import completed
from kinectbench.release.release import Release, Target
from kinectbench.scoring.prediction_file import packed

Precision = Literal["packed", "float16"]
SPLITS: tuple[Split, ...] = ("validation", "test")
# How probabilities are written: packed (see `packed_prediction`), or as float16 at full precision.
PRECISIONS: tuple[Precision, ...] = ("packed", "float16")
# Levels of deflate. float16 at 256^3 take 26 MB; compressing them further takes longer than predicting them.
# Packed ones take 6.7 MB at level 1, 6.1 MB at 4 and 5.8 MB at 6, in 0.15, 0.25 and 0.85 s a view.
LEVEL, PACKED_LEVEL = 1, 4
# Errors that concern one pair only, so that the others can still be predicted.
OF_ONE_PAIR = (PairError, PredictionError)
# Folders of installed packages; the folder of the user's code may contain one.
INSTALLED = {"site-packages", "dist-packages"}


def predict(
    trained: Trained,
    release: Release,
    out: Path,
    *,
    threshold: float | None = None,
    precision: Precision = "packed",
    splits: Sequence[Split] = SPLITS,
    progress: Progress = no_progress,
    say: Callable[[str], None] | None = None,
    failed: Callable[[str], None] | None = None,
) -> Path:
    """Write `out/<name>/<recording>/<view>.npz` for every pair of some splits, and method.json.

    A stopped run resumes, and keeps its complete files, if everything that determines their bytes is the same
    (`UnfinishedFile`). Otherwise existing predictions are removed first.

    Args:
        trained: the network.
        release: the release that is predicted.
        out: a folder of methods.
        threshold: write packed bits, which are set above this probability; None writes probabilities.
        precision: how probabilities at 256^3 are written: "packed" (8 bits) or "float16"; coarser grids are
            always float16.
        splits: "validation", "test" or both.
        progress: called with (pairs done, pairs in all).
        say: called with a line if predictions of another run are removed, or before waiting for another run
            to end.
        failed: called with a line for each pair that cannot be read, or for which an output of the network is
            no probability. With None, the first such error is raised; it is also raised if no pair has a
            prediction in the end.

    Returns:
        The method's folder.

    Raises:
        PairError, ReleaseError: a pair cannot be read, or a file of the release has changed.
        SettingsError: the splits have no pair, or the folder holds predictions for another release or files
            that `predict` did not write.
        PredictionError: method.json or unfinished.json of an earlier run cannot be read, or an output of the
            network is no probability.
        StorageError: the disk is full or read-only.
    """
    wanted = release.of_splits([split for split in SPLITS if split in splits])
    folder = out / trained.config.name
    make_folder(folder)
    run = run_of(trained, release, threshold, precision)
    every = [target for split in SPLITS for target in release.split(split)]

    def waiting(holder: str) -> None:
        if say:
            say(f"{folder}: waiting for {holder}")

    with locked(folder, waiting=waiting):
        kept = PredictionFolder(folder, run, every, wanted, say)
        seconds = _write_all(kept, trained, release, run, wanted, progress, failed)
        kept.finish(method_of(trained, release, run, seconds))
    return folder


def run_of(
    trained: Trained, release: Release, threshold: float | None, precision: Precision
) -> UnfinishedFile:
    """Return everything that determines the bytes of a run's prediction files; arguments as in `predict`."""
    # There is no key for values that are written unchanged, so that folders of earlier versions stay valid.
    is_fine = threshold is None and trained.network.output_cells == FULL_CELLS
    coded = {"precision": precision} if is_fine and precision == "packed" else {}
    own = {"code_sha256": _code_sha256(trained)} if trained.config.network.kind == OWN else {}
    more: dict[str, Any] = coded | own
    return UnfinishedFile(
        version=__version__,
        benchmark_sha256=release.benchmark_sha256,
        config_sha256=trained.config.sha256,
        weights_sha256=trained.weights_sha256,
        threshold=threshold,
        torch=str(torch.__version__),
        hardware=hardware(trained.device),
        **more,
    )


def _code_sha256(trained: Trained) -> str:
    """Return one hash of the network's code: the file that defines its class, and files imported there.

    Imported files count if they are in the folder of the outermost package with the class or, without a
    package, in the folder of the class's module. Subfolders, and imports of imports, are included; installed
    packages are not.
    """
    module = sys.modules[type(trained.network).__module__]
    root, packages = Path(inspect.getfile(module)).resolve().parent, module.__name__.count(".")
    for _ in range(packages if hasattr(module, "__path__") else packages - 1):
        root = root.parent
    paths: set[Path] = set()
    left = [module]
    while left:
        one = left.pop()
        path = Path(getattr(one, "__file__", None) or "").resolve()
        is_own = path.is_relative_to(root) and not INSTALLED & set(path.relative_to(root).parts)
        if path not in paths and is_own and path.is_file():  # torch names files that do not exist
            paths.add(path)
            left += _imported(one, path) if path.suffix == ".py" else ()
    with storage_errors(root):
        hashes = [sha256_file(path) for path in sorted(paths)]
    return hashes[0] if len(hashes) == 1 else sha256_text("".join(hashes))


def _imported(module: ModuleType, path: Path) -> Iterator[ModuleType]:
    """Yield the modules that a module's file imports, and the packages that contain them."""
    with storage_errors(path), open_plain(path) as file:
        tree = ast.parse(file.read())
    for node in ast.walk(tree):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import | ast.ImportFrom) else []
        if isinstance(node, ast.ImportFrom):
            relative = "." * node.level + (node.module or "")
            package = module.__package__ if node.level else None
            whole = resolve_name(relative, package) if package or not node.level else relative.lstrip(".")
            names = [whole, *(f"{whole}.{name}" for name in names)]
        for name in names:
            parts = name.split(".")
            yield from filter(None, (sys.modules.get(".".join(parts[:n])) for n in range(1, len(parts) + 1)))


def _write_all(
    kept: PredictionFolder,
    trained: Trained,
    release: Release,
    run: UnfinishedFile,
    targets: Sequence[Target],
    progress: Progress,
    failed: Callable[[str], None] | None,
) -> list[float]:
    """Predict and write the missing files; return the seconds that the network took for each such view."""
    waiting, first = [target for target in targets if not kept.holds(target)], list[KinectBenchError]()

    def failing(target: Target, error: KinectBenchError) -> None:
        if failed is None:
            raise error
        first.append(error)
        failed(f"{target.name}: {error}")

    def write(target: Target, probability: NDArray[np.float16]) -> None:
        kept.write(target, _prediction_bytes(probability, run))

    before = len(targets) - len(waiting)
    seconds = in_turn(
        trained, release, waiting, write, failing, lambda done, _: progress(before + done, len(targets))
    )
    if first and not any(map(kept.holds, targets)):
        raise first[0]
    return seconds


def in_turn(
    trained: Trained,
    release: Release,
    targets: Sequence[Target],
    use: Callable[[Target, NDArray[np.float16]], None],
    failing: Callable[[Target, KinectBenchError], None],
    progress: Progress,
) -> list[float]:
    """Predict pairs one after another; return the seconds that the network took for each.

    Args:
        trained: the network.
        release: the pairs' release.
        targets: the pairs.
        use: called with each pair and its probabilities (n, n, n), in order, on another thread: it works
            while the network predicts the next pair.
        failing: called with a pair that cannot be predicted, and its error.
        progress: called with (pairs done, pairs in all).
    """
    seconds, used = list[float](), None
    with memory_kept(), ThreadPoolExecutor(1) as user:
        for done, target in enumerate(targets, start=1):
            try:
                probability, took = completed_target(trained, release, target)
            except OF_ONE_PAIR as error:
                failing(target, error)
            else:
                seconds.append(took)
                if used:
                    used.result()
                used = user.submit(use, target, probability)
            progress(done, len(targets))
        if used:
            used.result()
    return seconds


def completed_target(trained: Trained, release: Release, target: Target) -> tuple[NDArray[np.float16], float]:
    """Complete the partial shape of a pair.

    Returns:
        The probabilities that cells are occupied, (n, n, n) float16, and the seconds that the network took.

    Raises:
        PairError, ReleaseError: the pair cannot be read.
        PredictionError: an output of the network is no probability.
    """
    where = str(release.pair_path(target))
    pair = checked_pair(PairInput, pair_values(release.pair_content(target), where), where)
    started = time.perf_counter()
    probability = completed(trained.network, unpack(pair.partial), trained.config, trained.device)
    return probability, time.perf_counter() - started


def _prediction_bytes(probability: NDArray[np.float16], run: UnfinishedFile) -> bytes:
    """Return the content of a prediction's file: bits at 256^3, or packed or float16 probabilities."""
    if run.threshold is not None:
        planes = upsampled_planes(probability)
        return packed_npz_bytes({"prediction": np.stack([pack(p > run.threshold) for p in planes])})
    if run.precision == "packed" and (arrays := packed(probability)):
        return npz_bytes(arrays, level=PACKED_LEVEL)
    return npz_bytes({"prediction": probability}, level=LEVEL)


def notes(trained: Trained, release: Release) -> list[str]:
    """Return caveats about the scores, one line each.

    A line is returned if the network was trained on test objects (it states how many and names one), if the
    test split has categories that the network was not trained on, or if the release has a framing (`object`
    or `view`) that the network was not trained on.
    """
    training = trained.training
    lines = []
    learnt = sorted({target.object for target in release.split("test")}.intersection(training.objects))
    if learnt:
        lines.append(f"learnt from {len(learnt)} of the test objects, such as {learnt[0]}: no fair scores")
    only, tested = trained.config.training.category, {target.category for target in release.split("test")}
    if others := sorted(tested - {only}) if only else ():
        lines.append(f"learnt from {only} alone, and predicts {listed(others)}")
    framing = release.metadata.framing
    if training.framings and framing not in training.framings:
        lines.append(
            f"learnt in framing {' and '.join(training.framings)}, and predicts in framing {framing}"
        )
    return lines


def method_of(
    trained: Trained, release: Release, run: UnfinishedFile, seconds: Sequence[float]
) -> MethodFile:
    """Return the method.json of a run; `seconds` has the network's time for each predicted view."""
    config, training = trained.config, trained.training
    return MethodFile(
        name=config.name,
        benchmark_sha256=release.benchmark_sha256,
        version=f"kinectbench {__version__}",
        inputs=("depth", "mask", "intrinsics", "framing"),
        parameter_count=trained.running_parameters,
        settings={
            "config": config.model_dump(mode="json"),
            "config_sha256": config.sha256,
            "weights_sha256": trained.weights_sha256,
            "threshold": run.threshold,
            "precision": run.precision,
            "torch": run.torch,
        }
        | ({} if run.code_sha256 is None else {"code_sha256": run.code_sha256}),
        training=training.model_dump(
            mode="json", exclude={"rows", "format_version", "name", "config_sha256", "objects"}
        )
        | {"notes": notes(trained, release)},
        # Bits are the same at every threshold, so no threshold is stated.
        threshold=training.threshold if run.threshold is None else None,
        hardware=run.hardware,
        seconds_per_view=round(float(np.mean(seconds)), 4) if seconds else None,
        peak_memory_mb=round(_peak_bytes(trained.device) / 1e6, 1),
    )


def _peak_bytes(device: str) -> float:
    """Return the peak memory so far of the GPU or, without one, of this process, bytes."""
    if device.startswith("cuda"):
        return float(torch.cuda.max_memory_allocated(device))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(peak if sys.platform == "darwin" else peak * 1024)
