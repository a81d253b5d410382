"""A folder of predictions in the camera frame: find each view's files, and compare them with its depth."""

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinectbench.core import PredictionError, lies_below
from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.geometry import invert_rigid, transform_points
from kinectbench.core.types import Float64, Progress, no_progress
from kinectbench.core.voxels.pair_file import FULL_CELLS
from kinectbench.release.exchange.rgbd import parts_of, read_view
from kinectbench.release.release import Release, Target
from kinectbench.scoring.camera_shape import SUFFIXES, CameraShape, read_shape, similarity_to_camera
from kinectbench.scoring.closed_mesh import closed_mesh, open_because, refuse_mesh
from kinectbench.scoring.depth_agreement import (
    LARGE,
    SCENE,
    SMALL,
    Agreement,
    agreement,
    beyond_share,
    likeliest,
)
from kinectbench.scoring.method_json import method_problems
from kinectbench.scoring.predictions import NO_PREDICTION, stray_files
from kinectbench.scoring.strays import stray_lines
from kinectbench.scoring.suspicious import Held, content_of, same_lines

# Number of predictions that `score` compares with their depth (chosen here).
LOOKED_AT = 5


@dataclass(frozen=True)
class CameraPredictionFile:
    """The file of one prediction.

    Attributes:
        target: the predicted view.
        name: `<recording>/<view>`, without the file's suffix; of several hypotheses, number k is
            `<recording>/<view>.<k>`.
        path: the file.
    """

    target: Target
    name: str
    path: Path


def _names_of(target: Target, hypotheses: int) -> list[str]:
    """Return the names of a view's predictions; several hypotheses are numbered from 0."""
    return [target.name] if hypotheses == 1 else [f"{target.name}.{k}" for k in range(hypotheses)]


def find_files(
    folder: Path, targets: Iterable[Target], method: MethodFile
) -> Iterator[tuple[Target, str, CameraPredictionFile | str | None]]:
    """Yield (view, name, file) of each expected prediction.

    If the file cannot be used, the reason is yielded in its place; if there is no file, None.
    """
    root = folder.resolve()
    for target in targets:
        for name in _names_of(target, method.hypotheses):
            present = [path for suffix in SUFFIXES if (path := folder / f"{name}{suffix}").is_file()]
            if not present:
                yield target, name, None
            elif len(present) > 1:
                yield (
                    target,
                    name,
                    f"{name}: {' and '.join(path.suffix for path in present)} are there; keep one",
                )
            elif not lies_below(present[0], root):
                yield (
                    target,
                    name,
                    f"{name}{present[0].suffix}: a link out of the folder; put the file itself",
                )
            else:
                yield target, name, CameraPredictionFile(target, name, present[0])


def load_camera_shape(file: CameraPredictionFile, method: MethodFile) -> CameraShape:
    """Read a prediction in its view's camera frame, metres; any unit if `scale` in method.json is "free".

    Raises:
        PredictionError: the file is invalid, or not of the declared form; the message is one line.
    """
    where = f"{file.name}{file.path.suffix}"
    shape = read_shape(file.path, where)
    # A mesh without faces is a cloud of points.
    if "form" in method.model_fields_set and shape.form != method.form:
        raise PredictionError(
            f"{where}: {MethodFile.FILE} says 'form': '{method.form}', and it holds {shape.form}; correct one"
        )
    return shape.transformed(similarity_to_camera(method, file.name, file.target.name))


def view_agreement(release: Release, file: CameraPredictionFile, method: MethodFile) -> Agreement | None:
    """Compare a prediction with its view's depth; return None if no point of the object was measured.

    Raises:
        PredictionError: the file is invalid.
        ReleaseError: the release has no depth images, or one is damaged.
    """
    shape = load_camera_shape(file, method)
    view = read_view(release, file.target)
    points_m = view.object_points_m
    if not len(points_m):
        return None
    T_world_grid, size_m = parts_of(release, file.target, ("T_world_grid", "voxel_size_m"))
    T = similarity_to_camera(method, file.name, file.target.name)
    found = agreement(shape, points_m, T, view.T_world_camera, T_world_grid)
    T_grid_camera = invert_rigid(T_world_grid) @ view.T_world_camera
    return replace(
        found,
        beyond_share=beyond_share(shape, T_grid_camera, float(size_m) * FULL_CELLS),
        refused=_refused(shape, T_grid_camera, float(size_m)),
        open_because=open_because(shape),
        content=_shape_digest(shape),
    )


