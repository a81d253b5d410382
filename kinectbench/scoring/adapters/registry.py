"""The supported published methods by name; export of their inputs, and conversion of their outputs."""

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from kinectbench._version import __version__
from kinectbench.core import PredictionError, SettingsError, missing_extra, replaced_folder
from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.geometry import similarity_problem
from kinectbench.core.types import Float64, Progress, no_progress
from kinectbench.core.voxels.npz import UNREADABLE
from kinectbench.release.exchange.layouts import names_sha256, refuse_others
from kinectbench.release.exchange.rgbd import ViewCamera, camera_of, export_rgbd
from kinectbench.release.release import Release, Target
from kinectbench.scoring.adapters.adapter import Adapter, find_output
from kinectbench.scoring.adapters.octmae import OCTMAE
from kinectbench.scoring.adapters.patchcomplete import PATCHCOMPLETE
from kinectbench.scoring.adapters.pointr import POINTR
from kinectbench.scoring.adapters.rayst3r import RAYST3R
from kinectbench.scoring.adapters.sam3d import SAM3D
from kinectbench.scoring.camera_shape import write_shape

ADAPTERS: Mapping[str, Adapter] = {
    "rayst3r": RAYST3R,
    "octmae": OCTMAE,
    "sam3d": SAM3D,
    "pointr": POINTR,
    "patchcomplete": PATCHCOMPLETE,
}
# The key in the settings of method.json by which a later `adapt` recognises that a folder holds only its own
# output.
FILES = "files_sha256"
# Two poses of a view are equal if they differ by less; writing and reading JSON changes far less.
SAME_POSE = 1e-6


def _adapter_of(name: str) -> Adapter:
    if name not in ADAPTERS:
        raise SettingsError(f"'{name}': no such method; choose among {', '.join(ADAPTERS)}")
    return ADAPTERS[name]


def export_for(
    release: Release, out: Path, name: str, progress: Progress = no_progress
) -> tuple[int, list[str]]:
    """Write the views of a release to `out`, in the format that a method's own loader reads.

    Returns:
        The number of views, and notes of one line each (as `export_rgbd`).

    Raises:
        SettingsError: there is no adapter of this name, a package for it is not installed, or `out` holds
            something else.
        ReleaseError, StorageError: as in `export_rgbd`, or the adapter cannot write a view.
    """
    adapter = _adapter_of(name)
    if adapter.module and find_spec(adapter.module) is None:
        raise SettingsError(f"--for {name}: {missing_extra('methods')}", what="no-package")
    return export_rgbd(release, out, progress, name, adapter.write, "color" in adapter.inputs)


def adapt(
    release: Release, name: str, output: Path, out: Path, progress: Progress = no_progress
) -> tuple[int, list[str]]:
    """Convert a method's output into predictions in the camera frame, and write their method.json.

    Args:
        release: the release that contains the views.
        name: the method's name.
        output: folder with a subfolder `<recording>/<view>/` for each view, which holds the method's output
            and the camera.json that `export --for` wrote.
        out: a new or empty folder, or an earlier output of `adapt`, which is replaced.
        progress: called with (views done, views in all).

    Returns:
        The number of predictions, and a line for each view whose output cannot be used.

    Raises:
        SettingsError: unknown method, or `out` holds something else.
        PredictionError: no output can be used, or the method.json in `out` is damaged.
        ReleaseError: a pair of the release cannot be read.
        StorageError: the disk is full or read-only.
    """
    adapter = _adapter_of(name)
    if not output.is_dir():
        raise PredictionError(f"{output}: no such folder", what="no-folder")
    earlier = MethodFile.read_if_there(out) if out.is_dir() else None
    refuse_others(out, ((earlier and earlier.settings) or {}).get(FILES), MethodFile.FILE)
    problems, volumes, written = list[str](), dict[str, Float64](), 0
    with replaced_folder(out) as folder:
        for done, target in enumerate(release.targets, start=1):
            try:
                camera = _convert_view(release, name, adapter, output, target, folder)
                written += camera is not None
                if camera is not None and camera.volume_m is not None:
                    volumes[target.name] = camera.volume_m
            except PredictionError as error:
                problems.append(f"{target.name}: {error}")
            progress(done, len(release.targets))
        if not written:
            raise PredictionError(_nothing_converted(output, adapter, problems), what="none")
        method_file = MethodFile(
            name=name,
            benchmark_sha256=release.benchmark_sha256,
            frame="camera",
            form=adapter.form,  # type: ignore[arg-type]  # its words are those of the adapters
            unit="m",
            axes="cv",
            volume_m=volumes or None,
            inputs=adapter.inputs,
            settings={
                "adapted_by": f"kinectbench {__version__}",
                FILES: names_sha256(folder, MethodFile.FILE),
            },
        )
        method_file.write(folder)
    return written, problems


def _convert_view(
    release: Release, name: str, adapter: Adapter, output: Path, target: Target, folder: Path
) -> ViewCamera | None:
    """Convert one view's output, write it to `folder`, return its camera.json; None if there is no output."""
    view_folder = output / target.recording / target.view
    try:
        path = find_output(view_folder, adapter.output)
    except OSError as error:
        raise PredictionError(
            f"its folder cannot be listed ({error.strerror or error})", what="unreadable"
        ) from error
    if path is None:
        return None
    camera = ViewCamera.read(view_folder)
    T_camera_method = _method_to_camera(camera, name)
    if not np.allclose(camera.T_world_camera, camera_of(release, target)[1], rtol=0, atol=SAME_POSE):
        raise PredictionError(
            f"{ViewCamera.FILE}: of another release; export this one, and run {name} again",
            what="other-release",
        )
    try:
        shape = adapter.read(path).transformed(T_camera_method)
    except (ValueError, *UNREADABLE) as error:
        raise PredictionError(f"{path.name}: cannot be read ({error})", what="unreadable") from error
    write_shape(shape, folder / target.recording / target.view)
    return camera


def _method_to_camera(camera: ViewCamera, name: str) -> Float64:
    """Check camera.json, and return its similarity (4, 4) from the method's frame to the camera.

    Raises:
        PredictionError: the matrix is missing or no similarity, or the file was written for another method.
    """
    if camera.method != name or camera.T_camera_method is None:
        raise PredictionError(f"{ViewCamera.FILE}: not of `export --layout rgbd --for {name}`; export again")
    if problem := similarity_problem(camera.T_camera_method):
        raise PredictionError(f"{ViewCamera.FILE}: 'T_camera_method': {problem}; export again")
    return camera.T_camera_method


def _nothing_converted(output: Path, adapter: Adapter, problems: list[str]) -> str:
    """Return the error text if nothing was converted: the first problem, or that `output` has no file."""
    if problems:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        return f"{output}: nothing there can be used: {problems[0]}{more}"
    return f"{output}: no <recording>/<view>/{adapter.output} of the benchmark's views there"
