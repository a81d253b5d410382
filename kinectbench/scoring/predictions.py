"""Find the files in a folder of predictions, match them to the targets (pairs), and report problems."""

import contextlib
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from kinectbench.core import PredictionError, lies_below, listed_paths, name_problem, printable
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON
from kinectbench.core.artefacts.method import MethodFile, UnfinishedFile
from kinectbench.core.types import Bools, Progress, no_progress
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.release.release import Release, Target
from kinectbench.scoring.counts import Prediction
from kinectbench.scoring.grid_axes import MOST_LOOKED_AT, axes_problem
from kinectbench.scoring.mesh_prediction import IN_CAMERA, MESHES
from kinectbench.scoring.method_json import NAMED, changed_files, form_problem, method_problems, read_method
from kinectbench.scoring.prediction_file import load_hashed, load_prediction
from kinectbench.scoring.strays import OTHER_MESHES, SUFFIXES, stray_lines
from kinectbench.scoring.suspicious import MOST_OUTSIDE, Held, content_of, same_lines
from kinectbench.scoring.truth import read_parts, read_voxel_size

NO_PREDICTION = "no prediction; expected"
# The files that a method's folder should hold, in words.
EXPECTED = "<recording>/<view>.npy, .npz, .ply or .obj, or in the camera frame .glb"
# Maximum number of files in a folder of predictions; every release has fewer pairs.
MOST_FILES = 1_000_000


@dataclass(frozen=True)
class FoundPredictions:
    """The content of a method's folder.

    Attributes:
        files: the file of each target that has one.
        missing: targets without a file.
        problems: {target: why its file cannot be used}: several files, a link out of the folder, or a wrong
            format.
        stray: files that match no target, relative to the folder, sorted.
        method: the folder's method.json; None if there is none.
    """

    files: dict[Target, Path]
    missing: tuple[Target, ...]
    problems: dict[Target, str]
    stray: tuple[str, ...]
    method: MethodFile | None = None


def find_predictions(folder: Path, targets: Iterable[Target]) -> FoundPredictions:
    """Find the file of each target: `<recording>/<view>` with one of `SUFFIXES`.

    The names of targets must be safe as paths (see `parse_targets`).

    Raises:
        PredictionError: the folder is missing, cannot be listed or holds more than `MOST_FILES` files, or its
            method.json is refused (`read_method`).
    """
    _check_there(folder)
    with _readable(folder):
        return _matched(folder, targets, read_method(folder))


def _matched(folder: Path, targets: Iterable[Target], method: MethodFile | None) -> FoundPredictions:
    """Find the file of each target (see `find_predictions`) in a folder that exists."""
    root = folder.resolve()
    files: dict[Target, Path] = {}
    missing: list[Target] = []
    problems: dict[Target, str] = {}
    expected = {MethodFile.FILE, UnfinishedFile.FILE}
    for target in targets:
        expected.update(target.name + suffix for suffix in (*SUFFIXES, *OTHER_MESHES))
        candidates = [folder / target.recording / (target.view + suffix) for suffix in SUFFIXES]
        present = [path for path in candidates if path.is_symlink() or path.exists()]
        if not present:
            if other := _other_mesh(folder, target):
                problems[target] = other
            else:
                missing.append(target)
        elif len(present) > 1:
            suffixes = [path.suffix for path in present]
            both = "both " if len(suffixes) == 2 else ""
            listed = " and ".join([", ".join(suffixes[:-1]), suffixes[-1]])
            problems[target] = f"{target.name}: {both}{listed} are there; keep one"
        elif not lies_below(present[0], root):
            problems[target] = (
                f"{target.name}{present[0].suffix}: a link out of the folder; put the file itself"
            )
        elif other_form := form_problem(method, present[0].suffix):
            problems[target] = f"{target.name}{present[0].suffix}: {other_form}"
        else:
            files[target] = present[0]
    return FoundPredictions(files, tuple(missing), problems, stray_files(folder, expected), method)


def _other_mesh(folder: Path, target: Target) -> str | None:
    """Return a line if a target has a mesh file in an unsupported format; None if there is no such file."""
    for suffix in OTHER_MESHES:
        name = target.name + suffix
        if (folder / name).is_file():
            kinds = " or ".join(MESHES)
            return f"{name}: no kind of mesh that is read; save it as {kinds}, closed, in metres, {IN_CAMERA}"
    return None