def _shape_digest(shape: CameraShape) -> Held:
    return content_of(shape.points_m, shape.faces)


def _refused(shape: CameraShape, T_grid_camera: Float64, voxel_size_m: float) -> str:
    """Return why a closed mesh cannot be made solid in the grid; "" if it can, or if it is no closed mesh."""
    if (mesh := closed_mesh(shape)) is None:
        return ""
    try:
        refuse_mesh(transform_points(T_grid_camera, mesh.vertices_m), mesh.faces, voxel_size_m)
    except PredictionError as error:
        return str(error).partition(";")[0]
    return ""


def check_camera(
    release: Release, folder: Path, method: MethodFile, progress: Progress = no_progress
) -> tuple[list[str], list[str]]:
    """Check one method's predictions in the camera frame.

    Args:
        release: the release that was predicted.
        folder: the folder of predictions.
        method: the method's method.json.
        progress: called with (predictions done, predictions in all).

    Returns:
        The problems, one line each; and notes on the usable predictions, such as how well they fit their
        views' depth.

    Raises:
        ReleaseError: a depth image or a pair is missing or damaged.
    """
    problems = method_problems(folder, method, release)
    problems += [
        f"{MethodFile.FILE}: 'T_camera_prediction' has '{name}', which is no view here; correct it"
        for name in sorted(_unknown(release, method))[:1]
    ]
    compared, contents, answered = dict[str, Agreement](), dict[str, Held](), 0
    last: Target | None = None
    is_compared = method.scale == "metric" and not _without_depth(release)
    for done, (target, name, found) in enumerate(find_files(folder, release.targets, method), start=1):
        if isinstance(found, CameraPredictionFile):
            answered += 1
            try:
                if not is_compared:
                    content: Held | None = _shape_digest(load_camera_shape(found, method))
                elif (here := view_agreement(release, found, method)) is not None:
                    compared[name], content = here, here.content
                else:
                    content = None
                # Several predictions of one view may be equal.
                contents |= {name: content} if content and last is not target else {}
                last = target
            except PredictionError as error:
                problems.append(str(error))
        elif found is not None:
            problems.append(found)
        elif target.split == "test":
            problems.append(missing_in_camera(name))
        progress(done, len(release.targets) * method.hypotheses)
    slips, notes = _problems_and_notes(compared, method)
    problems += [*slips, *strays_in_camera(release, folder, method)]
    said = [*_summary(release, method, compared, answered), *notes, *_open_lines(compared)]
    return problems, [*said, *same_lines(contents)]


def _open_lines(compared: Mapping[str, Agreement]) -> list[str]:
    """Return a line on how many predicted meshes are open, and why one of them is; [] if none is open."""
    why = {name: one.open_because for name, one in compared.items() if one.open_because}
    return [
        f"{len(why)} of {len(compared)} predictions are open meshes, such as {name} ({reason}): they have no "
        "inside, so they have metrics of surfaces alone"
        for name, reason in list(why.items())[:1]
    ]


