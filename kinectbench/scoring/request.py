"""The options of `score`, and checks that they agree with each other and with each method.json."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from kinectbench.core import SettingsError, require_extra
from kinectbench.core.artefacts.score_figures import CLOSINGS
from kinectbench.core.types import Progress, no_progress
from kinectbench.core.voxels.resample import CONVENTIONS, HALF_PIXEL
from kinectbench.engine.executor import Executor
from kinectbench.scoring.method_json import read_in_camera, read_method
from kinectbench.scoring.predictions import check_folder, declared_folders
from kinectbench.scoring.protocols import check_protocols, protocols_in_space, space_alone
from kinectbench.scoring.rounds import Missing
from kinectbench.scoring.thresholds import read_thresholds


@dataclass(frozen=True)
class Request:
    """The options of `score`, which may contradict each other or the predictions.

    Attributes:
        protocols: names of `PROTOCOLS`, or camera, aligned or both; None: all that apply, except shell.
        thresholds_file: a threshold file (`read_thresholds`); then nothing is chosen on the validation split.
        save_thresholds: a file for the thresholds; at least one must be chosen on the validation split.
        missing: "error" lists a missing prediction as a failure; "empty" scores an empty one in its place.
        upsampling: "half-pixel" or "corner-aligned" (see `upsampled_planes`).
        surface: whether surface metrics are computed; they take most of the time.
        close: one of `CLOSINGS`, to make open meshes and points in the camera frame solid; None: not at all.
        jobs: number of processes, or an executor for other machines, or (to check it) that one's address; the
            result does not depend on it.
        progress: called with (pairs done, pairs in all), for each method in turn.
        in_parts: whether only one part of the pairs is counted (`count_methods`).
    """

    protocols: Sequence[str] | None = None
    thresholds_file: Path | None = None
    save_thresholds: Path | None = None
    missing: str = "error"
    upsampling: str = HALF_PIXEL
    surface: bool = True
    close: str | None = None
    jobs: int | Executor | str = 1
    progress: Progress = no_progress
    in_parts: bool = False

    @property
    def here(self) -> int:
        """The number of processes for what is done on this machine."""
        return self.jobs if isinstance(self.jobs, int) else 1


def check_request(request: Request, predictions: Path | None) -> Missing:
    """Refuse wrong options, as far as this is possible without the release.

    Args:
        request: the options.
        predictions: a method's folder, or a folder of methods; None if baselines are scored.

    Returns:
        How a missing prediction is treated.

    Raises:
        SettingsError: an option is wrong, or contradicts another option or a method.json.
        PredictionError: the folder is missing or belongs to a release, or a method.json is refused.
    """
    rule = check_missing(request.missing)
    check_words(request.protocols, request.upsampling, request.close)
    if request.thresholds_file is not None:
        if request.save_thresholds is not None:
            raise SettingsError(
                f"--save-thresholds {request.save_thresholds}: with --thresholds none are found; drop one"
            )
        read_thresholds(request.thresholds_file, (), frozenset())
    if predictions is not None:
        check_folder(predictions)
        for folder in declared_folders(predictions):
            check_declared(request, folder, of_several=folder != predictions)
    if space := space_alone(request.protocols, HALF_PIXEL if predictions else request.upsampling):
        _refuse_elsewhere(request, f"surfaces under {', '.join(space)}")
    return rule


def check_declared(request: Request, folder: Path, *, of_several: bool = False) -> None:
    """Refuse options that contradict the method.json of one method.

    Without a method.json, predictions are in the pairs' grid. If other methods are scored, too
    (`of_several`), a method that the protocols do not fit is left out, and raises no error.

    Raises:
        SettingsError: an option does not apply to predictions in the method's frame (camera, or the pair's
            grid).
        PredictionError: the method.json is refused (`read_method`).
    """
    check_words(request.protocols, request.upsampling, request.close)
    declared = read_in_camera(folder)
    if declared is None:
        read_method(folder)
        if space := space_alone(request.protocols, request.upsampling, request.close):
            _refuse_elsewhere(request, f"surfaces under {', '.join(space)}")
        return
    if not of_several:
        protocols_in_space(request.protocols, declared)
    options = {"--thresholds": request.thresholds_file, "--save-thresholds": request.save_thresholds}
    for name, given in options.items():
        if given is not None:
            raise SettingsError(f"{name} {given}: {declared.name} in the camera frame has none")
    _refuse_elsewhere(request, f"{folder}: predictions in the camera frame")


def _refuse_elsewhere(request: Request, what: str) -> None:
    """Raise an error if the options ask for parts or other machines; `what` is a plural noun, the subject."""
    if request.in_parts:
        raise SettingsError(f"{what} are not scored in parts; leave out --shard")
    if not isinstance(request.jobs, int):
        raise SettingsError(f"--cluster: {what} are scored on one machine; use --jobs")


def check_words(protocols: Sequence[str] | None, upsampling: str, close: str | None = None) -> None:
    """Refuse unknown names of protocols, upsamplings and ways to close meshes.

    Raises:
        SettingsError: a name is not known, or a package that it needs is not installed.
    """
    check_protocols(protocols)
    if upsampling not in CONVENTIONS:
        raise SettingsError(f"no upsampling '{upsampling}': choose {' or '.join(CONVENTIONS)}")
    if close not in (None, *CLOSINGS):
        raise SettingsError(f"--close {close}: choose {' or '.join(CLOSINGS)}")
    if close == "poisson":
        require_extra("build", f"--close {close}")


def check_missing(missing: str) -> Missing:
    """Return how a missing prediction is treated.

    Raises:
        SettingsError: the word is neither "error" nor "empty".
    """
    if missing not in get_args(Missing):
        raise SettingsError(f"--missing {missing}: choose error or empty")
    return "empty" if missing == "empty" else "error"