def stray_files(folder: Path, expected: set[str]) -> tuple[str, ...]:
    """Return the unexpected files in a folder, relative to it, sorted; hidden files are left out.

    A link to a folder is listed like a file, unless it has the name of a folder with expected files.

    Raises:
        PredictionError: the folder has more than `MOST_FILES` files, or a folder cannot be listed.
    """
    strays, waiting, seen = list[str](), [(folder, "")], 0
    folders = {name.rpartition("/")[0] for name in expected}
    while waiting:
        inside, way = waiting.pop()
        with _readable(inside), os.scandir(inside) as entries:
            for entry in entries:
                seen += 1
                if seen > MOST_FILES:
                    raise PredictionError(
                        f"{folder}: more than {MOST_FILES} files; keep predictions only", what="too-large"
                    )
                name = way + entry.name
                if entry.name.startswith("."):
                    continue
                if entry.is_dir(follow_symlinks=False):
                    waiting.append((Path(entry.path), f"{name}/"))
                elif name not in expected and not (name in folders and entry.is_dir()):
                    strays.append(name)
    return tuple(sorted(strays))


@contextlib.contextmanager
def _readable(folder: Path) -> Iterator[None]:
    """Turn an OSError about an unreadable folder into a PredictionError of one line."""
    try:
        yield
    except OSError as error:
        where = printable(str(error.filename or folder))
        raise PredictionError(
            f"{where}: cannot be looked into ({error.strerror or error})", what="unreadable"
        ) from error


def missing_line(target: Target) -> str:
    """Return the message for a target without a file; it states the accepted file names."""
    return f"{target.name}: {NO_PREDICTION} {target.name}.npy, .npz, .ply or .obj"


def strays_of(release: Release, found: FoundPredictions) -> list[str]:
    """Return the lines of `stray_lines` on what was found in a method's folder."""
    missing, targets = [target.name for target in found.missing], set(release.targets)
    recordings = {target.recording for target in targets}
    answered = {target.recording for target in targets.difference(found.missing)}
    return stray_lines(found.stray, missing, recordings, answered)


def split_methods(folder: Path, targets: Iterable[Target]) -> dict[str, Path]:
    """Return the folder of each method: the given folder itself, or its subfolders if these hold predictions.

    If subfolders of the given folder are recordings with predictions, the folder is that of a single method.

    Returns:
        {method's name: folder}, sorted. The name is that of the folder.

    Raises:
        PredictionError: the folder is missing, holds no predictions, or belongs to a release; or a method's
            folder is a link out of the folder, or its name cannot be a method's name.
    """
    check_folder(folder)
    targets = list(targets)
    recordings = frozenset(target.recording for target in targets)
    with _readable(folder):
        if _answers(folder, recordings):
            return {folder.resolve().name: folder}
        found = [path for path in sorted(listed_paths(folder)) if path.is_dir()]
        methods = [path for path in found if _answers(path, recordings)]
    if not methods:
        advice = f"expected {EXPECTED}{_such(targets)}, or a folder of these per method"
        names = {name.lower(): name for name in recordings}
        for path in found:
            if (name := names.get(path.name.lower(), path.name)) != path.name:
                advice = f"rename {printable(path.name)}/ to {name}/ (letter case matters)"
                break
        raise PredictionError(f"{folder}: no predictions there; {advice}", what="none")
    for path in methods:
        if not lies_below(path, folder.resolve()):
            raise PredictionError(
                f"{path}: a link out of the folder; put the predictions themselves there", what="link"
            )
        check_method(path.name)
    return {path.name: path for path in methods}


def lines_without(folder: Path, methods: Mapping[str, Path], targets: Iterable[Target]) -> list[str]:
    """Return a line for each subfolder without predictions in a folder of several methods.

    Hidden subfolders are skipped. At most 20 are named; one more line gives the number of the others. The
    first test target serves as an example.
    """
    if folder in methods.values():
        return []
    with _readable(folder):
        others = sorted(
            path.name
            for path in listed_paths(folder)
            if path.is_dir() and path.name not in methods and not path.name.startswith(".")
        )
    expected = f"{EXPECTED}{_such(targets)}"
    lines = [f"{printable(name)}/: no prediction there; expected {expected}" for name in others[:NAMED]]
    return lines + [f"and {len(others) - NAMED} more folders without a prediction"] * (len(others) > NAMED)


def declared_folders(folder: Path) -> list[Path]:
    """Return the folder itself if it has a method.json, else its subfolders that have one, sorted.

    Raises:
        PredictionError: the folder cannot be listed.
    """
    if (folder / MethodFile.FILE).is_file():
        return [folder]
    with _readable(folder):
        return sorted(path for path in listed_paths(folder) if (path / MethodFile.FILE).is_file())


def _such(targets: Iterable[Target]) -> str:
    return next((f", such as {target.name}.npy" for target in targets if target.split == "test"), "")