def depth_warnings(release: Release, files: Sequence[CameraPredictionFile], method: MethodFile) -> list[str]:
    """Return a line if predictions seem to have a wrong unit or wrong axes, or to be far off; else [].

    Only five predictions are compared (0.1 s each): a method's predictions usually all have the same error.
    """
    if method.scale == "free" or _without_depth(release):
        return []
    compared = dict[str, Agreement]()
    for file in files[:: max(len(files) // LOOKED_AT, 1)][:LOOKED_AT]:
        with contextlib.suppress(PredictionError):  # reported by `score`
            if (found := view_agreement(release, file, method)) is not None:
                compared[file.name] = found
    slips, notes = _problems_and_notes(compared, method)
    return [f"{line}; `kinectbench check` looks at all" for line in [*slips, *notes][:1]]


def _problems_and_notes(compared: Mapping[str, Agreement], method: MethodFile) -> tuple[list[str], list[str]]:
    """Return (problems, notes) about predictions that were compared with their views' depth, one line each.

    Problems are wrong units or axes, and meshes that cannot be made solid; `check` reports them as errors,
    `score` as warnings. Notes are on predictions that seem to contain the whole scene, or that are far from
    their view's depth for an unknown reason.
    """
    slips = dict(zip(compared, likeliest(list(compared.values())), strict=True))
    problems = [f"{name}: {compared[name].line(slip, method)}" for name, slip in slips.items() if slip]
    others = {name: one for name, one in compared.items() if not slips[name]}
    problems += [
        f"{name}: {one.refused}, so that it cannot be scored; keep the object alone"
        for name, one in others.items()
        if one.refused
    ]
    notes = [
        f"{name}: {one.beyond_share:.0%} of it (bound {SCENE:.0%}) lies far beyond the object: the whole "
        "scene? Keep the object alone"
        for name, one in others.items()
        if one.is_scene and not one.refused
    ]
    if far := [name for name, one in others.items() if one.is_large]:
        notes.append(
            f"{len(far)} predictions are farther from their depth than {LARGE:.0%} of what the view "
            f"measured, such as {far[0]}; no usual error of unit or axes explains it"
        )
    return problems, notes


def missing_in_camera(name: str) -> str:
    """Return the message for a missing prediction; it states the accepted file names."""
    return f"{name}: {NO_PREDICTION} {name}{', '.join(SUFFIXES)}"


def strays_in_camera(release: Release, folder: Path, method: MethodFile) -> list[str]:
    """Return a line for each of the first 20 files in a folder that belong to no view, and on the rest."""
    names = [name for target in release.targets for name in _names_of(target, method.hypotheses)]
    expected = {MethodFile.FILE, *(name + suffix for name in names for suffix in SUFFIXES)}
    missing = [name for name in names if not any((folder / (name + end)).exists() for end in SUFFIXES)]
    recordings = {target.recording for target in release.targets}
    answered = {name.partition("/")[0] for name in set(names).difference(missing)}
    return stray_lines(stray_files(folder, expected), missing, recordings, answered)


def _unknown(release: Release, method: MethodFile) -> set[str]:
    """Return the keys of `T_camera_prediction` in method.json that name neither a view nor a prediction."""
    names = {name for target in release.targets for name in _names_of(target, method.hypotheses)}
    return set(method.T_camera_prediction or ()) - names - {target.name for target in release.targets}


def _without_depth(release: Release) -> bool:
    return not any(name.endswith(".depth.png") for name in release.sums)


def _summary(
    release: Release, method: MethodFile, compared: dict[str, Agreement], answered: int
) -> list[str]:
    if method.scale == "free":
        return [f"{answered} predictions are readable; of free size: none is compared with its depth"]
    if _without_depth(release):
        return [f"{answered} predictions are readable; the release has no depth to compare them with"]
    if not compared:
        return []
    distances_m = {name: one.distance_m for name, one in compared.items()}
    where = max(distances_m, key=lambda name: distances_m[name])
    middle, largest = float(np.median(list(distances_m.values()))), distances_m[where]
    return [
        f"median distance from each prediction to its view's own depth: {middle * 1000:.1f} mm in the "
        f"median of {len(distances_m)}, {largest * 1000:.1f} mm at most ({where}), which is "
        f"{largest / max(compared[where].diagonal_m, 1e-9):.1%} of the size of what it measured; up to "
        f"{SMALL:.0%} is well, beyond {LARGE:.0%} is named"
    ]
