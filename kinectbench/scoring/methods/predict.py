"""Predictions of a trained network for the pairs of a release, as any method's, with their method.json."""

import resource
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from kinectbench._version import __version__
from kinectbench.core.artefacts.method import MethodFile, UnfinishedFile
from kinectbench.core.errors import SettingsError
from kinectbench.core.storage import replaced_file, write_below
from kinectbench.core.types import Progress, Split
from kinectbench.core.voxels.npz import npz_bytes, packed_npz_bytes
from kinectbench.core.voxels.pair_file import PairInput, checked_pair, pack, pair_values, unpack
from kinectbench.core.voxels.resample import upsampled_planes
from kinectbench.release.release import Release, Target
from kinectbench.scoring.methods.allocator import memory_kept
from kinectbench.scoring.methods.run_folder import hardware, make_folder
from kinectbench.scoring.methods.trained import Trained
from kinectbench.scoring.methods.validate import completed

SPLITS: tuple[Split, ...] = ("validation", "test")
# Probabilities at 256^3 take 34 MB: to squeeze them further costs more time than to make them.
LEVEL = 1


def predict(
    trained: Trained,
    release: Release,
    out: Path,
    *,
    threshold: float | None = None,
    device: str = "cpu",
    progress: Progress | None = None,
) -> Path:
    """Write `out/<name>/<recording>/<view>.npz` for every test and validation pair, and method.json.

    What was stopped goes on where it was, if network, release and threshold are the same still.

    Args:
        trained: the network, on its device.
        release: what is predicted.
        out: a folder of methods.
        threshold: predictions are packed bits, set above it; None: probabilities, float16.
        device: that the network is on.
        progress: called with (pairs done, pairs in all).

    Returns:
        The method's folder.

    Raises:
        PairError, ReleaseError: a pair cannot be read.
        StorageError: the disk is full or read-only.
    """
    folder = out / trained.config.name
    make_folder(folder)
    _check_folder(folder, release)
    kept = _begin(folder, trained, release, threshold)
    targets = [target for split in SPLITS for target in release.split(split)]
    waiting = [target for target in targets if not (kept and _path(folder, target).is_file())]
    seconds = []
    # A file is squeezed and written while the network completes the next view.
    with memory_kept(), ThreadPoolExecutor(1) as writer:
        written: Future[None] | None = None
        for done, target in enumerate(waiting, start=1 + len(targets) - len(waiting)):
            where = str(release.pair_path(target))
            pair = checked_pair(PairInput, pair_values(release.pair_content(target), where), where)
            started = time.perf_counter()
            probability = completed(trained.network, unpack(pair.partial), trained.config, device)
            seconds.append(time.perf_counter() - started)
            if written:
                written.result()
            written = writer.submit(_write, _path(folder, target), probability, threshold)
            if progress:
                progress(done, len(targets))
        if written:
            written.result()
    text = _method(trained, release, threshold, seconds, device).text()
    with replaced_file(folder / MethodFile.FILE) as temporary:
        write_below(temporary, text.encode())
    (folder / UnfinishedFile.FILE).unlink()
    return folder


def _path(folder: Path, target: Target) -> Path:
    return folder / target.recording / f"{target.view}.npz"


def _write(path: Path, probability: NDArray[np.float16], threshold: float | None) -> None:
    with replaced_file(path) as temporary:
        temporary.write_bytes(prediction_bytes(probability, threshold))


def _begin(folder: Path, trained: Trained, release: Release, threshold: float | None) -> bool:
    """Note which run begins; whether what is there was left by the same one, which was stopped."""
    run = UnfinishedFile(
        version=__version__,
        benchmark_sha256=release.benchmark_sha256,
        config_sha256=trained.config.sha256,
        weights_sha256=trained.weights_sha256,
        threshold=threshold,
    )
    same = UnfinishedFile.read_if_there(folder) == run
    if not same:
        with replaced_file(folder / UnfinishedFile.FILE) as temporary:
            write_below(temporary, run.text().encode())
    (folder / MethodFile.FILE).unlink(missing_ok=True)  # until all is there, nothing says what it is of
    return same


def prediction_bytes(probability: NDArray[np.float16], threshold: float | None) -> bytes:
    """A prediction's file: probabilities as they are, or bits at 256^3, packed along the last axis."""
    if threshold is None:
        return npz_bytes({"prediction": probability}, level=LEVEL)
    return packed_npz_bytes(
        {"prediction": np.stack([pack(p > threshold) for p in upsampled_planes(probability)])}
    )


def notes(trained: Trained, release: Release) -> list[str]:
    """What a reader of the scores must know, a line each: test objects that were learnt, other framings."""
    training = trained.training
    found = []
    learnt = sorted({target.object for target in release.split("test")}.intersection(training.objects))
    if learnt:
        found.append(f"learnt from {len(learnt)} of the test objects, such as {learnt[0]}: no fair scores")
    framing = release.metadata.framing
    if training.framings and framing not in training.framings:
        found.append(
            f"learnt in framing {' and '.join(training.framings)}, and predicts in framing {framing}"
        )
    return found


def replaced_lines(trained: Trained, folder: Path) -> list[str]:
    """A line where other weights' predictions, of the same name, are about to be replaced."""
    kept = MethodFile.read_if_there(folder)
    of = (kept.settings or {}).get("weights_sha256") if kept else None
    if of is None or of == trained.weights_sha256:
        return []
    return [f"{folder}: replaces the predictions of other weights; --out keeps both"]


def _check_folder(folder: Path, release: Release) -> None:
    """Refuse a folder that holds predictions for another release, or none that `predict` wrote.

    Raises:
        SettingsError: it does.
    """
    kept, begun = MethodFile.read_if_there(folder), UnfinishedFile.read_if_there(folder)
    for of in (kept.benchmark_sha256 if kept else None, begun.benchmark_sha256 if begun else None):
        if of and of != release.benchmark_sha256:
            raise SettingsError(
                f"{folder}: holds predictions for another release ({of[:8]}…); choose another folder by --out"
            )
    # What begins with a dot is the system's, or half a file of a run that was killed at its start.
    if not kept and not begun and any(not path.name.startswith(".") for path in folder.iterdir()):
        raise SettingsError(
            f"{folder}: holds what `predict` did not write; choose another folder by --out, or move it away"
        )


def _method(
    trained: Trained, release: Release, threshold: float | None, seconds: list[float], device: str
) -> MethodFile:
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
            "threshold": threshold,
        },
        training=training.model_dump(
            mode="json", exclude={"rows", "format_version", "name", "config_sha256", "objects"}
        )
        | {"notes": notes(trained, release)},
        hardware=hardware(device),
        seconds_per_view=round(float(np.mean(seconds)), 4) if seconds else None,
        peak_memory_mb=round(_peak_bytes(device) / 1e6, 1),
    )


def _peak_bytes(device: str) -> float:
    """Most memory so far: of the GPU, or of this process."""
    if device.startswith("cuda"):
        return float(torch.cuda.max_memory_allocated(device))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(peak if sys.platform == "darwin" else peak * 1024)