def _check_there(folder: Path) -> None:
    if not folder.is_dir():
        fault = "a file, not a folder" if folder.exists() else "there is no such folder"
        advice = f"give the folder of your predictions, with {EXPECTED}"
        raise PredictionError(f"{folder}: {fault}; {advice}", what="no-folder")


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot hold predictions of any release.

    Raises:
        PredictionError: the folder is missing, is a release, or lies directly in one.
    """
    _check_there(folder)
    if any((path / BENCHMARK_JSON).is_file() for path in (folder, folder.resolve().parent)):
        raise PredictionError(
            f"{folder}: belongs to a release; give the folder of your predictions", what="no-folder"
        )


def _answers(folder: Path, recordings: frozenset[str]) -> bool:
    """Return whether a subfolder that is named like a recording has a file with a prediction's suffix."""
    with os.scandir(folder) as entries:
        named = [entry.path for entry in entries if entry.name in recordings and entry.is_dir()]
    for path in named:
        with os.scandir(path) as entries:
            if any(Path(entry.name).suffix.lower() in (*SUFFIXES, *OTHER_MESHES) for entry in entries):
                return True
    return False


def check_method(name: str) -> None:
    """Refuse invalid method names, because names become folder names and table cells.

    Raises:
        PredictionError: the name has characters other than letters, digits and a few signs, or is reserved.
    """
    if problem := name_problem(name, also="+"):
        raise PredictionError(
            f"'{printable(name)}': no name for a method: {problem}; rename its folder, or say --method NAME",
            what="bad-name",
        )


def check(release: Release, folder: Path) -> list[str]:
    """Return the problems that `check_grids` finds, without its notes."""
    return check_grids(release, folder)[0]


def check_grids(
    release: Release, folder: Path, progress: Progress = no_progress
) -> tuple[list[str], list[str]]:
    """Check one method's predictions of the test split, and of the validation split if it predicts any of it.

    Args:
        release: the release that was predicted.
        folder: one method's predictions.
        progress: called with (targets done, targets in all).

    Returns:
        The problems, one line each: first those of method.json, then those of the targets in order, then
        swapped axes and stray files. And notes on predictions that do not depend on their view, as they are
        constant or equal.

    Raises:
        PredictionError: the folder is missing, or its method.json is refused (`read_method`).
        ReleaseError: a pair file is missing or changed.
    """
    predictions = find_predictions(folder, release.targets)
    answered = {target.split for target in (*predictions.files, *predictions.problems)}
    required = {"test", "validation"} & answered | {"test"}
    missing = {target: missing_line(target) for target in predictions.missing if target.split in required}
    problems, readable = method_problems(folder, predictions.method, release), dict[Target, Held]()
    for done, target in enumerate(release.targets, start=1):
        line = predictions.problems.get(target) or missing.get(target)
        if target in predictions.files:
            found = _file_content(release, target, predictions.files[target], predictions.method)
            line = found if isinstance(found, str) else None
            readable |= {} if isinstance(found, str) else {target: found}
        if line:
            problems.append(line)
        progress(done, len(release.targets))
    if line := axes_problem(_looked_at(release, predictions, list(readable))):
        problems.append(line)
    problems += strays_of(release, predictions)
    return problems, list(same_lines({target.name: of for target, of in sorted(readable.items())}))


def misplaced(release: Release, folder: Path) -> str | None:
    """Return a line if one method's grids, of those that can be read, have other axes or lie elsewhere.

    None for meshes, for predictions in the camera frame, and for what is refused.
    """
    try:
        predictions = find_predictions(folder, release.targets)
    except PredictionError:
        return None
    grids = [target for target, path in predictions.files.items() if path.suffix not in MESHES]
    return axes_problem(_looked_at(release, predictions, grids))


def _looked_at(
    release: Release, predictions: FoundPredictions, readable: Sequence[Target]
) -> Iterator[tuple[Prediction, Bools]]:
    """Yield evenly spread predictions, each with its view's `partial_256`, bool (256, 256, 256)."""
    for target in sorted(readable)[:: -(-len(readable) // MOST_LOOKED_AT) or 1]:
        names = ("partial_256", "voxel_size_m")
        partial, size_m = read_parts(release.pair_path(target), target.sha256, names)
        with contextlib.suppress(PredictionError):
            yield load_prediction(predictions.files[target], voxel_size_m=float(size_m)), unpack(partial)


def _file_content(release: Release, target: Target, path: Path, method: MethodFile | None) -> str | Held:
    """Return why a prediction's file is faulty; if it is not, return a digest of the prediction."""
    size_m = read_voxel_size(release.pair_path(target), target.sha256) if path.suffix in MESHES else None
    name = target.name + path.suffix
    try:
        loaded = load_hashed(path, name, size_m)
    except PredictionError as error:
        return str(error)
    if loaded.outside_share > MOST_OUTSIDE:
        share = f"{loaded.outside_share:.0%}"
        return f"{name}: {share} of its volume lies outside the cube: use the grid's axes, {IN_CAMERA}"
    if changed_files(method, {name: loaded.digest}):
        return f"{name}: not what its run of `predict` wrote: changed since, or of another run; predict again"
    return content_of(loaded.prediction)
